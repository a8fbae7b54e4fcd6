"""How the light of an image may differ from the scene's: by nothing, a little, or more.

What the scene does not describe (shade, daylight's slope, errors of beam and response) is smooth
over the array. So an image has, beside the scene's unknown constants, modes of such a discrepancy,
whose prior is a mixture of several sizes: most images have none. Each size is a kind of frame, with
a posterior of its own, and the kinds are weighted by their evidence. Each of several lamps may also
differ by itself.
"""

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.least_squares.frame import FITTED, FrameResult
from uuv_optical_array.estimation.least_squares.problem import Problem, problem_of
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

LEAST = 1e-6  # probability that an image is clear or not, whatever the images before said
# Standard deviations, at full size, of what several lamps show beside a shade: the roll, rad, as
# without an IMU; the beam's width, deg; power, in its logarithm, and axis of each lamp. Our choice.
BY_LAMPS = {ROLL: 0.3, BEAM_SIGMA: 2.0}
BY_LAMP = {OWN_POWER: 0.2, "pitch_deg": 1.0, "yaw_deg": 1.0}


class FrameKind(NamedTuple):
    """A kind of frame, with nuisances, some of which are the scene's unknown constants.

    - problem: its posterior, without readings.
    - names: of its nuisances.
    - share: of such frames, in (0, 1].
    - shared: places of the clear kind's nuisances among these.
    - doubt: factor of the pose's covariance, >= 1, for what the kind does not describe.
    - size: of what the scene does not name, as of `FrameLight`.
    """

    problem: Problem
    names: tuple[str, ...]
    share: float
    shared: NDArray[np.intp]
    doubt: float
    size: float


def frame_kinds(model: ForwardModel, pose_mean: Array, pose_std: Array) -> list[FrameKind]:
    """Return the kinds of frame of a model's scene, the clear one first, by the pose's prior."""
    scene = model.scene
    kinds: list[FrameKind] = []
    for light in scene.prior.lights(scene.daylight_scale_counts, len(scene.lamps)):
        stds, gain_std = unknown_in(light, scene)
        names, problem = tuple(stds), problem_of(model, pose_mean, pose_std, stds)
        noise = problem.noise._replace(square=gain_std**2 + model.analogue_noise.square)
        mean = problem.nuisance_mean.copy()
        if light.cloud:
            mean[names.index(POWER)] = -light.depth
        clear = kinds[0].names if kinds else names
        kind = FrameKind(
            problem=problem._replace(nuisance_mean=mean, noise=noise),
            names=names,
            share=light.share,
            shared=np.array([names.index(name) for name in clear], dtype=np.intp),
            doubt=shade_doubt(scene.lamp_count) if light.cloud else 1.0,
            size=light.size,
        )
        kinds.append(kind)
    return kinds


def unknown_in(light: FrameLight, scene: Scene) -> tuple[dict[str, float], float]:
    """Return the standard deviations of what a kind of frame leaves unknown, and of its gains."""
    own, lamps = scene.nuisance_std(), len(scene.lamps)
    stds, gain_std = {**own, **scene.prior.std_in(light)}, scene.prior.gain_std_in(light)
    if light.cloud and lamps:
        stds = shaded_apart(stds, light.depth, lamps)
        gain_std = math.hypot(gain_std, light.depth * SHADE_DECAY)
    elif light.size and lamps:
        by_lamp = {of_lamp(i, key): std for i in range(lamps) for key, std in BY_LAMP.items()}
        more = {name: light.size * std for name, std in {**BY_LAMPS, **by_lamp}.items()}
        stds = widened(stds, more)
    constants = scene.constants_std().items()
    return widened(stds, {name: std for name, std in constants if name not in own}), gain_std


def shaded_apart(stds: dict[str, float], depth: float, lamps: int) -> dict[str, float]:
    """Return standard deviations where the light of each lamp is shaded differently on its way."""
    apart = {name: std for name, std in stds.items() if name not in SHADES}
    for i in range(lamps):
        power = of_lamp(i, OWN_POWER)
        apart[power] = math.hypot(apart.get(power, 0.0), depth)
        apart |= {of_lamp(i, mode): stds[mode] for mode in SHADES}
    return apart


def widened(stds: dict[str, float], more: dict[str, float]) -> dict[str, float]:
    """Return standard deviations with those of further errors; a scene knows the others exactly."""
    return {name: math.hypot(std, more.get(name, 0.0)) for name, std in stds.items()}


def expecting(kinds: list[FrameKind], uneven: float | None) -> list[FrameKind]:
    """Return the kinds of frame with the share of unclear ones that earlier images predict."""
    if uneven is None or len(kinds) == 1:
        return kinds
    share, (clear, *others) = min(max(uneven, LEAST), 1 - LEAST), kinds
    whole = sum(kind.share for kind in others)
    others = [kind._replace(share=share * (kind.share / whole)) for kind in others]
    return [clear._replace(share=1 - share), *others]


def mixture(
    frames: Sequence[FrameResult], evidence: Sequence[float]
) -> tuple[FrameResult, list[float]]:
    """Return the mixture of one image's posteriors by kinds of frame, and their probabilities."""
    fitted = [i for i, frame in enumerate(frames) if frame.outcome == FITTED]
    if not fitted:
        return frames[0], [0.0] * len(frames)
    best = max(fitted, key=lambda i: evidence[i])
    odds = {i: math.exp(evidence[i] - evidence[best]) for i in fitted}
    whole = sum(odds.values())
    shares = [odds.get(i, 0.0) / whole for i in range(len(frames))]
    pose = functools.reduce(np.add, [shares[i] * frames[i].pose for i in fitted])
    offs = [(shares[i], frames[i].covariance, frames[i].pose - pose) for i in fitted]
    covariance = functools.reduce(
        np.add, [share * (own + off[:, None] * off) for share, own, off in offs]
    )
    return frames[best]._replace(pose=pose, covariance=covariance), shares
