"""The posterior of one image over coordinates of the pose and the scene's nuisances."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy import sqrt

from uuv_optical_array.core.geometry import PITCH, YAW, Array, turned_components
from uuv_optical_array.core.numerics.elementwise import (
    indices,
    total,
    workspace,
    zeros,
)
from uuv_optical_array.core.numerics.gauss_newton import (
    FREE,
    GIVE_UP,
    minimiser,
    stepper,
)
from uuv_optical_array.core.numerics.linear_algebra import cholesky, solve_lower, solve_upper
from uuv_optical_array.estimation.information.likelihood import likelihood_of
from uuv_optical_array.estimation.least_squares.misfit import chi_square_score, residual_moments
from uuv_optical_array.estimation.unknowns.coordinates import (
    CoordinateFrame,
    frame_of,
    from_centre,
    from_pose,
    to_lamp,
    write_slopes,
)
from uuv_optical_array.forward.daylight import without_lamps
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.noise import ReadingNoise, reading_variance
from uuv_optical_array.forward.optics import Optics, detect, write_light
from uuv_optical_array.forward.prior import AMBIENT, of_lamp

MAX_STEP = 0.3  # in every coordinate: beyond it the linear model is not valid
STEEPEST = np.pi / 3  # pitch of a vehicle, rad
# NumPy integers, as Numba compiles again for each literal.
FEW_STEPS: Any = np.int64(12)
MOST_STEPS: Any = np.int64(40)
# Decrement from which the next step, a tenth of a standard deviation, arrives to second order.
ARRIVED = 5e-3
# Of `settle`: damping of the first step, and how many without gain it takes before it goes back.
SLIGHT, UPHILL = 1e-6, 6
VOLUME = 5  # row of `State.slopes`, after those of the pose


class Problem(NamedTuple):
    """A scene and a prior in numbers; with readings and a roll, a posterior.

    - optics, noise, frame: of the scene.
    - pose_mean, pose_std: of the prior of the pose, m and rad, shape ``(5,)`` each.
    - nuisance_mean, nuisance_std: of the prior of the nuisances, shape ``(q,)`` each.
    - spans: where the readings that each unknown changes begin and end, shape ``(p, 2)``.
    - dark_counts: up to which a reading may show no lamp, only daylight and noise.
    - readings: counts, finite, shape ``(n,)``.
    - weights: how far each reading counts, from 0 for none to 1, shape ``(n,)``.
    - roll: of the follower, rad.
    """

    optics: Optics
    noise: ReadingNoise
    frame: CoordinateFrame
    pose_mean: Array
    pose_std: Array
    nuisance_mean: Array
    nuisance_std: Array
    spans: Any
    dark_counts: float
    readings: Array
    weights: Array
    roll: float


class State(NamedTuple):
    """The posterior at one place.

    - cost: negative log-posterior of the pose, without constants.
    - at: coordinates and nuisances, shape ``(p,)``.
    - gradient: of the log-posterior, shape ``(p,)``.
    - information: of Gauss and Newton, prior included, shape ``(p, p)``.
    - pose: m and rad, five numbers.
    - log_volume: logarithm of the volume of poses that a unit volume of the coordinates holds.
    - slopes: of the pose, and in row `VOLUME` of that, by the coordinates, shape ``(6, 5)``.
    """

    cost: float
    at: Array
    gradient: Array
    information: Array
    pose: tuple[float, float, float, float, float]
    log_volume: float
    slopes: Array


def problem_of(
    model: ForwardModel,
    pose_mean: Array,
    pose_std: Array,
    stds: Mapping[str, float],
) -> Problem:
    """Return the problem of a model's images, without readings.

    - pose_mean, pose_std: of the prior of the pose, m and rad, shape ``(5,)`` each.
    - stds: of the offset of each setting that is estimated along, by name; the mean is 0.
    """
    nuisance_std = np.array(list(stds.values()), dtype=float)
    count, lamps = math.prod(model.image_shape), model.scene.lamp_count
    spans = np.tile((0, count), (5 + len(stds), 1))
    for q, name in enumerate(stds):
        for i in range(lamps):
            if name.startswith(of_lamp(i, "")):
                spans[5 + q] = i * count // lamps, (i + 1) * count // lamps
    return Problem(
        model.optics(tuple(stds)),
        model.noise,
        frame_of(model),
        np.array(pose_mean, dtype=float),
        np.array(pose_std, dtype=float),
        np.zeros(len(nuisance_std)),
        nuisance_std,
        spans,
        _dark_counts(model, stds),
        np.zeros(count),
        np.ones(count),
        0.0,
    )


def _dark_counts(model: ForwardModel, stds: Mapping[str, float]) -> float:
    """Return the most that a detector reads without the lamp, by three standard deviations."""
    light, _ = without_lamps(model, [])
    variance = float(reading_variance(light.max(), model.noise))
    return float(light.max()) + 3 * math.hypot(math.sqrt(variance), stds.get(AMBIENT, 0.0))


def lit(readings: Array, problem: Problem) -> int:
    """Count the readings of a problem that are clearly lit, less those at full scale."""
    noise, darkest, count = problem.noise, np.inf, 0
    for reading in readings:
        darkest = min(darkest, reading)
    # All readings have about the same daylight.
    clear = min(problem.dark_counts, darkest + 6 * np.sqrt(noise.variance))
    for reading in readings:
        if reading >= noise.high:
            count -= 1
        elif reading > clear:
            count += 1
    return count


def start_at(problem: Problem, pose: Array) -> Array:
    """Return coordinates and nuisances of a pose of the table, shape ``(p,)``."""
    start = np.empty(5 + len(problem.nuisance_mean))
    turned = turned_components(pose[0], pose[1], pose[2], pose[3], pose[4], problem.roll)
    at = from_pose(problem.frame, turned, problem.roll)
    for i in range(5):
        start[i] = at[i]
    for i in range(len(problem.nuisance_mean)):
        start[5 + i] = problem.nuisance_mean[i]
    return start


def normal_equations(
    image: Any, likelihood: Any, spans: Any, gradient: Array, information: Array
) -> None:
    """Write what readings say to gradient and information."""
    size, n = len(gradient), image.shape[1]
    weighted = workspace(1, likelihood[0, 0], n)
    for q in range(size):
        start, stop = spans[q, 0], spans[q, 1]
        pull, own, line = 0.0, image[1 + q, start:stop], weighted[0, start:stop]
        score, curvature = likelihood[1, start:stop], likelihood[2, start:stop]
        for j in indices(stop - start):
            pull += total(score[j] * own[j])
            line[j] = curvature[j] * own[j]
        gradient[q] = pull
        for s in range(q + 1):
            known, other = 0.0, image[1 + s, start:stop]
            for j in indices(stop - start):
                known += total(line[j] * other[j])
            information[q, s] = information[s, q] = known


def evaluate(problem: Problem, at: Array) -> State:
    """Return the posterior at a place, shape ``(p,)``, with derivatives."""
    size, n = len(at), len(problem.readings)
    optics, frame, roll = problem.optics, problem.frame, problem.roll
    mean, std, nuisances = problem.pose_mean, problem.pose_std, at[5:]
    lamp, pose, log_volume = to_lamp(frame, at, roll)
    lamp_slopes, slopes = zeros(6, 5, at[0]), zeros(6, 5, at[0])
    write_slopes(frame, at, roll, lamp, lamp_slopes, slopes)
    write_volume_slopes(frame, lamp, lamp_slopes, slopes[VOLUME])
    image = workspace(1 + size, at[0], n)
    write_light(optics, lamp, lamp_slopes, (at[PITCH], at[YAW], roll), nuisances, image)
    detect(optics, nuisances, image)
    likelihood = workspace(3, at[0], n)
    likelihood_of(problem.readings, image[0], problem.noise, likelihood)
    weights = problem.weights
    for i in range(3):
        for j in indices(n):
            likelihood[i, j] *= weights[j]
    # A vehicle does not stand on its tail, and its body hides a lamp behind its array.
    ahead, _, _, range_m = from_centre(frame, lamp)
    possible = abs(pose[PITCH]) < STEEPEST and ahead > -0.5 * range_m
    cost = 0.0
    for j in indices(n):
        cost -= total(likelihood[0, j])
    if not possible:
        cost = np.inf
    gradient, information = np.empty(size), np.empty((size, size))
    normal_equations(image, likelihood, problem.spans, gradient, information)
    # The prior is another five readings, of the pose, and some of the nuisances.
    for i in range(5):
        precision = 1 / std[i]
        off = (pose[i] - mean[i]) * precision
        cost += 0.5 * off * off
        for q in range(5):
            slope = slopes[i, q] * precision
            gradient[q] -= off * slope
            slope *= precision
            for s in range(5):
                information[q, s] += slope * slopes[i, s]
    cost += nuisance_cost(problem, at)
    for i in range(5, size):
        precision = 1 / problem.nuisance_std[i - 5] ** 2
        gradient[i] -= (at[i] - problem.nuisance_mean[i - 5]) * precision
        information[i, i] += precision
    return State(cost, at.copy(), gradient, information, pose, log_volume, slopes)


def nuisance_cost(problem: Problem, at: Array) -> float:
    """Return the negative logarithm of the nuisances' prior, without constants."""
    cost = 0.0
    for i in range(len(problem.nuisance_mean)):
        cost += 0.5 * ((at[5 + i] - problem.nuisance_mean[i]) / problem.nuisance_std[i]) ** 2
    return cost


