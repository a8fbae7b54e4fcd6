"""``uuv_array study robustness``: figures of planted errors, what is plausible, and whole runs."""

import functools
import json

import command_line
import numpy as np
import pytest
from blind import Blind
from command_line import assert_picture, json_of
from scenes import WATER, make_scene
from scipy.linalg import block_diag

from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.working_volume import lit_poses
from uuv_optical_array.studies import robustness
from uuv_optical_array.studies.mismatches.kinds import KINDS, kinds_named
from uuv_optical_array.studies.shared.errors import FrameErrors
from uuv_optical_array.studies.shared.results import until_interrupted

run = functools.partial(command_line.run, "study", "robustness")
BY_NAME = {kind.name: kind for kind in KINDS}
# What a program that reads the answer counts on.
KEYS = ("kind", "frames", "answered", "beyond_6_sigma", "beyond_1_m", "nees_mean")


def test_figures_are_those_of_the_errors():
    # One sigma is 0.2 m and 0.02 rad; the last frame has no pose.
    errors = np.zeros((5, 5))
    errors[0, 1] = 0.2  # NEES 1
    errors[1, :2] = 0.8, -0.8  # 32, beyond 3 sigma, and off by 1.13 m
    errors[2, 4] = -0.13  # 42.25, beyond 6 sigma
    errors[3, 2] = 1.3  # the same, and off by 1.3 m
    errors[4] = np.nan
    covariances = np.full((5, 5, 5), np.diag([0.04, 0.04, 0.04, 4e-4, 4e-4]))
    covariances[4] = np.nan
    frames = FrameErrors(errors, covariances, np.ones(5), np.ones(1))
    plausible = np.array([True, False, True, True, False])
    found = robustness.figures(BY_NAME["k-0.05"], frames, plausible)
    assert (found["kind"], found["times_prior"]) == ("k-0.05", 2.5)
    assert not found["within_twice_prior"]
    counts = {"frames": 5, "answered": 4, "beyond_6_sigma": 2, "beyond_1_m": 2}
    assert {**counts, "indistinguishable": 2, "beyond_3_sigma": 3}.items() <= found.items()
    assert found["nees_mean"] == pytest.approx((1 + 32 + 2 * 42.25) / 4)
    assert found["rms_range_m"] == pytest.approx(0.4)
    across = (0.2**2 + 0.8**2 + 1.3**2) / 8
    assert found["rms_across_m"] == pytest.approx(np.sqrt(across))
    assert found["rms_angle_deg"] == pytest.approx(np.degrees(0.13 / np.sqrt(8)))


def test_without_an_answer_there_are_no_means():
    frames = FrameErrors(
        np.full((2, 5), np.nan), np.full((2, 5, 5), np.nan), np.ones(2), np.ones(1)
    )
    found = robustness.figures(BY_NAME["noise"], frames, np.zeros(2, bool))
    assert found["answered"] == found["beyond_6_sigma"] == found["beyond_1_m"] == 0
    assert found["nees_mean"] is found["rms_range_m"] is found["times_prior"] is None
    json.dumps(found, allow_nan=False)


def fitted(model, poses, images):
    """Return linear least squares about the truth with the prior's nuisances, and covariances."""
    stds = model.scene.prior.nuisance_std()
    answers, covariances = poses.copy(), np.empty((len(poses), 5, 5))
    for i, pose in enumerate(poses):
        light, slopes = model.linearised(pose, offsets={name: np.zeros(()) for name in stds})
        scatter = np.diag(model.variance(light)[0])
        for j, std in enumerate(stds.values()):
            scatter += std**2 * np.outer(slopes[:, 5 + j], slopes[:, 5 + j])
        weighted = slopes[:, :5].T @ np.linalg.inv(scatter)
        covariances[i] = np.linalg.inv(weighted @ slopes[:, :5])
        answers[i] += covariances[i] @ weighted @ (images[i].ravel() - light)
    return answers, covariances


@pytest.mark.parametrize("prior", [{}, {"lamp_power_std": 0.02}])
def test_the_scene_explains_its_own_images_and_no_spoilt_or_misplaced_ones(prior):
    # Bright and without limits, so that all is linear.
    model = ForwardModel(make_scene(effects=WATER, prior=prior))
    model.power *= 100
    rng = np.random.default_rng(4)
    poses = lit_poses(model, 300, rng) * [1, 0.3, 0.3, 0.3, 0.3]
    stds = model.scene.prior.nuisance_std()
    offsets = {name: std * rng.standard_normal(300) for name, std in stds.items()}
    light = model.light(poses, 0.0, offsets)
    images = model.read(light, rng)
    answers, covariances = fitted(model, poses, images)

    def plausible(answers, covariances, images, light):
        ratio = robustness.log_ratio(model, answers, covariances, images, light)
        return ratio < robustness.EXCUSED_BELOW

    assert plausible(answers, covariances, images, light).all()
    spoilt = np.ones((5, 5))
    spoilt[2, 2] = 0.9
    assert not plausible(answers, covariances, images * spoilt, light * spoilt).any()
    # Ten standard deviations off, unless the answer is known to be no better.
    answers += 10 * covariances[:, 0] / np.sqrt(covariances[:, :1, 0])
    assert plausible(answers, covariances, images, light).mean() < 0.01
    assert plausible(answers, 100 * covariances, images, light).mean() > 0.95
    answers[7] = np.nan
    assert robustness.log_ratio(model, answers, covariances, images, light)[7] == np.inf


