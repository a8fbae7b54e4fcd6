"""Tracks of images: under uneven daylight, told nonsense by commands, and after long drives."""

import itertools

import numpy as np
import pytest
from scenes import changed, coarse, squared_error, with_prior
from scipy.linalg import eigh
from scipy.stats import chi2, norm

from uuv_optical_array.core.geometry import YAW, X, wrapped
from uuv_optical_array.core.messages import MAX_TWIST
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.estimation.signature_table import build_table
from uuv_optical_array.estimation.tracking.settings import TrackerSettings
from uuv_optical_array.estimation.tracking.tracker import Tracker
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import ABSORPTION, AMBIENT, GRADIENTS, POWER
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.studies.drives import images
from uuv_optical_array.studies.shared.course import course

POSE = np.array([-6.0, 0.2, -0.1, 0.05, -0.04])
NEAR = np.array([-5.0, 0.2, -0.1, 0.05, -0.04])


@pytest.fixture(scope="module")
def estimator(compiled_fit):
    return Estimator(build_table(coarse("follow")))


def test_daylight_is_as_uneven_as_it_is_unknown_but_where_the_scene_says_more():
    follow = load_scene("follow")

    def learnt(**prior):
        stds = with_prior(follow, **prior).constants_std()
        return [stds.get(name, 0.0) for name in GRADIENTS]

    assert learnt() == [follow.prior.ambient_std_counts] * 2
    assert learnt(ambient_std_counts=0.0) == [0, 0]
    assert learnt(ambient_gradient_std_counts=2.0) == [2, 2]
    assert learnt(shade_probability=0.3, shade_depth=0.2) == [0, 0]
    # Daylight that the scene names is as uneven as its prior says.
    assert set(GRADIENTS).isdisjoint(load_scene("sunlit_shallow").constants_std())
    assert load_scene("reference").constants_std() == {}


def test_what_one_image_does_not_tell_of_the_slope_widens_its_pose_for_a_track(estimator):
    model = ForwardModel(estimator.scene)

    def fitted(slopes, uneven=None):
        light = model.light(POSE, 0.0, dict(zip(GRADIENTS, np.array(slopes), strict=True)))
        return estimator.estimate(light, uneven=uneven)

    # A slope of daylight that the fit does not know of looks like a turn, so far by a count.
    moved = np.array([fitted(side).pose - fitted(-side).pose for side in np.eye(2)]) / 2
    by_itself, uneven = fitted([0, 0]), estimator.constants.uneven
    added = fitted([0, 0], uneven).covariance - by_itself.covariance
    std = estimator.scene.prior.ambient_std_counts
    expected = by_itself.clear * std**2 * moved.T @ moved
    np.testing.assert_allclose(added, expected, rtol=0.05, atol=0.02 * added.max())


@pytest.mark.parametrize("seed", [1, 2])
def test_a_steady_slope_misleads_neither_poses_nor_the_track(estimator, seed):
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(seed)
    times_s = np.arange(240) / 4
    poses, pipeline = course(times_s, 60.0, rng), Pipeline(estimator)
    bearing = rng.uniform(0, 2 * np.pi)
    slopes = 12 * np.array([np.cos(bearing), np.sin(bearing)])
    lights, squares = model.light(poses, 0.0, dict(zip(GRADIENTS, slopes, strict=True))), []
    for t, pose, light in zip(times_s, poses, lights, strict=True):
        image = model.read(12 + light, rng)
        frame = pipeline.answer(round((1 + t) * 1e9), image)
        squares += [squared_error(said, pose) for said in (frame.estimate, frame.track)]
    assert np.less(squares, 46).all()  # as improbable as six standard deviations of one number
    for name, slope in zip(GRADIENTS, slopes, strict=True):
        mean, std = frame.track.constants[name]
        assert std < 4
        assert mean == pytest.approx(slope, abs=4 * std)