def longest_step(problem: Problem, i: int) -> float:
    """Return the longest step of a fit in a coordinate, or in a nuisance, from 5 on."""
    return MAX_STEP if i < 5 else 2 * problem.nuisance_std[i - 5]


def write_volume_slopes(frame: CoordinateFrame, lamp: Any, lamp_slopes: Any, slopes: Any) -> None:
    """Write the slopes of `coordinates.to_lamp`'s `log_volume`, shape ``(5,)``."""
    x, y, z, range_m = from_centre(frame, lamp)
    level = max(1 - (z / range_m) ** 2, 1e-18)
    by_range = 2 / range_m + 1 / (range_m * range_m * (1 / range_m + 0.5 * frame.k_per_m))
    for q in range(5):
        u, v, w = lamp_slopes[0, q], lamp_slopes[1, q], lamp_slopes[2, q]
        radial = (x * u + y * v + z * w) / range_m
        # ln cos e is half of ln (1 - (z / r)^2).
        risen = (w - z / range_m * radial) / range_m
        slopes[q] = by_range * radial - z / range_m * risen / level


def propose(problem: Problem, state: State, damping: float) -> tuple[Array, float]:
    """Return the damped Gauss-Newton step from a state, and its decrement; nan: there is none."""
    size = len(state.at)
    factor, there = state.information.copy(), state.gradient.copy()
    for i in range(size):
        factor[i, i] *= 1 + damping
    decrement = np.nan
    excess = 1.0
    if cholesky(factor):
        solve_lower(factor, there)
        decrement = 0.0
        for i in range(size):
            decrement += 0.5 * there[i] * there[i]
        solve_upper(factor, there)
        for i in range(size):
            excess = max(excess, abs(there[i]) / longest_step(problem, i))
    else:
        for i in range(size):
            there[i] = 0.0
    for i in range(size):
        there[i] = state.at[i] + there[i] / excess
    return there, decrement


