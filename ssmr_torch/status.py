"""`Status`: how a solver or a control step ended, and what to do about it."""

from enum import Enum


class Status(Enum):
    """The value of each member is a sentence on what happened and what to do."""

    SOLVED = "solved to the requested tolerance"
    ITERATION_LIMIT = "stopped at the iteration limit; raise max_iterations or scale the cost so that R is about 1"
    PRIMAL_INFEASIBLE = "the constraints contradict each other; soften the output constraints or widen the rate limit"
    CLOSEST_FEASIBLE = "infeasible; the solver returned the point with the least violation, which is not a solution"
    DUAL_INFEASIBLE = "the cost is unbounded below; make R positive definite"
    NOT_RUN = "the solver never ran; initialize it before solving"
    NOT_FINITE = "the problem or its solution is not finite; check the measurement and the model's range"
    RESIDUAL_TOO_LARGE = "the solver reports success, but the recomputed residuals are too large; tighten its tolerance"
    NOT_DESCENDING = "the line search found no lower cost; the linearization does not describe the model here"
    OUT_OF_RANGE = "the state is far outside the model's training data; wait until it returns, or train on wider data"
    SOFTENED = "no input keeps the hard constraints; the step violates them by as little as possible"
    WRONG_TIME = "the call has no new sample: its time is not finite or not later than the last one; check the clock"
    FROZEN_SENSOR = "the measurement stayed exactly equal while the input changed; check the sensor and its connection"

    @property
    def success(self) -> bool:
        return self is Status.SOLVED
