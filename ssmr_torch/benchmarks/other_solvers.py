"""Other people's solvers on our tracking problem: CasADi with IPOPT or in real-time iteration, and acados.

Each gets the same model (the symbolic trace of our own Runge-Kutta step), cost, bounds, shift and fallback as
`ModelPredictiveController`, scaled alike: inputs by their range, states by state_scale, the cost by the weight of R.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import shutil
import tempfile
from abc import ABC, abstractmethod
from collections import Counter

import numpy as np

from ssmr_torch.benchmarks.tracking_instance import PAPER
from ssmr_torch.control.base import Command

PERIOD, OUTPUT_WEIGHT, INPUT_WEIGHT = PAPER.period, PAPER.output_weight, PAPER.input_weight
SILENT = {"print_time": False}
IPOPT = SILENT | {
    "error_on_fail": True, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-6,
    "ipopt.warm_start_init_point": "yes", "ipopt.mu_init": 1e-5, "ipopt.warm_start_bound_push": 1e-6,
    "ipopt.warm_start_bound_frac": 1e-6, "ipopt.warm_start_mult_bound_push": 1e-6,
    "ipopt.warm_start_slack_bound_push": 1e-6, "ipopt.warm_start_slack_bound_frac": 1e-6}
REAL_TIME = SILENT | {
    "max_iter": 1, "max_iter_ls": 0, "error_on_fail": False, "print_header": False, "print_iteration": False,
    "print_status": False}
COMPILED = {"jit": True, "jit_cleanup": False, "compiler": "shell",
            "jit_options": {"flags": ["-O3", "-march=native"], "verbose": False}}
QP_OPTIONS = {"hpipm": {}, "qrqp": {"print_iter": False, "print_header": False, "print_info": False}}


class Unavailable(Exception):
    """A solver that cannot run here, with the reason."""


class OtherController(ABC):
    """Receding horizon around another solver: plans at every control step, holds the input in between.

    A plan that fails is replaced by the last one, shifted, and counted in `fallbacks`. Subclasses plan.
    """

    period = PERIOD

    def __init__(self, model, task, bounds: np.ndarray, horizon: int):
        self.model, self.task, self.bounds, self.N = model.at_timestep(PERIOD), task, bounds, horizon
        self.n, self.m, self.columns = model.state_dim, model.input_dim, list(task.columns())
        self._samples_per_step = round(PERIOD / model.timestep)
        self.input_scale = bounds[1] - bounds[0]
        self.cost_scale = float(INPUT_WEIGHT)
        self.fallbacks = Counter()

    def start(self) -> None:
        """Run once, so that nothing is set up within the loop, then forget it."""
        self.reset()
        self(0.0, np.zeros(self.model.output_dim))
        self.reset()

    def reset(self) -> None:
        self.fallbacks.clear()
        self._sample, self._input = 0, np.zeros(self.m)

    def __call__(self, time: float, observation: np.ndarray) -> Command:
        due = self._sample % self._samples_per_step == 0
        self._sample += 1
        if not due:
            return Command(self._input, held=True)
        reference = self.task.reference(time + PERIOD * np.arange(1, self.N + 1))
        state = self.model.encode(observation[None], np.empty((0, self.m)))
        planned = self.plan(state, reference)
        if not np.isfinite(planned).all():
            self.fallbacks["not solved"] += 1
            planned = self.intended()
        self._input = np.clip(planned, *self.bounds)
        return Command(self._input)

    @abstractmethod
    def plan(self, state: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """The first input of a new plan, NaN where there is none; keeps the plan, shifted, as the next guess."""

    @abstractmethod
    def intended(self) -> np.ndarray:
        """The first input of the last plan, shifted; it shifts that plan once more."""


class CasADi(OtherController):
    """Multiple shooting in x = (v_0, s_1, v_1, s_2, …), v = u / range, s = z / state_scale.

    plugin, options: of casadi.nlpsol. gauss_newton: hand over the Hessian of the cost, which is constant, instead of
    that of the Lagrangian. compiled: the functions as C code.   Raises Unavailable without CasADi or a compiler.
    """

    def __init__(self, model, task, bounds, *, horizon: int, plugin: str, options: dict, gauss_newton: bool = False,
                 compiled: bool = False):
        super().__init__(model, task, bounds, horizon)
        if compiled and shutil.which("gcc") is None:
            raise Unavailable("needs a C compiler: gcc is not on the path")
        problem, hessian = self._problem(casadi(), compiled)
        options = dict(options) | (COMPILED if compiled else {})
        if gauss_newton:
            options["hess_lag"] = hessian
        with aside() as directory:
            self._solver = casadi().nlpsol("tracking", plugin, problem, options)
        self._directory = directory
        free, stage = np.full(self.n, np.inf), bounds / self.input_scale
        self._lower, self._upper = (np.tile(np.append(stage[side], sign * free), self.N)
                                    for side, sign in ((0, -1.0), (1, 1.0)))
        self.start()

    def _problem(self, ca, compiled: bool):
        """The nonlinear program, and the Hessian of its cost as CasADi wants that of the Lagrangian.

        Compiled, one step is a function of its own, so that its derivatives are compiled once and not N times;
        interpreted, one flat graph is faster.
        """
        N, n, m, kind = self.N, self.n, self.m, ca.MX if compiled else ca.SX
        step = symbolic_step(self.model)
        start, target = kind.sym("start", n), kind.sym("target", len(self.columns), N)
        z, cost, unknowns, gaps = start, 0.0, [], []
        for k in range(N):
            v, s = kind.sym(f"v{k}", m), kind.sym(f"s{k}", n)
            unknowns += [v, s]
            gaps.append(step(z, v * self.input_scale) / self.model.state_scale - s)
            z = s * self.model.state_scale
            error = self._output(z) - target[:, k]
            cost += OUTPUT_WEIGHT * ca.sumsqr(error) + INPUT_WEIGHT * ca.sumsqr(v)
        cost = cost / self.cost_scale
        x, p, g = ca.vertcat(*unknowns), ca.vertcat(start, ca.vec(target)), ca.vertcat(*gaps)
        scale, multipliers = kind.sym("scale"), kind.sym("multipliers", N * n)
        hessian = ca.Function("nlp_hess_l", [x, p, scale, multipliers], [scale * ca.hessian(cost, x)[0]],
                              ["x", "p", "lam_f", "lam_g"], ["hess_gamma_x_x"])
        return {"x": x, "p": p, "f": cost, "g": g}, hessian

    def _output(self, z):
        """The tracked outputs of symbolic states; they are linear in the benchmark's model."""
        if self.model.structure.parametrization.highest != 1:
            raise Unavailable("the benchmark traces linear outputs only")
        table = self.model.parametrization[-self.model.output_dim:][self.columns]
        return casadi().sparsify(casadi().DM(table)) @ z

    def reset(self) -> None:
        super().reset()
        self._x = np.zeros(self.N * (self.m + self.n))
        self._box, self._gaps = np.zeros_like(self._x), np.zeros(self.N * self.n)

    def plan(self, state, reference):
        try:
            found = self._solver(x0=self._x, lam_x0=self._box, lam_g0=self._gaps, lbx=self._lower, ubx=self._upper,
                                 lbg=0.0, ubg=0.0, p=np.concatenate([state, reference.ravel()]))
        except RuntimeError:  # what CasADi raises for a solver that failed
            return np.full(self.m, np.nan)
        x = found["x"].full().ravel()
        if np.isfinite(x).all():
            self._x = self._shifted(x)
            self._box, self._gaps = (self._shifted(found[name].full().ravel()) for name in ("lam_x", "lam_g"))
        return x[:self.m] * self.input_scale

    def intended(self):
        planned = self._x[:self.m] * self.input_scale
        self._x = self._shifted(self._x)
        return planned

    def _shifted(self, flat: np.ndarray) -> np.ndarray:
        return np.append(flat[len(flat) // self.N:], flat[-(len(flat) // self.N):])


def ipopt(*arguments, **options) -> CasADi:
    """Solved to convergence with the exact Hessian, warm-started in primal and dual variables."""
    return CasADi(*arguments, **options, plugin="ipopt", options=IPOPT)


def casadi_rti(*arguments, compiled: bool = False, qp: str | None = None, **options) -> CasADi:
    """sqpmethod, one Gauss-Newton program per step; by default in HPIPM, which knows the stages, or else in qrqp."""
    qp = qp or ("hpipm" if casadi().has_conic("hpipm") else "qrqp")
    settings = {"qpsol": qp, "qpsol_options": {"error_on_fail": False} | QP_OPTIONS.get(qp, {})}
    return CasADi(*arguments, **options, plugin="sqpmethod", options=REAL_TIME | settings, gauss_newton=True,
                  compiled=compiled)


class Acados(OtherController):
    """acados in real-time iteration: explicit Runge-Kutta of order four, Gauss-Newton, HPIPM partially condensed.

    Raises Unavailable where acados_template is not installed.
    """

    def __init__(self, model, task, bounds, *, horizon: int):
        super().__init__(model, task, bounds, horizon)
        try:
            template = importlib.import_module("acados_template")
        except ImportError as error:
            raise Unavailable("acados_template is not installed; see docs.acados.org/installation") from error
        with aside() as directory:
            self._solver = template.AcadosOcpSolver(self._problem(template), verbose=False)
        self._directory = directory
        self.start()

    def _problem(self, template):
        ca, ocp = casadi(), template.AcadosOcp()
        z, u = ca.SX.sym("z", self.n), ca.SX.sym("u", self.m)
        ocp.model.name, ocp.model.x, ocp.model.u = "tracking", z, u
        ocp.model.f_expl_expr = ca.cse(ca.vertcat(*self.model.rate(entries(z), entries(u))))
        tracked = self.model.parametrization[-self.model.output_dim:][self.columns]
        q = len(tracked)
        Q, R = OUTPUT_WEIGHT * np.eye(q), INPUT_WEIGHT * np.diag(self.input_scale**-2.0)
        Q, R = Q / self.cost_scale, R / self.cost_scale
        cost, constraints, options = ocp.cost, ocp.constraints, ocp.solver_options
        cost.cost_type_0 = cost.cost_type = cost.cost_type_e = "LINEAR_LS"
        # acados multiplies the cost of every stage but the last by its duration.
        cost.W_0, cost.Vx_0, cost.Vu_0 = R / PERIOD, np.zeros((self.m, self.n)), np.eye(self.m)
        cost.W = np.block([[Q, np.zeros((q, self.m))], [np.zeros((self.m, q)), R]]) / PERIOD
        cost.Vx, cost.Vu = np.vstack([tracked, cost.Vx_0]), np.vstack([np.zeros((q, self.m)), cost.Vu_0])
        cost.W_e, cost.Vx_e = Q, tracked
        cost.yref_0, cost.yref, cost.yref_e = np.zeros(self.m), np.zeros(q + self.m), np.zeros(q)
        constraints.x0, constraints.idxbu = np.zeros(self.n), np.arange(self.m)
        constraints.lbu, constraints.ubu = self.bounds
        if hasattr(options, "N_horizon"):
            options.N_horizon = self.N
        else:
            ocp.dims.N = self.N
        options.tf, options.integrator_type, options.nlp_solver_type = self.N * PERIOD, "ERK", "SQP_RTI"
        options.sim_method_num_stages, options.sim_method_num_steps = 4, self.model.substeps
        options.qp_solver, options.hessian_approx = "PARTIAL_CONDENSING_HPIPM", "GAUSS_NEWTON"
        return ocp

    def reset(self) -> None:
        super().reset()
        self._states, self._inputs = np.zeros((self.N + 1, self.n)), np.zeros((self.N, self.m))

    def plan(self, state, reference):
        """One real-time iteration of acados from state (n,) to the outputs reference (N, q), m."""
        solver, target = self._solver, np.zeros(len(self.columns) + self.m)
        for k in range(self.N):
            solver.set(k, "x", self._states[k])
            solver.set(k, "u", self._inputs[k])
            if k:
                target[:len(self.columns)] = reference[k - 1]
                solver.set(k, "yref", target)
        solver.set(self.N, "x", self._states[self.N])
        solver.set(self.N, "yref", reference[-1])
        solver.set(0, "lbx", state)
        solver.set(0, "ubx", state)
        if solver.solve() != 0:
            return np.full(self.m, np.nan)
        states = np.stack([solver.get(k, "x") for k in range(self.N + 1)])
        inputs = np.stack([solver.get(k, "u") for k in range(self.N)])
        self._states, self._inputs = _next(states), _next(inputs)
        return inputs[0]

    def intended(self):
        planned = self._inputs[0]
        self._inputs = _next(self._inputs)
        return planned


def _next(rows: np.ndarray) -> np.ndarray:
    return np.concatenate([rows[1:], rows[-1:]])


def symbolic_step(model):
    """z⁺ as a CasADi function of z and u, by running our own code on symbols."""
    from ssmr_torch.deployment.casadi_program import casadi_functions

    return casadi_functions(model, ["step"])["step"]


def entries(symbol) -> np.ndarray:
    """The entries of a symbolic vector as an array of objects, which NumPy adds and multiplies one by one."""
    array = np.empty(symbol.numel(), dtype=object)
    array[:] = [symbol[i] for i in range(symbol.numel())]
    return array


def casadi():
    try:
        return importlib.import_module("casadi")
    except ImportError as error:
        raise Unavailable("casadi is not installed: pip install 'ssmr_torch[benchmarks]'") from error


@contextlib.contextmanager
def aside():
    """A temporary working directory, for the C code that solvers write where they stand; keep it as long as them."""
    before, directory = os.getcwd(), tempfile.TemporaryDirectory()
    os.chdir(directory.name)
    try:
        yield directory
    finally:
        os.chdir(before)
