"""``uuv_array study measured`` on light that was made up here, without the package's laws."""

import re

import numpy as np
import pytest
from calibrated_seas import named
from command_line import json_of, run
from pages import ROOT

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.forward.lamp.photometric_files import read
from uuv_optical_array.forward.lamp.photometry import fitted
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import PRIORS
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.studies.measured_light import lamps as measured_lamps
from uuv_optical_array.studies.measured_light import poses as measured_poses
from uuv_optical_array.studies.measured_light.lamps import MeasuredLamp
from uuv_optical_array.studies.measured_light.lamps import scene_of as scene_of_beam
from uuv_optical_array.studies.measured_light.poses import positions, relative_error, virtual_array
from uuv_optical_array.studies.measured_light.report import report_room
from uuv_optical_array.studies.measured_light.room import (
    FULL,
    HEIGHT_M,
    LAMPS,
    Pattern,
    Room,
    lamp_of,
    pattern_of,
    read_room,
    scene_of,
)

PLACES = np.array([[6.0, 3.0], [6.0, 1.0], [3.4, 2.9], [3.5, 1.0]])
POWERS, SIGMAS_DEG = [5000.0, 4500.0, 4000.0, 3000.0], [50.0, 55.0, 60.0, 65.0]
FLOORS = [40.0, 10.0, 20.0, 30.0]
NOISE, SHARE = 5.0, 0.01


def readings_of(places, rng):
    """Return readings below each lamp: inverse square, Lambert at the photodiode, and a floor."""
    columns = []
    for place, power, sigma, floor in zip(PLACES, POWERS, SIGMAS_DEG, FLOORS, strict=True):
        square = ((places - place) ** 2).sum(axis=1) + HEIGHT_M**2
        cosine = HEIGHT_M / np.sqrt(square)
        light = (
            power / square * cosine * np.exp(-0.5 * (np.arccos(cosine) / np.radians(sigma)) ** 2)
        )
        noise = np.hypot(NOISE, SHARE * light) * rng.standard_normal(len(places))
        columns.append(light + floor + noise)
    return np.column_stack(columns)


def room_of(count, seed):
    rng = np.random.default_rng(seed)
    places = rng.uniform([2.3, 0.3], [6.4, 3.6], (count, 2))
    return Room(np.full(count, 1.0), places, readings_of(places, rng))


@pytest.fixture(scope="module")
def lamps():
    learn = room_of(400, 1)
    return [lamp_of(learn, i) for i in range(LAMPS)]


def test_place_floor_and_noise_of_each_lamp_are_found(lamps):
    for i, lamp in enumerate(lamps):
        np.testing.assert_allclose(lamp.place, PLACES[i], atol=0.05)
        error = named(lamp.found)["lamp.floor_counts"].std
        assert abs(lamp.floor - FLOORS[i]) < 4.5 * error < 40
        assert not lamp.found.refusal
        assert lamp.found.parameters[0].value == pytest.approx(POWERS[i], rel=0.03)
        assert lamp.found.parameters[1].value == pytest.approx(SIGMAS_DEG[i], rel=0.15)
        sigma, relative = (
            named(lamp.found)[f"sensor_noise.{key}"] for key in ("sigma_counts", "relative")
        )
        # Synchronous detection adds noise to that of a plain mean.
        detected = np.pi / np.sqrt(8)
        assert abs(sigma.value * detected - NOISE) < 4.5 * sigma.std * detected
        assert abs(relative.value - SHARE) < 4.5 * relative.std
        assert lamp.pattern.share < 0.1  # independent
        assert np.abs(lamp.off[:3]).max() < 0.02


def test_places_are_found_within_their_errors(lamps):
    room = room_of(12, 2)
    errors, stds = np.moveaxis(positions(room, lamps), 1, 0)
    assert np.isfinite(errors).all()
    squares = ((errors / stds) ** 2).sum(axis=1)
    # Its prior leaves more unknown than is: below the chi-square of 2, and not far below it.
    assert 0.02 < squares.mean() < 2 + 5 * np.sqrt(4 / 12)
    assert np.median(np.linalg.norm(errors, axis=1)) < 0.1


