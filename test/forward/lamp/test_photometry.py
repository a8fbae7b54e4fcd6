"""Photometric files: beams of known Gaussians written as LM-63 and EULUMDAT, and read again."""

import dataclasses
import math

import numpy as np
import pytest
from scenes import ready

from uuv_optical_array.commands.scenes import settings_text
from uuv_optical_array.forward.lamp import photometry
from uuv_optical_array.forward.lamp.beam import gaussians_of, radiance
from uuv_optical_array.forward.lamp.photometric_files import read
from uuv_optical_array.forward.lamp.photometry import fitted
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

ANGLES = np.arange(0, 90.5, 0.5)
HEADS = {
    1986: "A lamp\nof my own\n",
    1991: "IESNA91\n[TEST] none\n",
    1995: "IESNA:LM-63-1995\n[TEST] none\n",
    2002: "IESNA:LM-63-2002\n[TEST] none\n[LAMP] TILT the lamp\n",
    2019: "IES:LM-63-2019\n[TEST] none\n",
}


def beam_of(parts, angles=ANGLES):
    return sum(w * np.exp(-0.5 * (angles / s) ** 2) for s, w in parts)


NARROW = ((4.0, 0.25), (9.0, 0.5), (20.0, 0.25))  # sigma, deg, and weight
FLAT = ((7.0, -0.22), (11.0, 0.87), (20.0, 0.35))


def ies(planes, rows, year=2002, angles=ANGLES, tilt="NONE", kind=1):
    numbers = [1, -1, 1.0, len(angles), len(planes), kind, 2, 0.1, 0.1, 0, 1, 1, 40]
    lists = [numbers, angles, planes, *(1234.5 * row for row in rows)]
    body = [
        "\n".join(" ".join(f"{x:.6g}" for x in it[i : i + 10]) for i in range(0, len(it), 10))
        for it in map(list, lists)
    ]
    return f"{HEADS[year]}TILT={tilt}\n" + "\n".join(body) + "\n"


def ldt(symmetry, count, rows, angles=ANGLES, comma=False):
    planes = [360 / count * k for k in range(count)]
    head = ["Mine", "1", str(symmetry), str(count), "0", str(len(angles)), "0.5", "", "lamp", "7"]
    head += ["lamp.ldt", "today", "100", "0", "50", "40", "0", "0", "0", "0", "0", "100", "85"]
    head += ["1.0", "0", "2"]
    lamps = ["1", "LED", "900", "4000", "80", "12"] * 2
    numbers = [*[0.5] * 10, *planes, *angles, *(877.0 * np.concatenate(rows))]
    text = "\n".join([*head, *lamps, *(f"{x:.6g}" for x in numbers)]) + "\n"
    return text.replace(".", ",") if comma else text


def written(folder, text, name="lamp.ies"):
    (folder / name).write_text(text, encoding="latin-1")
    return folder / name


@pytest.mark.parametrize("year", HEADS)
def test_a_file_of_any_year_is_read(tmp_path, year):
    found = read(written(tmp_path, ies([0], [beam_of(FLAT)], year)))
    np.testing.assert_array_equal(found.angles_deg, ANGLES)
    np.testing.assert_allclose(found.mean, beam_of(FLAT), rtol=1e-5)


@pytest.mark.parametrize("parts", [NARROW, FLAT])
def test_the_gaussians_of_a_file_are_found(tmp_path, parts):
    beam = fitted(read(written(tmp_path, ies([0], [beam_of(parts)]))))
    assert beam.rms < 1.5
    assert beam.planes_rms < 1e-6
    assert beam.on_axis == pytest.approx(1, abs=5e-3)
    found = radiance(np.array([beam.weights, beam.widths]), ANGLES / beam.sigma_deg)
    within = beam.reach_deg >= ANGLES
    np.testing.assert_allclose(found[within], beam_of(parts)[within], atol=5e-3)
    half = np.interp(-0.5, -beam_of(parts), ANGLES)
    assert beam.sigma_deg == pytest.approx(half / math.sqrt(2 * math.log(2)), rel=1e-3)


@pytest.mark.parametrize("parts", [((6.0, 1.0),), ((6.0, 0.7), (11.0, 0.3))])
def test_there_are_no_more_gaussians_than_the_beam_has(tmp_path, parts):
    beam = fitted(read(written(tmp_path, ies([0], [beam_of(parts)]))))
    np.testing.assert_allclose(beam.weights, [weight for _, weight in parts], atol=2e-3)
    sigmas = np.array(beam.widths) * beam.sigma_deg
    np.testing.assert_allclose(sigmas, [sigma for sigma, _ in parts], rtol=3e-3)
    assert beam.rms < 0.1
    shaped = "beam_weights" in beam.settings()
    assert shaped == (len(parts) > 1)
    assert ("one Gaussian is within" in beam.text()) != shaped


def elliptic(turn_deg):
    """Return a beam whose planes differ; its mean about the axis is a sum of many."""
    return beam_of(((9.0 + 1.0 * math.cos(2 * math.radians(turn_deg)), 0.7), (20.0, 0.3)))


