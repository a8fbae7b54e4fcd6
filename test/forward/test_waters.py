"""The water types: K against a library with the same source, and against another table of it."""

import math
from typing import get_args

import numpy as np
import pytest

from uuv_optical_array.forward.effects.waters import Water, diffuse_attenuation


def test_every_type_of_jerlov_is_that_of_a_library_from_blue_to_red():
    jerlov = pytest.importorskip("jerlov", reason="needs the package jerlov, of the extra test")
    wavelengths_nm = np.arange(400, 701)
    types = [water for water in get_args(Water) if not water.startswith("eren2016")]
    assert len(types) == 10
    for water in types:
        ours = [diffuse_attenuation(water, wavelength_nm) for wavelength_nm in wavelengths_nm]
        theirs = jerlov.water(water.partition("_")[2].upper(), source="jerlov1976")
        # Between the wavelengths of Jerlov's table theirs are rounded to 1e-4 /m.
        np.testing.assert_allclose(ours, theirs.kd(wavelengths_nm), rtol=1e-12, atol=5.01e-5)


def test_the_transmittance_per_metre_is_what_jerlov_gives_too():
    # His table of transmittance, in % per metre at 525 nm: 96.1 (I), 88.5 (1C), 61 (7C), 46 (9C).
    for water, percent in (
        ("oceanic_i", 96.1),
        ("coastal_1c", 88.5),
        ("coastal_7c", 61.0),
        ("coastal_9c", 46.0),
    ):
        # Both are rounded: he gives Kd to two digits.
        found = 100 * math.exp(-diffuse_attenuation(water, 525.0))
        assert found == pytest.approx(percent, abs=1.0)
