"""Designs of array and lamp: what is swept, how bright each lamp is, and what each is worth."""

import dataclasses
import itertools
import json
import math
import random
import re
import signal
import time
import tracemalloc

import matplotlib.image
import numpy as np
import pytest
from conftest import dask_workers
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation
from scipy.special import dawsn
from scipy.stats import skew

from uuv_optical_array import design_store as store_module
from uuv_optical_array.accuracy import HIGH, LOW
from uuv_optical_array.array import build_array
from uuv_optical_array.cluster import on_cluster, on_threads
from uuv_optical_array.commands import main
from uuv_optical_array.design import Design, Sweep, default_sweep, designed, with_gain
from uuv_optical_array.design_choice import front, fronts, numbered, of_the_paper, standing
from uuv_optical_array.design_picture import apart, draw_designs
from uuv_optical_array.design_score import Score, score, signature_noise_deg, volume_poses
from uuv_optical_array.design_store import COLUMNS, DesignStore, Row, Study
from uuv_optical_array.image import ForwardModel
from uuv_optical_array.light import beam_solid_angle
from uuv_optical_array.scene import load_scene, scene_from_settings

POWERS = ("flux", "flux_in_range", "counts")
PLANAR = Design("planar", 5, 0.3, None, 6.0)
CURVED = Design("curved", 4, 0.3, 0.25, 11.0)
SMALL = Sweep(("planar", "curved"), (3, 5), (0.2, 0.4), (0.2, 0.32), (6.0, 8.0))


def scene_with(effects, name="follow", prior=None):
    settings = load_scene(name).settings()
    return scene_from_settings({**settings, "effects": effects, "prior": prior}, "test")


def rng(seed=1):
    return np.random.default_rng(seed)


# What is swept


@given(
    st.sets(st.sampled_from(["planar", "curved"]), min_size=1),
    st.sets(st.integers(2, 30), min_size=1, max_size=3),
    st.sets(st.floats(0.05, 1), min_size=1, max_size=4),
    st.sets(st.floats(0.05, 1), min_size=1, max_size=4),
    st.sets(st.floats(1, 40), min_size=1, max_size=3),
)
def test_a_sweep_holds_each_design_that_can_be_built_once(shapes, sides, sizes, radii, sigmas):
    buildable = sum(radius > size / 2**0.5 for size in sizes for radius in radii)
    each = len(sides) * len(sigmas)
    planar, curved = "planar" in shapes, "curved" in shapes
    count = each * (planar * len(sizes) + curved * buildable)
    lists = [sorted(values) for values in (shapes, sides, sizes, radii, sigmas)]
    if not count:
        with pytest.raises(ValueError, match="no design is left"):
            Sweep(*lists)
        return
    sweep = Sweep(*lists)
    designs = sweep.designs()
    assert len(designs) == len(set(designs)) == count
    assert sum(sweep.dropped().values()) == curved * each * (len(sizes) * len(radii) - buildable)
    assert all((design.radius_m is None) == (design.shape == "planar") for design in designs)


