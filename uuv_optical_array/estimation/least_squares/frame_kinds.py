"""Kinds of frame that an image may be, such as clear or shaded, weighed by their evidence."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.numerics.linear_algebra import solve
from uuv_optical_array.estimation.least_squares.frame import FITTED, FrameResult
from uuv_optical_array.estimation.least_squares.problem import Problem, problem_of
from uuv_optical_array.estimation.unknowns.constants import Expected
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import (
    BEAM_SIGMA,
    OWN_POWER,
    POWER,
    ROLL,
    SHADE_DECAY,
    SHADES,
    FrameLight,
    of_lamp,
    shade_doubt,
)
from uuv_optical_array.forward.scene import Scene

# An image is hardly a clear one where a fifth of them at most leave larger residuals, or where the
# one before makes it this probable.
DOUBTFUL, SUSPECTED = 0.84, 0.05
LEAST = 1e-6  # probability of a kind, whatever the images before said
# Standard deviations of what is rarely wrong where several lamps can tell: each mode of a shade, in
# the logarithm of the light; the roll, rad, as without an IMU; the beam's width, deg; power, in its
# logarithm, and axis of one lamp. Our choice, for the unforeseen, and the share of each kind.
SHADED, ROLLED, WIDER_DEG = 0.1, 0.3, 2.0
OTHER_LAMP = {OWN_POWER: 0.3, "pitch_deg": 2.0, "yaw_deg": 2.0}
RARE = FrameLight(1e-3)


class FrameKind(NamedTuple):
    """A kind of frame, with r nuisances, some of which are the scene's q unknown constants.

    Of the constants the first are fitted; those that no image can tell are given.

    - problem: its posterior, without readings.
    - names: of its nuisances.
    - share: of such frames, in (0, 1].
    - places: those of the fitted constants among the nuisances, shape ``(k,)``.
    - added: what this kind adds to the covariance of the constants, shape ``(r, r)``.
    - doubt: factor of the pose's covariance, >= 1, for what the kind does not describe.
    - clear: whether it is lit as the scene says, also with faulty detectors or a dark lamp.
    - rare: whether it is considered only for images that are hardly clear ones.
    """

    problem: Problem
    names: tuple[str, ...]
    share: float
    places: NDArray[np.intp]
    added: Array
    doubt: float
    clear: bool
    rare: bool

    def knowing(self, expected: Expected | None) -> Problem:
        """Return the problem where more is known of the constants than the scene says."""
        if expected is None or not len(expected.mean):
            return self.problem
        fitted, optics = len(self.places), self.problem.optics
        whole, at = self.added.copy(), self.problem.nuisance_mean.copy()
        whole[self.places[:, None], self.places] += expected.covariance[:fitted, :fitted]
        at[self.places] += expected.mean[:fitted]
        precision = np.ascontiguousarray(solve(whole, np.eye(len(whole))))
        scales, given = optics.step_scales.copy(), expected.mean[fitted:]
        scales[: len(given)] = given
        return self.problem._replace(
            optics=optics._replace(step_scales=scales),
            nuisance_mean=at,
            nuisance_precision=precision,
        )


def wider_by_several(scene: Scene) -> list[dict[str, float]]:
    """Return what is less known in each rare kind of frame of several lamps that no prior names."""
    lamps = [
        {of_lamp(i, setting): std for setting, std in OTHER_LAMP.items()}
        for i in range(len(scene.lamps))
    ]
    stds = scene.nuisance_std()
    wider = [{ROLL: ROLLED}, {BEAM_SIGMA: WIDER_DEG}, *lamps]
    kinds = [
        {key: std for key, std in each.items() if 0 < stds.get(key, 0.0) < std} for each in wider
    ]
    return [dict.fromkeys(SHADES, SHADED), *filter(None, kinds)] if scene.lamps else []


def frame_kinds(model: ForwardModel, pose_mean: Array, pose_std: Array) -> list[FrameKind]:
    """Return the kinds of frame of a model's scene, clear ones first, by the prior of the pose."""
    known, constants = model.scene.prior, model.scene.constants_std()
    own_stds = model.scene.nuisance_std()
    kinds: list[FrameKind] = []
    lights = known.lights(model.scene.daylight_scale_counts)
    rare_kinds = [(RARE, wider) for wider in wider_by_several(model.scene)]
    for light, wider in [*((light, {}) for light in lights), *rare_kinds]:
        stds = {**own_stds, **known.std_in(light), **wider}
        gain_std = known.gain_std_in(light)
        if light.cloud and model.scene.lamps:
            # On its way from each lamp the light is shaded otherwise.
            for i in range(model.scene.lamp_count):
                power = of_lamp(i, OWN_POWER)
                stds[power] = math.hypot(stds.get(power, 0.0), light.depth)
                stds |= {of_lamp(i, mode): stds[mode] for mode in SHADES}
            stds = {name: std for name, std in stds.items() if name not in SHADES}
            gain_std = math.hypot(gain_std, light.depth * SHADE_DECAY)
        names = list(stds)
        given = [name for name in constants if name not in stds]
        problem = problem_of(model, pose_mean, pose_std, stds, given)
        mean = problem.nuisance_mean.copy()
        if light.cloud:
            mean[names.index(POWER)] = -light.depth
        noise = problem.noise._replace(square=gain_std**2)
        fitted = [name for name in constants if name in stds]
        places = np.array([names.index(name) for name in fitted], dtype=np.intp)
        added = np.square(list(stds.values()))
        added[places] -= np.square([own_stds.get(name, 0.0) for name in fitted])
        problem = problem._replace(nuisance_mean=mean, noise=noise)
        doubt = shade_doubt(model.scene.lamp_count) if light.cloud else 1.0
        clear = not kinds
        rare = not (clear or light.cloud)
        of = problem, tuple(names), light.share, places, np.diag(added), doubt, clear, rare
        kinds.append(FrameKind(*of))
    return kinds