def test_a_virtual_array_has_poses_of_the_readings_it_is_made_of(lamps, monkeypatch):
    monkeypatch.setattr(measured_poses, "CENTRES", 3)
    monkeypatch.setattr(measured_poses, "ABOUT_M", 0.2)
    found = virtual_array(room_of(900, 3), lamps[2], "calibrated", 1)
    assert 5 <= found["centres"] <= 9  # those in the middle of places
    for known in ("open", "attitude", "level"):
        assert found["centres"] == found[known]["answered"]
        assert found[known]["beyond_6_sigma"] == 0
    # A level array tells a shift from a turn.
    assert found["level"]["rms_across_m"] < 0.08
    assert found["level"]["rms_across_m"] < 0.5 * found["open"]["rms_across_m"]


def test_readings_that_share_places_or_patterns_tell_less():
    """Equal weights of the same places are one reading; alike ones count as often."""
    places = np.random.default_rng(5).uniform(-1.5, 1.5, (400, 2))
    truth = 0.5, 0.4
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    together = truth[0] * np.exp(-0.5 * (apart / truth[1]) ** 2)
    np.fill_diagonal(together, 1.0)
    root = np.linalg.cholesky(together)
    draws = (root @ np.random.default_rng(6).standard_normal((400, 30))).T
    found = np.array([pattern_of(places, each) for each in draws])
    error = found.std(axis=0) / np.sqrt(len(found))
    # The mean residual of a run is of the pattern, too: the share is found a little too small.
    assert (np.abs(found.mean(axis=0) - truth) < 5 * error + [0.02, 0.02]).all()


def test_the_error_of_an_array_is_that_of_its_own_readings_where_it_has_some(lamps):
    """Each detector reads one place by itself, then each two places, half each."""
    lamp = lamps[2]._replace(pattern=Pattern(0.0, 0.5))
    pose = np.array([[-HEIGHT_M, 0.3, 0.2, 0.0, 0.0]])
    room = Room(np.zeros(50), np.zeros((50, 2)), np.zeros((50, LAMPS)))
    single = np.eye(25, 50)
    pairs = np.kron(np.eye(25), [[0.5, 0.5]])
    shared = np.zeros((25, 50))
    shared[:, 0] = 1.0
    found = [relative_error(room, lamp, pose, each[None]) for each in (single, pairs, shared)]
    assert found[0] == pytest.approx(1.0)
    assert found[1] == pytest.approx(np.sqrt(0.5))
    # All errors are the same: that of the power, as often as there are detectors.
    design = ForwardModel(scene_of(lamp=lamp.found.scene.settings()["lamp"]))
    light, slopes = design.linearised(pose)
    relative = (slopes[0, :, :3].T / (light[0] - lamp.floor)).T
    along = relative @ np.linalg.lstsq(relative, np.ones(25), rcond=None)[0]
    assert found[2] == pytest.approx(np.sqrt(along @ along / 3))


def test_a_room_is_read_in_counts(tmp_path):
    path = tmp_path / "places_rss.csv"
    path.write_text(
        "# a room\nrun,x,y,a,b,c,d,e\n0,1,2,0.1,0.2,0.3,0.4,9\n5,3,4,0.5,0.6,0.7,0.8,9\n"
    )
    room = read_room(path)
    np.testing.assert_array_equal(room.runs, [0, 5])
    np.testing.assert_array_equal(room.places, [[1, 2], [3, 4]])
    np.testing.assert_allclose(room.readings[1], FULL * np.array([0.5, 0.6, 0.7, 0.8]))
    assert len(room.of((5,)).runs) == 1
    path.write_text("# run,x,y,a,b,c,d\n0,1,2,0.1,0.2,0.3,0.4\n5,3,4,0.5,0.6,0.7,0.8\n")
    np.testing.assert_array_equal(read_room(path).runs, [0, 5])
    for short in ("run,x,y\n0,1,2\n", "0,1,2,0.1,0.2,0.3,0.4\n0,1,2\n"):
        path.write_text(short)
        with pytest.raises(ValueError, match="give run, x, y and the readings of 4 lamps"):
            read_room(path)


