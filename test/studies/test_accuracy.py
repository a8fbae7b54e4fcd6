"""``uuv_array study accuracy``: statistics in closed form on planted errors, then real runs."""

import functools

import command_line
import matplotlib.image
import numpy as np
import pytest
from blind import Blind
from command_line import json_of, text_of
from scenes import changed, with_prior

from uuv_optical_array.core.geometry import DOF_NAMES
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.information.likelihood import information
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, save_scene
from uuv_optical_array.forward.working_volume import lit_poses
from uuv_optical_array.studies import accuracy
from uuv_optical_array.studies.shared.errors import FrameErrors

FRAMES = 2000
run = functools.partial(command_line.run, "study", "accuracy")


@pytest.fixture(scope="module")
def model(scene):
    return ForwardModel(scene)


@pytest.fixture(scope="module")
def poses(model):
    return lit_poses(model, FRAMES, np.random.default_rng(5))


@pytest.fixture(scope="module")
def bound(model, poses):
    return cramer_rao_bound(model, poses)


@pytest.fixture(scope="module")
def honest(bound):
    """Errors that are Gaussian with the bound as covariance."""
    roots = np.linalg.cholesky(bound.covariance)
    return (roots @ np.random.default_rng(6).standard_normal((FRAMES, 5, 1)))[..., 0]


def figures(bound, errors, scale=1.0):
    """Figures of errors whose covariances are those of the bound, times a factor."""
    count = len(errors)
    frames = FrameErrors(errors, scale * bound.covariance[:count], np.ones(count), np.ones(1))
    return accuracy.figures(frames, bound.std[:count])


def test_errors_as_large_as_the_bound_have_ratio_1_and_nees_5(bound, honest):
    found = figures(bound, honest)
    np.testing.assert_allclose(list(found["ratio_to_bound"].values()), 1, atol=0.06)
    low, high = found["nees_band"]
    assert low < found["nees_mean"] < high
    assert found["nees_std_error"] == pytest.approx(np.sqrt(10 / FRAMES), rel=0.1)
    assert found["beyond_6_sigma"] == found["beyond_6_bounds"] == found["without_pose"] == 0
    twice = figures(bound, 2 * honest)
    assert twice["nees_mean"] == pytest.approx(4 * found["nees_mean"])
    ratios = np.divide(*(list(each["ratio_to_bound"].values()) for each in (twice, found)))
    np.testing.assert_allclose(ratios, 2)


@pytest.mark.parametrize("dof", range(5))
def test_one_frame_of_seven_sigma_is_counted_and_one_of_five_is_not(bound, dof):
    errors = np.zeros((50, 5))
    errors[17, dof], errors[30, dof] = -7 * bound.std[17, dof], 5 * bound.std[30, dof]
    found = figures(bound, errors)
    assert (found["beyond_6_sigma"], found["beyond_6_bounds"]) == (1, 1)
    rms = np.sqrt(np.mean(errors[:, dof] ** 2)) * [1, 1, 1, 180 / np.pi, 180 / np.pi][dof]
    assert list(found["rms_error"].values())[dof] == pytest.approx(rms)
    # Seven of the bound's standard deviations are few of an estimate that is less sure.
    unsure = figures(bound, errors, scale=4.0)
    assert (unsure["beyond_6_sigma"], unsure["beyond_6_bounds"]) == (0, 1)


def test_frames_without_a_pose_are_left_out_of_every_mean(bound, honest):
    errors = honest[:40].copy()
    errors[::4] = np.nan
    posed = np.flatnonzero(~np.isnan(errors[:, 0]))
    covariances = bound.covariance[posed]
    alone = accuracy.figures(
        FrameErrors(errors[posed], covariances, np.ones(30), np.ones(1)), bound.std[posed]
    )
    found = figures(bound, errors)
    assert (found.pop("poses"), found.pop("without_pose")) == (40, 10)
    assert found.items() <= alone.items()


@pytest.mark.parametrize(("count", "band"), [(1, (0.831, 12.833)), (FRAMES, (4.862, 5.140))])
def test_the_band_is_the_chi_square_tables(bound, count, band):
    # Table of chi-square with 5 degrees of freedom; for many, 5 +- 1.96 sqrt(10 / n).
    found = figures(bound, np.zeros((count, 5)))
    np.testing.assert_allclose(found["nees_band"], band, atol=2e-3)


def test_a_scene_in_which_no_frame_gets_a_pose_is_refused(model, poses):
    images = model.expose(poses[:3], np.random.default_rng(7))
    with pytest.raises(ValueError, match="none of 3 frames got a pose"):
        accuracy.measure(Blind(model.scene), poses[:3], images)


def test_least_squares_is_near_the_bound_of_the_reference_scene(capsys):
    answer = json_of(run, "--poses", 600, "--seed", 3)
    about = {"scene": "reference", "method": "least_squares", "poses": 600, "without_pose": 0}
    assert about.items() <= answer.items()
    assert tuple(answer["ratio_to_bound"]) == DOF_NAMES
    assert all(0.85 < ratio < 1.15 for ratio in answer["ratio_to_bound"].values())
    assert answer["beyond_6_sigma"] <= 2
    low, high = answer["nees_band"]
    assert 4.7 < low < 5 < high < 5.3
    assert 4 < answer["nees_mean"] < 6
    assert 0 < answer["frame_ms"]["median"] <= answer["frame_ms"]["99th_percentile"]
    assert answer["model_ms"] > 0
    assert "600/600" in capsys.readouterr().err


