"""Arrays become messages and back, and a message that must not be used is refused by its kind."""

import contextlib
import functools
import itertools
import math
import struct

import numpy as np
import pytest
from geometry_msgs.msg import (
    PoseWithCovarianceStamped,
    Quaternion,
    TransformStamped,
    TwistStamped,
)
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from nav_msgs.msg import Odometry
from odometries import odometry, time_of
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image, Imu, PointCloud2, PointField, Range
from std_msgs.msg import Header

from uuv_optical_array.core.messages import (
    Refused,
    image_from_message,
    odometry_pose,
    stamp_ns,
    twist_from_message,
    up_of_odometry,
)
from uuv_optical_array.forward.array import ArraySettings
from uuv_optical_array.nodes.shared.messages import (
    StampOrder,
    covariance_from_message,
    features_from_message,
    features_to_message,
    image_to_message,
    imu_roll,
    not_finite,
    pose_from_message,
    range_from_message,
    range_to_message,
)

SIDE = 5
ARRAY = ArraySettings("planar", SIDE)
COUNTS = np.arange(SIDE * SIDE, dtype=float).reshape(SIDE, SIDE) * 2621
NAMES = ["peak", "column", "row", "skewness_horizontal", "skewness_vertical"]
finite = st.floats(allow_nan=False, allow_infinity=False)
BAD_NUMBERS = [np.nan, np.inf, -np.inf]


def header(seconds=3, nanoseconds=4):
    message = Header(frame_id="array")
    message.stamp.sec, message.stamp.nanosec = seconds, nanoseconds
    return message


@given(arrays(np.uint16, (SIDE, SIDE)))
def test_an_image_survives_the_message_and_lies_in_it_row_by_row(counts):
    message = image_to_message(counts.astype(float), header())
    assert message.header == header()
    assert (message.encoding, message.height, message.width) == ("mono16", SIDE, SIDE)
    assert (message.step, message.is_bigendian) == (2 * SIDE, 0)
    assert struct.unpack("<25H", bytes(message.data)) == tuple(counts.ravel())
    np.testing.assert_array_equal(image_from_message(message, ARRAY), counts)


@pytest.mark.parametrize(
    ("order", "is_bigendian", "padding", "encoding"), [(">", 1, 6, "mono16"), ("<", 0, 2, "16UC1")]
)
def test_an_image_of_any_byte_order_and_padding_is_read(order, is_bigendian, padding, encoding):
    message = image_to_message(COUNTS, header())
    rows = [struct.pack(f"{order}5H", *row.astype(int)) + b"\xff" * padding for row in COUNTS]
    message.data, message.step = b"".join(rows), 2 * SIDE + padding
    message.is_bigendian, message.encoding = is_bigendian, encoding
    np.testing.assert_array_equal(image_from_message(message, ARRAY), COUNTS)


@given(arrays(float, 5, elements=finite))
def test_key_parameters_survive_the_cloud_to_the_last_bit(parameters):
    message = features_to_message(parameters, header())
    assert message.header == header()
    assert struct.unpack("<5d", bytes(message.data)) == tuple(parameters)
    np.testing.assert_array_equal(features_from_message(message), parameters)


def test_the_cloud_is_one_point_that_other_readers_of_clouds_understand():
    message = features_to_message(np.arange(1.0, 6.0), header())
    fields = [(field.name, field.offset, field.datatype, field.count) for field in message.fields]
    assert fields == [(name, 8 * i, PointField.FLOAT64, 1) for i, name in enumerate(NAMES)]
    assert (message.height, message.width) == (1, 1)
    assert (message.point_step, message.row_step, len(message.data)) == (40, 40, 40)
    assert not message.is_bigendian
    message.data, message.is_bigendian = struct.pack(">5d", 1, 2, 3, 4, 5), True
    np.testing.assert_array_equal(features_from_message(message), [1, 2, 3, 4, 5])


def test_no_light_is_a_cloud_without_a_point():
    message = features_to_message(None, header())
    assert (message.width * message.height, len(message.data)) == (0, 0)
    assert [field.name for field in message.fields] == NAMES
    assert features_from_message(message) is None


def field(i, **changes):
    values = {"name": NAMES[i], "offset": 8 * i, "datatype": PointField.FLOAT64, "count": 1}
    return PointField(**{**values, **changes})


def put(message, changes):
    """Set fields of a message by their paths, such as ``pose.covariance.8``; return it."""
    for path, value in changes.items():
        *groups, last = path.split(".")
        inner = functools.reduce(getattr, groups, message)
        if last.isdigit():
            inner[int(last)] = value
        else:
            setattr(inner, last, value)
    return message


