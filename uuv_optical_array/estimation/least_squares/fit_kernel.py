"""The kernels of `fit.ImageFit`, compiled by Numba; importing this module imports Numba.

They say the same as `chart`, `light`, `effects` and `likelihood`, at one place of the chart at a
time: for the 25 readings of a frame NumPy takes longer to be called than to calculate. All is in
one file, because Numba keeps what it compiled until that file changes. A call with all of a `Sea`
counts the references of its arrays, so what is called for each reading takes numbers.
"""

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numba import njit

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.least_squares.compiled_fit import COSINE_POWER, RIM, Sea
from uuv_optical_array.estimation.likelihood import ASYMPTOTIC
from uuv_optical_array.forward.light import MIN_RANGE_M
from uuv_optical_array.forward.light_batch_kernel import EVEN, ODD, exponential, horner

Kernel = TypeVar("Kernel", bound=Callable[..., Any])
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}


def compiled(function: Kernel) -> Kernel:
    """Let Numba compile a function when it is first called, and keep that where it can."""
    try:
        return njit(cache=True, **OPTIONS)(function)
    except RuntimeError:  # no folder to keep it in
        return njit(**OPTIONS)(function)


@compiled
def _omega(target: float) -> float:
    """Solve ``w + ln w = target`` (F. Fritsch, R. Shafer and W. Crowley, 1973)."""
    if target < -1.0:
        w = math.exp(target)
    else:
        w = target - math.log(target) if target > 2.0 else 0.5671 + 0.3620 * target
    for _ in range(3):
        left = target - w - math.log(w)
        ahead = 1 + w
        wide = 2 * ahead * (ahead + 2 / 3 * left)
        w *= 1 + left / ahead * (wide - left) / (wide - 2 * left)
    return w