def test_a_dim_sea_that_is_hardly_moved_in_gets_no_sharp_and_wrong_track(estimator):
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(3)
    dim = {POWER: np.array(-0.15), ABSORPTION: np.array(0.04)}
    poses, pipeline, squares = course(np.arange(160) / 2, 1200.0, rng), Pipeline(estimator), []
    for k, (pose, light) in enumerate(zip(poses, model.light(poses, 0.0, dim), strict=True)):
        image = model.read(light, rng)
        track = pipeline.answer((k + 2) * 500_000_000, image).track
        squares.append(squared_error(track, pose))
    # The sea itself is 2.5 standard deviations from what was believed.
    assert np.mean(squares[80:]) < 5 + 2.5**2


def bent(light, second):
    """Read by a converter that is bent, like an S, by a hundredth of full scale."""
    return light + 10 * np.sin(2 * np.pi * np.minimum(light, 1023) / 1023)


def dimmed(light, second):
    """Return the light of a lamp that is dimmed by a fifth after 20 s."""
    return light * (0.8 if second >= 20 else 1.0)


@pytest.mark.parametrize("other", [bent, dimmed])
def test_in_a_sea_that_is_not_the_scene_neither_images_nor_the_track_are_falsely_sure(
    estimator, other
):
    # Aims, which no image shows, would widen all covariances.
    estimator = Estimator(with_prior(estimator.scene, aim_std_deg=0.0, lamp_aim_std_deg=0.0))
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(1)
    pipeline, seconds, false, posed = Pipeline(estimator), np.arange(300) / 5, np.zeros(2), 0
    poses = course(seconds, 60.0, rng)
    for second, pose, light in zip(seconds, poses, model.light(poses), strict=True):
        image = model.read(other(light, second), rng)
        frame = pipeline.answer(round((1 + second) * 1e9), image)
        if frame.track and frame.estimate:
            false += [squared_error(it, pose) > 6**2 for it in (frame.estimate, frame.track)]
            posed += 1
    assert posed == 300
    np.testing.assert_array_equal(false, 0)


def test_a_lamp_that_dims_by_a_tenth_is_said_and_the_track_stays_true_and_as_sure_as_images(
    estimator,
):
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(1)
    poses, pipeline, squares, said = (
        course(np.arange(500) / 5, 40.0, rng),
        Pipeline(estimator),
        [],
        0,
    )
    for k, (pose, light) in enumerate(zip(poses, model.light(poses), strict=True)):
        image = model.read((1.0 if k < 350 else 0.9) * light, rng)
        frame = pipeline.answer((k + 1) * 200_000_000, image)
        if k < 350 or frame.track is None:
            continue
        squares.append(squared_error(frame.track, pose))
        # The largest of all directions' variances, in those of the image by itself.
        assert eigh(frame.track.covariance, frame.estimate.covariance)[0].max() < 3**2
        said += frame.track.mismatch != ""
    assert said > 5
    assert len(squares) > 120
    # Of five numbers, and of the lamp, which is off by the standard deviation of its prior.
    assert np.mean(squares) < 2 * (5 + 1)


@pytest.mark.parametrize(
    ("name", "step", "off"),
    [
        # To first order, which what light there is follows, but for its logarithm.
        (POWER, np.log(0.8), 0.8 - 1),
        (POWER, np.log(1.2), 1.2 - 1),
        (AMBIENT, 15.0, 15.0),
    ],
)
def test_what_changes_at_once_is_named_as_vehicles_do_not_jump(estimator, name, step, off):
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(2)
    poses, pipeline, said = course(np.arange(190) / 10, 40.0, rng), Pipeline(estimator), []
    steps = np.where(np.arange(190) >= 150, step, 0.0)
    for k, light in enumerate(model.light(poses, 0.0, {name: steps})):
        image = model.read(light, rng)
        track = pipeline.answer((k + 1) * 100_000_000, image).track
        said += [track.mismatch] if track and track.mismatch else []
    named, size = said[0].split(" changed by ")
    assert named == name
    assert float(size.partition(" ")[0]) == pytest.approx(off, rel=0.2)


