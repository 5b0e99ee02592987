"""A polynomial model of one's own: its structure, the shapes of its tables, and nothing else."""

from ssmr_torch.models.monomials import Monomials, graded
from ssmr_torch.models.structure import Structure
from ssmr_torch.models.torch_model import PolynomialTorchModel, table


class SquaresAndProducts(PolynomialTorchModel):
    """A linear map that bends with the squares of its states and with their products with the inputs:

        z = chart · [ŷ, û],   y = parametrization · z,   z⁺ = dynamics · [z, u, z_i², z_i u_j] after base_timestep.

    chart (n, (n_d + 1) p + n_d m), parametrization (p, n), dynamics (n, n + m + n + n m).
    """

    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int = 1, *, timestep: float = 0.01,
                 window_timestep: float | None = None, base_timestep: float | None = None):
        super().__init__(state_dim, input_dim, output_dim, delays, timestep, window_timestep)
        n, m, seen = self.state_dim, self.input_dim, self.window_dim + self.delays * self.input_dim
        self.base_timestep = self.timestep if base_timestep is None else base_timestep
        linear = [(i,) for i in range(n + m)]
        squares = [(i, i) for i in range(n)]
        products = [(i, n + j) for i in range(n) for j in range(m)]
        self.structure = Structure(chart=graded(seen, 1, 1), window_order=tuple(range(seen)),
                                   parametrization=graded(n, 1, 1), scheme="map",
                                   dynamics=Monomials(n + m, [*linear, *squares, *products]))
        self.chart, self.parametrization = table(n, seen), table(output_dim, n)
        self.dynamics = table(n, len(self.structure.dynamics))
