"""``uuv_array scenes``: what it lists is there, and what it explains is as declared."""

import functools

import command_line
import numpy as np
import pytest
from scenes import READY, changed

from uuv_optical_array.commands import scenes as command
from uuv_optical_array.commands.limits import REACH_M, reach
from uuv_optical_array.core.geometry import IN_DEGREES
from uuv_optical_array.core.settings import declared
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.forward.scene_files import scene_file, sentence

told = functools.partial(command_line.text_of, command_line.run, "scenes")


def test_every_ready_scene_is_listed_with_its_sentence_and_figures():
    blocks = told().replace("\n  ", "\t").splitlines()
    assert [block.partition("\t")[0] for block in blocks] == READY
    for block in blocks:
        name, words, *figures = block.split("\t")
        assert words == sentence(scene_file(name))
        assert len(figures) == 3
    text = "\n".join(blocks)
    assert "curved 21 x 21, 1000 of 1023 counts at 4 m, beam 4.5 deg, K 0.1 /m" in text
    assert "900 counts by 3 lamps, each of 702.5, at 4 m" in text  # not 900 of 702.5
    # A scene for 4 to 8 m says of what its shorter reach is.
    near, far = reach(load_scene("follow"))
    assert f"reach within 0.2 m and 10 deg: {near:.1f} to {far:.1f} m, table to 8.3 m" in text
    assert "known exactly except lamp_power_std, k_std_per_m" in text
    assert "known calibrated except shade_probability, shade_depth" in text
    assert "effects: none" in text


@pytest.mark.parametrize("name", ["reference", "clear_ocean"])
def test_reach_is_where_the_bound_of_each_aligned_pose_meets_the_specification(name):
    scene = load_scene(name)
    model = ForwardModel(scene)

    def meets(range_m):
        bound = cramer_rao_bound(model, [-range_m, 0, 0, 0, 0]).std * IN_DEGREES
        return max(bound[:3]) <= 0.2 and max(bound[3:]) <= 10

    near, far = reach(scene)
    assert near < scene.lamp.reference_range_m < far
    assert [meets(x) for x in (near - 0.1, near, far, far + 0.1)] == [False, True, True, False]
    assert all(meets(x) for x in np.arange(near, far, 0.5))


def test_reach_is_nowhere_in_the_dark_and_endless_without_noise():
    dark = changed("reference", lamp={"reference_counts": 1.0})
    assert reach(dark) is None
    assert "reach within 0.2 m and 10 deg: nowhere" in command.figures(dark)[1]
    assert reach(load_scene("ideal"))[1] == REACH_M[-1]


def test_a_scene_is_printed_as_a_file_that_makes_the_same_scene(tmp_path):
    text = told("night_plume")
    assert text.splitlines()[1] == "# night_plume extends coastal, which extends follow."
    (tmp_path / "night_plume.yaml").write_text(text, encoding="utf-8")
    assert load_scene(tmp_path / "night_plume.yaml") == load_scene("night_plume")
    own = tmp_path / "own.yaml"
    own.write_text("extends: night_plume.yaml\nlamp: {beam_sigma_deg: 9.0}\n", encoding="utf-8")
    assert told(own).startswith("# own extends night_plume.yaml.\n\nlamp:\n  beam_sigma_deg: 9.0\n")


def test_every_key_is_explained_by_its_bounds_and_default():
    for owner, declares in command.OWNERS.items():
        found = "\n".join(command.explanation(owner))
        for key, setting in declared(declares).items():
            name = f"{owner}.{key}"
            lines = "\n".join(command.explanation(name)).splitlines()
            assert lines[0] == f"{name}: {setting.quantity.text}".removesuffix(": ")
            words = " or ".join(setting.choices) or setting.quantity.bounds()
            words = "a text" if setting.kind is str else words
            assert lines[1].startswith(f"  {words}")
            assert ("must be given" in lines[1]) == setting.required
            assert f"{lines[0]}\n{lines[1]}\n" in f"{found}\n", "the group has it, too"


def test_a_key_an_effect_and_a_group_are_found_by_their_short_names():
    assert told("lamp.beam_sigma_deg").splitlines()[:2] == [
        "lamp.beam_sigma_deg: standard deviation of a Gaussian beam, unless photometry gives it",
        "  from 0.1 to 90 deg; must be given",
    ]
    assert told("plume") == told("effects.plume")
    assert told("x_m").count("default [-8.3, -3.7, 13]") == 1
    seeds = [line.partition(":")[0] for line in told("seed").splitlines() if ".seed:" in line]
    assert seeds == [f"effects.{name}.seed" for name in ("lamp_drift", "plume", "responsivity")]
    assert "Eren et al. (2017)" in told("drift_per_c"), "source"
    assert "exp(-K r)` (Eren et al. 2016, eq. 5)" in told("effects"), "law and source"


def test_a_beam_is_drawn_beside_its_photometric_file(tmp_path):
    angles = np.arange(0.0, 90.5, 0.5)
    row = 0.4 * np.exp(-0.5 * (angles / 5) ** 2) + 0.6 * np.exp(-0.5 * (angles / 14) ** 2)
    numbers = ["1 -1 1 181 1 1 2 0 0 0", "1 1 9", *map(str, angles), "0", *map(str, 500 * row)]
    (tmp_path / "lamp.ies").write_text("\n".join(["IESNA91", "TILT=NONE", *numbers]))
    scene, picture = tmp_path / "sea.yaml", tmp_path / "beam.svg"
    scene.write_text("extends: follow\nlamp: {beam_sigma_deg: null, photometry: lamp.ies}\n")
    lines = told(scene, "--output", picture).splitlines()
    assert lines[-1] == f"picture: {picture}"
    file, beam = ([float(x) for x in line.split(":")[1].split(",")] for line in lines[2:4])
    shown = [float(x) for x in lines[1].split(":")[1].split(",")]
    np.testing.assert_allclose(file, 1000 * np.interp(shown, angles, row), atol=4)
    np.testing.assert_allclose(beam, file, atol=3)
    assert picture.read_text(encoding="utf-8").count("planes of the file") == 1
    for words, named in ((["follow"], "follow"), ([], "no scene")):
        error = command_line.run("scenes", *words, "--output", picture, code=2)
        assert f"{named} names no lamp.photometry; give a scene" in error