def test_the_text_tells_the_same_as_the_object(scene_file):
    words = ("--scene", scene_file, "--poses", 40, "--seed", 9)
    answer = json_of(run, *words)
    text = text_of(run, *words)
    assert text.startswith("least_squares in scene small, curved array, 40 random poses, seed 9\n")
    for name, ratio in answer["ratio_to_bound"].items():
        assert any(
            line.startswith(name) and line.endswith(f"{ratio:.3f}") for line in text.splitlines()
        )
    for phrase in (
        f"without a pose: {answer['without_pose']} of 40",
        f"its own standard deviations: {answer['beyond_6_sigma']} of 40",
        f"the bound at the truth: {answer['beyond_6_bounds']} of 40",
        f"mean NEES: {answer['nees_mean']:.3f}",
        "{:.3f} to {:.3f}".format(*answer["nees_band"]),
        "for the model of 4 poses",
    ):
        assert phrase in text


@pytest.mark.usefixtures("sketched")
def test_it_costs_to_know_less_of_the_sea_and_stays_honest(scene_file, tmp_path):
    picture = tmp_path / "known.png"
    words = ("--scene", scene_file, "--known", picture, "--poses", 60)
    answer = json_of(run, *words)
    assert (answer["scene"], answer["poses"], answer["picture"]) == ("small", 60, str(picture))
    rows = answer["known"]
    assert [row["known"] for row in rows] == ["exactly", "calibrated", "as_bought"]
    bounds = [row["rms_bound"]["x_m"] for row in rows]
    assert bounds[0] < 0.8 * bounds[1] < 0.8 * bounds[2]
    for row in rows:
        # Of 60 chi-square numbers with five degrees of freedom, five standard errors.
        assert abs(row["nees_mean"] - 5) < 5 * np.sqrt(10 / 60)
    assert matplotlib.image.imread(picture).shape[2] == 4
    for row, line in zip(rows, accuracy.comparison(rows).splitlines()[2:], strict=True):
        assert line.split()[:2] == [row["known"], f"{row['rms_error']['x_m']:.3f}"]
    # Fewer poses: the text has a line for each row, and one for each setting that costs something.
    words = ("--scene", scene_file, "--known", tmp_path / "few.png", "--poses", 4)
    head, compared, costs, end = text_of(run, *words).strip().split("\n\n")
    assert "4 random poses" in head
    assert [line.split()[0] for line in compared.splitlines()[2:]] == [row["known"] for row in rows]
    assert [line.split("  ")[0] for line in costs.splitlines()[2:]] == list(answer["costs"])
    assert end == f"picture: {tmp_path / 'few.png'}"


def test_the_cost_of_a_setting_is_what_the_bound_gains_where_it_is_known():
    scene = load_scene("coastal")
    poses = lit_poses(ForwardModel(scene), 40, np.random.default_rng(3))
    found = accuracy.costs(scene, poses)
    assert list(found)[:2] == ["as it is", "lamp_power_std"]
    assert "k_std_per_m" not in found, "coastal has absorption"
    for key in ("lamp_power_std", "cosine_power_std", "lamp_aim_std_deg"):
        model = ForwardModel(with_prior(scene, **{key: 0.0}))
        square = [cramer_rao_bound(model, pose).std ** 2 for pose in poses]
        rms = np.sqrt(np.mean(square, axis=0)) * [1, 1, 1, 180 / np.pi, 180 / np.pi]
        assert list(found[key].values()) == pytest.approx(rms.tolist())
        assert max(np.divide(rms, list(found["as it is"].values()))) <= 1


def test_one_to_four_lamps_are_compared_in_three_seas():
    names = [tuple(name.values()) for name, *_ in accuracy.by_lamps(load_scene("leading_lights"))]
    assert names == [(n, sea) for n in (1, 2, 3, 4) for sea in ("known", "drawn", "cloud")]


