"""What accuracy costs in time: every method on every array and table, measured side by side.

A setting is a method, an array and the size of its table. Those that share an array and a table are
measured together, frame by frame in turn, so that a busy machine is as busy for each of them.
"""

import dataclasses
import functools
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Span
from uuv_optical_array.estimation.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.estimator import METHODS, Estimator, NoPose
from uuv_optical_array.estimation.features import key_parameters
from uuv_optical_array.estimation.table.signature_table import Progress, SignatureTable, build_table
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, TableSettings
from uuv_optical_array.studies.accuracy import (
    HIGH,
    LOW,
    MODEL_EVERY,
    MODEL_POSES,
    Study,
    random_poses,
    within_volume,
)
from uuv_optical_array.studies.baselines import lookup, moments
from uuv_optical_array.studies.tradeoff.results import Mode, Row, load_average

# Our methods have a table of any size, the published ones what they were published with.
LOOK_UP, MOMENTS = "look_up", "moments"
PUBLISHED = (LOOK_UP, MOMENTS)
ALL_METHODS = (*PUBLISHED, *METHODS)
SIDES = (3, 5, 7, 21)
SHAPES: tuple[Shape, ...] = ("curved", "planar")
# Values along each of the five axes: 1e3, 8e3, 1e5, 1e6 and 1e7 poses.
STEPS = (4, 6, 10, 16, 25)
FRAMES: dict[Mode, int] = {"quick": 300, "full": 1000}
QUICK_STEPS, QUICK_OWN_STEPS = (10,), (4, 6, 10, 16)
QUICK_LOOK_UP_SIDE = 7
QUICK_LEAVES_OUT = (
    "left out but for --full: tables of 1e7 poses, of 1e6 but on the scene's own array, of 1e3 and "
    "8e3 on arrays of the other shape, and the look-up but on planar arrays up to 7 x 7"
)
SAMPLE_FRAMES = 4
LOOK_UP_ROWS = int(
    np.prod([getattr(lookup.GRID, f.name).number for f in dataclasses.fields(lookup.GRID)])
)
# What the calibration of the moments exposes, and a k-d tree takes for a row.
CALIBRATION_IMAGES = moments.SAMPLES * 435
INDEX_S_PER_ROW = 1e-6

Answer: TypeAlias = Callable[[Array], Array]


@dataclass(frozen=True)
class Group:
    """Settings that share an array and a table, and are measured together.

    Parameters
    ----------
    shape, detectors_per_side
        The array.
    steps
        Values along each axis of the table; 0 for published methods, which have their own.
    methods
        Of `ALL_METHODS`.
    """

    shape: Shape
    detectors_per_side: int
    steps: int
    methods: tuple[str, ...]

    def scene(self, scene: Scene) -> Scene:
        """Return the scene with this array, and with a table of the study's volume."""
        array = dataclasses.replace(
            scene.array.with_shape(self.shape), detectors_per_side=self.detectors_per_side
        )
        table = volume_table(self.steps) if self.steps else scene.table
        return dataclasses.replace(scene, array=array, table=table)


def volume_table(steps: int) -> TableSettings:
    """Return a grid over the study's volume with as many values along each axis."""
    high = np.array([*HIGH[:3], *np.degrees(HIGH[3:])]).round(9)
    low = np.array([*LOW[:3], *np.degrees(LOW[3:])]).round(9)
    return TableSettings(*(Span(float(a), float(b), steps) for a, b in zip(low, high, strict=True)))


def plan(scene: Scene, mode: Mode) -> list[Group]:
    """List what a run measures, the scene's own array first."""
    own = scene.array
    sides = sorted({*SIDES, own.detectors_per_side}, key=lambda n: (n != own.detectors_per_side, n))
    groups = []
    for shape in sorted(SHAPES, key=lambda shape: shape != own.shape):
        for side in sides:
            steps: tuple[int, ...] = STEPS
            published: tuple[str, ...] = PUBLISHED
            if mode == "quick":
                steps = QUICK_STEPS
                if shape == own.shape:
                    steps = QUICK_OWN_STEPS if side == own.detectors_per_side else STEPS[:3]
                if shape != "planar" or side > QUICK_LOOK_UP_SIDE:
                    published = (MOMENTS,)
            groups += [Group(shape, side, n, METHODS) for n in steps]
            groups += [Group(shape, side, 0, (method,)) for method in published]
    return groups