def expecting(kinds: list[FrameKind], expected: Expected | None) -> list[FrameKind]:
    """Return kinds of frame with the shares that the images before let expect."""
    rares = all(kind.rare for kind in kinds[1:]) and len(kinds) > 1
    if expected is None or expected.uneven is None or not rares:
        return kinds
    share, (clear, *rare) = min(max(expected.uneven, LEAST), 1 - LEAST), kinds
    whole = sum(kind.share for kind in rare)
    rare = [kind._replace(share=share * (kind.share / whole)) for kind in rare]
    return [clear._replace(share=1 - share), *rare]


def is_doubtful(clear: FrameResult, share: float) -> bool:
    """Say whether an image may be of a rare kind, by the fit as a clear one and the rare share."""
    # What no clear frame explains at all stays without a pose.
    return clear.outcome == FITTED and (clear.strict_score > DOUBTFUL or share > SUSPECTED)


def mixture(frames: list[FrameResult], evidence: Array) -> tuple[FrameResult, Array]:
    """Return what different kinds of frame make of one image together, and their probabilities."""
    fitted = [i for i, frame in enumerate(frames) if frame.outcome == FITTED]
    shares = np.zeros(len(frames))
    if not fitted:
        return frames[0], shares
    best = max(fitted, key=lambda i: evidence[i])
    weights = np.exp(evidence[fitted] - evidence[best])
    weights /= weights.sum()
    poses = np.array([frames[i].pose for i in fitted])
    pose = weights @ poses
    off = poses - pose
    covariance = (weights[:, None] * off).T @ off
    for weight, i in zip(weights, fitted, strict=True):
        covariance += weight * frames[i].covariance
    shares[fitted] = weights
    together = frames[best]._replace(pose=pose, covariance=0.5 * (covariance + covariance.T))
    return together, shares