@compiled
def _chart(
    settings: tuple[float, float, float, float, float, float],
    at: Array,
    roll: float,
    lamp: Array,
    by_chart: Array,
    pose: Array,
    pose_by: Array,
    differentiate: bool,
) -> float:
    """Write lamp and axis, the pose and their derivatives at a place; return the log-volume.

    `lamp` holds position and axis, shape ``(6,)``, `by_chart` their derivatives, ``(6, 5)``,
    `pose_by` those of the pose, ``(5, 5)``.
    """
    beam_sigma_rad, k_per_m, share, centre_x, centre_y, centre_z = settings
    sin_r, cos_r = math.sin(roll), math.cos(roll)
    sin_p, cos_p = math.sin(at[3]), math.cos(at[3])
    sin_y, cos_y = math.sin(at[4]), math.cos(at[4])
    turn = (
        (
            cos_y * cos_p,
            cos_y * sin_p * sin_r - sin_y * cos_r,
            cos_y * sin_p * cos_r + sin_y * sin_r,
        ),
        (
            sin_y * cos_p,
            sin_y * sin_p * sin_r + cos_y * cos_r,
            sin_y * sin_p * cos_r - cos_y * sin_r,
        ),
        (-sin_p, cos_p * sin_r, cos_p * cos_r),
    )
    source = turn[0]  # where the light comes from: the beam's axis, turned round
    by_chart[:] = 0.0
    lamp[3], lamp[4], lamp[5] = -source[0], -source[1], -source[2]
    by_chart[3, 3] = source[1] * sin_r + source[2] * cos_r
    by_chart[4, 3] = -source[0] * sin_r
    by_chart[5, 3] = -source[0] * cos_r
    for i in range(3):
        by_chart[3 + i, 4] = turn[1][i]
    azimuth, elevation = at[0], at[1]
    level = math.hypot(source[0], source[1])
    if share > 0:
        azimuth += share * math.atan2(source[1], source[0])
        elevation += share * math.atan2(source[2], level)
    cos_a, sin_a = math.cos(azimuth), math.sin(azimuth)
    cos_e, sin_e = math.cos(elevation), math.sin(elevation)
    sight = (cos_e * cos_a, cos_e * sin_a, sin_e)
    by_chart[0, 0], by_chart[1, 0] = -sight[1], sight[0]
    by_chart[0, 1], by_chart[1, 1], by_chart[2, 1] = -sin_e * cos_a, -sin_e * sin_a, cos_e
    if share > 0:
        level = max(level, 1e-6)
        for q in (3, 4):
            x, y, z = -by_chart[3, q], -by_chart[4, q], -by_chart[5, q]
            swing_a = (source[0] * y - source[1] * x) / level**2
            swing_e = level * z - source[2] / level * (source[0] * x + source[1] * y)
            for i in range(3):
                by_chart[i, q] = share * (by_chart[i, 0] * swing_a + by_chart[i, 1] * swing_e)
    # Loss to the beam's profile, as `Chart._beam_loss`.
    cosine = sight[0] * source[0] + sight[1] * source[1] + sight[2] * source[2]
    sine = 0.0
    for i in range(3):
        sine += (sight[i] - cosine * source[i]) ** 2
    sine = math.sqrt(sine)
    off_axis = math.atan2(sine, cosine)
    scale = 0.25 / beam_sigma_rad**2
    ratio = 2 * scale * (off_axis / sine if sine > 1e-9 else 1.0)
    dimness, slope = at[2] - scale * off_axis**2, 0.0
    if share > 0:
        facing = max(sight[0], 1e-3)
        dimness += 0.5 * math.log(facing)
        slope = 0.5 / facing if facing == sight[0] else 0.0
    half_k = k_per_m / 2
    dimness = min(max(dimness, -7.0), 12.0)
    range_m = math.exp(dimness) if half_k == 0 else _omega(dimness + math.log(half_k)) / half_k
    given = 1 / (1 / range_m + half_k)
    lamp[0] = range_m * sight[0] + centre_x
    lamp[1] = range_m * sight[1] + centre_y
    lamp[2] = range_m * sight[2] + centre_z
    for i in range(3):
        row = turn[i]
        pose[i] = -(row[0] * lamp[0] + row[1] * lamp[1] + row[2] * lamp[2])
    pose[3], pose[4] = at[3], at[4]
    log_volume = math.log(range_m**2 * max(abs(cos_e), 1e-9) * given)
    if not differentiate:
        return log_volume
    for q in range(5):
        stretch = 1.0
        if q != 2:
            stretch = 0.0
            for i in range(3):
                stretch += ratio * (source[i] * by_chart[i, q] - sight[i] * by_chart[3 + i, q])
        stretch = given * (stretch + slope * by_chart[0, q])
        for i in range(3):
            by_chart[i, q] = range_m * by_chart[i, q] + sight[i] * stretch
    pitched = -(lamp[1] * sin_r + lamp[2] * cos_r), lamp[0] * sin_r, lamp[0] * cos_r
    pose_by[:] = 0.0
    for i in range(3):
        row = turn[i]
        for q in range(5):
            for j in range(3):
                moved = by_chart[j, q] - pitched[j] if q == 3 else by_chart[j, q]
                pose_by[i, q] -= row[j] * moved
    pose_by[0, 4] -= pose[1]
    pose_by[1, 4] += pose[0]
    pose_by[3, 3] = pose_by[4, 4] = 1.0
    return log_volume


@compiled
def _off_axis(along: float, across_squared: float, r: float) -> tuple[float, float]:
    """Return the squared off-axis angle, and that angle over the distance from the axis."""
    if along * along > across_squared and along > MIN_RANGE_M:
        s = across_squared / (r * r)
        relation = horner(EVEN, s * s) + s * horner(ODD, s * s)
        return s * relation, math.sqrt(relation) / r
    across = math.sqrt(across_squared)
    off_axis = math.atan2(across, along)
    return off_axis * off_axis, off_axis / max(across, 1e-9 * r)


@compiled
def _ray(
    detectors: Array, j: int, lamp: tuple[float, float, float, float, float, float]
) -> tuple[float, float, float, float, float, float, float]:
    """Return x, y, z to the lamp, the way along the beam, that across squared, range and cosine."""
    x, y, z = lamp[0] - detectors[0, j], lamp[1] - detectors[1, j], lamp[2] - detectors[2, j]
    along = -(x * lamp[3] + y * lamp[4] + z * lamp[5])
    off_x, off_y, off_z = x + along * lamp[3], y + along * lamp[4], z + along * lamp[5]
    across_squared = off_x * off_x + off_y * off_y + off_z * off_z
    r = max(math.sqrt(x * x + y * y + z * z), MIN_RANGE_M)
    facing = x * detectors[3, j] + y * detectors[4, j] + z * detectors[5, j]
    return x, y, z, along, across_squared, r, min(facing / r, 1.0)


