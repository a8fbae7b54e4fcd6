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
    of_lamp,
    shade_doubt,
)

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
    known, lamps = model.scene.prior, model.scene.lamp_count if model.scene.lamps else 0
    own_stds, constants = model.scene.nuisance_std(), model.scene.constants_std()
    seen_by_many = {name: std for name, std in constants.items() if name not in own_stds}
    kinds: list[FrameKind] = []
    for light in known.lights(model.scene.daylight_scale_counts, lamps):
        stds = {**own_stds, **known.std_in(light)}
        gain_std = known.gain_std_in(light)
        if light.cloud and lamps:
            # On its way from each lamp the light is shaded differently.
            for i in range(lamps):
                power = of_lamp(i, OWN_POWER)
                stds[power] = math.hypot(stds.get(power, 0.0), light.depth)
                stds |= {of_lamp(i, mode): stds[mode] for mode in SHADES}
            stds = {name: std for name, std in stds.items() if name not in SHADES}
            gain_std = math.hypot(gain_std, light.depth * SHADE_DECAY)
        elif light.size and lamps:
            own = {of_lamp(i, key): std for i in range(lamps) for key, std in BY_LAMP.items()}
            for name, std in {**BY_LAMPS, **own}.items():
                if stds.get(name, 0.0) > 0:  # else a scene of this kind knows it exactly
                    stds[name] = math.hypot(stds[name], light.size * std)
        for name, std in seen_by_many.items():
            if name in stds:
                stds[name] = math.hypot(stds[name], std)
        names = list(stds)
        problem = problem_of(model, pose_mean, pose_std, stds)
        mean = problem.nuisance_mean.copy()
        if light.cloud:
            mean[names.index(POWER)] = -light.depth
        noise = problem.noise._replace(square=gain_std**2 + model.analogue_noise.square)
        problem = problem._replace(nuisance_mean=mean, noise=noise)
        doubt = shade_doubt(model.scene.lamp_count) if light.cloud else 1.0
        clear = kinds[0].names if kinds else names
        shared = np.array([names.index(name) for name in clear], dtype=np.intp)
        of = problem, tuple(names), light.share, shared, doubt, light.size
        kinds.append(FrameKind(*of))
    return kinds


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
