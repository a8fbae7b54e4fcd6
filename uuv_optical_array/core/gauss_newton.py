"""Damped Gauss-Newton minimisation (Levenberg and Marquardt), for one problem or many at once."""

from collections.abc import Callable
from typing import Any

from uuv_optical_array.core.elementwise import any_of, choose, choose_state, not_

DAMPING = 1e-3  # at the start
FREE = 1e-1  # a step damped more is short wherever it is taken, so it proves nothing
GIVE_UP = 1e4  # damping beyond which no step gains


def minimiser(
    evaluate: Callable[..., Any], propose: Callable[..., Any], arrived: float
) -> Callable[..., Any]:
    """Return a function that minimises the cost of a problem, or of many at once.

    Parameters
    ----------
    evaluate
        ``evaluate(problem, at)``: a tuple of the cost, the place `at` and whatever `propose`
        needs to know of it; of many problems, each part has their axis last.
    propose
        ``propose(problem, state, damping)``: the place to try next and the decrement of the cost
        that the model of second order promises there; nan where there is none.
    arrived
        Decrement below which a step is the last.

    Returns
    -------
    callable
        ``minimise(problem, start, most)``: what `evaluate` found at the best place in `most` steps.
    """

    def minimise(problem: Any, start: Any, most: int) -> Any:
        state = evaluate(problem, start)
        damping = DAMPING + 0.0 * state[0]
        active = damping > 0
        for _ in range(most):
            trial, decrement = propose(problem, state, damping)
            last = (decrement < arrived) & (damping < FREE)
            new = evaluate(problem, trial)
            gain = state[0] - new[0]
            better = active & (gain > 0)
            state = choose_state(better, new, state)
            # On the edge where a detector turns away from the lamp the slope jumps, and a fit
            # that sits there gains nothing either way.
            settled = last | (better & (gain < arrived)) | (damping > GIVE_UP)
            active = active & (not_(settled))
            if not any_of(active):
                break
            damping = damping * choose(better, 0.1, 10.0)
        return state

    return minimise