@compiled
def _beam(
    detectors: Array,
    lamp: tuple[float, float, float, float, float, float],
    power: float,
    gain: float,
    k_per_m: float,
    light: Array,
) -> None:
    """Write the light of the lamp on each detector, in water without scatter."""
    wide = 0
    # No branch and no call, so the processor takes several turns at once.
    for j in range(len(light)):
        _, _, _, along, across_squared, r, cosine = _ray(detectors, j, lamp)
        cosine = cosine if cosine > 0 else 0.0
        inverse = 1 / r
        s = across_squared * inverse * inverse
        squared = s * (horner(EVEN, s * s) + s * horner(ODD, s * s))
        wide += 0 if along * along > across_squared and along > MIN_RANGE_M else 1
        light[j] = cosine * power * inverse * inverse * exponential(gain * squared - k_per_m * r)
    if not wide:
        return
    # That holds within 45 deg of the axis, clear of the lamp. Elsewhere, once more.
    for j in range(len(light)):
        _, _, _, along, across_squared, r, cosine = _ray(detectors, j, lamp)
        squared, _ = _off_axis(along, across_squared, r)
        light[j] = max(cosine, 0.0) * power / (r * r) * exponential(gain * squared - k_per_m * r)


@compiled
def _rays(
    sea: Sea,
    at: Array,
    lamp: Array,
    by_chart: Array,
    light: Array,
    jacobian: Array,
    differentiate: bool,
) -> None:
    """Write the light of lamp and water on each detector, and its derivatives, ``(n, p)``."""
    detectors = sea.detectors
    power = sea.power * (math.exp(at[sea.at_power]) if sea.at_power >= 0 else 1.0)
    k_per_m = sea.chart[1] + (at[sea.at_k] if sea.at_k >= 0 else 0.0)
    narrow = sea.chart[0] ** 2
    beam_x, beam_y, beam_z = lamp[3], lamp[4], lamp[5]
    ray = lamp[0], lamp[1], lamp[2], beam_x, beam_y, beam_z
    _beam(detectors, ray, power, -0.5 / narrow, k_per_m, light)
    if sea.scattering_per_m == 0 and sea.view_form == 0 and not differentiate:
        return
    for j in range(len(light)):
        for q in range(len(at) if differentiate else 0):
            jacobian[j, q] = 0.0
        x, y, z, along, across_squared, r, cosine = _ray(detectors, j, ray)
        if not cosine > 0:
            continue
        squared, ratio = _off_axis(along, across_squared, r)
        bright, by_cosine = light[j], light[j] / cosine
        # Of the logarithm.
        by_r, by_half_square = -2 / r - k_per_m, -1 / narrow
        if sea.scattering_per_m > 0:
            factor, slope, by_scatter = _scattered(
                sea.scattering_per_m, sea.scattering_variance, narrow, r, 0.5 * squared
            )
            bright *= factor
            by_cosine *= factor
            by_r += slope
            by_half_square += by_scatter
        if sea.view_form == COSINE_POWER:
            seen = max(cosine, 1e-12) ** sea.view_values[0]
            bright *= seen
            by_cosine *= seen * (1 + sea.view_values[0])
        elif sea.view_form == RIM:
            inside = math.tanh((cosine - sea.view_values[0]) / sea.view_values[1])
            seen = 0.5 * (1 + inside)
            bright *= seen
            by_cosine *= seen + cosine * 0.5 * (1 - inside**2) / sea.view_values[1]
        light[j] = bright
        if not differentiate:
            continue
        bend = bright * by_half_square * ratio
        radial = (bright * by_r - by_cosine * cosine / r + bend * along / r) / r
        by_cosine /= r
        by_x = radial * x + by_cosine * detectors[3, j] + bend * beam_x
        by_y = radial * y + by_cosine * detectors[4, j] + bend * beam_y
        by_z = radial * z + by_cosine * detectors[5, j] + bend * beam_z
        for q in range(5):
            jacobian[j, q] = (
                by_x * by_chart[0, q]
                + by_y * by_chart[1, q]
                + by_z * by_chart[2, q]
                + bend * (x * by_chart[3, q] + y * by_chart[4, q] + z * by_chart[5, q])
            )
        if sea.at_power >= 0:
            jacobian[j, sea.at_power] = bright
        if sea.at_k >= 0:
            jacobian[j, sea.at_k] = -r * bright