def ies(path, intensity):
    angles = np.arange(0, 90.5, 0.5)
    numbers = " ".join(f"{angle:g}" for angle in angles), "0"
    table = " ".join(f"{value:.6g}" for value in 1000 * intensity(angles))
    head = f"IESNA:LM-63-2002\nTILT=NONE\n1 -1 1 {len(angles)} 1 1 2 0 0 0\n1 1 10\n"
    path.write_text(head + "\n".join([*numbers, table, ""]))


@pytest.mark.parametrize(("power", "refused"), [(3.0, True), (2.5, False)])
def test_places_that_follow_an_edge_that_is_no_gaussians_are_refused(power, refused, tmp_path):
    """Of a steep edge three Gaussians leave 6 of 1000, and of a softer one 1."""

    def beam(angle):
        edge = np.exp(-np.log(2) * (angle / 8) ** power)
        return 0.92 * edge + 0.08 * np.exp(-0.5 * (angle / 18) ** 2)

    ies(tmp_path / "lamp.ies", beam)
    lamp = read(tmp_path / "lamp.ies")
    scene = scene_of_beam(fitted(lamp).settings())
    rng, std = np.random.default_rng(1), np.array([0.1, 0.1, 0.1, *np.radians([2, 2])])
    places, images = MeasuredLamp(lamp, ForwardModel(scene)).lit(150, rng)
    assert not calibrate(scene, images, places).refusal
    errors = std * rng.standard_normal(places.shape)
    told = calibrate(scene, images, places + errors, pose_std=std).refusal
    assert ("nearer to the beam's axis" in told and "diffuser" in told) == refused


def narrow(angle):
    """Return the beam of a narrow lamp, which is no Gaussian."""
    parts = (2.7, -0.35), (3.6, 0.91), (7.2, 0.44)
    return sum(weight * np.exp(-0.5 * (angle / sigma) ** 2) for sigma, weight in parts)


@pytest.mark.parametrize("gaussian", [True, False])
def test_by_poor_places_a_narrow_lamp_is_its_file_and_no_gaussian(tmp_path, gaussian):
    """These take up all but 2.5 times the noise of what one Gaussian is not.

    The fit by the file begins so far off that all is taken for the shape of the beam at first.
    """
    ies(tmp_path / "lamp.ies", narrow)
    lamp = read(tmp_path / "lamp.ies")
    half = np.interp(-0.5, -narrow(angles := np.linspace(0, 20, 2001)), angles)
    one = {"beam_sigma_deg": half / np.sqrt(2 * np.log(2))}
    scene = scene_of_beam(one if gaussian else fitted(lamp).settings())
    rng, std = np.random.default_rng(1), np.array([0.1, 0.1, 0.1, *np.radians([2, 2])])
    places, images = MeasuredLamp(lamp, ForwardModel(scene)).lit(150, rng)
    errors = std * rng.standard_normal(places.shape)
    told = calibrate(scene, images, places + errors, pose_std=std)
    if gaussian:
        assert told.misfit < 3  # within what is called noise
        assert "farther from the beam's axis" in told.refusal
        assert "lamp.photometry" in told.refusal
    else:
        assert told.misfit == pytest.approx(1, abs=0.1)
        assert told.refusal == ""