def test_planes_count_by_the_angle_that_they_stand_for(tmp_path):
    turns = np.arange(0, 360, 22.5)
    mean = np.mean([elliptic(turn) for turn in turns], axis=0)
    rows = {count: [elliptic(22.5 * k) for k in range(count)] for count in (5, 9, 16, 17)}
    shifted = [elliptic(90 + 22.5 * k) for k in range(9)]
    files = [
        written(tmp_path, ies(22.5 * np.arange(n), rows[n]), f"{n}.ies") for n in (5, 9, 16, 17)
    ]
    for symmetry, given in ((0, rows[16]), (2, rows[9]), (3, shifted), (4, rows[5])):
        text = ldt(symmetry, 16, given, comma=symmetry == 2)
        files.append(written(tmp_path, text, f"{symmetry}.ldt"))
    files.append(written(tmp_path, ldt(1, 24, [mean]), "1.ldt"))
    for file in files:
        found = read(file)
        np.testing.assert_allclose(found.mean, mean, atol=1e-5, err_msg=file.name)
        np.testing.assert_allclose(found.angles_deg, ANGLES)
    of_some, of_all = (fitted(read(files[i])).planes_rms for i in (0, 3))
    assert of_some == pytest.approx(of_all, rel=0.01)
    assert of_some > 10


def test_lines_of_a_tilt_are_passed_over(tmp_path):
    plain = ies([0], [beam_of(FLAT)])
    tilted = plain.replace("TILT=NONE", "TILT=INCLUDE\n1\n3\n0 45 90\n1.0 0.95 0.9")
    found = read(written(tmp_path, tilted))
    np.testing.assert_allclose(found.mean, read(written(tmp_path, plain, "b.ies")).mean)


def box(angles):
    return np.where(angles < 20, 1.0, np.where(angles < 21, 0.5, 0.01))


ROW = beam_of(FLAT)
BAD = [
    ("lamp.txt", "", r"neither an \.ies \(LM-63\) nor an \.ldt"),
    ("lamp.ies", "IESNA91\n1 2 3\n", "no line TILT="),
    ("lamp.ies", ies([0], [ROW])[:400], "ends before its table"),
    ("lamp.ies", ies([0], [ROW], kind=2), "photometric type B; convert it to type C"),
    ("lamp.ies", ies([0], [ROW]).replace("1 -1", "one -1"), "no number where one should be"),
    ("lamp.ies", ies([0], [ROW], angles=ANGLES + 90), "none on the axis at 0"),
    ("lamp.ies", ies([90, 0], [ROW, ROW]), "planes that do not rise"),
    ("lamp.ies", ies([0], [0.7 + 0.3 * ROW]), "nowhere falls to half"),
    ("lamp.ies", ies([0], [box(ANGLES)]), r"differs by \d+ of 1000 .* 10 are allowed"),
    ("lamp.ldt", ldt(7, 16, [ROW]), "symmetry 7"),
    ("lamp.ldt", ldt(0, 16, [ROW]), "ends before its table"),
]


@pytest.mark.parametrize(("name", "text", "error"), BAD)
def test_what_is_no_such_file_or_no_such_beam_is_refused(tmp_path, name, text, error):
    written(tmp_path, text, name)
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        f"extends: follow\nlamp: {{photometry: {name}, beam_sigma_deg: null}}\n", encoding="utf-8"
    )
    with pytest.raises(ValueError, match=rf"lamp\.photometry: .*{name}: .*{error}"):
        load_scene(scene)


@pytest.fixture
def fitted_once(monkeypatch):
    """Let each beam be fitted once, however often its file is read: that takes a second."""
    known = {}

    def once(file, fit=photometry.fitted):
        content = tuple(np.asarray(part).tobytes() for part in file)
        if content not in known:
            known[content] = fit(file)
        return known[content]

    monkeypatch.setattr(photometry, "fitted", once)


@pytest.mark.usefixtures("fitted_once")
def test_a_scene_takes_the_beam_of_its_file_and_says_so(tmp_path):
    written(tmp_path, ies([0], [ROW]))
    scene = tmp_path / "scene.yaml"
    scene.write_text("extends: follow\nlamp: {photometry: lamp.ies}\n", encoding="utf-8")
    found = load_scene(scene)
    lamp, base = found.lamp, ready("follow").lamp
    assert (lamp.photometry, lamp.reference_counts) == (None, base.reference_counts)
    angles = np.radians([0.0, 6.0, 15.0])
    beam = radiance(gaussians_of(lamp), angles / math.radians(lamp.beam_sigma_deg))
    np.testing.assert_allclose(beam, np.interp(np.degrees(angles), ANGLES, ROW), atol=5e-3)
    assert ForwardModel(found).light([-4.0, 0, 0, 0, 0]).max() == pytest.approx(900, rel=1e-9)
    text = settings_text(str(scene))
    assert "# lamp.photometry lamp.ies: half-width 16.9" in text
    assert "photometry: " not in text.partition("\n\n")[2]
    again = tmp_path / "again.yaml"
    again.write_text(text, encoding="utf-8")
    assert load_scene(again).settings() == found.settings()
    given = "extends: follow\nlamp: {photometry: lamp.ies, beam_sigma_deg: null}\n"
    scene.write_text(given, encoding="utf-8")
    assert load_scene(scene).settings() == found.settings()
    wider = tmp_path / "wider.yaml"
    wider.write_text("extends: scene.yaml\nlamp: {beam_sigma_deg: 9.0}\n", encoding="utf-8")
    assert load_scene(wider).lamp == dataclasses.replace(base, beam_sigma_deg=9.0)
    scene.write_text(given.replace("null", "8.0"), encoding="utf-8")
    with pytest.raises(ValueError, match=r"photometry: given together with beam_sigma_deg"):
        load_scene(scene)
    scene.write_text(given.replace("lamp.ies", "gone.ies"), encoding="utf-8")
    with pytest.raises(ValueError, match=r"gone\.ies"):
        load_scene(scene)