def test_a_track_that_outliers_begin_anew_believes_nothing_that_it_learnt(estimator):
    # What changed may be a constant, and not the place.
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(4)
    pipeline, poses = Pipeline(estimator), course(np.arange(210) / 10, 60.0, rng)
    poses[200:, 1] += 1.0
    answers = [
        pipeline.answer((k + 1) * 100_000_000, model.read(light, rng))
        for k, light in enumerate(model.light(poses))
    ]
    first = next(answer.track for answer in answers[200:] if answer.track)
    learnt = answers[199].track.constants[POWER].std
    assert first.frames < 10
    assert first.constants[POWER].std > 1.05 * learnt


@pytest.mark.parametrize(
    ("array", "range_m", "linear"),
    [
        ({}, 6.0, True),
        ({}, 13.0, False),  # the range is not known to a tenth of it
        ({"radius_m": 1.0}, 6.0, False),  # weakly curved: mirrored attitudes look alike
        ({"shape": "planar", "radius_m": None}, 6.0, False),
    ],
)
def test_an_image_is_linear_where_it_shows_one_pose(array, range_m, linear, compiled_fit):
    scene = changed(coarse("follow"), array=array, prior={"known": "calibrated"})
    found = Estimator(build_table(scene))
    known = Tracker(TrackerSettings(), constants=found.constants).uneven(0)
    image = ForwardModel(scene).light(np.array([-range_m, *POSE[1:]]))
    assert found.estimate(image, uneven=known).bent == (not linear)


def test_a_track_goes_on_through_images_that_are_far_from_linear(estimator):
    """18 deg off the beam's axis a lamp's place and the turn of the array look much alike."""
    model, stds = ForwardModel(estimator.scene), estimator.scene.nuisance_std()
    squares, errors, bent = [], [], []
    aside = np.radians(18) * np.minimum(np.arange(200) / 60, 1)
    yaw = np.radians(10) * np.sin(2 * np.pi * np.arange(200) / 80) - aside
    level = np.full((200, 2), [0.2, 0.05])
    poses = np.column_stack([-5 * np.cos(aside), 5 * np.sin(aside), level, yaw])
    rng, pipeline = np.random.default_rng(3), Pipeline(estimator)
    sea = {name: np.array(std * rng.standard_normal()) for name, std in stds.items()}
    gains = 1 + estimator.scene.prior.gain_std * rng.standard_normal((5, 5))
    for k, (pose, light) in enumerate(zip(poses, model.light(poses, 0.0, sea), strict=True)):
        image = model.read(model.with_gains(light, gains), rng)
        estimate, track = pipeline.answer((k + 10) * 100_000_000, image)[1:3]
        if k >= 80 and estimate is not None:
            bent.append(estimate.bent)
            squares.append(squared_error(track, pose))
            errors.append((track.pose - pose, estimate.pose - pose))
    assert len(bent) >= 119  # of 120; of a few the best fit pitches too steeply
    assert np.mean(bent) > 0.9
    tracked, single = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (tracked[[YAW, X]] < 0.6 * single[[YAW, X]]).all()
    assert tracked[YAW] < 0.4 * single[YAW]
    # In one sea all errors are as one.
    assert np.mean(squares) < 5 + 3 * np.sqrt(10)


# Each of these seas with gaps, where the readings alone were held to the track, lost it.
@pytest.mark.parametrize(("seed", "gap"), [(0, 1), (1, 1), (11, 5), (16, 5), (18, 5), (23, 5)])
def test_commands_that_mean_nothing_take_no_frame_and_falsify_no_track(estimator, seed, gap):
    rng = np.random.default_rng((31, seed))
    model, pipeline, said = ForwardModel(estimator.scene), Pipeline(estimator), []
    pose, stamp = np.array([-3.5, *POSE[1:]]), 2_000_000_000
    light = model.light(pose, 0.0)
    for k in range(80):
        # In a gap, the command carries a follower past the lamp that in fact stays where it is.
        stamp += 100_000_000 * (gap if k % 8 == 0 else 1)
        frame = pipeline.answer(stamp, model.read(light, rng))
        assert squared_error(frame.track, pose) < chi2.isf(2 * norm.sf(6), 5)  # no outlier has one
        said.append(frame.track.own_motion)
        if k % 8 == 7:
            ways = MAX_TWIST[:3] * rng.uniform([0.3, -0.3, -0.3], [1.0, 0.3, 0.3])
            pipeline.command(stamp, ways, np.zeros(3))
    assert said[0] == "not told"
    assert "contradicted" in said


