"""What a design is worth, against implementations of its own."""

import dataclasses
import math

import numpy as np
import pytest
import second_forward
from designs import CURVED, PLANAR, rng, scene_with
from second_paper import second_angle, second_features

from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.working_volume import HIGH, LOW, uniform_poses
from uuv_optical_array.studies.design_sweep import Design, designed, score, signature_noise_deg


def own_scene(design, k_per_m, reference_counts=1.0):
    """The scene of a design, as the second forward model takes it."""
    array = {
        "shape": "planar" if design.radius_m is None else "curved",
        "detectors_per_side": design.detectors_per_side,
        "width_m": design.width_m,
        "bow_m": 0.72 - (design.radius_m or 0.0),
        "radius_m": design.radius_m,
    }
    lamp = {
        "beam_sigma_deg": design.beam_sigma_deg,
        "reference_counts": reference_counts,
        "reference_range_m": 4.0,
    }
    return {"lamp": lamp, "array": array, "effects": {"attenuation": {"k_per_m": k_per_m}}}


@pytest.mark.parametrize("design", [PLANAR, CURVED])
def test_the_bound_is_that_of_an_implementation_of_its_own(design):
    scene = scene_with({"attenuation": {"k_per_m": 0.15}, "sensor_noise": {"sigma_counts": 2.0}})
    # A weak lamp leaves some of the poses dark.
    weak = dataclasses.replace(scene.lamp, reference_counts=150.0)
    scene = dataclasses.replace(scene, lamp=weak)
    poses = uniform_poses(12, rng())
    assert (poses >= LOW).all()
    assert (poses <= HIGH).all()
    found = score(designed(scene, design, "counts"), poses, rng())
    own = own_scene(design, 0.15, 150.0)
    alone, known, lit = [], [], []
    for pose in poses:
        slopes = []
        for i in range(5):
            move = np.zeros(5)
            move[i] = 1e-5
            up, down = (second_forward.light(own, pose + s * move) for s in (1, -1))
            slopes.append((up - down).ravel() / 2e-5)
        information = np.array(slopes) @ np.array(slopes).T / 2.0**2
        spread = np.diag(1 / np.array([4.0, 1.8, 1.8, *np.radians([40.0, 40.0])]) ** 2 * 12)
        lit.append(second_forward.light(own, pose).max() > 20)
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


def test_the_angles_are_those_of_a_second_implementation():
    scene = load_scene("eren2016")
    plain = {"attenuation": scene.effects["attenuation"]}
    scene = dataclasses.replace(scene, effects=plain)
    design = Design("curved", 5, 0.4, 0.32, 4.5, 1, 0.0, 0.0)
    found = score(designed(scene, design, "counts"), uniform_poses(2, rng()), rng())

    def least(motion, step):
        both = [
            [second_angle("curved", 5, m, motion, step, port, window=None) for port in (0, 1)]
            for m in (4, 5, 6, 7, 8)
        ]
        return np.min(both, axis=1)

    shifts, yaws = least("shift", 0.2), least("yaw", 10)
    assert found.shift_near_deg == pytest.approx(shifts[0], rel=1e-5)
    assert found.yaw_near_deg == pytest.approx(yaws[0], rel=1e-5)
    assert found.shift_deg == pytest.approx(min(shifts), rel=1e-5)
    assert found.yaw_deg == pytest.approx(min(yaws), rel=1e-5)


def test_the_papers_array_gets_the_numbers_of_docs_paper():
    """Row "moves to port", the smaller side at 5 x 5: nos. 8 and 11 at 4 m, 13 and 14 at 8 m."""
    scene = designed(
        load_scene("eren2016"), Design("curved", 5, 0.4, 0.32, 4.5, 1, 0.0, 0.0), "counts"
    )
    found = score(scene, uniform_poses(2, rng()), rng())
    stated = [found.shift_near_deg, found.yaw_near_deg, found.shift_deg, found.yaw_deg]
    np.testing.assert_allclose(stated, [26.1, 21.2, 6.3, 9.7], atol=0.05)
    assert found.resolved_at_4m
    assert not found.resolved_4_to_8m


def test_noise_moves_the_signature_as_its_slope_says():
    scene = scene_with({"sensor_noise": {"sigma_counts": 0.01}})
    model, range_m = ForwardModel(scene), 5.0
    clean = model.expected([-range_m, 0, 0, 0, 0])

    def unit(image):
        values = second_features(image, clean.max(), between=True)
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
    found = score(scene, uniform_poses(2, rng()), rng(3))
    first = signature_noise_deg(model, 4.0, rng(3))
    assert found.shift_near_sigmas == pytest.approx(found.shift_near_deg / first)
    assert found.yaw_near_sigmas / found.shift_near_sigmas == pytest.approx(
        found.yaw_near_deg / found.shift_near_deg
    )
    assert found.shift_sigmas <= found.shift_near_sigmas


def test_several_lamps_are_scored_by_their_sum_and_their_bound():
    scene = load_scene("leading_lights")
    poses = uniform_poses(20, np.random.default_rng(2))
    found = score(scene, poses, rng())
    one = score(scene.with_lamps(()), poses, rng())
    assert found.angle_deg < 0.8 * one.angle_deg
    # All in one place would look as one lamp does, but for a pedestal each.
    dense = [
        dataclasses.replace(lamp, y_m=0.01 * i, z_m=0, pitch_deg=0, yaw_deg=0)
        for i, lamp in enumerate(scene.lamps)
    ]
    close = score(dataclasses.replace(scene, lamps=tuple(dense)), poses, rng())
    assert close.yaw_near_deg == pytest.approx(one.yaw_near_deg, rel=0.1)


def test_a_flat_image_meets_no_criterion():
    scene = scene_with({"forward_scatter": {"window_m": 10.0}, "sensor_noise": {"sigma_counts": 1}})
    found = score(scene, uniform_poses(3, rng()), rng())
    assert math.isnan(found.shift_deg)
    assert not found.resolved_4_to_8m
    assert not found.resolved_at_4m
