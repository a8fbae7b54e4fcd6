"""Node parameters, declared once: the descriptor, the check and the documentation follow."""

import re
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar, get_args

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidTopicNameException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.validate_full_topic_name import validate_full_topic_name

from uuv_optical_array.control.vehicles.trajectory import MAX_GAP, MAX_GAP_S
from uuv_optical_array.core.messages import BEACON_FRAME, BEACON_POSITION, Axes
from uuv_optical_array.core.settings import Numbers, Quantity, check, declared, hint
from uuv_optical_array.core.storage.files import shared_file
from uuv_optical_array.nodes.shared.sections import astray

Settings = TypeVar("Settings")
DEFAULTS = "config/follow.yaml"  # lists every parameter of every node, commented out
# What a value that is no number must be, by its type.
WORDS = {bool: "a switch; give true or false", str: "a text; give one, in quotes: \"'...'\""}


@dataclass(frozen=True)
class Parameter:
    """A node parameter; its type is its default's."""

    default: Any  # a bool, int, float, str or list of floats
    quantity: Quantity
    read_only: bool = False  # fixed once the node runs
    choices: tuple[str, ...] = ()  # the words that a str may be; empty for any
    any_length: bool = False  # whether a list may have another length than the default

    def descriptor(self) -> ParameterDescriptor:
        """Return what ``ros2 param describe`` shows."""
        unit = f" [{self.quantity.unit}]" if self.quantity.unit else ""
        descriptor = ParameterDescriptor(
            type=RosParameter.Type.from_parameter_value(self.default).value,
            description=self.quantity.text + unit,
            read_only=self.read_only,
            additional_constraints=" or ".join(self.choices),
        )
        kind, low, high = type(self.default), self.quantity.low, self.quantity.high
        if kind is float:
            span = FloatingPointRange(from_value=float(low), to_value=float(high))
            descriptor.floating_point_range = [span]
        elif kind is int:
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
        elif kind is list:  # for which ROS has no range
            number = "" if self.any_length else f"{len(self.default)} "
            bounds = self.quantity.bounds()
            descriptor.additional_constraints = f"{number}numbers, each {bounds}"
        return descriptor

    def check(self, name: str, value: Any) -> Any:
        """Return a value as its type; ValueError for a wrong type or one out of bounds."""
        kind = type(self.default)
        if self.choices and value not in self.choices:
            raise ValueError(f"{name}: {value!r} is unknown; choose {' or '.join(self.choices)}")
        if kind in WORDS:
            if not isinstance(value, kind):
                raise ValueError(f"{name}: {value!r} is not {WORDS[kind]}")
            return value
        if kind is not list:
            return check(Annotated[kind, self.quantity], value, name)
        values = value.tolist() if isinstance(value, array) else value
        if self.any_length and type(values) in (int, float):
            values = [values]
        values = check(Annotated[Numbers, self.quantity], values, name)
        if len(values) != len(self.default) and not self.any_length:
            raise ValueError(f"{name}: {len(values)} values; give {len(self.default)}")
        return values