def long_drive(estimator, seed):
    """Return squared errors of poses and tracks, a frame every 2 s, from 16 to 20 minutes."""
    model, prior = ForwardModel(estimator.scene), estimator.scene.prior
    rng, pipeline, squares = np.random.default_rng(seed), Pipeline(estimator), []
    offsets = {name: std * rng.standard_normal() for name, std in prior.nuisance_std().items()}
    gains = 1 + prior.gain_std * rng.standard_normal((5, 5))
    turn = 2 * np.pi * np.arange(600) / 30
    way = [-6 + np.sin(turn), 0.3 * np.cos(turn), 0.2 * np.sin(2 * turn)]
    poses = np.column_stack([*way, 0.03 * np.sin(turn), 0.05 * np.cos(turn)])
    for k, (pose, light) in enumerate(zip(poses, model.light(poses, 0.0, offsets), strict=True)):
        image = model.read(gains * light, rng)
        frame = pipeline.answer((k + 1) * 2_000_000_000, image)
        for said in (frame.estimate, frame.track) if k >= 480 else ():
            squares.append(squared_error(said, pose))
    return np.mean(squares)


@pytest.mark.parametrize("move", [[0.1, 0.05, -0.05, 0.02, 0.03], [-0.15, 0.1, 0.1, 0.05, -0.05]])
def test_readings_are_linearised_once_more_near_the_beginning_of_their_correction(estimator, move):
    """A quarter of the way, by the part of the readings that depends on the pose."""
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(1)
    tracker, near, tracks = Tracker(TrackerSettings(), estimator.constants), {}, []
    for k, off in enumerate((np.zeros(5), np.zeros(5), np.zeros(5), np.array(move))):
        image = model.read(model.light(NEAR + off), rng)
        found, asked = estimator.estimate(image, uneven=0.1), []
        near[k] = estimator.lineariser(found, image)

        def relinearise(at, k=k, asked=asked):
            asked.append(at)
            return near[k](at)

        frame = (k + 10) * 100_000_000, found.pose, found.covariance, found.readings
        tracks.append(tracker.update(*frame, relinearise))
    predicted = tracks[-2].pose + 0.1 * tracks[-2].rate
    way = tracks[-1].pose - predicted
    assert np.linalg.norm(way[:3]) > 0.05
    assert 0.15 < (asked[0][:5] - predicted) @ way / (way @ way) < 0.35


def test_what_is_learnt_for_long_is_not_pulled_to_one_side(estimator):
    # In one sea all errors are as one: a chi square of five degrees of freedom.
    assert long_drive(estimator, 11) < 5 + 3 * np.sqrt(10)


@pytest.mark.parametrize("seed", [3, 5])
def test_a_yaw_that_reverses_at_once_teaches_no_wrong_constants(estimator, seed):
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(seed)
    stds = estimator.scene.nuisance_std()
    sea = {name: np.array(std * rng.standard_normal()) for name, std in stds.items()}
    gains = 1 + estimator.scene.prior.gain_std * rng.standard_normal((5, 5))
    pipeline, poses = Pipeline(estimator), np.tile([-5.0, 0.05, -0.05, 0.0, 0.0], (150, 1))
    poses[:, YAW] = np.radians(30) * 1.5 * (abs(np.arange(150) / 15 % 2 - 1) - 0.5)
    for k, (pose, light) in enumerate(zip(poses, model.light(poses, 0.0, sea), strict=True)):
        image = model.read(model.with_gains(light, gains), rng)
        track = pipeline.answer((k + 10) * 100_000_000, image).track
        assert not track.mismatch
        assert squared_error(track, pose) < 46
    for name, offset in sea.items():
        mean, std = track.constants[name]
        assert mean == pytest.approx(offset, abs=5 * std)