def test_the_default_sweep_holds_the_scene_and_the_paper():
    for name in ("follow", "eren2016", "eren2017_tank"):
        scene = load_scene(name)
        assert Design.of(scene) in default_sweep(scene).designs()
    designs = default_sweep(load_scene("follow")).designs()
    assert Design("curved", 5, 0.4, 0.32, 8.0) in designs
    # 5 sizes; on radii of 0.16 to 0.64 m fit 1, 2, 3, 4, 5 and 5 of them.
    assert len(designs) == (5 + 20) * 6 * 6
    # Of the 5 of a radius, the tightest sits on the sphere as the paper's does.
    tight = {d.width_m: min(e.radius_m for e in designs if e.radius_m and e.width_m == d.width_m)
             for d in designs}  # fmt: skip
    assert tight == pytest.approx({w: 0.8 * w for w in (0.2, 0.3, 0.4, 0.5, 0.6)})


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"shape": ("round",)}, "shape: 'round' is unknown; choose planar or curved"),
        ({"shape": ()}, "shape: no value"),
        ({"detectors_per_side": (1,)}, "detectors_per_side: 1 is out of bounds.*from 2 to 501"),
        ({"detectors_per_side": (2.5,)}, "2.5 is not a whole number"),
        ({"width_m": (0.4, 0.4)}, "width_m: 0.4 is given twice"),
        ({"width_m": (math.nan,)}, "width_m: nan is out of bounds.*m$"),
        ({"radius_m": ()}, "radius_m: no value"),
        ({"radius_m": (0.1,), "shape": ("curved",)}, r"no design is left \(0.2 m wide on.*larger"),
        ({"beam_sigma_deg": (0.0,)}, "beam_sigma_deg: 0.0 is out of bounds.*from 0.1 to 90 deg"),
    ],
)
def test_a_bad_sweep_is_refused_by_name(change, error):
    with pytest.raises(ValueError, match=error):
        dataclasses.replace(SMALL, **change)
    assert not dataclasses.replace(SMALL, shape=("planar",), radius_m=()).dropped()


# How bright each lamp is


@pytest.mark.parametrize("sigma_deg", [0.1, 3.0, 8.0, 20.0, 45.0, 90.0])
def test_the_beams_solid_angle_is_the_sum_over_the_sphere(sigma_deg):
    sigma = math.radians(sigma_deg)
    edges = np.linspace(0, min(math.pi, 12 * sigma), 200_001)
    middle = (edges[1:] + edges[:-1]) / 2
    zones = 2 * math.pi * (np.cos(edges[:-1]) - np.cos(edges[1:]))
    total = (np.exp(-(middle**2) / (2 * sigma**2)) * zones).sum()
    assert beam_solid_angle(sigma) == pytest.approx(total, rel=1e-5)
    if sigma_deg < 20:  # the closed form of a beam that ends before it is behind the lamp
        closed = 2 * math.pi * math.sqrt(2) * sigma * dawsn(sigma / math.sqrt(2))
        assert beam_solid_angle(sigma) == pytest.approx(closed, rel=1e-7)


def emitted(scene):
    """Flux of a scene's lamp, from its light on a sphere of detectors around it, in clear water."""
    clear = dataclasses.replace(scene, effects={})
    model = ForwardModel(dataclasses.replace(clear, array=load_scene("follow").array))
    model.power = ForwardModel(scene).power
    sigma = math.radians(scene.lamp.beam_sigma_deg)
    step = 1e-4
    # A detector in the array's middle looks straight at the lamp, off its axis by eta.
    flux, _ = quad(
        lambda eta: 2 * math.pi * math.sin(eta) * seen(model, eta), step, min(3.1, 9 * sigma)
    )
    return flux


def seen(model, eta):
    """Light times range squared of a detector that looks at the lamp from off its axis."""
    array, range_m = model.array, 100.0
    middle = array.side**2 // 2
    lever = array.positions[middle, 0]
    pose = [-(range_m + lever) * math.cos(eta), (range_m + lever) * math.sin(eta), 0, 0, -eta]
    return model.light(pose).ravel()[middle] * range_m**2


@pytest.mark.parametrize("design", [PLANAR, CURVED, Design("curved", 5, 0.4, 0.32, 20.0)])
def test_equal_flux_means_that_the_lamps_emit_as_much(design):
    base = load_scene("follow")
    assert emitted(designed(base, design, "flux")) == pytest.approx(emitted(base), rel=1e-5)


