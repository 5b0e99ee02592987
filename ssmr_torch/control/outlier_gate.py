"""An outlier gate for a filter: it rejects innovations that the covariance cannot explain, but only a few in a row."""

from __future__ import annotations

import numpy as np

# Standard deviations, of the largest recent innovations, beyond which a measurement is an outlier.
SIGMAS = 6.0
# Outliers in a row after which the gate opens, because then the filter must be wrong.
MOST_IN_A_ROW = 3
# Share of the largest innovation that is remembered from one sample to the next, and its value at first.
MEMORY, AT_FIRST = 0.98, 100.0


class InnovationGate:
    """Passes an innovation e (p,) with covariance S (p, p) where m² = eᵀ S⁻¹ e / p ≤ SIGMAS² s.

    The scale s follows the largest m² that passed, s⁺ = max(1, MEMORY s, m²). A wrong model makes innovations larger
    than its filter expects, but not suddenly. At first s is AT_FIRST. After `MOST_IN_A_ROW` outliers one passes, and s
    grows by a factor of at most SIGMAS². An innovation that is not finite never passes.
    """

    def __init__(self):
        self.reset()

    def reset(self) -> None:
        """Return to the state before the first innovation."""
        self._scale, self._shut = AT_FIRST, 0

    def passes(self, distance: float) -> bool:
        """distance: m²."""
        if not np.isfinite(distance):
            return False
        widest = SIGMAS**2 * self._scale
        if distance > widest and self._shut < MOST_IN_A_ROW:
            self._shut += 1
            return False
        self._shut = 0
        self._scale = max(1.0, MEMORY * self._scale, min(distance, widest))
        return True
