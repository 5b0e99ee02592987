"""Spectral submanifold reduction (SSMR) and its linear counterpart (SSSR) as Torch modules."""

from __future__ import annotations

from ssmr_torch.checked_arguments import checked
from ssmr_torch.models.named_structures import ssm_structure
from ssmr_torch.models.torch_model import PolynomialTorchModel, check_degrees, table
from ssmr_torch.quantities import DEGREE, DEGREE_OR_NONE, DELAYS, MODEL_TIMESTEP, STATES, SUBSTEPS, TIMESTEP
from ssmr_torch.ranges import OrNone


class SSMR(PolynomialTorchModel):
    """Dynamics on a spectral submanifold, observed through a window of delayed outputs (paper, Eq. 3 and 7).

        z = v(ŷ) = chart · ŷ^{1:n_v},   ŷ = w(z) = parametrization · z^{1:n_w},
        dz/dt = drift · z^{1:n_r} + control · [u, z^{1:n_u} ⊗ u],

    with ŷ the window flattened oldest sample first. n_v = 1 gives the orthogonal chart Vᵀ; control_degree n_u = 0 gives
    a constant input matrix. A step is `substeps` Runge-Kutta steps of order four with the input held.

    chart (n, ·), parametrization ((n_d + 1) p, ·), drift_table (n, ·), control_table (n, m (1 + ·)), over monomials in
    graded order.
    Raises ValueError if the window holds fewer values than state_dim, because no chart of that dimension exists.
    """

    tables = {"chart": ("chart",), "parametrization": ("parametrization",),
              "dynamics": ("drift_table", "control_table")}

    @checked(state_dim=STATES, delays=DELAYS, timestep=MODEL_TIMESTEP, window_timestep=OrNone(TIMESTEP),
             parametrization_degree=DEGREE, dynamics_degree=DEGREE, control_degree=DEGREE_OR_NONE,
             chart_degree=DEGREE, substeps=SUBSTEPS)
    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int = 1, *,
                 parametrization_degree: int = 3, dynamics_degree: int = 3, control_degree: int = 1,
                 chart_degree: int = 1, timestep: float = 0.01, window_timestep: float | None = None,
                 substeps: int = 2):
        super().__init__(state_dim, input_dim, output_dim, delays, timestep, window_timestep)
        if self.window_dim < state_dim:
            raise ValueError(f"a window of {delays + 1} samples of {output_dim} outputs holds {self.window_dim} "
                             f"values, fewer than the {state_dim} reduced coordinates; use at least "
                             f"{-(-state_dim // output_dim) - 1} delays or a smaller state_dim")
        check_degrees(parametrization_degree=parametrization_degree, dynamics_degree=dynamics_degree,
                      chart_degree=chart_degree, substeps=substeps)
        if int(control_degree) != control_degree or control_degree < 0:
            raise ValueError(f"control_degree is {control_degree}; expected 0 (constant) or more")
        self.parametrization_degree, self.dynamics_degree = int(parametrization_degree), int(dynamics_degree)
        self.control_degree, self.chart_degree = int(control_degree), int(chart_degree)
        self.substeps = int(substeps)
        self.structure = ssm_structure(
            self.state_dim, self.input_dim, self.window_dim, parametrization_degree=self.parametrization_degree,
            dynamics_degree=self.dynamics_degree, control_degree=self.control_degree, chart_degree=self.chart_degree)
        n, inputs = self.state_dim, sum(factors[-1] >= self.state_dim for factors in self.structure.dynamics.factors)
        self.chart = table(n, len(self.structure.chart))
        self.parametrization = table(self.window_dim, len(self.structure.parametrization))
        self.drift_table = table(n, len(self.structure.dynamics) - inputs)
        self.control_table = table(n, inputs)


class SSSR(SSMR):
    """The linear counterpart of SSMR: all degrees are 1; the control field is affine in z, so the dynamics are
    bilinear.

        z = Vᵀ ŷ,   ŷ = V z,   dz/dt = drift · z + control · [u, z ⊗ u].
    """

    @checked(state_dim=STATES, delays=DELAYS, timestep=MODEL_TIMESTEP, window_timestep=OrNone(TIMESTEP),
             control_degree=DEGREE_OR_NONE, substeps=SUBSTEPS)
    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int = 1, *, control_degree: int = 1,
                 timestep: float = 0.01, window_timestep: float | None = None, substeps: int = 2):
        super().__init__(state_dim, input_dim, output_dim, delays, parametrization_degree=1, dynamics_degree=1,
                         control_degree=control_degree, timestep=timestep, window_timestep=window_timestep,
                         substeps=substeps)