@pytest.mark.parametrize("name", ["follow", "coastal", "sunlit_shallow"])
@pytest.mark.parametrize("sigma_deg", [4.0, 8.0, 20.0])
def test_the_gain_is_turned_down_where_the_array_would_read_more(name, sigma_deg):
    base = load_scene(name)
    design = dataclasses.replace(Design.of(base), beam_sigma_deg=sigma_deg)
    fixed, ranged, counts = (designed(base, design, p) for p in POWERS)
    most, wanted = fixed.lamp.reference_counts, base.lamp.reference_counts
    assert (most > wanted) == (sigma_deg < base.lamp.beam_sigma_deg)
    assert ranged.lamp.reference_counts == pytest.approx(min(most, wanted))
    assert counts.lamp.reference_counts == wanted
    assert counts.effects == fixed.effects == base.effects
    if most <= wanted:
        assert ranged == fixed
        return
    # The same light is fewer counts, so all that is light is, and what is electrons stays.
    gain = wanted / most
    pose = np.array([-5.0, 0.3, 0.2, 0.1, -0.1])
    np.testing.assert_allclose(
        ForwardModel(ranged).light(pose), gain * ForwardModel(fixed).light(pose), rtol=1e-12
    )
    models = ForwardModel(fixed), ForwardModel(ranged)
    noise = [sum(step(model.light(pose))[0] for step in model.plan.noise) for model in models]
    before_gain = {"shot_noise", "photodiode"} & set(base.effects)
    behind_gain = {"sensor_noise"} & set(base.effects)
    if before_gain and not behind_gain:
        np.testing.assert_allclose(noise[1], gain**2 * noise[0], rtol=1e-12)
    if behind_gain and not before_gain:
        np.testing.assert_allclose(noise[1], noise[0], rtol=1e-12)
    assert before_gain or behind_gain


def test_the_prior_of_the_ambient_light_follows_the_gain():
    effects = {"ambient": {"level_counts": 8.0}, "shot_noise": {"electrons_per_count": 2.0}}
    scene = scene_with(effects, prior={"ambient_std_counts": 4.0})
    found = with_gain(scene, 0.5)
    assert found.effects["ambient"]["level_counts"] == 4.0
    assert found.effects["shot_noise"]["electrons_per_count"] == 4.0
    assert found.prior.ambient_std_counts == 2.0


@pytest.mark.parametrize("power", POWERS)
@pytest.mark.parametrize("mount", ["front", "centre"])
@pytest.mark.parametrize("name", ["follow", "eren2017_tank"])
def test_the_scenes_own_design_is_the_scene(name, power, mount):
    scene = load_scene(name)
    assert designed(scene, Design.of(scene), power, mount) == scene


def test_the_foremost_point_stays_or_the_centre_does():
    for base in (load_scene("follow"), load_scene("follow").with_shape("planar")):
        front_m = build_array(base.array).positions[:, 0].max()
        for design in SMALL.designs():
            array = build_array(designed(base, design).array)
            assert array.positions[:, 0].max() == pytest.approx(front_m)
            scene = designed(base, design, mount="centre")
            assert scene.array.bow_m == base.array.bow_m
            found = build_array(scene.array)
            shift = found.positions - array.positions
            np.testing.assert_allclose(shift[:, 1:], 0)
            assert np.ptp(shift[:, 0]) < 1e-12


# What each is worth


def own_light(design, bow_m, power, k_per_m, pose):
    """Light on each detector, from the formulas and with SciPy's rotations."""
    side, half = design.detectors_per_side, design.width_m / 2
    attitude = Rotation.from_euler("ZY", [pose[4], pose[3]])
    image = np.empty((side, side))
    for row, column in itertools.product(range(side), repeat=2):
        y, z = half - column * design.width_m / (side - 1), half - row * design.width_m / (side - 1)
        if design.radius_m is None:
            place, normal = [bow_m, y, z], [1, 0, 0]
        else:
            x = math.sqrt(design.radius_m**2 - y * y - z * z)
            place, normal = [bow_m + x, y, z], np.array([x, y, z]) / design.radius_m
        at = pose[:3] + attitude.apply(place)
        r = np.linalg.norm(at)
        eta = math.acos(-at[0] / r)
        cosine = max(0.0, attitude.apply(normal) @ -at / r)
        sigma = math.radians(design.beam_sigma_deg)
        beam = math.exp(-(eta**2) / (2 * sigma**2))
        image[row, column] = power / r**2 * beam * cosine * math.exp(-k_per_m * r)
    return image