def placed(kind, position=(1.0, 2.0, 3.0), quaternion=(0.0, 0.0, 0.0, 1.0)):
    pose = {f"position.{axis}": value for axis, value in zip("xyz", position, strict=True)}
    pose |= {f"orientation.{axis}": value for axis, value in zip("xyzw", quaternion, strict=True)}
    return put(kind(), {f"pose.pose.{path}": float(value) for path, value in pose.items()})


# What is read, by a message that is good and its reader.
READ = {
    "image": (lambda: image_to_message(COUNTS, header()), lambda m: image_from_message(m, ARRAY)),
    "cloud": (lambda: features_to_message(np.arange(1.0, 6.0), header()), features_from_message),
    "pose": (lambda: placed(PoseWithCovarianceStamped), pose_from_message),
    "odometry": (lambda: placed(Odometry), odometry_pose),
    "covariance": (PoseWithCovarianceStamped, covariance_from_message),
    "twist": (TwistStamped, twist_from_message),
    "roll": (lambda: Imu(orientation=Quaternion(w=1.0)), imu_roll),
    "range": (
        lambda: Range(range=5.0, min_range=0.5, max_range=9.0),
        lambda m: range_from_message(m, 0.2),
    ),
}
FIELDS, QUATERNION = [field(i) for i in range(5)], "pose.pose.orientation"
NO_COMPASS = {"orientation_covariance.8": 1e6}
REFUSED = [
    ("image", {"encoding": "mono8"}, "wrong encoding: .*mono8"),
    ("image", {"height": 4}, "wrong size: .*4 x 5"),
    ("image", {"width": 6}, "wrong size: .*5 x 6"),
    ("image", {"step": 11, "data": b"\0" * 55}, "wrong step: .*11"),
    ("image", {"step": 8, "data": b"\0" * 40}, "wrong step: .*8"),
    *(("image", {"data": b"\0" * count}, f"truncated: .*{count}") for count in (0, 48, 52)),
    ("cloud", {"fields": []}, "wrong fields"),
    ("cloud", {"fields": [FIELDS[i] for i in (0, 2, 1, 3, 4)]}, "wrong fields"),
    ("cloud", {"fields": [*FIELDS[:4], field(4, name="z")]}, "wrong fields"),
    ("cloud", {"fields": [field(i, datatype=7) for i in range(5)]}, "wrong field type"),  # FLOAT32
    ("cloud", {"fields": [field(0, count=2), *FIELDS[1:]]}, "wrong field type"),
    ("cloud", {"fields": [field(i, offset=4 * i) for i in range(5)]}, "wrong field offsets"),
    ("cloud", {"width": 2, "data": b"\0" * 80}, "wrong size"),
    ("cloud", {"data": b"\0" * 39}, "truncated"),
    # No darkness, which has fields.
    ("cloud", {"fields": [], "height": 0, "width": 0, "data": b""}, "wrong fields"),
    ("roll", {"orientation_covariance.0": -1.0}, "no orientation"),
    ("twist", {"twist.angular.y": -6.1}, r"out of bounds: twist .*-6\.1.*10 m/s and \+-6 rad"),
]
for far in (0.4, 9.1, -5.0):
    REFUSED.append(("range", {"range": far}, f"out of bounds: the range of {far:g} m, .* 0.5 to 9"))
for variance in (-0.1, *BAD_NUMBERS) if hasattr(Range, "variance") else ():
    REFUSED.append(("range", {"variance": variance}, "out of bounds: the range's variance of"))
for variance in (1.1e12, -1e308):
    change = {"pose.covariance.8": variance}
    REFUSED.append(("covariance", change, "out of bounds: the pose's covariance"))
for i, variance in ((0, 1e10), (0, np.nan), (0, np.inf), (4, -0.1), (8, np.nan)):
    change = {**NO_COMPASS, f"orientation_covariance.{i}": variance}
    REFUSED.append(("roll", change, "out of bounds: variances of the"))
for kind in ("pose", "odometry"):
    far = r"out of bounds: position \[1.0, 1e\+308, 3.0\].*1e\+08"
    REFUSED.append((kind, {"pose.pose.position.y": 1e308}, far))
    for x, w in ((0.0, 0.0), (0.0, 2.0), (0.5, 0.5)):
        REFUSED.append((kind, {f"{QUATERNION}.x": x, f"{QUATERNION}.w": w}, "bad attitude"))
