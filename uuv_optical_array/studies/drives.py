"""Tracks of drives through seas that are drawn from the scene's prior, and stay as they are.

A single frame cannot tell a weak lamp from a far one. While the range changes a track can, and
learns what the scene leaves open.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import DOF_NAMES, IN_DEGREES, Array, X
from uuv_optical_array.core.storage.formats import plain
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.estimation.table.signature_table import Progress
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.working_volume import HIGH, LOW
from uuv_optical_array.studies.errors import SIGMAS, FrameErrors

SWAY = 0.4  # of the working volume's half width, across and in angle
SWAY_RAD_PER_S = (0.1, 0.25)
LAST_S = 10.0  # at the end of a drive, when most was learnt


@dataclass(frozen=True)
class Drive:
    """One drive.

    Parameters
    ----------
    tracks
        Of the track at each frame; nan where the frame is not in it.
    singles
        Of the last `LAST_S`, each frame by itself and without what was learnt.
    """

    tracks: FrameErrors
    singles: FrameErrors


def course(times_s: Array, duration_s: float, rng: np.random.Generator) -> Array:
    """Return poses that go through the working volume from afar to near and back, swaying.

    Parameters
    ----------
    times_s
        Since the start, s, shape ``(n,)``.
    duration_s
        Of the whole, s.
    rng
        Of the sway.

    Returns
    -------
    Array
        m and rad, shape ``(n, 5)``.
    """
    poses = np.empty((len(times_s), 5))
    middle, half = (LOW[X] + HIGH[X]) / 2, (HIGH[X] - LOW[X]) / 2
    poses[:, X] = middle - half * np.cos(2 * np.pi * times_s / duration_s)
    phases = np.outer(times_s, rng.uniform(*SWAY_RAD_PER_S, 4)) + rng.uniform(0, 2 * np.pi, 4)
    poses[:, 1:] = SWAY * HIGH[1:] * np.sin(phases)
    return poses


def _errors(answers: list[tuple[Array, Array]], poses: Array) -> FrameErrors:
    found = np.array([pose for pose, _ in answers]) - poses
    nothing = np.empty(0)
    return FrameErrors(found, np.array([spread for _, spread in answers]), nothing, nothing)


def drive(
    estimator: Estimator,
    duration_s: float,
    rate_hz: float,
    rng: np.random.Generator,
) -> Drive:
    """Drive once through a sea drawn from the scene's prior; the aim of the array is the scene's.

    Parameters
    ----------
    estimator
        The estimator, with the scene as it is believed to be.
    duration_s
        How long, s.
    rate_hz
        Of the images, Hz.
    rng
        Of the sea, the course and the noise.
    """
    scene = estimator.scene
    model, known = ForwardModel(scene), scene.prior
    offsets = {name: std * rng.standard_normal() for name, std in known.nuisance_std().items()}
    gains = 1 + known.gain_std * rng.standard_normal((model.array.side, model.array.side))
    times_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    poses = course(times_s, duration_s, rng)
    pipeline = Pipeline(estimator)
    nothing = np.full(5, np.nan), np.full((5, 5), np.nan)
    tracks, singles = [], []
    for i in range(len(times_s)):
        light = model.light(poses[i], 0.0, {name: np.array(off) for name, off in offsets.items()})
        image = model.read(gains * light, rng)
        track = pipeline.answer(round((1 + times_s[i]) * 1e9), image).track
        tracks.append(nothing if track is None else (track.pose, track.covariance))
        if times_s[i] >= duration_s - LAST_S:
            try:
                estimate = estimator.estimate(image)
                singles.append((estimate.pose, estimate.covariance))
            except NoPose:
                singles.append(nothing)
    return Drive(_errors(tracks, poses), _errors(singles, poses[-len(singles) :]))


def measure_drives(
    estimator: Estimator,
    count: int,
    duration_s: float,
    rate_hz: float,
    seed: int,
    progress: Progress = iter,
) -> Iterator[Drive]:
    """Drive through one sea after the other.

    Parameters
    ----------
    estimator, duration_s, rate_hz
        As `drive` has them.
    count
        Drives, >= 1.
    seed
        Of all random numbers.
    progress
        Wraps the loop over the drives.

    Yields
    ------
    Drive
        Through each sea.
    """
    for i in progress(range(count)):
        yield drive(estimator, duration_s, rate_hz, np.random.default_rng((seed, i)))


def as_object(drives: list[Drive]) -> dict[str, Any]:
    """Return plain values of all drives together, errors in m and deg."""
    tracks = [each.tracks for each in drives]
    posed = np.concatenate([each.posed for each in tracks])
    means = np.array([each.nees.mean() for each in tracks if each.posed.any()])
    singles = np.concatenate([each.singles.errors for each in drives])
    last = np.concatenate([each.tracks.errors[-len(each.singles.errors) :] for each in drives])
    tracked, single = (
        np.sqrt(np.nanmean(np.square(errors), axis=0)) * IN_DEGREES for errors in (last, singles)
    )
    return plain(
        {
            "drives": len(drives),
            "frames": len(posed),
            "refused": int((~posed).sum()),
            "beyond_6_sigma": sum(int(each.beyond_sigma(SIGMAS).sum()) for each in tracks),
            "nees_mean": float(means.mean()),
            "nees_of_drives": np.quantile(means, [0.05, 0.5, 0.95]).tolist(),
            "last_s": LAST_S,
            "rms_tracked": dict(zip(DOF_NAMES, tracked.tolist(), strict=True)),
            "rms_single": dict(zip(DOF_NAMES, single.tolist(), strict=True)),
            "range_ratio": float(tracked[X] / single[X]),
        }
    )