def own_power(design, bow_m, k_per_m, reference_counts):
    """Power for a reading at 4 m."""
    aligned = np.array([-4.0, 0, 0, 0, 0])
    return reference_counts / own_light(design, bow_m, 1.0, k_per_m, aligned).max()


@pytest.mark.parametrize("design", [PLANAR, CURVED])
def test_the_bound_is_that_of_an_implementation_of_its_own(design):
    scene = scene_with({"attenuation": {"k_per_m": 0.15}, "sensor_noise": {"sigma_counts": 2.0}})
    # A weak lamp leaves some of the poses dark.
    weak = dataclasses.replace(scene.lamp, reference_counts=150.0)
    scene = dataclasses.replace(scene, lamp=weak)
    poses = volume_poses(12, rng())
    assert (poses >= LOW).all()
    assert (poses <= HIGH).all()
    found = score(designed(scene, design, "counts"), poses, rng())
    bow_m = 0.72 - (design.radius_m or 0.0)
    power = own_power(design, bow_m, 0.15, 150.0)
    alone, known, lit = [], [], []
    for pose in poses:
        slopes = []
        for i in range(5):
            move = np.zeros(5)
            move[i] = 1e-5
            up, down = (own_light(design, bow_m, power, 0.15, pose + s * move) for s in (1, -1))
            slopes.append((up - down).ravel() / 2e-5)
        information = np.array(slopes) @ np.array(slopes).T / 2.0**2
        spread = np.diag(1 / np.array([4.0, 1.8, 1.8, *np.radians([40.0, 40.0])]) ** 2 * 12)
        lit.append(own_light(design, bow_m, power, 0.15, pose).max() > 20)
        known.append(np.linalg.inv(information + spread).diagonal())
        alone.append(np.linalg.inv(information).diagonal())
    known, alone = np.array(known), np.array(alone)[np.array(lit)]
    assert 0 < found.lit == np.mean(lit) < 1
    for variances, position, angle, rtol in (
        (known, found.position_m, found.angle_deg, 1e-5),
        (alone, found.lit_position_m, found.lit_angle_deg, 1e-2),
    ):
        wanted = math.sqrt(variances[:, :3].sum(axis=1).mean())
        assert position == pytest.approx(wanted, rel=rtol)
        wanted = math.degrees(math.sqrt(variances[:, 3:].sum(axis=1).mean()))
        assert angle == pytest.approx(wanted, rel=rtol)


def own_signature(image, on_axis):
    """Take the paper's signature: whole detector, counted from one, population skewness."""
    row, column = np.unravel_index(image.argmax(), image.shape)
    side = len(image)
    skews = [skew(np.gradient(profile)) for profile in (image[row], image[:, column])]
    return np.array([image.max() / on_axis, (column + 1) / side, (row + 1) / side, *skews])


@pytest.mark.parametrize("design", [Design("curved", 5, 0.4, 0.32, 4.5), PLANAR])
def test_the_angles_are_those_of_an_implementation_of_its_own(design):
    scene = load_scene("eren2016")
    effects = {**scene.effects}
    del effects["forward_scatter"], effects["adc"]
    scene = dataclasses.replace(scene, effects=effects)
    found = score(designed(scene, design, "counts"), volume_poses(2, rng()), rng())
    bow_m = 0.72 - (design.radius_m or 0.0)

    def angles(range_m, *moved):
        images = [
            own_light(design, bow_m, 1.0, 0.1, np.array([-range_m, *rest]))
            for rest in ((0, 0, 0, 0), *moved)
        ]
        first, *others = (own_signature(image, images[0].max()) for image in images)
        return [
            math.degrees(math.acos(first @ v / math.sqrt((first @ first) * (v @ v))))
            for v in others
        ]

    turn = math.radians(10)
    shifts = [min(angles(m, (0.2, 0, 0, 0), (-0.2, 0, 0, 0))) for m in (4, 5, 6, 7, 8)]
    yaws = [min(angles(m, (0, 0, 0, turn), (0, 0, 0, -turn))) for m in (4, 5, 6, 7, 8)]
    assert found.shift_near_deg == pytest.approx(shifts[0], rel=1e-5)
    assert found.yaw_near_deg == pytest.approx(yaws[0], rel=1e-5)
    assert found.shift_deg == pytest.approx(min(shifts), rel=1e-5)
    assert found.yaw_deg == pytest.approx(min(yaws), rel=1e-5)