@pytest.mark.usefixtures("sketched")
def test_lamps_of_one_power_are_compared(tmp_path, monkeypatch):
    monkeypatch.setattr(accuracy, "NUMBERS", (1, 3))
    picture = tmp_path / "lamps.png"
    answer = json_of(run, "--scene", "leading_lights", "--lamps", picture, "--poses", 8)
    rows = {(row["lamps"], row["sea"]): row for row in answer["lamps"]}
    assert list(rows) == [(n, sea) for n in (1, 3) for sea in ("known", "drawn", "cloud")]
    assert matplotlib.image.imread(picture).shape[2] == 4
    figure = accuracy.draw(answer["lamps"][:5], "interrupted", "lamps")
    figure.set_layout_engine("none")  # which takes most of the time
    figure.draw_without_rendering()
    for axes, dofs in zip(figure.axes, ([0], [1, 2], [3, 4]), strict=True):
        for key, heights in (
            ("rms_error", [bar.get_height() for bar in axes.patches]),
            ("rms_bound", [line.get_segments()[0][0, 1] for line in axes.collections]),
        ):
            values = [np.array(list(row[key].values()))[dofs] for row in answer["lamps"][:5]]
            assert heights == pytest.approx([np.sqrt(np.mean(v**2)) for v in values])
    lines = accuracy.comparison(answer["lamps"]).splitlines()[2:]
    for line, row in zip(lines, rows.values(), strict=True):
        x, _, _, pitch, yaw = row["rms_error"].values()
        words = line.split()
        assert words[:3] == [str(row["lamps"]), row["sea"], f"{x:.3f}"]
        assert words[6] == f"{np.sqrt((pitch**2 + yaw**2) / 2):.3f}"
        assert words[8:11] == [f"{row['nees_mean']:.2f}", "0", str(row["without_pose"])]
    bound = {key: list(row["rms_bound"].values()) for key, row in rows.items()}
    # Three lamps see aside of the beam what one cannot, and behind a cloud, too.
    assert bound[3, "known"][1] < 0.4 * bound[1, "known"][1]
    assert bound[3, "cloud"][1] < 0.5 * bound[1, "cloud"][1]


@pytest.mark.parametrize("lamps", [1, 3])
def test_behind_a_cloud_the_bound_is_that_of_five_more_unknowns(lamps):
    scene = with_prior(load_scene("leading_lights"), aim_std_deg=0.0, lamp_aim_std_deg=0.0)
    cases = {(name["lamps"], name["sea"]): truth for name, truth, _ in accuracy.by_lamps(scene)}
    drawn, cloud = (ForwardModel(cases[lamps, sea]) for sea in ("drawn", "cloud"))
    # By the axis, so that no roll matters, and Legendre polynomials in place of the modes.
    pose, stds = np.array([-5.0, 0, 0, 0, 0]), drawn.scene.nuisance_std()
    stds.pop("follower.roll_rad", None)
    light, jacobian = drawn.linearised(pose, 0.0, {name: np.zeros(()) for name in stds})
    column, row = np.meshgrid(*2 * [np.linspace(-1, 1, 5)])
    modes = [m - m.mean() for m in (column, row, column**2, column * row, row**2)]
    modes = np.array([m.ravel() / np.sqrt(np.mean(m**2)) for m in modes])
    signal = light - 20.0
    jacobian = np.hstack([jacobian, signal[:, None] * np.tile(modes, lamps).T])
    # A fifth, a quarter of it in a tilt, and a quarter of that in a bow and in each detector.
    precision = np.array([0.05, 0.05, 0.0125, 0.0125, 0.0125, *stds.values()]) ** -2.0
    precision = np.diag([*5 * [0.0], *np.roll(precision, -5)])
    noise = cloud.noise._replace(square=drawn.noise.square + 0.0125**2)
    weights = information(light, noise)
    whole = np.linalg.inv(jacobian.T * weights @ jacobian + precision)
    expected = np.sqrt(np.diag(whole)[:5])
    found = cramer_rao_bound(cloud, pose).std
    np.testing.assert_allclose(found[[0, 3, 4]], expected[[0, 3, 4]], rtol=1e-6)
    assert found[1] > 1.5 * cramer_rao_bound(drawn, pose).std[1] or lamps == 3


@pytest.fixture
def answers_of(tmp_path):
    """What the study answers in another reference scene, without an option and with it."""

    def answers(group, values, count, option):
        path = tmp_path / "other.yaml"
        save_scene(changed("reference", **{group: values}), path, "Other.")
        for words in ((), (option,)):
            yield json_of(run, "--scene", path, "--poses", count, *words)

    return answers


def test_what_moves_is_seen_at_moments_only_and_is_no_part_of_the_covariance(answers_of):
    drift = {"lamp_drift": {"std": 0.1, "time_scale_s": 60.0, "seed": 1}}
    still, moving = answers_of("effects", drift, 100, "--moving")
    plain = json_of(run, "--poses", 100)
    assert still["ratio_to_bound"] == plain["ratio_to_bound"]  # the same poses and noise
    assert (still["moving"], moving["moving"]) == (False, True)
    # The lamp's power is off by a tenth, of which noise is a small part.
    assert moving["ratio_to_bound"]["x"] > 1.3 * still["ratio_to_bound"]["x"]
    assert moving["nees_mean"] > 3 * still["nees_mean"]


def test_truth_that_is_drawn_from_the_prior_has_an_honest_covariance(answers_of):
    mean, drawn = answers_of("prior", {"lamp_power_std": 0.1}, 600, "--drawn")
    # A lamp at its mean is better known than the prior says, most of all in range.
    assert mean["nees_mean"] < 4.5
    assert mean["ratio_to_bound"]["x"] < 0.88
    assert 4.4 < drawn["nees_mean"] < 5.6
    assert 0.85 < drawn["ratio_to_bound"]["x"] < 1.15
