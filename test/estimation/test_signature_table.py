"""The signature table in memory: every row computed a second time."""

import itertools
import math
import re
from pathlib import Path

import numpy as np
import pytest
import second_forward
from command_line import python
from needs import numba
from scenes import changed, make_scene
from second_features import slow_key_parameters

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.estimation import signature_table
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.signature_table import (
    BLOCK_POSES,
    PROCESS_BYTES,
    ROW_BYTES,
    build_table,
    check_memory,
    grid_axes,
    grid_parameters,
    grid_poses,
    machine_bytes,
    pose_blocks,
    table_compiler,
)
from uuv_optical_array.forward.lamp.lamps import together
from uuv_optical_array.forward.many_poses import expected_readings
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

pytestmark = pytest.mark.filterwarnings("error")

SPANS = {
    "x_m": [-8.0, -4.0, 3],
    "y_m": [-0.6, 0.6, 4],
    "z_m": [-0.3, 0.5, 3],
    "pitch_deg": [-20.0, 20.0, 3],
    "yaw_deg": [5.0, 5.0, 1],
}
# Every span is symmetric but in range.
WIDE = {
    "x_m": [-9.0, -3.0, 6],
    "y_m": [-1.0, 1.0, 6],
    "z_m": [-1.0, 1.0, 6],
    "pitch_deg": [-20.0, 20.0, 6],
    "yaw_deg": [-20.0, 20.0, 6],
}
WATER = {
    "attenuation": {"k_per_m": 0.2},
    "ambient": {"level_counts": 30.0},
    "forward_scatter": {"window_m": 0.25},
    "responsivity": {"spread": 0.1, "seed": 3},
    "saturation": {"level_counts": 300.0},
    "adc": {"bits": 10},
}


def scene_with(effects=None, peak="subdetector", **spans):
    """Return the reference scene on a small grid, with other spans, effects and peak."""
    scene = load_scene("reference") if effects is None else make_scene(effects=effects)
    return changed(scene, table={**SPANS, **spans}, signature={"peak": peak})


def rows_by_hand(scene):
    """Return poses, peaks and parameters of the scene's grid, one pose at a time."""
    settings = scene.settings()
    spans, power = settings["table"], second_forward.power_of(settings)
    level = settings["effects"].get("saturation", {}).get("level_counts", np.inf)
    poses, peaks, parameters = [], [], []
    for cell in itertools.product(*(range(spans[axis][2]) for axis in SPANS)):
        pose = []
        for axis, i in zip(SPANS, cell, strict=True):
            start, stop, number = spans[axis]
            value = start + (stop - start) * i / max(number - 1, 1)
            pose.append(math.radians(value) if axis.endswith("_deg") else value)
        image = np.minimum(second_forward.light(settings, pose, power=power), level)
        poses.append(pose)
        peaks.append(image.max())
        parameters.append(slow_key_parameters(image, scene.full_scale_counts, scene.signature.peak))
    return np.array(poses), np.array(peaks), np.array(parameters)


@pytest.mark.parametrize("peak", ["detector", "subdetector"])
@pytest.mark.parametrize("effects", [None, WATER], ids=["reference", "water"])
def test_every_row_is_the_signature_of_its_pose(peak, effects):
    scene = scene_with(effects, peak)
    table = build_table(scene)
    poses, peaks, parameters = rows_by_hand(scene)
    assert peaks.min() > 1
    np.testing.assert_allclose(table.poses, poses, atol=1e-14)
    np.testing.assert_allclose(table.parameters, parameters, atol=1e-9)


@numba
@pytest.mark.parametrize("name", ["reference", "follow", "leading_lights"])
def test_compiled_rows_are_those_of_numpy_but_where_two_detectors_are_the_brightest(
    monkeypatch, name
):
    """Which of two is, rounding decides, in NumPy as well: in a grid that mirrors the array."""
    scene = changed(load_scene(name), table=WIDE)
    model, rows = ForwardModel(scene), range(6**5)
    with monkeypatch.context() as patch:
        patch.setattr(compilation, "loaded", lambda function: function)
        expected = grid_parameters(model, rows)
    table_compiler().wait()
    assert table_compiler().failure == ""
    found = grid_parameters(model, rows)
    images = together(model.expected(grid_poses(grid_axes(scene.table), rows)))
    second, first = np.sort(images.reshape(len(rows), -1))[:, -2:].T
    clear = first - second > 1e-9 * first
    assert clear.sum() > 5000
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    np.testing.assert_allclose(found[clear], expected[clear], rtol=1e-9, atol=1e-9)
    assert not np.array_equal(found, expected, equal_nan=True)  # it did run as compiled


def test_only_a_large_table_is_worth_a_compiler_and_it_waits_for_none(monkeypatch):
    asked, rows = [], []
    monkeypatch.setattr(signature_table, "table_compiler", lambda: asked.append(len(rows)))
    monkeypatch.setattr(signature_table, "is_compiled", lambda mark: False)
    Estimator(load_scene("reference"), "least_squares", compiled=False)
    build_table(scene_with())
    assert asked == []
    monkeypatch.setattr(signature_table, "WORTH_LOADING", 108)
    build_table(scene_with(), progress=lambda blocks: (rows.append(i) or i for i in blocks))
    assert asked == [1]  # after its only block
    monkeypatch.setattr(signature_table, "is_compiled", lambda mark: mark == signature_table.DONE)
    build_table(scene_with(), progress=lambda blocks: (rows.append(i) or i for i in blocks))
    assert asked == [1, 1, 2]  # what is there is loaded before it