def test_the_papers_array_gets_the_numbers_of_docs_paper():
    """Row "moves to port", the smaller side at 5 x 5: nos. 8 and 11 at 4 m, 13 and 14 at 8 m."""
    scene = designed(load_scene("eren2016"), Design("curved", 5, 0.4, 0.32, 4.5), "counts")
    found = score(scene, volume_poses(2, rng()), rng())
    stated = [found.shift_near_deg, found.yaw_near_deg, found.shift_deg, found.yaw_deg]
    np.testing.assert_allclose(stated, [26.1, 21.2, 6.3, 9.7], atol=0.05)
    assert found.told_near
    assert not found.told


def test_noise_moves_the_signature_as_its_slope_says():
    scene = scene_with({"sensor_noise": {"sigma_counts": 0.01}})
    model, range_m = ForwardModel(scene), 5.0
    clean = model.expected([-range_m, 0, 0, 0, 0])

    def unit(image):
        # The vertex of a parabola through the peak and its neighbours.
        values = own_signature(image, clean.max())
        row, column = np.unravel_index(image.argmax(), image.shape)
        for i, (a, b, c) in ((1, image[row, column - 1 : column + 2]),
                             (2, image[row - 1 : row + 2, column])):  # fmt: skip
            values[i] += (a - c) / (a - 2 * b + c) / 2 / len(image)
        return values / np.linalg.norm(values)

    squares = 0.0
    for at in range(clean.size):
        step = np.zeros(clean.size)
        step[at] = 1e-3
        step = step.reshape(clean.shape)
        squares += (((unit(clean + step) - unit(clean - step)) / 2e-3) ** 2).sum()
    wanted = math.degrees(0.01 * math.sqrt(squares))
    draws = [signature_noise_deg(model, range_m, rng(seed)) for seed in range(40)]
    # 40 x 64 draws of two or so degrees of freedom: 3 % is three standard errors.
    assert math.sqrt(np.mean(np.square(draws))) == pytest.approx(wanted, rel=0.04)
    found = score(scene, volume_poses(2, rng()), rng(3))
    first = signature_noise_deg(model, 4.0, rng(3))
    assert found.shift_near_sigmas == pytest.approx(found.shift_near_deg / first)
    assert found.yaw_near_sigmas / found.shift_near_sigmas == pytest.approx(
        found.yaw_near_deg / found.shift_near_deg
    )
    assert found.shift_sigmas <= found.shift_near_sigmas


def test_a_flat_image_meets_no_criterion():
    scene = scene_with({"forward_scatter": {"window_m": 10.0}, "sensor_noise": {"sigma_counts": 1}})
    found = score(scene, volume_poses(3, rng()), rng())
    assert math.isnan(found.shift_deg)
    assert not found.told
    assert not found.told_near


def test_a_thread_stays_within_what_it_is_reckoned_to_hold():
    for name, side in (("follow", 21), ("harbour", 130)):
        scene = load_scene(name)
        sweep = Sweep(("curved",), (side,), (0.4,), (0.32,), (8.0,))
        study = Study(scene, sweep, poses=40 if side < 100 else 1)
        tracemalloc.start()
        study.scored(sweep.designs())
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert most < DesignStore("", study).thread_bytes()


