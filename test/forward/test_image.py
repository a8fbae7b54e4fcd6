"""From pose to reading: the lamp's power, the limits of the electronics and the noise."""

import numpy as np
import pytest
from scenes import make_scene

from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.forward.model import ForwardModel

ASIDE = [-5.0, 0.2, -0.1, 0.05, 0.1]


def make_model(array="curved", reference=(900.0, 4.0), **effects):
    shape, _, even = array.partition(", ")
    counts, range_m = reference
    lamp = {"reference_counts": counts, "reference_range_m": range_m}
    return ForwardModel(make_scene(shape, 4 if even else 5, effects, **lamp))


def test_the_lamp_does_not_know_the_limits_of_the_electronics():
    # Half a metre away even a lamp of unit power is above the lowest saturation level.
    near = (900.0, 0.9)
    low = make_model("planar", near, saturation={"level_counts": 1.0})
    assert low.power == make_model("planar", near).power == pytest.approx(900 * 0.5**2)


@pytest.mark.parametrize("range_m", [0.1, 0.3])
def test_a_reference_with_the_lamp_behind_the_array_is_refused(range_m):
    with pytest.raises(ValueError, match="reference_range_m") as refusal:
        make_model("planar", (900.0, range_m))
    assert f"{range_m} m gives the aligned array no light" in str(refusal.value)
    assert "give a range" in str(refusal.value)


def test_the_expected_image_is_the_light_within_the_electronics_limits():
    model = make_model(saturation={"level_counts": 500.0}, adc={"bits": 4})
    light = model.light([-3.0, 0, 0, 0, 0])
    assert light.max() > 500 > light.min()
    expected = [[min(value, 500.0) for value in row] for row in light]
    np.testing.assert_array_equal(model.expected([-3.0, 0, 0, 0, 0]), expected)


@pytest.mark.parametrize(
    ("level", "largest"),
    [(2000.0, 1023), (700.4, 700), (100.5, 100), (101.5, 102), (102.3, 102)],
)
def test_every_reading_is_a_whole_count_from_zero_to_the_lower_limit(level, largest):
    model = make_model(
        sensor_noise={"sigma_counts": 300.0}, saturation={"level_counts": level}, adc={"bits": 10}
    )
    readings = model.expose(np.broadcast_to(ASIDE, (200, 5)), np.random.default_rng(14))
    np.testing.assert_array_equal(readings, np.round(readings))
    assert (readings.min(), readings.max()) == (0, largest)
    assert model.noise.high == largest


def test_a_known_roll_reaches_light_expected_image_and_readings_alike():
    model = make_model("planar")
    pose, quarter = [-5.0, 0.4, 0, 0, 0], np.pi / 2
    # Starboard goes down, so the spot at starboard ends at the top: anticlockwise.
    rolled = model.light(pose, quarter)
    np.testing.assert_allclose(rolled, np.rot90(model.light(pose)), rtol=1e-12)
    np.testing.assert_array_equal(model.expected(pose, quarter), rolled)
    np.testing.assert_array_equal(model.expose(pose, None, quarter), rolled)


@pytest.mark.parametrize(
    "name", ["sea.absorption_per_m", "responsivity.temperature_c", "lamp.colour"]
)
def test_a_nuisance_that_the_scene_does_not_have_is_refused(name):
    for call in (make_model().linearised, make_model().light):
        with pytest.raises(ValueError, match=f"{name}: not a nuisance of scene"):
            call(ASIDE, 0.0, {name: np.zeros(())})


# Of a degree of freedom: its place in the pose, a move, the axis of the image that the spot moves
# along, and its sign. Row 0 is the top and column 0 the port edge, seen from behind the array.
MOVES = {
    "y": (1, 0.5, 0, +1),  # follower to port: spot to starboard, in a higher column
    "z": (2, 0.5, 1, +1),  # follower above: spot lower, in a higher row
    "yaw": (4, np.radians(15), 0, +1),  # bow to port: spot to starboard
    "pitch": (3, np.radians(15), 1, -1),  # bow down: spot higher, towards row 0
}


@pytest.mark.parametrize("array", ["planar", "curved, even"])
@pytest.mark.parametrize("dof", MOVES)
def test_centroid_and_peak_move_along_one_image_axis_only(array, dof):
    model, (index, amount, along, sign) = make_model(array), MOVES[dof]
    offsets = np.arange(model.array.side) - (model.array.side - 1) / 2
    images = [model.light([-6, 0, 0, 0, 0] + way * amount * np.eye(5)[index]) for way in (1, -1)]

    def centroid(image):
        return image.sum(axis=0) @ offsets / image.sum(), image.sum(axis=1) @ offsets / image.sum()

    def peak(image):
        return key_parameters(image, 900.0, "subdetector")[1:3]

    for where in (centroid, peak):
        plus, minus = map(where, images)
        assert sign * plus[along] > 1e-3
        assert minus[along] == pytest.approx(-plus[along], rel=1e-9), "mirrored pose"
        assert plus[1 - along] == pytest.approx(0, abs=1e-9), "no other axis"
