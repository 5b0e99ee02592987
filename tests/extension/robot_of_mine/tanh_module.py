"""The same model as a Torch module, to be trained: its parameters, how it begins, and the size of a step of each."""

from robot_of_mine.tanh_units import TanhUnits
from ssmr_torch.models.torch_model import TorchModel, fill, table


class TanhModule(TorchModel):
    """`TanhUnits` on parameters; it begins as a linear model, K = 0."""

    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int = 1, *, timestep: float = 0.01,
                 window_timestep: float | None = None):
        super().__init__(state_dim, input_dim, output_dim, delays, timestep, window_timestep)
        n, seen = self.state_dim, self.window_dim + self.delays * self.input_dim
        self.chart, self.parametrization = table(n, seen), table(output_dim, n)
        self.A, self.B, self.K = table(n, n), table(n, input_dim), table(n, n)

    @property
    def reduced(self) -> TanhUnits:
        return TanhUnits(chart=self.chart, parametrization=self.parametrization, A=self.A, B=self.B, K=self.K,
                         **self.sizes)

    def begin(self, chart, parametrization, A, B):
        fill([(self.chart, chart), (self.parametrization, parametrization), (self.A, A), (self.B, B)])

    def scales(self):
        rate = (self.A.detach().abs() @ self.state_scale)[:, None]
        return {"A": rate / self.state_scale, "B": rate, "K": rate}