def _ours(table: SignatureTable, methods: Iterable[str]) -> dict[str, Answer]:
    """Return the answers of an estimator, with the default parameters of its node."""
    scene = table.scene

    def pose(image: Array, estimator: Estimator) -> Array:
        parameters = key_parameters(image, scene.full_scale_counts, scene.signature.peak)
        return estimator.estimate(parameters, image).pose

    estimators = {
        method: Estimator(table, method)  # type: ignore[arg-type]  # of METHODS
        for method in methods
    }
    return {
        method: functools.partial(pose, estimator=estimator)
        for method, estimator in estimators.items()
    }


def _moments(scene: Scene, rng: np.random.Generator) -> Answer:
    """Return the moments' answer to single images: random poses are no path to reckon along."""
    try:
        method = moments.MomentsMethod(moments.calibrate(ForwardModel(scene), rng))
    except (np.linalg.LinAlgError, ValueError) as error:
        reason = f"no calibration: {error}"

        def nothing(image: Array) -> Array:
            raise NoPose(reason)

        return nothing

    def pose(image: Array) -> Array:
        method.reset()
        return method.pose(image)

    return pose


def compare(
    answers: Mapping[str, Answer],
    model: ForwardModel,
    yardstick: ForwardModel,
    poses: Array,
    images: Array,
    progress: Progress = iter,
) -> dict[str, Study]:
    """Estimate frame after frame by each method in turn.

    Parameters
    ----------
    answers
        From an image to a pose, by name; one that raises `NoPose` has none.
    model
        Of the scene.
    yardstick
        The model whose time is taken between frames, to tell how fast the machine is just then.
    poses
        True poses, m and rad, shape ``(n, 5)``, n >= 1.
    images
        Counts, shape ``(n, side, side)``.
    progress
        Wraps the loop over frames.

    Returns
    -------
    dict
        A study of each method, without covariances (nan).
    """
    count, names = len(poses), list(answers)
    errors = {name: np.full((count, 5), np.nan) for name in names}
    frame_s = {name: np.empty(count) for name in names}
    model_s = []
    bounds = cramer_rao_bound(model, poses).std
    for answer in answers.values():  # the first call is slower
        with suppress(NoPose):
            answer(images[0])
    for i in progress(range(count)):
        first = i % len(names)
        for name in names[first:] + names[:first]:
            began = time.perf_counter()
            with suppress(NoPose):
                errors[name][i] = answers[name](images[i]) - poses[i]
            frame_s[name][i] = time.perf_counter() - began
        if i % MODEL_EVERY == 0:
            began = time.perf_counter()
            yardstick.linearised(np.resize(poses[i : i + MODEL_POSES], (MODEL_POSES, 5)))
            model_s.append(time.perf_counter() - began)
    unknown = np.full((count, 5, 5), np.nan)
    return {
        name: Study(errors[name], unknown, bounds, frame_s[name], np.array(model_s))
        for name in names
    }


def position_and_angle(errors: Array) -> tuple[float, float]:
    """Root mean square of distance, m, and of angle, deg, of errors ``(n, 5)`` in m and rad."""
    if not len(errors):
        return float("nan"), float("nan")
    position, angle = (np.sqrt((part**2).sum(axis=1).mean()) for part in np.split(errors, [3], 1))
    return float(position), float(np.degrees(angle))


def known_volume_std(model: ForwardModel, poses: Array) -> Array:
    """Return the Cramer-Rao bound of an image whose pose is known to lie in the study's volume.

    The volume counts as a Gaussian of its variance. Where the image tells more than that, this is
    the bound; where it tells nothing, it is the volume's own spread, and never more.

    Parameters
    ----------
    model
        Forward model of the scene.
    poses
        m and rad, shape ``(n, 5)``.

    Returns
    -------
    Array
        Standard deviations, m and rad, shape ``(n, 5)``.
    """
    return within_volume(cramer_rao_bound(model, poses).information)