LOADED = """
from uuv_optical_array.core.numerics.compilation import compiled
from uuv_optical_array.estimation.signature.features import write_parameters
from uuv_optical_array.estimation.signature_table import table_compiler
from uuv_optical_array.forward.many_poses import write_arriving
table_compiler().wait()
for function in (write_arriving, write_parameters):
    stats = compiled(function).stats
    print(len(stats.cache_hits), len(stats.cache_misses))
"""


@numba
def test_a_process_loads_what_another_one_compiled():
    table_compiler().wait()
    assert python(LOADED).stdout == "1 0\n1 0\n"


def test_grid_poses_are_those_of_all_combinations():
    axes = [np.arange(n) + 0.5 * n for n in (2, 3, 1, 4, 5)]
    every = list(itertools.product(*axes))
    np.testing.assert_array_equal(grid_poses(axes, range(120)), every)
    np.testing.assert_array_equal(grid_poses(axes, [[7, 119], [0, 7]])[1, 1], every[7])


@pytest.mark.parametrize("size", [1, 4, 19, 20, 64, 1000])
def test_blocks_of_a_grid_follow_each_other(size):
    axes = [np.arange(n) + 0.5 * n for n in (2, 3, 1, 4, 5)]
    every = np.array(list(itertools.product(*axes)))
    for rows in (range(120), range(7, 113)):
        blocks = list(pose_blocks(axes, rows, size))
        assert [block.shape[1] for block in blocks[:-1]] == [size] * (len(blocks) - 1)
        np.testing.assert_array_equal(np.concatenate(blocks, axis=1).T, every[rows])


def test_poses_count_from_the_threshold_of_light_on_and_the_dark_ones_are_left_out():
    scene = scene_with(x_m=[-5.0, 5.0, 5], y_m=[-3.0, 3.0, 13])
    poses, peaks, parameters = rows_by_hand(scene)
    for threshold in (20.0, np.sort(peaks)[-30] * (1 - 1e-9)):
        table = build_table(scene, threshold)
        lit = peaks >= threshold
        assert 20 < lit.sum() < len(lit) - 50
        np.testing.assert_allclose(table.poses, poses[lit], atol=1e-14)
        np.testing.assert_allclose(table.parameters, parameters[lit], atol=1e-9)
    np.testing.assert_allclose(build_table(scene).poses, poses[peaks >= 1], atol=1e-14)
    assert ((peaks > 0.5) & (peaks < 1)).any()
    # A pose at the threshold has light.
    model = ForwardModel(scene)
    at = expected_readings(model, model.optics(), poses).max(axis=0)
    threshold = at[(at > 1) & (at < 900)][0]
    assert len(build_table(scene, threshold).poses) == (at >= threshold).sum()


def test_blocks_do_not_show_in_the_table():
    scene = scene_with(y_m=[-0.6, 0.6, 30], z_m=[-0.3, 0.5, 30])
    starts = []
    table = build_table(scene, progress=lambda rows: (starts.append(i) or i for i in rows))
    assert starts == list(range(0, len(table.poses), BLOCK_POSES))
    assert len(starts) > 1
    for start in starts:
        row = min(start + 7, len(table.poses) - 1)
        image = second_forward.light(scene.settings(), table.poses[row])
        expected = slow_key_parameters(image, scene.full_scale_counts, "subdetector")
        np.testing.assert_allclose(table.parameters[row], expected, atol=1e-9)


def test_a_grid_without_any_light_is_refused():
    for make in (build_table, Estimator):
        with pytest.raises(ValueError, match=r"scene changed: no pose of .* has 1 count .*; move"):
            make(scene_with(x_m=[2.0, 4.0, 2]))
    with pytest.raises(ValueError, match=r"scene changed: no pose of .* has 2000 count .*; move"):
        build_table(scene_with(), 2000.0)  # more than full scale


def test_a_table_too_large_for_the_machine_is_refused_with_the_figures():
    spans = {axis: [-1.0, 1.0, 10_000] for axis in SPANS}
    with pytest.raises(ValueError, match=r"scene changed: .* needs 2\.4e\+13 GB .*coarser grid"):
        build_table(scene_with(**spans))
    most = (machine_bytes() - PROCESS_BYTES) // ROW_BYTES
    check_memory(most, "mine")
    with pytest.raises(ValueError, match=rf"mine: .* at most {most:,} rows"):
        check_memory(most + 1, "mine")


def test_the_memory_is_that_of_the_machine_or_of_the_container(tmp_path):
    total = int(re.search(r"MemTotal:\s+(\d+)", Path("/proc/meminfo").read_text())[1]) * 1024
    limit = tmp_path / "memory.max"
    assert machine_bytes(limit) == pytest.approx(total, rel=0.05)
    for text, expected in (("max\n", total), ("123456789\n", 123456789)):
        limit.write_text(text)
        assert machine_bytes(limit) == pytest.approx(expected, rel=0.05)


FRESH_PAGES = """import resource
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.forward.lamp.lamps import together
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings
settings = load_scene("follow").settings()
settings["table"] = {key: [*span[:2], 11] for key, span in settings["table"].items()}
scene = scene_from_settings(settings, "coarse")
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
rows = len(build_table(scene).poses)
print(rows, resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)"""


def test_the_blocks_of_a_table_are_computed_in_the_same_memory():
    # In a process of its own, whose allocator has seen no large array yet.
    rows, fresh_pages = map(int, python(FRESH_PAGES).stdout.split())
    assert fresh_pages < rows / 6