@compiled
def _scattered(
    b: float, variance: float, narrow: float, r: float, half_square: float
) -> tuple[float, float, float]:
    """Return the factor of `effects.beam_spread`, and its logarithm's slopes by range and angle."""
    straight, scattered = math.exp(-b * r), -math.expm1(-b * r)
    wide = narrow + variance * b * r / (3 * scattered)
    spread = narrow / wide * math.exp(min(half_square * (1 / narrow - 1 / wide), 600.0))
    widening = b * variance / 3 * (scattered - b * r * straight) / scattered**2
    factor = straight + scattered * spread
    by_range = b * straight * (spread - 1)
    by_range += scattered * spread * widening / wide * (half_square / wide - 1)
    by_half_square = scattered * spread * (1 / narrow - 1 / wide)
    return factor, by_range / factor, by_half_square / factor


@compiled
def _blurred(blur: Array, image: Array, half: Array) -> None:
    """Blur an image, shape ``(side, side)``, in place, by ``blur @ image @ blur.T``."""
    side = len(blur)
    half[:] = 0.0
    for i in range(side):
        for k in range(side):
            if blur[i, k] != 0:
                for j in range(side):
                    half[i, j] += blur[i, k] * image[k, j]
    image[:] = 0.0
    for j in range(side):
        for k in range(side):
            if blur[j, k] != 0:
                for i in range(side):
                    image[i, j] += blur[j, k] * half[i, k]


@compiled
def _detect(sea: Sea, at: Array, light: Array, jacobian: Array, differentiate: bool) -> None:
    """Turn the light of the lamp into that of the reading, its derivatives along with it."""
    size = len(at)
    side = len(sea.blur)
    if side:
        half = np.empty((side, side))
        _blurred(sea.blur, light.reshape(side, side), half)
        if differentiate:
            plane = np.empty((side, side))
            for q in range(size):
                plane.reshape(-1)[:] = jacobian[:, q]
                _blurred(sea.blur, plane, half)
                jacobian[:, q] = plane.reshape(-1)
    drift = 1 + (sea.drift_per_c * at[sea.at_temperature] if sea.at_temperature >= 0 else 0.0)
    ambient = sea.ambient + (at[sea.at_ambient] if sea.at_ambient >= 0 else 0.0)
    for j in range(len(light)):
        whole = sea.gain[j] * (light[j] + ambient)
        light[j] = drift * whole + sea.floor[j]
        if not differentiate:
            continue
        for q in range(size):
            jacobian[j, q] *= sea.gain[j] * drift
        if sea.at_ambient >= 0:
            jacobian[j, sea.at_ambient] = sea.gain[j] * drift
        if sea.at_temperature >= 0:
            jacobian[j, sea.at_temperature] = sea.drift_per_c * whole