def guess() -> tuple[float, float]:
    """Return the errors of no measurement, always the middle of the volume: m and deg."""
    variance = (HIGH - LOW) ** 2 / 12
    return float(np.sqrt(variance[:3].sum())), float(np.degrees(np.sqrt(variance[3:].sum())))


def measure(
    scene: Scene,
    group: Group,
    frames: int,
    seed: int,
    progress: Progress = iter,
    on_table: Callable[[SignatureTable, float], None] | None = None,
) -> list[Row]:
    """Measure the settings of a group.

    Parameters
    ----------
    scene
        The scene, whose array and table are replaced by those of the group.
    group
        What to measure.
    frames
        How many images, >= 1.
    seed
        Of poses and noise; an array sees the same images in every group.
    progress
        Wraps the loop over frames.
    on_table
        Gets the table of our methods, and what building it took, s.

    Returns
    -------
    list
        A row for each of the group's methods.
    """
    yardstick, scene = ForwardModel(scene), group.scene(scene)
    side = group.detectors_per_side
    rng = np.random.default_rng([seed, side, SHAPES.index(group.shape)])
    model = ForwardModel(scene)
    poses = random_poses(model, frames, rng)
    images = model.expose(poses, rng)
    began, rows = time.perf_counter(), 0
    if group.methods == (MOMENTS,):
        answers = {MOMENTS: _moments(scene, rng)}
        build_s = time.perf_counter() - began
    else:
        is_look_up = group.methods == (LOOK_UP,)
        table = build_table(lookup.lookup_scene(scene) if is_look_up else scene)
        build_s, rows = time.perf_counter() - began, len(table.poses)
        if is_look_up:
            answers = {LOOK_UP: lookup.LookUp(table).pose}
        else:
            if on_table:
                on_table(table, build_s)
            answers = _ours(table, group.methods)
    found = compare(answers, model, yardstick, poses, images, progress)
    bound = position_and_angle(cramer_rao_bound(model, poses).std)
    floor = position_and_angle(known_volume_std(model, poses))
    made = []
    for method, study in found.items():
        median_ms, p99_ms = 1e3 * np.percentile(study.frame_s, [50, 99])
        model_ms = 1e3 * float(np.median(study.model_s))
        made.append(
            Row(
                method,
                group.shape,
                side,
                group.steps,
                rows,
                float((~study.posed).mean()),
                *position_and_angle(study.errors[study.posed]),
                *bound,
                *floor,
                float(median_ms),
                float(p99_ms),
                model_ms,
                float(median_ms) / model_ms,
                build_s,
                load_average(),
            )
        )
    return made


def expected_s(scene: Scene, groups: list[Group], frames: int) -> list[float]:
    """Estimate how long each group takes, s, from a small sample of each array that is left."""
    samples: dict[tuple[Shape, int], tuple[float, float]] = {}
    rng = np.random.default_rng(0)
    expected = []
    for group in groups:
        key = group.shape, group.detectors_per_side
        if key not in samples:
            small = dataclasses.replace(group, steps=min(STEPS))
            model = ForwardModel(small.scene(scene))
            poses = random_poses(model, SAMPLE_FRAMES, rng)
            began = time.perf_counter()
            table = build_table(model.scene)
            row_s = (time.perf_counter() - began) / len(table.poses)
            images = model.expose(poses, rng)
            found = compare(_ours(table, METHODS), model, model, poses, images)
            samples[key] = row_s, sum(float(study.frame_s.mean()) for study in found.values())
        row_s, frame_s = samples[key]
        if group.methods == (MOMENTS,):
            expected.append(CALIBRATION_IMAGES * row_s)
        elif group.methods == (LOOK_UP,):
            expected.append(LOOK_UP_ROWS * row_s)
        else:
            expected.append(group.steps**5 * (row_s + INDEX_S_PER_ROW) + frames * frame_s)
    return expected
