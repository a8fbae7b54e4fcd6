"""What every node does alike: publish, subscribe, start and stop."""

import gc
import os
import signal
import sys
from collections.abc import Callable, Iterable
from copy import copy
from types import FrameType
from typing import Any

import rclpy
from geometry_msgs.msg import Pose, TransformStamped
from rclpy.clock import Clock, ClockType  # type: ignore[attr-defined]
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from std_msgs.msg import Header

from uuv_optical_array.nodes.shared.diagnostics import BrokenOff
from uuv_optical_array.nodes.shared.messages import not_finite
from uuv_optical_array.nodes.shared.sections import note_arguments

PATIENCE_S = 1.0  # with a callback, after a signal
WAITING = 100  # messages that may wait for the newest to be taken, and are counted


class FinitePublisher:
    """Publish messages but those that hold a number that is not finite: the diagnostics name it."""

    def __init__(self, node: Any, publisher: Publisher) -> None:
        self._node, self._publisher = node, publisher

    @property
    def heard(self) -> bool:
        """Whether anyone subscribes."""
        return bool(self._publisher.get_subscription_count())

    def publish(self, message: Any) -> bool:
        """Publish a message; return whether it was."""
        where = not_finite(message)
        if where:
            topic = self._publisher.topic_name
            self._node.diagnostics.refuse(f"not finite: {where} of {topic}, which is not published")
            return False
        self._publisher.publish(message)
        return True


USUAL = QoSProfile(depth=10)
OVERRIDABLE = {"qos_overriding_options": QoSOverridingOptions.with_default_policies()}
LASTING = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def publish(node: Any, message_type: type, topic: str, qos: QoSProfile = USUAL) -> FinitePublisher:
    """Create a reliable publisher of finite numbers whose QoS parameters can override.

    What is `LASTING` reaches those who listen later, too, and may have several publishers.
    """
    # A copy, as rclpy writes what parameters override into the profile.
    publisher = node.create_publisher(message_type, topic, copy(qos), **OVERRIDABLE)
    if qos is not LASTING:
        node.diagnostics.watch(publisher.topic_name)
    return FinitePublisher(node, publisher)


def subscribe(
    node: Any,
    message_type: type,
    topic: str,
    callback: Callable[[Any], None],
    newest: bool = False,
    qos: QoSProfile = qos_profile_sensor_data,
) -> Subscription:
    """Create a subscription, with sensor-data QoS unless `LASTING`, that parameters can override.

    The node's ``diagnostics`` tell where the topic has more than one publisher. With `newest` only
    the newest of the messages that wait, in a longer queue, is served, and the others are counted.
    """
    take = callback
    if newest:
        node.diagnostics.pass_over(0)
        qos = QoSProfile(depth=WAITING, reliability=ReliabilityPolicy.BEST_EFFORT)
        taken: list[Any] = []

        def serve() -> None:
            message = taken[-1]
            node.diagnostics.pass_over(len(taken) - 1)
            taken.clear()
            callback(message)

        def take(message: Any) -> None:
            scheduled, queue = bool(taken), subscription.handle
            taken.append(message)
            with queue:
                while newer := queue.take_message(message_type, False):
                    taken.append(newer[0])
            if len(taken) == 1:
                serve()
            elif not scheduled:
                # Others have their turn first, so that they do not starve at overload.
                node.executor.create_task(serve)

    subscription = node.create_subscription(message_type, topic, take, copy(qos), **OVERRIDABLE)
    node.diagnostics.watch(subscription.topic_name)
    return subscription


def unsubscribe(node: Any, subscription: Subscription) -> None:
    """End what `subscribe` created."""
    node.diagnostics.unwatch(subscription.topic_name)
    node.destroy_subscription(subscription)


def steady_clock(node: Node) -> Clock:
    """Return the clock of what controls or moves, which is never set.

    It is that of the machine's uptime, or the simulated one where the node uses simulated time.
    """
    if node.get_parameter("use_sim_time").value:
        return node.get_clock()
    return Clock(clock_type=ClockType.STEADY_TIME)


def transform_publisher(
    node: Node, wanted: bool, fixed: bool = False
) -> Callable[[Header, str, Pose], None]:
    """Return a function that places a frame on ``/tf``, or one that does nothing.

    It takes the parent's header, the child frame and its pose; a fixed one goes to ``/tf_static``.
    """
    if not wanted:
        return lambda header, child_frame, pose: None
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        node.get_logger().warning("publish_tf: tf2_msgs is not installed, so no TF is published")
        return lambda header, child_frame, pose: None
    topic = ("/tf_static", LASTING) if fixed else ("/tf", QoSProfile(depth=100))
    publisher = FinitePublisher(node, node.create_publisher(TFMessage, *topic))

    def send(header: Header, child_frame: str, pose: Pose) -> None:
        message = TransformStamped(header=header, child_frame_id=child_frame)
        place, position = message.transform.translation, pose.position
        place.x, place.y, place.z = position.x, position.y, position.z
        message.transform.rotation = pose.orientation
        publisher.publish(TFMessage(transforms=[message]))

    return send


def start(args: list[str] | None) -> None:
    """Start ROS; ValueError for arguments or a parameter file that it cannot read."""
    note_arguments(args)
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)  # `spin` has them
    except RuntimeError as error:
        raise ValueError(" ".join(str(error).split())) from None


def spin(executor: Executor, wanted: Callable[[], bool] = lambda: True) -> bool:
    """Serve callbacks while they are wanted, until SIGINT, SIGTERM or a shutdown.

    Return whether a signal ended it. A signal counts between two callbacks: an exception in the
    midst of one, which is what Python makes of SIGINT, can strike rclpy while it takes a message.
    A callback that goes on for `PATIENCE_S`, such as a fit that is not compiled, is broken off.
    """
    signals: list[int] = []

    def caught(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)

    def break_off(number: int, frame: FrameType | None) -> None:
        raise BrokenOff

    numbers = signal.SIGINT, signal.SIGTERM
    before = [signal.signal(number, caught) for number in numbers]
    signal.signal(signal.SIGALRM, break_off)
    try:
        while rclpy.ok() and not signals and wanted():
            executor.spin_once(timeout_sec=0.1)
    except (ExternalShutdownException, KeyboardInterrupt):
        pass
    signal.signal(signal.SIGALRM, signal.SIG_IGN)
    # Ctrl-C reaches a launched node twice, from the terminal and from launch; once is enough.
    if not signals:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
    return bool(signals)


def fastest_executor() -> Executor:
    """Return the executor of events, where rclpy has it, which costs a message about 1 ms less."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:  # before Jazzy's
        return SingleThreadedExecutor()
    return EventsExecutor()


def run(make: Callable[[], Node | Iterable[Node]], args: list[str] | None = None) -> None:
    """Run a node, or several in one thread; a bad set-up ends it with one line and exit code 1."""
    try:
        start(args)
        executor, made = fastest_executor(), make()
        for node in [made] if isinstance(made, Node) else made:
            executor.add_node(node)
        gc.freeze()  # what lasts: to look it all through, the collector takes 0.1 s now and then
        spin(executor)
    except KeyboardInterrupt:  # while the node was being set up
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    except (ValueError, OSError, ParameterException) as error:
        sys.exit(str(error))
    except RuntimeError as error:
        if os.environ.get("ROS_SECURITY_ENABLE") != "true":
            raise
        sys.exit(
            f"{error}: the enclave has to allow what the node declares; print its policy by "
            "python3 -m uuv_optical_array.nodes.bringup.security with the node's arguments"
        )
    finally:
        rclpy.try_shutdown()