@compiled
def _likely(
    reading: float, light: float, still: float, steep: float, least: float, low: float, high: float
) -> tuple[float, float, float]:
    """Return log-likelihood, score and curvature, as `likelihood.log_likelihood`."""
    variance = max(still + steep * max(light, 0.0), least)
    if low < reading < high:
        curvature = 1 / variance
        residual = reading - light
        score = residual * curvature
        value = -0.5 * residual * score
        if steep > 0:
            relative = steep * curvature
            score += 0.5 * relative * (residual * score - 1)
            curvature += 0.5 * relative**2
            value -= 0.5 * math.log(variance)
        return value, score, curvature
    sign = 1.0 if reading >= high else -1.0
    bound = high - 0.5 if reading >= high else low + 0.5
    inverse_std = 1 / math.sqrt(variance)
    u = min(max(sign * (light - bound) * inverse_std, -1e100), 1e100)
    if u > ASYMPTOTIC:
        # The distribution and, over it, the density.
        within = 0.5 * math.erfc(-u * math.sqrt(0.5))
        value = math.log(within)
        hazard = math.exp(-0.5 * u * u) / (within * math.sqrt(2 * math.pi))
        share = max(hazard * (hazard + u), 0.0)
    else:
        s = 1 / (u * u)
        less = s * (1 - 3 * s * (1 - 5 * s * (1 - 7 * s * (1 - 9 * s))))
        value = -0.5 * u * u + math.log((1 - less) / (-u * math.sqrt(2 * math.pi)))
        hazard = -u / (1 - less)
        share = hazard * -u * less / (1 - less)
    return value, sign * hazard * inverse_std, share * inverse_std**2


@compiled
def _work(n: int, size: int) -> tuple[Array, Array, Array, Array, Array]:
    """Return room for light, its Jacobian, the lamp, and the slopes of lamp and pose."""
    return np.empty(n), np.empty((n, size)), np.empty(6), np.empty((6, 5)), np.empty((5, 5))


@compiled
def _place(
    sea: Sea,
    readings: Array,
    at: Array,
    roll: float,
    mean: Array,
    gradient: Array,
    information: Array,
    pose: Array,
    work: tuple[Array, Array, Array, Array, Array],
) -> tuple[float, float]:
    """Write all about one place of the chart; return its cost and log-volume."""
    light, jacobian, lamp, by_chart, pose_by = work
    size = len(at)
    log_volume = _chart(sea.chart, at, roll, lamp, by_chart, pose, pose_by, True)
    _rays(sea, at, lamp, by_chart, light, jacobian, True)
    _detect(sea, at, light, jacobian, True)
    gradient[:] = 0.0
    information[:] = 0.0
    cost = 0.0
    noise = sea.still, sea.steep, sea.least_variance, sea.low, sea.high
    for j in range(len(light)):
        value, score, curvature = _likely(readings[j], light[j], *noise)
        cost -= value
        for q in range(size):
            gradient[q] += score * jacobian[j, q]
            weighted = curvature * jacobian[j, q]
            for s in range(q + 1):
                information[q, s] += weighted * jacobian[j, s]
    # The prior is another five readings, of the pose, and one of each nuisance.
    for i in range(size):
        std = sea.std[i]
        off = ((pose[i] if i < 5 else at[i]) - mean[i]) / std
        cost += 0.5 * off * off
        if i >= 5:
            gradient[i] -= off / std
            information[i, i] += 1 / (std * std)
        else:
            for q in range(5):
                gradient[q] -= off * pose_by[i, q] / std
                for s in range(q + 1):
                    information[q, s] += pose_by[i, q] * pose_by[i, s] / (std * std)
    for q in range(size):
        for s in range(q):
            information[s, q] = information[q, s]
    return cost, log_volume


@compiled
def _step(information: Array, damping: float, gradient: Array, factor: Array, step: Array) -> float:
    """Solve for the damped Newton step by Cholesky's factor; return the decrement, nan if none."""
    size = len(gradient)
    for i in range(size):
        for j in range(i + 1):
            total = information[i, j]
            if i == j:
                total *= 1 + damping
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                if not total > 0:
                    return math.nan
                factor[i, i] = math.sqrt(total)
            else:
                factor[i, j] = total / factor[j, j]
    for i in range(size):
        total = gradient[i]
        for k in range(i):
            total -= factor[i, k] * step[k]
        step[i] = total / factor[i, i]
    decrement = 0.0
    for i in range(size):
        decrement += 0.5 * step[i] * step[i]
    for i in range(size - 1, -1, -1):
        total = step[i]
        for k in range(i + 1, size):
            total -= factor[k, i] * step[k]
        step[i] = total / factor[i, i]
    return decrement


