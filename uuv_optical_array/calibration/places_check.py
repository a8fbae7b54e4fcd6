"""In which way measured places are wrong, by what the light alone says of them.

A wrong place looks like another array or another lamp. So where a calibration is refused, the poses
of its images are estimated in the scene that it started from, and compared with the given places.
Where it is not refused, all places may still be off alike.
"""

import copy
import dataclasses
import math
from typing import Any

import numpy as np

from uuv_optical_array.calibration.fit.fit import CalibrationFit
from uuv_optical_array.calibration.likelihood.likelihood import CalibrationState
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES, PITCH, Array, X
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.scene import Scene, without_meaning

LEAST_PLACES, MOST_PLACES = 6, 16
# What a scene that is not calibrated yet may be off.
UNSURE = {
    "lamp_power_std": 0.4,
    "beam_sigma_std_deg": 1.5,
    "k_std_per_m": 0.1,
    "absorption_std_per_m": 0.1,
    "scattering_std": 0.7,
    "cosine_power_std": 0.2,
    "radius_std": 0.05,
    "ambient_std_counts": 20.0,
    "gain_std": 0.05,
}
# Mean square of what a part of the places is off, by its median and over what light and rail may be
# off, from where it is wrong; share of it that an even or a proportional error explains; and from
# how many medians on an estimate is another pose's.
FAR, ALIKE, ELSEWHERE = 5.0, 0.8, 4.0
MEDIAN = 0.455  # of the square of a normal number
# Standard errors from which all places are off alike, and share of their information about it that
# must remain beside all that is fitted.
SURE, LEAST_LEFT = 5.0, 1e-6


def disagreement(scene: Scene, images: Array, poses: Array, rolls: Array, std: Array) -> str:
    """Say how the given places are off, or nothing where they may be right.

    Of each place there is one image, ``(k, side, side)``, with its pose, m and rad, ``(k, 5)``, its
    roll, ``(k,)``, and the standard deviations of its pose, ``(k, 5)``.
    """
    unused = {*without_meaning(scene.effects, scene.array, scene.lamps)}
    stds: dict[str, Any] = {key: 0.0 if key in unused else std for key, std in UNSURE.items()}
    prior = dataclasses.replace(scene.prior, **stds)
    estimator = Estimator(dataclasses.replace(scene, prior=prior), max_misfit=0.0).wait()
    off, spread, seen = [], [], []
    chosen = np.linspace(0, len(images) - 1, min(len(images), MOST_PLACES)).round().astype(int)
    for k in chosen.tolist():
        try:
            found = estimator.estimate(images[k], roll=float(rolls[k]))
        except NoPose:
            continue
        off.append(found.pose - poses[k])
        spread.append(found.covariance.diagonal())
        seen.append(k)
    if len(off) < LEAST_PLACES:
        return ""
    errors, variances = np.array(off), np.array(spread) + std[seen] ** 2
    words = [
        in_words(i, poses[seen, i], errors[:, i])
        for i in np.flatnonzero(np.median(errors**2 / variances, axis=0) > MEDIAN * FAR).tolist()
    ]
    if not words:
        return ""
    return f"the light contradicts the places, by {len(off)} of them: {'; '.join(words)}"


def in_words(i: int, told: Array, off: Array) -> str:
    """Say how the values of one part of the places are off the given ones."""
    name, size, unit = DOF_NAMES[i], IN_DEGREES[i], DOF_UNITS[i]
    kept = np.abs(off) <= ELSEWHERE * np.median(np.abs(off))
    told, off = told[kept], off[kept]
    squares, mean = float(off @ off), float(off.mean())
    if len(off) * mean**2 > ALIKE * squares:
        return f"all are off by {name} {mean * size:+.2g} {unit}"
    slope = float(told @ off) / max(float(told @ told), 1e-12)
    if slope**2 * float(told @ told) > ALIKE * squares:
        return f"{name} is {1 + slope:+.2f} times the given value"
    return f"{name} is off by {np.sqrt(squares / len(off)) * size:.2g} {unit} rms"


def common_error(fit: CalibrationFit) -> str:
    """Say how all places of a fit are off alike, where their light shows it; or nothing.

    A shift along the beacon's x bends how light falls with the range, another scale how it falls
    beside what the array's own size shows; by the score test (C. R. Rao, 1948) with all that is
    fitted. Over its short steps the light is straight, beside the noise of 16 bits, too. Turns, and
    most of a shift aside, are aims of lamp and array, and reported as such.
    """
    poses, worst, reason = fit.likelihood.poses, SURE, ""
    ahead, scaled = np.zeros_like(poses), poses.copy()
    ahead[:, X], scaled[:, PITCH:] = 1.0, 0.0
    for direction, step, words in (
        (ahead, 3e-5, "along x by {:+.3f} m, with a standard error of {:.3f} m"),
        (
            scaled,
            1e-5,
            "by {:+.3f} of their distance from the lamp, with a standard error of {:.3f}",
        ),
    ):
        size, std = _error_along(fit, direction, step)
        if abs(size) > worst * std:
            worst = abs(size) / std
            reason = f"by the light all places are off {words.format(-size, std)}"
    if not reason:
        return ""
    return (
        f"{reason}: check the origin and the tape of the measurement; or the light comes from "
        "behind the lamp's face, which is fitted with prior.lamp_behind_std_m: 0.1"
    )


def _error_along(fit: CalibrationFit, direction: Array, step: float) -> tuple[float, float]:
    """Return how far to move all poses along a direction, ``(m, 5)``, and its standard error.

    The latter is inf where nothing determines it. Readings that a step brings near a limit do not
    count, as they say other things before it and after it.
    """
    likelihood, state = copy.copy(fit.likelihood), fit.state

    def moved(by: float, readings: Array) -> CalibrationState:
        other = copy.copy(likelihood)
        other.poses, other.readings = likelihood.poses + by * direction, readings
        return other.evaluate(state.at, expected=True)

    ends = [moved(by, likelihood.readings) for by in (-step, step)]
    likelihood.used = likelihood.used & np.all([*map(likelihood.uncensored, ends)], axis=0)

    def cost(at: CalibrationState) -> float:
        return at.cost - at.shift_decrement

    back, here, forth = (moved(by, likelihood.readings) for by in (-step, 0.0, step))
    score = (cost(back) - cost(forth)) / (2 * step)
    gradient, information = here.gradient, here.information
    # Without noise the changes of the gradient are those of Gauss-Newton.
    back, here, forth = (moved(by, state.mean) for by in (-step, 0.0, step))
    own = (cost(back) + cost(forth) - 2 * cost(here)) / step**2
    free = likelihood.layout.free_directions(fit.held() | likelihood.layout.lacking)
    crossed = free.T @ (back.gradient - forth.gradient) / (2 * step)
    known = np.column_stack([crossed, free.T @ gradient])
    taken_up = np.linalg.lstsq(free.T @ information @ free, known, rcond=None)[0]
    left = own - float(crossed @ taken_up[:, 0])
    if not left > LEAST_LEFT * own:
        return 0.0, math.inf
    size = (score - float(crossed @ taken_up[:, 1])) / left
    return size, math.sqrt(max(1.0, fit.agreement.misfit) / left)