class Parameters:
    """The parameters of a node: declared, checked (ValueError), and read by name.

    `apply` is called with the new values of a change before it takes effect. A ValueError refuses
    all of it, so it must come before anything is taken over; its text is returned to the caller.
    """

    def __init__(
        self,
        node: Node,
        declarations: Mapping[str, Parameter],
        apply: Callable[[dict[str, Any]], None] = lambda changes: None,
    ) -> None:
        self._node, self._declared, self._apply = node, declarations, apply
        for name, parameter in declarations.items():
            # Declared without type and range first, so that a bad start value gets our own message.
            free = ParameterDescriptor(dynamic_typing=True)
            given = node.declare_parameter(name, parameter.default, free).value
            descriptor = parameter.descriptor()
            kind = RosParameter.Type(descriptor.type)
            taken = RosParameter(name, kind, parameter.check(name, given))
            node.set_descriptor(name, descriptor, taken.get_parameter_value())
        node.add_on_set_parameters_callback(self._on_set)
        if hasattr(node, "add_pre_set_parameters_callback"):  # which Humble has not
            node.add_pre_set_parameters_callback(self._numbers)
        self._warn_of_unknown()

    def _warn_of_unknown(self) -> None:
        """Name what the node was given and no node of the package has, or it does not get."""
        # A section `/**` has what other nodes declare.
        known = re.findall(r"^#    (\w+):", shared_file(DEFAULTS).read_text("utf-8"), re.M)
        for name in self._node._parameter_overrides:
            if not (name in known or self._node.has_parameter(name) or "qos_overrides." in name):
                text = hint(name, known, f"{DEFAULTS} lists those that there are")
                self._node.get_logger().warning(f"{name}: no node has this parameter; {text}")
        for text in astray(self._node.get_fully_qualified_name()):
            self._node.get_logger().warning(text)

    def __getitem__(self, name: str) -> Any:
        """Return the present value of a parameter."""
        return self._node.get_parameter(name).value

    def frame(self, name: str) -> str:
        """Return a frame that a parameter names, behind the prefix; without a name, nothing."""
        given: str = self[name]
        if given.startswith("/"):
            return given[1:]
        return f"{self['frame_prefix']}{given}" if given else ""

    def settings(self, kind: type[Settings], changes: Mapping[str, Any] | None = None) -> Settings:
        """Return a dataclass of settings that are parameters, with the values of a change."""
        values = {name: (changes or {}).get(name, self[name]) for name in declared(kind)}
        for name, value in values.items():
            if isinstance(self._declared[name].default, list):
                values[name] = tuple(value)
        return kind(**values)

    def _numbers(self, changes: list[RosParameter]) -> list[RosParameter]:
        """Return changes with numbers of the type that they are to be, as at the start."""
        return [self._number(change) for change in changes]

    def _number(self, change: RosParameter) -> RosParameter:
        declared, value = self._declared.get(change.name), change.value
        wanted = None if declared is None else declared.default
        if isinstance(wanted, float) and type(value) is int:
            return RosParameter(change.name, RosParameter.Type.DOUBLE, float(value))
        alone = type(value) in (int, float)
        if isinstance(wanted, list) and (alone or change.type_ == RosParameter.Type.INTEGER_ARRAY):
            numbers = [float(number) for number in ([value] if alone else value)]
            return RosParameter(change.name, RosParameter.Type.DOUBLE_ARRAY, numbers)
        return change

    def _on_set(self, changes: list[RosParameter]) -> SetParametersResult:
        ours = {change.name: change.value for change in changes if change.name in self._declared}
        try:
            for name, value in ours.items():
                self._declared[name].check(name, value)
            if ours:
                self._apply(ours)
        except (ValueError, OSError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def checked_topic(name: str, topic: str) -> str:
    """Return the name of a topic; ValueError for a text that cannot name one."""
    try:
        validate_full_topic_name(expand_topic_name(topic, "node", "/space"))
    except (ValueError, InvalidTopicNameException):
        raise ValueError(
            f"{name}: {topic!r} cannot name a topic; give words of letters, digits and _ between "
            "slashes, none of which begins with a digit, such as /rov_2/odometry"
        ) from None
    return topic


SHARED = {
    "scene": Parameter(
        "follow", Quantity("name of a ready scene, or path of a YAML file"), read_only=True
    ),
    "frame_prefix": Parameter(
        "", Quantity("prefix of each frame's name that does not begin with /"), True
    ),
    "base_frame": Parameter(
        "follower/base_link", Quantity("frame of the follower, of cmd_vel and leader_pose"), True
    ),
    "beacon_frame": Parameter(
        BEACON_FRAME,
        Quantity(
            "frame of the lamp; its y and z point to starboard and down where the name ends in "
            "_ned or _frd"
        ),
        True,
    ),
    "beacon_position_m": Parameter([0.0, 0.0, 0.0], BEACON_POSITION, True),
    "odometry_axes": Parameter(
        "flu",
        Quantity("axes of the odometries: REP 103, or NED and forward-right-down"),
        True,
        get_args(Axes),
    ),
    "max_gap_s": Parameter(MAX_GAP_S, MAX_GAP, True),
    "publish_tf": Parameter(
        False, Quantity("send frames to /tf or /tf_static; this needs tf2_msgs"), True
    ),
}


def shared(*names: str) -> dict[str, Parameter]:
    """Return parameters that several nodes have."""
    return {name: SHARED[name] for name in names}


def parameters_of(settings: type) -> dict[str, Parameter]:
    """Return the parameters for a dataclass of settings, each field with its default."""
    return {
        name: Parameter(
            list(setting.default) if isinstance(setting.default, tuple) else setting.default,
            setting.quantity,
            choices=setting.choices,
        )
        for name, setting in declared(settings).items()
    }