# One step, and the whole way, from coordinates, ``(p,)``, to the nearest maximum of the posterior.
step = stepper(evaluate, ARRIVED)
refine = minimiser(evaluate, propose, ARRIVED, MOST_STEPS)


def settle(problem: Problem, start: Array) -> State:
    """Return what `refine` does, from near a minimum, in few steps however narrow its valley.

    Where the valley bends, a step along it ends beside it and above, and the next step leads back,
    farther down. So the best place is gone back to, and the step damped, after `UPHILL` steps
    without gain (the watchdog technique of R. Chamberlain et al., 1982, Math. Prog. Study 16, 1).
    """
    state = evaluate(problem, start)
    best, damping, uphill = state, SLIGHT, 0
    for _ in range(MOST_STEPS):
        if not 0 < damping <= GIVE_UP or not abs(best.cost) < np.inf:
            break
        there, decrement = propose(problem, state, damping)
        state = evaluate(problem, there)
        arrives = uphill == 0 and decrement < ARRIVED and damping < FREE
        if -np.inf < state.cost < best.cost:
            short = state.cost > best.cost - ARRIVED
            best, uphill = state, 0
            damping = 0.0 if arrives or short else 0.1 * damping
        elif arrives:
            break
        else:
            uphill += 1
            if uphill == UPHILL or not abs(state.cost) < np.inf:
                state, uphill, damping = best, 0, max(100 * damping, FREE)
    return best


def light_at(problem: Problem, at: Array) -> Array:
    """Return the light of the readings at a place, counts, shape ``(n,)``."""
    optics, n = problem.optics, len(problem.readings)
    lamp, _, _ = to_lamp(problem.frame, at, problem.roll)
    image = np.empty((1, n))
    attitude = at[PITCH], at[YAW], problem.roll
    write_light(optics, lamp, zeros(6, 0, at[0]), attitude, at[5:], image)
    detect(optics, at[5:], image)
    return image[0]


def misfit(problem: Problem, at: Array) -> float:
    """Return the standard normal value that is as improbable as these residuals of a valid image.

    A reading at a limit counts by how far the light is from where the reading would be inside, and
    an unknown by the square of its offset over its standard deviation.
    """
    light, noise = light_at(problem, at), problem.noise
    readings, weights = problem.readings, problem.weights
    squares, mean, variance = 0.0, 0.0, 0.0
    for j in indices(len(light)):
        expected = np.minimum(np.maximum(light[j], noise.low), noise.high)
        off, spread = readings[j] - expected, reading_variance(light[j], noise)
        square, around = residual_moments(light[j], sqrt(spread), noise)
        squares += total(weights[j] * (off * off / spread))
        mean += total(weights[j] * square)
        variance += total(weights[j] * around)
    squares += 2 * nuisance_cost(problem, at)
    return chi_square_score(squares, mean, variance)
