"""Control-augmented spectral submanifold: reduced dynamics in the joint space of state and input."""

from __future__ import annotations

from ssmr_torch.checked_arguments import checked
from ssmr_torch.models.named_structures import control_augmented_structure
from ssmr_torch.models.torch_model import PolynomialTorchModel, check_degrees, table
from ssmr_torch.quantities import DEGREE, DELAYS, MODEL_TIMESTEP, STATES, TIMESTEP, TRUTH
from ssmr_torch.ranges import OrNone


class ControlAugmentedSSMR(PolynomialTorchModel):
    """Dynamics on the spectral submanifold of a robot whose state includes its input, which is held over a step:

        z = v(ŷ, û) = chart · [ŷ, û],   y = w(z) = parametrization · z^{1:n_w},
        z⁺ = z + h · dynamics · (z, u)^{1:n_r},   u⁺ = u,

    with the window ŷ and the inputs û held between its samples, both flattened oldest first, h = base_timestep, and the
    monomials of z and u together, of degree up to n_u in u. The manifold then depends on the input, and no input matrix
    has to be calibrated afterwards [Wolff et al., Learning actuator-aware spectral submanifolds for precise control of
    continuum robots, 2026]. The chart uses the inputs to remove their direct effect from the window.

    chart (n, (n_d + 1) p + n_d m), parametrization (p, ·), dynamics_table (n, ·).
    input_degree, state_degree: largest degrees n_u in u and in z (None: n_r); state_degree 1 gives the linear
    counterpart, bilinear in state and input. saturated: the nonlinear terms become constant beyond `state_scale`, the
    largest training states, see `saturation`; within this range nothing changes.
    Raises ValueError when window and inputs hold fewer values than state_dim.
    """

    tables = {"chart": ("chart",), "parametrization": ("parametrization",), "dynamics": ("dynamics_table",)}

    @checked(state_dim=STATES, delays=DELAYS, timestep=MODEL_TIMESTEP, window_timestep=OrNone(TIMESTEP),
             parametrization_degree=DEGREE, dynamics_degree=DEGREE, input_degree=OrNone(DEGREE),
             state_degree=OrNone(DEGREE), saturated=TRUTH, base_timestep=OrNone(TIMESTEP))
    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int = 1, *,
                 parametrization_degree: int = 1, dynamics_degree: int = 2, input_degree: int | None = 1,
                 state_degree: int | None = None, saturated: bool = True, timestep: float = 0.01,
                 window_timestep: float | None = None, base_timestep: float | None = None):
        super().__init__(state_dim, input_dim, output_dim, delays, timestep, window_timestep)
        held = self.delays * self.input_dim
        if self.window_dim + held < state_dim:
            raise ValueError(f"a window of {delays + 1} samples of {output_dim} outputs and the inputs between them "
                             f"hold {self.window_dim + held} values, fewer than the {state_dim} reduced coordinates; "
                             "use more delays or a smaller state_dim")
        input_degree = dynamics_degree if input_degree is None else input_degree
        check_degrees(parametrization_degree=parametrization_degree, dynamics_degree=dynamics_degree,
                      input_degree=input_degree, state_degree=dynamics_degree if state_degree is None else state_degree)
        self.parametrization_degree, self.dynamics_degree = parametrization_degree, dynamics_degree
        self.input_degree, self.state_degree, self.saturated = input_degree, state_degree, bool(saturated)
        self.base_timestep = self.timestep if base_timestep is None else float(base_timestep)
        self.structure = control_augmented_structure(
            self.state_dim, self.input_dim, self.window_dim, held, parametrization_degree=parametrization_degree,
            dynamics_degree=dynamics_degree, input_degree=input_degree, state_degree=state_degree,
            saturated=self.saturated)
        self.chart = table(self.state_dim, self.window_dim + held)
        self.parametrization = table(self.output_dim, len(self.structure.parametrization))
        self.dynamics_table = table(self.state_dim, len(self.structure.dynamics))
        _ = self.reduced  # raises an error if timestep is not a whole multiple of base_timestep


class ControlAugmentedSSSR(ControlAugmentedSSMR):
    """The linear counterpart of the control-augmented SSMR: linear in the state, bilinear in state and input."""

    @checked(state_dim=STATES, delays=DELAYS, timestep=MODEL_TIMESTEP, window_timestep=OrNone(TIMESTEP),
             parametrization_degree=DEGREE, dynamics_degree=DEGREE, input_degree=OrNone(DEGREE), saturated=TRUTH,
             base_timestep=OrNone(TIMESTEP))
    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int = 1, *,
                 parametrization_degree: int = 1, dynamics_degree: int = 2, input_degree: int | None = 1,
                 saturated: bool = True, timestep: float = 0.01, window_timestep: float | None = None,
                 base_timestep: float | None = None):
        super().__init__(state_dim, input_dim, output_dim, delays, parametrization_degree=parametrization_degree,
                         dynamics_degree=dynamics_degree, input_degree=input_degree, state_degree=1,
                         saturated=saturated, timestep=timestep, window_timestep=window_timestep,
                         base_timestep=base_timestep)