@compiled
def light_at(sea: Sea, at: Array, roll: float) -> Array:
    """As `fit.ImageFit.light`."""
    light, jacobian, lamp, by_chart, pose_by = _work(len(sea.gain), len(at))
    _chart(sea.chart, at, roll, lamp, by_chart, np.empty(5), pose_by, False)
    _rays(sea, at, lamp, by_chart, light, jacobian, False)
    _detect(sea, at, light, jacobian, False)
    return light


@compiled
def costs(
    sea: Sea, readings: Array, places: Array, roll: float, mean: Array
) -> tuple[Array, Array, Array]:
    """As `fit.ImageFit.cost`."""
    count, size = places.shape
    light, jacobian, lamp, by_chart, pose_by = _work(len(sea.gain), size)
    poses, found, log_volume = np.empty((count, 5)), np.empty(count), np.empty(count)
    noise = sea.still, sea.steep, sea.least_variance, sea.low, sea.high
    for i in range(count):
        at, pose = places[i], poses[i]
        log_volume[i] = _chart(sea.chart, at, roll, lamp, by_chart, pose, pose_by, False)
        _rays(sea, at, lamp, by_chart, light, jacobian, False)
        _detect(sea, at, light, jacobian, False)
        total = 0.0
        for j in range(len(light)):
            value, _, _ = _likely(readings[j], light[j], *noise)
            total -= value
        for q in range(size):
            off = ((pose[q] if q < 5 else at[q]) - mean[q]) / sea.std[q]
            total += 0.5 * off * off
        found[i] = total
    return poses, found, log_volume


@compiled
def evaluate(
    sea: Sea, readings: Array, places: Array, roll: float, mean: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """As `fit.ImageFit.evaluate`, with readings and mean of each place."""
    count, size = places.shape
    work = _work(len(sea.gain), size)
    cost, log_volume = np.empty(count), np.empty(count)
    gradient, information = np.empty((count, size)), np.empty((count, size, size))
    poses = np.empty((count, 5))
    for i in range(count):
        cost[i], log_volume[i] = _place(
            sea, readings[i], places[i], roll, mean[i], gradient[i], information[i], poses[i], work
        )
    return cost, gradient, information, poses, log_volume


@compiled
def descend(
    sea: Sea,
    readings: Array,
    places: Array,
    roll: float,
    mean: Array,
    iterations: int,
    near: float,
) -> tuple[Array, Array, Array]:
    """As `fit.ImageFit.descend`, with readings and mean of each place."""
    count, size = places.shape
    work = _work(len(sea.gain), size)
    costs, informations, poses = (
        np.empty(count),
        np.empty((count, size, size)),
        np.empty((count, 5)),
    )
    gradient, new_gradient, new_information = np.empty(size), np.empty(size), np.empty((size, size))
    factor, step, trial = np.empty((size, size)), np.empty(size), np.empty(size)
    for i in range(count):
        at, mine, prior, information, pose = (
            places[i],
            readings[i],
            mean[i],
            informations[i],
            poses[i],
        )
        cost, _ = _place(sea, mine, at, roll, prior, gradient, information, pose, work)
        damping = 1e-3
        for _ in range(iterations):
            decrement = _step(information, damping, gradient, factor, step)
            # A heavily damped step is short wherever it is taken, so it proves nothing.
            if decrement < near and damping < 1e-1:
                at += step
                cost -= decrement
                break
            gain = 0.0
            if decrement == decrement:  # else no step, and more damping
                excess = 1.0
                for q in range(size):
                    excess = max(excess, abs(step[q]) / sea.reach[q])
                for q in range(size):
                    trial[q] = at[q] + step[q] / excess
                new_cost, _ = _place(
                    sea, mine, trial, roll, prior, new_gradient, new_information, pose, work
                )
                gain = cost - new_cost
            if gain > 0:
                at[:] = trial
                cost = new_cost
                gradient[:] = new_gradient
                information[:] = new_information
            if 0 < gain < near or damping > 1e4:
                break
            damping *= 0.1 if gain > 0 else 10.0
        costs[i] = cost
        _chart(sea.chart, at, roll, work[2], work[3], pose, work[4], False)
    return costs, informations, poses
