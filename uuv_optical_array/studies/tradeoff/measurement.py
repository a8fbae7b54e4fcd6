"""What accuracy costs in time: methods on one array and table, measured side by side."""

import dataclasses
import math
import time
from collections.abc import Callable, Iterable

import numpy as np

from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.estimator import METHODS, Estimator
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.table.signature_table import Progress, SignatureTable, build_table
from uuv_optical_array.forward.array import Shape
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.working_volume import known_volume_std, lit_poses
from uuv_optical_array.studies import published
from uuv_optical_array.studies.errors import Answer, answer_of, frame_errors, position_and_angle
from uuv_optical_array.studies.tradeoff.plan import LOOK_UP, MOMENTS, SHAPES, STEPS, Group
from uuv_optical_array.studies.tradeoff.results import Measurement, load_average

SAMPLE_FRAMES = 4
LOOK_UP_ROWS = int(
    np.prod([getattr(published.GRID, f.name).number for f in dataclasses.fields(published.GRID)])
)
# What the calibration of the moments exposes, and a k-d tree takes for a row.
CALIBRATION_IMAGES = published.SAMPLES * 435
INDEX_S_PER_ROW = 1e-6


def _ours(table: SignatureTable, methods: Iterable[str]) -> dict[str, Answer]:
    """Return the answers of an estimator, with the default parameters of its node."""
    return {
        method: answer_of(Estimator(table, method).wait())  # type: ignore[arg-type]  # of METHODS
        for method in methods
    }


def _published(pose: Callable[[Array], Array]) -> Answer:
    return lambda image: (pose(image), math.nan)


def _moments(scene: Scene, rng: np.random.Generator) -> Answer:
    try:
        return _published(published.calibrate(ForwardModel(scene), rng, published.SAMPLES).pose)
    except (np.linalg.LinAlgError, ValueError) as error:
        reason = f"no calibration: {error}"

    def nothing(image: Array) -> Array:
        raise NoPose(reason)

    return _published(nothing)


def measure(
    scene: Scene,
    group: Group,
    frames: int,
    seed: int,
    progress: Progress = iter,
    on_table: Callable[[SignatureTable, float], None] | None = None,
) -> list[Measurement]:
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
        One of each of the group's methods.
    """
    yardstick, scene = ForwardModel(scene), group.scene(scene)
    side = group.detectors_per_side
    rng = np.random.default_rng([seed, side, SHAPES.index(group.shape)])
    model = ForwardModel(scene)
    poses = lit_poses(model, frames, rng)
    images = model.expose(poses, rng)
    began, rows = time.perf_counter(), 0
    if group.methods == (MOMENTS,):
        answers = {MOMENTS: _moments(scene, rng)}
        build_s = time.perf_counter() - began
    else:
        is_look_up = group.methods == (LOOK_UP,)
        table = build_table(published.lookup_scene(scene, published.GRID) if is_look_up else scene)
        build_s, rows = time.perf_counter() - began, len(table.poses)
        if is_look_up:
            answers = {LOOK_UP: _published(published.LookUp(table).pose)}
        else:
            if on_table:
                on_table(table, build_s)
            answers = _ours(table, group.methods)
    measured = frame_errors(answers, yardstick, poses, images, progress)
    bound = cramer_rao_bound(model, poses)
    bound_position_m, bound_angle_deg = position_and_angle(bound.std)
    floor_position_m, floor_angle_deg = position_and_angle(known_volume_std(bound.information))
    found = []
    for method, made in measured.items():
        if len(made.errors) < frames:  # cut short, so no measurement
            raise KeyboardInterrupt
        position_m, angle_deg = position_and_angle(made.errors[made.posed])
        median_ms, p99_ms = made.frame_ms
        found.append(
            Measurement(
                method=method,
                shape=group.shape,
                detectors_per_side=side,
                steps=group.steps,
                table_rows=rows,
                without_pose=float((~made.posed).mean()),
                position_m=position_m,
                angle_deg=angle_deg,
                bound_position_m=bound_position_m,
                bound_angle_deg=bound_angle_deg,
                floor_position_m=floor_position_m,
                floor_angle_deg=floor_angle_deg,
                median_ms=median_ms,
                p99_ms=p99_ms,
                model_ms=made.model_ms,
                models=median_ms / made.model_ms,
                build_s=build_s,
                load_average=load_average(),
            )
        )
    return found


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
            poses = lit_poses(model, SAMPLE_FRAMES, rng)
            began = time.perf_counter()
            table = build_table(model.scene)
            row_s = (time.perf_counter() - began) / len(table.poses)
            images = model.expose(poses, rng)
            found = frame_errors(_ours(table, METHODS), model, poses, images)
            samples[key] = row_s, sum(float(made.frame_s.mean()) for made in found.values())
        row_s, frame_s = samples[key]
        if group.methods == (MOMENTS,):
            expected.append(CALIBRATION_IMAGES * row_s)
        elif group.methods == (LOOK_UP,):
            expected.append(LOOK_UP_ROWS * row_s)
        else:
            expected.append(group.steps**5 * (row_s + INDEX_S_PER_ROW) + frames * frame_s)
    return expected