for bad in BAD_NUMBERS:
    REFUSED.append(("range", {"range": bad}, "not finite: the range is"))
    REFUSED.append(("cloud", {"data": struct.pack("<5d", 1, 2, bad, 4, 5)}, "not finite"))
    REFUSED.append(("covariance", {"pose.covariance.8": bad}, "not finite: the pose's covariance"))
    for kind, axis in itertools.product(("pose", "odometry"), "xyz"):
        REFUSED.append((kind, {f"pose.pose.position.{axis}": bad}, "not finite: position"))
        REFUSED.append((kind, {f"{QUATERNION}.{axis}": bad}, "bad attitude"))
    for part, axis in itertools.product(("linear", "angular"), "xyz"):
        REFUSED.append(("twist", {f"twist.{part}.{axis}": bad}, "not finite: twist"))


@pytest.mark.parametrize(("kind", "changes", "words"), REFUSED)
def test_a_message_that_must_not_be_used_is_refused_by_its_kind(kind, changes, words):
    good, read = READ[kind]
    read(good())
    with pytest.raises(Refused, match=f"^{words}"):
        read(put(good(), changes))


def test_what_is_at_its_bound_is_taken():
    for kind, read in ((PoseWithCovarianceStamped, pose_from_message), (Odometry, odometry_pose)):
        read(placed(kind, (1e8, -1e8, 0.0)))
    unknown = put(PoseWithCovarianceStamped(), {"pose.covariance.35": 1e12})  # such as a roll
    assert covariance_from_message(unknown)[5, 5] == 1e12
    assert imu_roll(put(Imu(orientation=Quaternion(w=1.0)), NO_COMPASS)) == 0.0


def test_a_range_has_its_own_variance_or_the_usual_one_and_no_bound_where_none_is_given():
    assert range_from_message(Range(range=5.0), 0.2) == (5.0, 0.2)
    sent = range_to_message(6.25, 0.5, header())
    known = 0.5 if hasattr(Range, "variance") else 0.2
    assert range_from_message(sent, 0.2) == (6.25, known)


def test_an_attitude_off_unit_length_by_less_than_a_hundredth_is_normalised():
    turn = Rotation.from_euler("ZYX", [0.3, -0.2, 0.1]).as_quat()
    for length in (0.991, 1.009):
        _, quaternion = odometry_pose(placed(Odometry, quaternion=length * turn))
        np.testing.assert_allclose(quaternion, turn, atol=1e-15)
    for length in (0.98, 1.02):
        with pytest.raises(Refused, match=r"^bad attitude: .* has length"):
            odometry_pose(placed(Odometry, quaternion=length * turn))


def test_a_stamp_counts_nanoseconds_without_rounding():
    assert stamp_ns(header(1_700_000_000, 999_999_999)) == 1_700_000_000_999_999_999


# What leaves a node: finite numbers, and stamps that never run backwards.
@pytest.mark.parametrize("bad", BAD_NUMBERS)
@pytest.mark.parametrize(
    ("message_type", "path"),
    [
        (PoseWithCovarianceStamped, "pose.pose.position.z"),
        (PoseWithCovarianceStamped, "pose.pose.orientation.w"),
        (PoseWithCovarianceStamped, "pose.covariance"),
        (TwistStamped, "twist.angular.x"),
        (TransformStamped, "transform.translation.y"),
        (Odometry, "pose.pose.position.x"),
        (Odometry, "twist.covariance"),
    ],
)
def test_a_number_that_is_not_finite_is_found_wherever_it_is(message_type, path, bad):
    assert not_finite(message_type()) == ""
    place = f"{path}.35" if path.endswith("covariance") else path
    assert not_finite(put(message_type(), {place: bad})) == path


def test_a_key_parameter_that_is_not_finite_is_found_and_images_and_empty_clouds_pass():
    assert not_finite(features_to_message(np.array([1, 2, np.nan, 4, 5]), Header())) == "data"
    assert not_finite(features_to_message(np.arange(5.0), Header())) == ""
    assert not_finite(features_to_message(None, Header())) == ""
    assert not_finite(PointCloud2()) == ""
    assert not_finite(Image(data=b"\xff" * 8)) == ""


def test_a_frame_within_a_list_is_looked_into_too():
    tf2_msgs = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not installed")
    message = tf2_msgs.TFMessage(transforms=[TransformStamped(), TransformStamped()])
    message.transforms[1].transform.rotation.z = np.nan
    assert not_finite(message) == "transforms.transform.rotation.z"


def passed(stamps, clock=None):
    """Return those of the stamps, ns, that are let through while a clock shows other times."""
    order, through = StampOrder(), []
    for stamp, now in zip(stamps, clock or itertools.repeat(math.inf), strict=False):
        with contextlib.suppress(Refused):
            order.check(Header(stamp=time_of(stamp)), now)
            through.append(stamp)
    return through


