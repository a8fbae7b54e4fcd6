"""The damped Gauss-Newton solver: closed forms, SciPy's own, batches, and the same compiled."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import least_squares

from uuv_optical_array.core.numerics.gauss_newton import DAMPING, FREE, GIVE_UP, minimiser

pytestmark = [pytest.mark.filterwarnings("error"), pytest.mark.usefixtures("strict_arithmetic")]


class State(NamedTuple):
    """What a problem of two unknowns knows of a place; many problems have their axis last."""

    cost: np.ndarray
    at: np.ndarray
    gradient: np.ndarray
    information: np.ndarray


def state_of(residuals, jacobian, at):
    """Return half the sum of squares, with derivatives, by NumPy's summation."""
    return State(
        0.5 * np.einsum("i...,i...->...", residuals, residuals),
        at,
        -np.einsum("iq...,i...->q...", jacobian, residuals),
        np.einsum("iq...,is...->qs...", jacobian, jacobian),
    )


def damped_step(problem, state, damping):
    """Solve two equations by Cramer's rule, for one problem or many."""
    (a, b), (_, d) = state.information
    a, d = a * (1 + damping), d * (1 + damping)
    u, v = state.gradient
    determinant = a * d - b * b
    step = np.array([d * u - b * v, a * v - b * u]) / determinant
    return state.at + step, 0.5 * np.einsum("q...,q...->...", state.gradient, step)


def valley(at):
    x, y = at
    return np.array([10 * (y - x**2), 1 - x])


def rosenbrock(problem, at):
    zero = np.zeros_like(at[0])
    return state_of(valley(at), np.array([[-20 * at[0], zero + 10], [zero - 1, zero]]), at)


def decay(problem, at):
    """Fit ``a exp(-k t)`` to values that no such curve goes through."""
    times, values = problem
    curve = np.exp(-at[1] * times)
    jacobian = np.stack([curve, -times * at[0] * curve], axis=1)
    return state_of(at[0] * curve - values, jacobian, at)


def test_one_step_is_that_of_the_damped_normal_equations():
    matrix, target = np.array([[3.0, 1.0], [1.0, 2.0], [0.5, -1.0]]), np.array([1.0, -2.0, 0.5])
    start = np.array([4.0, -3.0])

    def evaluate(problem, at):
        return state_of(matrix @ at - target, matrix, at)

    found = minimiser(evaluate, damped_step, 1e-12, 1)(None, start)
    information = matrix.T @ matrix
    damped = information + DAMPING * np.diag(np.diag(information))
    expected = start - np.linalg.solve(damped, matrix.T @ (matrix @ start - target))
    np.testing.assert_allclose(found.at, expected, rtol=1e-12)
    found = minimiser(evaluate, damped_step, 1e-15, 20)(None, start)
    np.testing.assert_allclose(found.at, np.linalg.lstsq(matrix, target, rcond=None)[0], rtol=1e-7)


STARTS = np.array([[-1.2, 1.0], [3.0, -4.0], [0.0, 0.0], [-2.0, 5.0], [1.0, 1.0], [8.0, 2.0]])
TIMES = np.linspace(0, 4, 12)
VALUES = 3 * np.exp(-0.7 * TIMES) + 0.2 * np.random.default_rng(1).standard_normal(12)


@pytest.mark.parametrize(
    ("problem", "residuals", "start"),
    [
        *((None, valley, start) for start in STARTS),
        *(
            ((TIMES, VALUES), lambda at: at[0] * np.exp(-at[1] * TIMES) - VALUES, start)
            for start in ([1.0, 0.0], [20.0, 3.0], [0.1, 0.5])
        ),
    ],
)
def test_it_ends_where_scipys_solver_does_with_a_misfit_or_without(problem, residuals, start):
    minimise = minimiser(decay if problem else rosenbrock, damped_step, 1e-16, 200)
    found = minimise(problem, np.array(start))
    own = least_squares(residuals, start, method="lm", xtol=1e-12)
    np.testing.assert_allclose(found.at, own.x, rtol=1e-6)
    assert found.cost == pytest.approx(own.cost, rel=1e-10, abs=1e-12)


def test_many_problems_at_once_end_as_each_by_itself():
    minimise = minimiser(rosenbrock, damped_step, 1e-10, 40)
    rng = np.random.default_rng(2)
    starts = np.concatenate([STARTS, rng.uniform(-3, 3, (30, 2))])
    together = minimise(None, starts.T)
    for i, start in enumerate(starts):
        alone = minimise(None, start)
        for part, own in zip(together, alone, strict=True):
            np.testing.assert_allclose(part[..., i], own, rtol=1e-12, atol=1e-15)