def test_a_lamp_is_tried_by_a_gaussian_and_by_its_file(tmp_path, monkeypatch):
    """A beam of two Gaussians: its file is explained, one Gaussian is off as it is by scipy."""
    # A misfit of 2,500 readings is known to 0.03.
    monkeypatch.setattr(measured_lamps, "DRIVE_IMAGES", 100)

    def beam(angle):
        return 0.7 * np.exp(-0.5 * (angle / 6) ** 2) + 0.3 * np.exp(-0.5 * (angle / 16) ** 2)

    ies(tmp_path / "lamp.ies", beam)
    found = json_of(run, "study", "measured", tmp_path, "--poses", "20")
    (lamp,) = found["lamps"]
    assert lamp["file_rms"] < 0.3
    half = lamp["half_width_deg"]
    assert beam(half) == pytest.approx(0.5, abs=2e-3)
    # The best Gaussian by a search of our own, weighted by the solid angle.
    angles = np.linspace(0, 2.2 * half, 2000)
    weight = np.sin(np.radians(angles)) / np.sin(np.radians(angles)).sum()
    sigmas = np.linspace(3, 20, 400)[:, None]
    shapes = np.exp(-0.5 * (angles / sigmas) ** 2)
    scale = (weight * shapes * beam(angles)).sum(1) / (weight * shapes**2).sum(1)
    off = (weight * (scale[:, None] * shapes - beam(angles)) ** 2).sum(1)
    assert lamp["gaussian_rms"] == pytest.approx(1000 * np.sqrt(off.min()), rel=0.02)
    ours = lamp["scenes"]["its file"]
    for known in ("calibrated, exact", "0.1 m, 2 deg"):
        assert not ours[known]["refusal"]
        assert ours[known]["misfit"] < 1.2
        assert ours[known]["answered"] == 20
    exact = lamp["scenes"]["one Gaussian"]["calibrated, exact"]
    assert exact["misfit"] > 2
    assert "beam" in exact["refusal"]


def test_a_folder_without_light_is_refused(tmp_path):
    told = run("study", "measured", tmp_path, code=2)
    assert "it has no .ies or .ldt file and no places_rss.csv" in told
    told = run("study", "measured", tmp_path / "no", code=2)
    assert "no such folder; name one of measured light" in told


def test_a_room_is_reported(lamps):
    of = {"answered": 3, "beyond_6_sigma": 0, "nees_mean": 1.5, "rms_range_m": 0.1}
    of |= {"rms_across_m": 0.2, "rms_angle_deg": 3.0}
    lamp = {"place_m": [1.0, 2.0], "floor_counts": 3.0, "sigma_deg": 50.0, "noise_counts": 7.0}
    lamp |= {"noise_share": 0.02, "residuals": [0.0, 0.01, -0.01, 0.02]}
    lamp |= {"pattern": {"share": 0.3, "length_m": 0.4}}
    places = {"places": 5, "answered": 4, "beyond_6_sigma": 1, "nees_mean": 1.2}
    places |= {"median_m": 0.15, "p95_m": 0.4}
    array = {"lamp": 0, "known": "calibrated", "centres": 4}
    array |= {"open": of, "attitude": of, "level": of}
    text = report_room({"lamps": [lamp], "places": {"clear": places}, "arrays": [array]})
    assert re.search("clear +4 of 5 +1 +1.2 of 2 +0.15 +0.4\n", text)
    assert re.search("0 +calibrated +3 of 4 +0 +1.5 of 5 +0.1 +0.2 +3\n", text)
    assert re.search("0 +calibrated, to 2 deg +3 of 4 +0 +1.5 of 5 +0.1 +0.2 +3\n", text)
    assert re.search("0 +calibrated, level +3 of 4 +0 +1.5 of 3 +0.1 +0.2 +-$", text)


def test_the_waters_that_priors_cover_are_as_the_page_has_them():
    """Three standard deviations of each set of values, about the sea of each scene."""
    page = (ROOT / "docs/results/measured.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| (.*) \|$", page, re.MULTILINE)
    assert rows[0][0] == "blue_ocean"
    for name, cells in rows:
        sea = load_scene(name).effects["sea"]
        a, b = sea["absorption_per_m"], sea["scattering_per_m"]
        wanted = [[a], [b]]
        for known in ("calibrated", "as_bought"):
            wide = 3 * PRIORS[known]["absorption_std_per_m"]
            factor = np.exp(3 * PRIORS[known]["scattering_std"])
            wanted += [[max(a - wide, 0.0), a + wide], [b / factor, b * factor]]
        found = [[float(x) for x in cell.split(" to ")] for cell in cells.split(" | ")]
        for given, expected in zip(found, wanted, strict=True):
            assert given == pytest.approx(expected, rel=0.06, abs=5e-4), name
