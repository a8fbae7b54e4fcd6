"""Damped Gauss-Newton minimisation (Levenberg and Marquardt), for one problem or many at once."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from uuv_optical_array.core.numerics.elementwise import any_of, choose, choose_tuple

DAMPING = 1e-3  # at the start
FREE = 1e-1  # a step damped more is short wherever it is taken, so it proves nothing
GIVE_UP = 1e4  # damping beyond which no step gains


@cache
def stepper(evaluate: Callable[..., Any], arrived: float) -> Callable[..., tuple[Any, Any]]:
    """Return a function that takes one step of a `minimiser`, whose arguments these are.

    - returned: ``step(problem, state, proposed, damping)``, by what `propose` returned: what
      `evaluate` found at the better of both places, and the next damping; 0: it was the last step.
    """

    def step(problem: Any, state: Any, proposed: Any, damping: Any) -> tuple[Any, Any]:
        active = damping > 0
        there, decrement = proposed
        last = (decrement < arrived) & (damping < FREE)
        new = evaluate(problem, there)
        better = active & (new[0] < state[0]) & (new[0] > -np.inf)
        # Where the slope jumps, as where a detector turns away, a fit gains nothing either way.
        short = better & (new[0] > state[0] - arrived)
        state = choose_tuple(better, new, state)
        go_on = choose(last | short | (damping > GIVE_UP), False, active)
        return state, choose(go_on, damping * choose(better, 0.1, 10.0), 0.0)

    return step


def first_damping(state: Any) -> Any:
    """Return the damping of the first step from a state; 0: none leads anywhere."""
    return choose(abs(state[0]) < np.inf, DAMPING, 0.0)


def minimiser(
    evaluate: Callable[..., Any], propose: Callable[..., Any], arrived: float, most: int
) -> Callable[..., Any]:
    """Return a function that minimises the cost of a problem, or of many at once.

    - evaluate: ``evaluate(problem, at)``: a named tuple of the cost, first, and whatever `propose`
      needs to know of the place; of many problems, each part has their axis last.
    - propose: ``propose(problem, state, damping)``: the next place, within its bounds, and the
      decrement of the cost that the model of second order promises; nan where there is no step. The
      more damping, the shorter the step; of many problems, those ended get 0 and need none.
    - arrived, most: decrement below which a step is the last, > 0, and number of steps at most.
    - returned: ``minimise(problem, start, steps=most)``: what `evaluate` found at the best place,
      the start itself where its cost is not finite. Such a place is never taken.
    """
    step = stepper(evaluate, arrived)

    def minimise(problem: Any, start: Any, steps: int = most) -> Any:
        state = evaluate(problem, start)
        damping = first_damping(state)
        for _ in range(steps):
            if not any_of(damping > 0):
                break
            state, damping = step(problem, state, propose(problem, state, damping), damping)
        return state

    return minimise