@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        ([10.0, 9.8, 9.9, 10.1], [10.0, 10.1]),
        ([10.0, 9.5, 9.6, 9.7, 9.9, 10.0, 10.1], [10.0, 10.1]),
        ([10.0, 9.3, 9.4, 9.5], [10.0, 9.4, 9.5]),
        ([10.0, 8.0, 10.1, 8.1, 10.2], [10.0, 10.1, 10.2]),
        ([10.0, 8.0, 8.1, 8.2], [10.0, 8.1, 8.2]),
        ([10.0, 8.0, 7.9, 8.0], [10.0, 8.0]),
        ([10.0, 8.0, 8.0], [10.0]),
        ([10.0, 900.0, 10.1, 10.2, 10.3], [10.0, 900.0, 10.2, 10.3]),
    ],
)
def test_late_stamps_are_dropped_and_a_clock_that_was_set_back_starts_anew(stamps, expected):
    assert passed([round(1e9 * s) for s in stamps]) == [round(1e9 * s) for s in expected]


@pytest.mark.parametrize("seconds", [0, 12])
def test_only_of_stamps_that_are_alike_it_is_said_that_the_driver_gives_none(seconds):
    order, words = StampOrder(), "the driver gives none: let it set `header.stamp`"
    for stamp in (seconds, seconds + 1):
        order.check(header(stamp, 0))
        with pytest.raises(Refused, match=f"stamp not later: .*{words}"):
            order.check(header(stamp, 0))
    with pytest.raises(Refused, match=r"stamp not later: \d+\.0+ s came after \d+\.0+ s$"):
        order.check(header(seconds, 0))
    order.check(header(20, 0), 20 * 10**9)
    with pytest.raises(Refused, match=r"^stamp ahead: 0\.9 s later than the clock$"):
        order.check(header(21, 900_000_000), 21 * 10**9)


@pytest.mark.parametrize(
    ("ahead_s", "expected"),
    [
        ([0.0, 0.9, 0.0, 0.0, 0.29], [0, 2, 3, 4]),
        ([0.9, 0.9, 0.4], [0, 1, 2]),
        ([0.0, 0.9, 0.9, 0.9, 0.0, 0.5], [0, 2, 3, 4]),
    ],
)
def test_one_stamp_ahead_of_the_clock_is_dropped_and_a_clock_that_is_always_ahead_is_believed(
    ahead_s, expected
):
    clock = [(100 + i) * 10**9 for i in range(len(ahead_s))]
    stamps = [now + round(1e9 * ahead) for now, ahead in zip(clock, ahead_s, strict=True)]
    assert passed(stamps, clock) == [stamps[i] for i in expected]


def test_a_late_stamp_may_still_be_of_use_and_a_repeated_one_or_a_stray_is_not():
    order, now = StampOrder(), 100 * 10**9
    for seconds, words in ((99, ""), (98, ""), (99, "stamp not later"), (109, "stamp ahead")):
        with pytest.raises(Refused, match=words) if words else contextlib.nullcontext():
            order.check_fresh(header(seconds, 0), now)
        if not words and seconds == 99:
            order.check(header(seconds, 0))
    # Once all are ahead of it, the clock is what is wrong, whatever is checked beside.
    for seconds in (110, 111):
        order.check_fresh(header(seconds, 0), now)
        order.check(header(seconds, 0))


@given(st.lists(st.integers(0, 4_000_000_000)))
def test_stamps_run_back_only_by_more_than_half_a_second_and_never_twice_at_once(stamps):
    through = passed(stamps)
    for before, after in itertools.pairwise(through):
        assert after > before or before - after > 10**9 // 2


@pytest.mark.parametrize(
    ("frame", "child"),
    [
        ("odom", "base_link"),
        ("map_ned", "base_link_frd"),
        ("odom", "hull_frd"),
        ("map_ned", "hull"),
    ],
)
def test_up_of_an_odometry_is_that_of_its_world_in_the_bodys_axes(frame, child):
    # Half a turn about x is between axes whose z is up and those whose z is down.
    half = Rotation.from_euler("x", np.pi)
    for rotation in Rotation.random(20, rng=np.random.default_rng(3)):
        told = rotation
        if frame.endswith("_ned"):
            told = half * told
        if child.endswith("_frd"):
            told = told * half
        found = up_of_odometry(odometry(0, np.zeros(3), told, frame, child))
        assert found == pytest.approx(rotation.as_matrix()[2], abs=1e-9)


@pytest.mark.parametrize("w", [0.0, 1.0])
def test_an_attitude_that_was_left_out_tells_no_up(w):
    message = odometry(0, np.zeros(3))
    message.pose.pose.orientation.w = w
    assert up_of_odometry(message) is None


def test_an_attitude_that_is_none_is_refused():
    message = odometry(0, np.zeros(3))
    message.pose.pose.orientation.x = 0.5
    with pytest.raises(Refused, match="bad attitude"):
        up_of_odometry(message)