# On disk


@pytest.fixture
def small_chunks(monkeypatch):
    for needed in ("zarr", "dask"):
        pytest.importorskip(needed, reason="a sweep in chunks needs the extra cluster")
    monkeypatch.setattr(store_module, "CHUNK_DESIGNS", 3)


def study_of(**changes):
    return Study(**{"scene": load_scene("follow"), "sweep": SMALL, "poses": 40, **changes})


def fill(path, study, threads=1):
    store = DesignStore.create(path, study)
    assert on_threads(store.fill, store.chunks, threads, lambda: None) == [3] * 6 + [2]
    return store


def contents(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def test_the_same_bytes_by_one_thread_two_threads_and_any_order(tmp_path, small_chunks):
    study = study_of()
    one, two = (fill(tmp_path / f"{n}.zarr", study, n) for n in (1, 2))
    back = DesignStore.create(tmp_path / "back.zarr", study)
    for chunk in reversed(back.chunks):
        back.fill(chunk)
    assert contents(one.path) == contents(two.path) == contents(back.path)
    assert len(contents(one.path)) == 7 + 2
    # A design's score is its own, whatever else is swept.
    alone = dataclasses.replace(SMALL, shape=("curved",), width_m=(0.4,), beam_sigma_deg=(6.0,))
    rows = dict(one.rows())
    for design, values in zip(
        alone.designs(), study_of(sweep=alone).scored(alone.designs()), strict=True
    ):
        np.testing.assert_array_equal(dataclasses.astuple(rows[design]), values)


def test_two_workers_one_killed_half_way_write_the_same_bytes(tmp_path, small_chunks):
    whole = contents(fill(tmp_path / "whole.zarr", study_of()).path)
    small = "import uuv_optical_array.design_store as s; s.CHUNK_DESIGNS = 3\n"
    with dask_workers(tmp_path, small) as (address, workers):
        store, seen_chunks = DesignStore.create(tmp_path / "t.zarr", study_of()), []

        def tick():
            seen_chunks.append(len(store.present()))
            if len(seen_chunks) == 2:
                workers[0].send_signal(signal.SIGKILL)

        def slow(chunk, fill=store.fill):
            time.sleep(0.1)
            return fill(chunk)

        counts = on_cluster(slow, store.chunks, address, 1, tick)
        assert workers[0].wait(10) == -signal.SIGKILL
    assert seen_chunks[1] < len(store.chunks)
    assert counts == [3] * 6 + [2]
    assert contents(store.path) == whole


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"poses": 41}, "poses is 40 there and 41 here"),
        ({"seed": 2}, "seed is 1 there and 2 here"),
        ({"power": "counts"}, "power is flux there and counts here"),
        ({"mount": "centre"}, "mount is front there"),
        ({"scene": load_scene("coastal")}, "attenuation.k_per_m is 0.1 there"),
        (
            {"sweep": dataclasses.replace(SMALL, width_m=(0.2, 0.3))},
            "width_m is 0.2 0.4 there and 0.2 0.3 here",
        ),
    ],
)
def test_the_store_of_another_study_is_refused_by_what_differs(
    tmp_path, small_chunks, changes, error
):
    store = DesignStore.create(tmp_path / "t.zarr", study_of())
    before = contents(store.path)
    assert DesignStore.create(tmp_path / "t.zarr", study_of()) == store
    with pytest.raises(ValueError, match=f"another study: .*{error}.*name another --output"):
        DesignStore.create(tmp_path / "t.zarr", study_of(**changes))
    assert contents(store.path) == before


def test_a_store_that_is_none_or_damaged_is_refused(tmp_path, small_chunks):
    with pytest.raises(ValueError, match=r"name it \*.zarr"):
        DesignStore.create(tmp_path / "t.designs", study_of())
    (tmp_path / "t.zarr").mkdir()
    with pytest.raises(ValueError, match="exists and is no design study"):
        DesignStore.create(tmp_path / "t.zarr", study_of())
    store = fill(tmp_path / "u.zarr", study_of())
    whole = contents(store.path)
    (store.path / "1.0").write_bytes(whole["1.0"][:-3])
    with pytest.raises(ValueError, match=r"chunk 1.0 is damaged.*uuv_array design again to mend"):
        store.rows()
    assert contents(fill(store.path, study_of()).path) == whole


