"""How a numerical procedure ended, and what to do about it."""

from enum import Enum


class Status(Enum):
    """The value of each member tells the user what happened and what to do."""

    SOLVED = "solved to the requested tolerance"
    ITERATION_LIMIT = "stopped at the iteration limit; raise max_iterations or scale the cost so that R is about 1"
    PRIMAL_INFEASIBLE = "the constraints contradict each other; soften the output constraints or widen the rate limit"
    CLOSEST_FEASIBLE = "infeasible; the solver returned the least-violating point, which is not a solution"
    DUAL_INFEASIBLE = "the cost is unbounded below; make R positive definite"
    NOT_RUN = "the solver never ran; initialize it before solving"
    NOT_FINITE = "the problem or its solution is not finite; check the measurement and the model's range"
    RESIDUAL_TOO_LARGE = "the solver claims success but the recomputed residuals disagree; tighten its tolerance"
    NOT_DESCENDING = "the line search found no lower cost; the linearization does not describe the model here"
    OUT_OF_RANGE = "the state lies far outside the model's training data; wait for it to return or train on wider data"
    SOFTENED = "no input keeps the hard constraints; the step violates them by as little as possible"
    WRONG_TIME = "the call brings no new sample: its time is not finite or that of the last one; check the clock"
    FROZEN_SENSOR = "the measurement has not changed by a bit while the input did; check the sensor and its connection"

    @property
    def success(self) -> bool:
        return self is Status.SOLVED
