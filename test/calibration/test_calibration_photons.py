"""Calibration on photons: images that share no law with what is fitted."""

import numpy as np
import pytest
from calibrated_seas import AIMS, TURNED, drive, named, seen

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.core.geometry import turned_about_beam
from uuv_optical_array.forward.effects.waters import PETZOLD_PER_M
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.studies.photon_transport import Lamp, shipped_pencil


@pytest.mark.parametrize("water", ["clear", "coastal"])
def test_photons_tell_their_water_and_where_lamp_and_array_point(water):
    scene, rng = load_scene("follow"), np.random.default_rng(3)
    poses, _ = drive(rng, 100)
    views, rolls = seen(poses, np.zeros(100), TURNED, scene.array.bow_m)
    # Photons take no roll: what rolls is turned about the beam until it is level.
    views = [turned_about_beam(view, -roll) for view, roll in zip(views, rolls, strict=True)]
    model = ForwardModel(scene)
    lamp = Lamp(shipped_pencil(water), np.radians(7.5))
    light = lamp.images(model, np.array(views))
    images = 700 / lamp.images(model, np.array([[-4.0, 0, 0, 0, 0]])).max() * light + 10
    images = np.clip(np.round(images + rng.normal(size=images.shape)), 0, 1023)
    found = calibrate(scene, images, poses)
    parameters = named(found)
    absorption, scattering = PETZOLD_PER_M[f"petzold_{water}"]
    for name, true, error in (
        ("sea.absorption_per_m", absorption, 0.003),
        ("sea.scattering_per_m", scattering, 0.025),
        ("lamp.beam_sigma_deg", 7.5, 0.03),
        ("field_of_view.cosine_power", 1.0, 0.005),
        ("array.radius_m", 0.32, 0.001),
        *((name, aim, 0.002) for name, aim in zip(AIMS, TURNED, strict=True)),
    ):
        assert parameters[name].value == pytest.approx(true, abs=error), name
    assert found.misfit < 1.15
    assert [note[:9] for note in found.notes] == ["the lamp ", "the array"]