# The front and the command


def row_of(side, position_m, angle_deg, **changes):
    values = dict.fromkeys(COLUMNS, 1.0) | {"position_m": position_m, "angle_deg": angle_deg}
    return Row(dataclasses.replace(PLANAR, detectors_per_side=side, **changes), Score(**values))


@given(
    st.lists(st.tuples(st.integers(2, 6), st.floats(0.01, 10), st.floats(0.01, 10)), min_size=1),
    st.randoms(),
)
@example([(3, 10.0, 0.1), (3, 9.5, 0.12)], random.Random(1))
def test_the_front_stands_for_all_and_none_of_it_for_another(points, order):
    rows = [row_of(*point, width_m=0.1 + i / 100) for i, point in enumerate(points)]

    def stands_for(one, other):
        fewer = one.design.detectors_per_side <= other.design.detectors_per_side
        return fewer and max_ratio(one, other) <= 1.1 * (1 + 1e-12)

    found = front(rows)
    assert all(any(stands_for(one, row) for one in found) for row in rows)
    pairs = itertools.permutations(found, 2)
    assert not any(stands_for(one, row) and max_ratio(one, row) < 1.1 - 1e-9 for one, row in pairs)
    assert [r.design.detectors for r in found] == sorted(r.design.detectors for r in found)
    order.shuffle(rows)
    assert len({row.score for row in front(rows)} ^ {row.score for row in found}) == 0


def max_ratio(one, other):
    return max(
        one.score.position_m / other.score.position_m, one.score.angle_deg / other.score.angle_deg
    )


def test_fronts_are_of_what_fits_and_of_what_the_criterion_lets_pass():
    wide = row_of(3, 0.01, 0.1, width_m=0.5)
    fits = row_of(3, 0.1, 1.0, width_m=0.4)
    score = dataclasses.replace(fits.score, position_m=0.2, shift_near_deg=15.0, yaw_near_deg=15.0)
    told = Row(dataclasses.replace(fits.design, width_m=0.3), score)
    paper = Row(Design("curved", 5, 0.4, 0.32, 8.0), dataclasses.replace(score, yaw_near_deg=14.9))
    rows, study = [wide, fits, told, paper], study_of()
    assert fronts(study, rows) == {"fits": [fits], "told": [told], "any": [wide]}
    assert told.score.told_near
    assert not paper.score.told_near
    assert numbered(study, rows) == [fits, told, wide, paper]
    assert standing(study, rows) == ["fits", "told", "any", "none; the paper's array"]
    assert [of_the_paper(row.design) for row in rows] == [False, False, False, True]
    # With another lamp it is the paper's array still, but not told for its own sake.
    other = Row(dataclasses.replace(paper.design, beam_sigma_deg=6.0), paper.score)
    assert of_the_paper(other.design)
    assert other not in numbered(study, [*rows, other])


def run(capsys, *words):
    with pytest.raises(SystemExit) as end:
        main(["design", *map(str, words)])
    return end.value.code, capsys.readouterr().out


LISTS = ["--side", 3, 5, "--size", 0.2, 0.4, "--radius", 0.2, 0.32, "--beam-sigma-deg", 6, 8]