def recorder(costs, decrements):
    """Return a problem of one unknown whose costs are read from a list, and what it was asked."""
    asked, dampings = iter(costs), []

    class Told(NamedTuple):
        cost: float
        at: int

    def evaluate(problem, at):
        return Told(next(asked), at)

    def propose(problem, state, damping):
        dampings.append(float(damping))
        return len(dampings), next(decrements)

    return evaluate, propose, dampings


def test_damping_falls_tenfold_with_a_step_that_gains_and_grows_with_one_that_does_not():
    costs = [10.0, 8.0, 9.0, 11.0, 7.0, 6.0, 5.999]
    evaluate, propose, dampings = recorder(costs, iter([1.0] * 6))
    found = minimiser(evaluate, propose, 0.1, 20)(None, 0)
    np.testing.assert_allclose(np.divide(dampings, DAMPING), [1, 0.1, 1, 10, 1, 0.1])
    # The last step gained less than 0.1: it is taken, and it is the last.
    assert found == (5.999, 6)


def test_a_step_that_promises_little_is_the_last_unless_it_was_damped():
    evaluate, propose, dampings = recorder([10.0, 5.0, 4.0, 3.0], iter([1.0, 0.01, 1.0]))
    assert minimiser(evaluate, propose, 0.1, 20)(None, 0) == (4.0, 2)
    assert len(dampings) == 2
    # Refused thrice: the damping is 1, and what it promises is little wherever it is taken.
    costs = [10.0, 11.0, 11.0, 11.0, 9.0, 8.0, 2.0]
    evaluate, propose, dampings = recorder(costs, iter([1.0, 1.0, 1.0, 0.01, 1.0, 0.01]))
    assert minimiser(evaluate, propose, 0.1, 20)(None, 0) == (2.0, 6)
    assert DAMPING * 1000 > FREE


def test_it_gives_up_where_no_step_gains_and_after_as_many_steps_as_it_may_take():
    evaluate, propose, dampings = recorder([10.0] * 99, iter([1.0] * 99))
    assert minimiser(evaluate, propose, 0.1, 90)(None, 0) == (10.0, 0)
    assert dampings[-1] > GIVE_UP >= dampings[-1] / 10 * (1 - 1e-9)
    evaluate, propose, dampings = recorder(np.arange(99.0, 0, -1), iter([1.0] * 99))
    assert minimiser(evaluate, propose, 0.1, 7)(None, 0) == (92.0, 7)
    assert len(dampings) == 7


def test_a_place_whose_cost_is_no_number_is_never_taken():
    costs = [10.0, np.nan, np.inf, -np.inf, 9.0, 8.99]
    evaluate, propose, dampings = recorder(costs, iter([1.0] * 5))
    assert minimiser(evaluate, propose, 0.1, 20)(None, 0) == (8.99, 5)
    np.testing.assert_allclose(np.divide(dampings, DAMPING), [1, 10, 100, 1000, 100])


@pytest.mark.parametrize("cost", [np.nan, np.inf, -np.inf])
def test_a_start_whose_cost_is_no_number_is_left_as_it_is(cost):
    evaluate, propose, dampings = recorder([cost, 1.0], iter([1.0]))
    assert minimiser(evaluate, propose, 0.1, 20)(None, 0)[1] == 0
    assert not dampings


def test_no_step_at_a_singular_place_leaves_it_and_its_neighbours_go_on():
    """The information of the second of three problems is zero: there is nothing to solve."""

    def evaluate(problem, at):
        state = rosenbrock(None, at)
        flat = np.array([False, True, False])
        return state._replace(information=np.where(flat, 0.0, state.information))

    def propose(problem, state, damping):
        singular = state.information[0, 0] == 0
        safe = np.where(singular, np.eye(2)[..., None], state.information)
        to, decrement = damped_step(problem, state._replace(information=safe), damping)
        return np.where(singular, state.at, to), np.where(singular, np.nan, decrement)

    starts = np.array([[-1.2, 3.0, 0.0], [1.0, 2.0, 0.0]])
    found = minimiser(evaluate, propose, 1e-12, 60)(None, starts)
    np.testing.assert_array_equal(found.at[:, 1], starts[:, 1])
    np.testing.assert_allclose(found.at[:, [0, 2]], 1.0, atol=1e-5)


def test_problems_that_have_ended_are_asked_for_no_step():
    asked = []

    def propose(problem, state, damping):
        asked.append(np.array(damping))
        return damped_step(problem, state, damping)

    starts = np.array([[1.0, -1.2], [1.0, 1.0]])
    minimiser(rosenbrock, propose, 1e-10, 60)(None, starts)
    asked = np.array(asked)
    assert asked[0, 0] > 0
    assert (asked[1:, 0] == 0).all()
    assert (asked[:, 1] > 0).all()
    assert len(asked) > 5