def test_the_ratio_is_that_of_the_likeliest_pose_and_constants(scene):
    model, rng = ForwardModel(scene), np.random.default_rng(2)
    pose, root = np.array([-5.0, 0.2, -0.1, 0.05, 0.1]), 0.02 * rng.standard_normal((5, 5))
    stds = scene.prior.nuisance_std()
    image, true = model.expose(pose, rng), model.light(pose)
    answer = pose + root @ rng.standard_normal(5)
    light, slopes = model.linearised(answer, offsets={name: np.zeros(()) for name in stds})
    std = np.sqrt(model.variance(light)[0])
    # Numbers of unit variance are the unknowns; what they are is the improbability.
    whole = slopes @ block_diag(root, np.diag(list(stds.values()))) / std[:, None]
    wanted = np.append((image.ravel() - light) / std, np.zeros(whole.shape[1]))
    _, (least,), *_ = np.linalg.lstsq(
        np.vstack([whole, np.eye(whole.shape[1])]), wanted, rcond=None
    )
    squares = np.sum((image - true) ** 2 / model.variance(true)[0].reshape(image.shape))
    shown = answer[None], (root @ root.T)[None], image[None], true[None]
    assert robustness.log_ratio(model, *shown)[0] == pytest.approx((least - squares) / 2, rel=1e-6)


def test_a_saturated_reading_excuses_what_is_beyond_it_and_counts_for_nothing(scene):
    model = ForwardModel(scene)
    pose = np.array([[-2.0, 0, 0, 0, 0]])
    image, light = model.expected(pose), model.light(pose)
    assert (light > 1100).any()
    nowhere = 1e-12 * np.eye(5)[None]
    assert robustness.log_ratio(model, pose, nowhere, image, 2 * light)[0] < 1
    # By how much the light of full readings is off does not show; that they are not full does.
    dim = np.minimum(image, 1000.0)
    assert robustness.log_ratio(model, pose, nowhere, dim, np.minimum(light, 1000.0))[0] > 10


def test_kinds_share_poses_and_noise_and_a_seed_repeats_them(table):
    def frames(seed):
        recorder = Blind(table.scene)
        kinds = kinds_named("nothing,ambient_10,gains_0.01", table.scene)
        rows = robustness.measure(recorder, kinds, 20, seed)
        assert [row["frames"] for row in rows] == [20, 20, 20]
        images = np.reshape(recorder.images, (3, 21, *recorder.images[0].shape))
        return images[:, 1:]  # the first answer is a rehearsal

    plain, brighter, gained = frames(3)
    unlimited = (plain > 0) & (brighter < 1023)
    assert set(np.unique((brighter - plain)[unlimited])) <= {10.0}
    # Of 1 % each; what differs is neither the pose nor the noise.
    assert np.abs((gained - plain)[unlimited]).max() < 0.06 * 1023
    np.testing.assert_array_equal(frames(3)[2], gained)
    assert (frames(4)[0] != plain).any()


def test_the_command_prints_the_same_as_text_and_as_json_and_draws(capsys, tmp_path, scene_file):
    picture, some = tmp_path / "r.png", ("--method", "sam", "--kinds", "stuck_detector,nothing")
    answer = json_of(run, "--scene", scene_file, "--poses", 60, "--output", picture, *some)
    assert (answer["scene"], answer["method"]) == ("small", "sam")
    assert (answer["poses"], answer["complete"]) == (60, True)
    assert all(row.keys() >= set(KEYS) for row in answer["kinds"])
    honest, stuck = answer["kinds"]
    assert (honest["kind"], stuck["kind"]) == ("nothing", "stuck_detector")  # as in the list
    assert honest["frames"] == stuck["frames"] == 60
    assert honest["answered"] > 50
    assert honest["beyond_6_sigma"] < 10
    assert stuck["answered"] < honest["answered"]
    assert stuck["beyond_6_sigma"] == 0
    assert "stuck_detector: 60/60 frame" in capsys.readouterr().err
    assert_picture(picture)
    lines = robustness.report(answer["kinds"]).splitlines()
    for row, line in zip(answer["kinds"], lines[1:], strict=True):
        shown = line.split()
        figures = ["answered", "beyond_6_sigma", "indistinguishable", "beyond_1_m"]
        assert shown[2:6] == [str(row[key]) for key in figures]
    assert lines[1].split()[-2:] == [f"{honest['nees_mean']:.3g}", str(honest["beyond_3_sigma"])]


@pytest.mark.parametrize(("frames", "kinds"), [(0, []), (7, [7]), (12, [12]), (17, [12, 5])])
def test_an_interrupt_keeps_the_kinds_that_it_has(table, frames, kinds):
    # Of each kind one image is estimated before the others, as the first call is slower.
    left = iter(range(frames + len(kinds)))

    class Interrupted(Estimator):
        def estimate(self, *image):
            if next(left, None) is None:
                raise KeyboardInterrupt
            return super().estimate(*image)

    named = kinds_named("nothing,mirrored", table.scene)
    measured = robustness.measure(Interrupted(table, "sam"), named, 12, 1)
    if not kinds:
        with pytest.raises(KeyboardInterrupt):
            until_interrupted(measured)
        return
    rows, complete = until_interrupted(measured)
    assert [row["frames"] for row in rows] == kinds
    assert complete == (len(kinds) == 2 and kinds[-1] == 12)