@pytest.mark.parametrize("seed", [8, 11])
def test_a_track_that_comes_from_afar_is_not_misled_by_bent_images(estimator, seed):
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(seed)
    stds = estimator.scene.nuisance_std()
    sea = {name: np.array(std * rng.standard_normal()) for name, std in stds.items()}
    phases, pipeline = rng.uniform(0, 2 * np.pi, 4), Pipeline(estimator)
    times = np.arange(300)
    sway = np.array([0.3, 0.3, 0.1, 0.1]) * np.sin(0.06 * times[:, None] + phases)
    poses = np.column_stack([-12 + times / 75, sway])
    for k, (pose, light) in enumerate(zip(poses, model.light(poses, 0.0, sea), strict=True)):
        image = model.read(light, rng)
        track = pipeline.answer((k + 10) * 100_000_000, image).track
        assert not (track and track.mismatch)
        assert track is None or squared_error(track, pose) < 46


@pytest.mark.parametrize(
    ("wrong", "wrong_s", "right_s", "said"),
    [
        ("smaller", 20, 15, True),
        ("smaller", 20, 45, False),
        ("slanted", 40, 10, True),
        ("slanted", 40, 110, False),
    ],
)
def test_a_track_that_wrong_images_taught_is_found_again_by_right_ones(
    estimator, wrong, wrong_s, right_s, said
):
    model, pipeline = ForwardModel(estimator.scene), Pipeline(estimator)
    radius_m = 0.95 * estimator.scene.array.radius_m
    smaller = ForwardModel(changed(estimator.scene, array={"radius_m": radius_m}))
    slant = np.linspace(0.93, 1.07, 5)
    rng, seconds = np.random.default_rng(1), np.arange(2 * (wrong_s + right_s)) / 2
    poses, taught = course(seconds, 60.0, rng), seconds < wrong_s
    lights = model.light(poses)
    lights[taught] = smaller.light(poses[taught]) if wrong == "smaller" else lights[taught] * slant
    for k, (second, pose, light) in enumerate(zip(seconds, poses, lights, strict=True)):
        track = pipeline.answer((k + 4) * 500_000_000, model.read(light, rng)).track
        if second >= wrong_s + right_s - 10:
            assert bool(track.mismatch) == said
            assert squared_error(track, pose) < 46


def test_images_that_bend_over_all_that_they_leave_call_no_honest_sea_off(compiled_fit):
    """In murky water nearly all do, and the error of the place lasts in what they leave."""
    estimator, tracked = Estimator(load_scene("harbour")).wait(), 0
    for drawn in (6, 30, 35):
        rng, pipeline = np.random.default_rng((2, drawn)), Pipeline(estimator)
        drive = images(estimator.scene, 60.0, 10.0, rng)
        for t, _, image in itertools.islice(drive, 150):  # within 10 s it would call each off
            track = pipeline.answer(round((1 + t) * 1e9), image).track
            if track is not None:
                tracked += 1
                assert not track.mismatch
    assert tracked > 400


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_darkness_in_brighter_daylight_than_the_scene_s_makes_no_false_track(estimator, seed):
    """What is left of the image then fits a lamp far off that hardly shines."""
    model, rng = ForwardModel(estimator.scene), np.random.default_rng(seed)
    pipeline = Pipeline(estimator)
    daylight, far = {AMBIENT: np.array(6.0)}, np.array([-1000.0, 0, 0, 0, 0])
    lit, dark = (model.light(place, 0.0, daylight) for place in (NEAR, far))
    for k in range(100):
        image = model.read(lit if k < 50 else dark, rng)
        pipeline.tracker.command(k * 10**8, np.zeros(5))
        track = pipeline.answer((k + 1) * 10**8, image).track
        if track is not None:
            assert (
                np.abs(wrapped(track.pose - NEAR)) < 6 * np.sqrt(track.covariance.diagonal())
            ).all()