def test_the_command_is_interrupted_goes_on_and_tells(tmp_path, monkeypatch, capsys, small_chunks):
    monkeypatch.chdir(tmp_path)
    fill, filled = DesignStore.fill, []

    def interrupted(self, chunk):
        if len(filled) == 2:
            raise KeyboardInterrupt
        filled.append(chunk)
        return fill(self, chunk)

    words = [*LISTS, "--poses", 40, "--threads", 1]
    monkeypatch.setattr(DesignStore, "fill", interrupted)
    code, out = run(capsys, *words)
    assert code == 130
    assert re.search(r"interrupted: \d of 7 chunks are in follow.design.zarr; the same comm", out)
    assert not (tmp_path / "follow.design.csv").exists()
    monkeypatch.setattr(DesignStore, "fill", fill)
    code, out = run(capsys, *words[:-2], "--memory", "4GB", "--take", 2)
    assert code == 0
    assert "left out: 4 designs whose corners lie beyond their sphere" in out
    assert "2 of 7 chunks are there already" in out
    assert re.search(r"curved 5 x 5, 0.4 m, radius 0.32 m, beam 8 deg .*the paper's array", out)
    assert "of 20 designs tell" in out

    code, text = run(capsys, *words, "--json")
    told = json.loads(text)
    study = study_of()
    rows = DesignStore.create(tmp_path / "follow.design.zarr", study).rows()
    assert code == 0
    assert [d["position_m"] for d in told["designs"]] == [r.score.position_m for r in rows]
    assert [rows[i].design for i in told["papers_array"]] == [
        Design("curved", 5, 0.4, 0.32, sigma_deg) for sigma_deg in (6.0, 8.0)
    ]
    assert [rows[i] for i in told["numbered"]] == numbered(study, rows)
    table = np.genfromtxt("follow.design.csv", delimiter=",", names=True, dtype=None, encoding=None)
    assert len(table) == 20
    np.testing.assert_allclose(table["angle_deg"], [r.score.angle_deg for r in rows], rtol=1e-12)
    assert set(table["seed"]) == {1}
    assert matplotlib.image.imread("follow.design.png").shape[:2] == (1260, 1440)
    taken = load_scene("follow.design.2.yaml")
    wanted = numbered(study, rows)[1].design
    assert taken.fingerprint == designed(study.scene, wanted).fingerprint


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--size", "0.4", "0.4"], "--size: 0.4 is given twice"),
        (["--side", "1"], "--side: 1 is out of bounds; it must be from 2 to 501"),
        (["--shapes", "curved", "--radius", "0.05"], "--radius: no design is left"),
        (["--poses", "0"], "--poses: 0 is out of bounds"),
        (["--threads", "0"], "threads: 0; give at least 1"),
        (["--scheduler", "tcp://x:1", "--memory", "1GB"], "limits of their own"),
        (["-o", "designs"], r"name it \*.zarr"),
    ],
)
def test_a_bad_option_is_one_line(tmp_path, monkeypatch, capsys, words, error):
    monkeypatch.chdir(tmp_path)
    code, _ = run(capsys, *words)
    assert re.search(f"^uuv_array design: .*{error}", code)
    assert "\n" not in code
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "designs",
    [
        [PLANAR],
        [CURVED, Design("curved", 21, 0.3, 0.5, 30.0)],
    ],
)
def test_any_study_can_be_drawn(tmp_path, designs):
    values = dict.fromkeys(COLUMNS, math.nan) | {"position_m": 0.3, "angle_deg": 5.0}
    rows = [Row(design, Score(**values)) for design in designs]
    draw_designs(study_of(), rows, tmp_path / "d.png")
    assert matplotlib.image.imread(tmp_path / "d.png").std() > 0.05


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8).map(sorted))
def test_labels_are_moved_apart_and_no_more_than_that_takes(heights):
    gap, count = 0.05, len(heights)
    # The first label and the steps above the gap, by bounded least squares.
    steps = np.tril(np.ones((count, count)))
    low = np.r_[-np.inf, np.zeros(count - 1)]
    wanted = heights - gap * np.arange(count)
    found = lsq_linear(steps, wanted, (low, np.inf), tol=1e-14)
    expected = steps @ found.x + gap * np.arange(count)
    np.testing.assert_allclose(apart(heights, gap), expected, atol=1e-5)
