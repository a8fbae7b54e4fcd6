"""Images of a recorded bag with their true poses by its odometries, commands and states."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.control.follow_states import state_from_status
from uuv_optical_array.control.following import State
from uuv_optical_array.control.vehicles.trajectory import (
    MAX_GAP,
    MAX_GAP_S,
    Between,
    TooEarly,
    Trajectory,
    interpolated,
)
from uuv_optical_array.core import messages
from uuv_optical_array.core.geometry import Array, relative_pose
from uuv_optical_array.core.messages import Axes, Readout, Refused
from uuv_optical_array.core.settings import Place, Quantity
from uuv_optical_array.recording.bag import IMAGE, ODOMETRY, STATUS, TWIST, Bag, opened

CLOCK_RESET_NS = 1_000_000_000  # no message is so late: the clock was set back


@dataclass(frozen=True)
class Recording:
    """Images of a bag in the order of their stamps."""

    images: Array  # counts, (m, side, side)
    poses: Array  # of the follower in ``beacon``, m and rad, (m, 5); nan where not known
    rolls: Array  # likewise, (m,)
    stamps_ns: NDArray[np.int64]  # of the images, (m,)
    refused: Counter[str] = field(default_factory=Counter)  # messages, by topic and reason
    # To the follower, ascending: stamp, ns, linear and angular body velocity, m/s and rad/s, (3,).
    commands: list[tuple[int, Array, Array]] = field(default_factory=list)
    states: list[State] = field(default_factory=list)  # of the follower, each once, ascending
    # Poses and rolls at other stamps, ns; nan where not known. `None`: a table of places gave them.
    poses_at: Callable[[NDArray[np.int64]], tuple[Array, Array]] | None = None
    offset_s: float = 0.0  # of the poses from the stamps of their images
    rates: Array | None = None  # of poses and rolls, m/s and rad/s, (m, 6), as of `clocks.rates_of`

    def only(self, kept: NDArray[np.bool_], reason: str) -> "Recording":
        """Return what is `kept` of the images, ``(m,)``; the others are counted as refused."""
        refused = Counter(self.refused)
        if left_out := int((~kept).sum()):
            refused[reason] += left_out
        return replace(
            self,
            images=self.images[kept],
            poses=self.poses[kept],
            rolls=self.rolls[kept],
            stamps_ns=self.stamps_ns[kept],
            refused=refused,
        )

    @property
    def seconds(self) -> Array:
        """Stamps of the images, s, shape ``(m,)``."""
        return self.stamps_ns.astype(float) * 1e-9

    @property
    def left_out(self) -> list[str]:
        """What of the bag is not here, a line each, most first."""
        return [f"left out: {count} x {reason}" for reason, count in self.refused.most_common()]


@dataclass
class _Stream:
    """The valid messages of one topic by ascending stamp, ns."""

    topic: str
    samples: list[tuple[int, Any]] = field(default_factory=list)
    frames: set[str] = field(default_factory=set)

    def add(self, header: Any, value: Any) -> None:
        """Add a value, or refuse one more of a stamp; ValueError where the clock was set back."""
        stamp = messages.stamp_ns(header)
        if self.samples and stamp < self.samples[-1][0] - CLOCK_RESET_NS:
            raise ValueError(
                f"{self.topic}: stamps go back from {self.samples[-1][0] * 1e-9:.3f} to "
                f"{stamp * 1e-9:.3f} s: the clock was set back; record each run in a bag of its own"
            )
        place = bisect_right(self.samples, stamp, key=itemgetter(0))
        if place and self.samples[place - 1][0] == stamp:
            raise Refused("duplicate stamp")
        self.samples.insert(place, (stamp, value))
        self.frames.add(header.frame_id)

    def span(self) -> str:
        if not self.samples:
            return f"{self.topic} none"
        first, last = self.samples[0][0] * 1e-9, self.samples[-1][0] * 1e-9
        return f"{self.topic} {first:.3f} to {last:.3f} s"

    def around(self, max_gap_s: float) -> Callable[[int], Between]:
        """Return what gives the poses around a stamp; `Refused` where none is known."""
        trajectory = Trajectory(max_gap_s, length=None)
        for stamp, pose in self.samples:
            trajectory.add(stamp, *pose)

        def around(stamp: int) -> Between:
            try:
                return trajectory.around(stamp)
            except (TooEarly, LookupError) as error:
                reason = str(error).partition(" of ")[0]  # without the length of a gap
                raise Refused(f"no {self.topic} at its stamp: {reason}") from None

        return around


def _check(bag: Bag, name: str, msgtype: str, kind: str) -> None:
    """Refuse a bag without a topic of a type."""
    cure = f"name another by --set {kind}_topic=TOPIC"
    kinds = {channel.kind for channel in bag.counts if channel.topic == name}
    if not kinds:
        known = sorted(f"{channel.topic} ({channel.kind})" for channel in bag.counts)
        raise ValueError(f"no topic {name}; the bag has {', '.join(known) or 'none'}; {cure}")
    if msgtype not in kinds:
        raise ValueError(f"{name} is {' and '.join(sorted(kinds))}, not {msgtype}; {cure}")


def read_recording(
    path: Path,
    array: Readout,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
    poses_needed: bool = True,
    lamps: int = 1,
    *,
    image_topic: Annotated[str, Quantity("topic of the images")] = "array/image",
    leader_topic: Annotated[str, Quantity("topic of the leader's odometry")] = "leader/odometry",
    follower_topic: Annotated[
        str, Quantity("topic of the follower's odometry")
    ] = "follower/odometry",
    commands_topic: Annotated[
        str, Quantity("topic of the follower's commands, for a track")
    ] = "cmd_vel",
    states_topic: Annotated[
        str, Quantity("topic of the follower's states, for the view")
    ] = "follow_state",
    beacon_position_m: Annotated[Place, messages.BEACON_POSITION] = (0.0, 0.0, 0.0),
    odometry_axes: Annotated[
        Axes, Quantity("axes of both odometries: REP 103, or NED and forward-right-down")
    ] = "flu",
    max_gap_s: Annotated[float, MAX_GAP] = MAX_GAP_S,
) -> Recording:
    """Read the images of a bag, and their poses from both odometries.

    These are interpolated, never extrapolated. What is left out, and what is
    missing by the bag's own counts, is counted in `Recording.refused`.

    - path: as of `opened`.
    - array: the array that every image must be of.
    - poses_needed: leave out images without a known pose; otherwise odometries may be missing.
    - lamps: how many an image shows.
    - image_topic and the other topics: with or without a leading slash.
    - beacon_position_m and what follows: as the nodes' parameters; axes as of `odometry_pose`.
    - ValueError: for a bag that cannot be read, a topic that is missing or of another type,
      odometries in two frames, a clock that was set back, or a bag without a valid image.
    - FileNotFoundError: where there is no such bag.
    """
    with opened(path) as bag:
        if not bag.counts.total():
            raise ValueError("; ".join(["it is empty", *bag.lost]))
        streams, wanted = {}, {}
        topics = {"image": image_topic, "leader": leader_topic, "follower": follower_topic}
        for kind, topic in topics.items():
            name, msgtype = "/" + topic.strip("/"), IMAGE if kind == "image" else ODOMETRY
            held = {channel.topic for channel in bag.counts}
            if poses_needed or msgtype == IMAGE or name in held:
                _check(bag, name, msgtype, kind)
                wanted[name] = msgtype
            streams[name] = _Stream(name)
        if len(streams) < 3:
            raise ValueError("leader and follower have the same topic; name both topics")
        image, leader, follower = streams.values()
        commands = _Stream("/" + commands_topic.strip("/"))
        streams.setdefault(commands.topic, commands)
        wanted.setdefault(commands.topic, TWIST)
        wanted.setdefault("/" + states_topic.strip("/"), STATUS)
        states: set[State] = set()  # each is repeated
        for _, channel, message in progress(bag.messages(wanted)):
            try:
                if channel.kind == STATUS:
                    states.add(state_from_status(message))
                    continue
                if channel.kind == IMAGE:
                    value: Any = messages.image_from_message(message, array, lamps)
                elif channel.kind == TWIST:
                    value = messages.twist_from_message(message)
                else:
                    value = messages.odometry_pose(message, odometry_axes)
                streams[channel.topic].add(message.header, value)
            except Refused as reason:
                # Counted by kind: the values of odometries and commands differ.
                text = str(reason)
                kind = text if channel.kind == IMAGE else text.partition(":")[0]
                bag.lost[f"{channel.topic}: {kind}"] += 1
        beacon = np.array(beacon_position_m)
        recording = _with_poses(image, leader, follower, beacon, max_gap_s, bag.lost, poses_needed)
    recording.commands.extend((stamp, *twist) for stamp, twist in commands.samples)
    recording.states.extend(sorted(states, key=attrgetter("since_s")))
    return recording


def _with_poses(
    image: _Stream,
    leader: _Stream,
    follower: _Stream,
    beacon_position_m: Array,
    max_gap_s: float,
    refused: Counter[str],
    poses_needed: bool,
) -> Recording:
    if len(leader.frames | follower.frames) > 1:
        raise ValueError(
            f"frames differ: {leader.topic} is in {sorted(leader.frames)}, {follower.topic} in "
            f"{sorted(follower.frames)}; both must be in the same"
        )
    of_leader, of_follower = leader.around(max_gap_s), follower.around(max_gap_s)

    def around(stamp: int) -> tuple[Between, Between]:
        return of_leader(stamp), of_follower(stamp)

    def poses_at(stamps: NDArray[np.int64]) -> tuple[Array, Array]:
        told, known, pairs = np.full((len(stamps), 6), np.nan), [], []
        for i, stamp in enumerate(stamps.tolist()):
            with suppress(Refused):
                pairs.append(around(stamp))
                known.append(i)
        if known:
            (places, turns), seen = (interpolated(each) for each in zip(*pairs, strict=True))
            beacons = places + turns @ beacon_position_m
            told[known, :5], told[known, 5] = relative_pose(beacons, turns, *seen)
        return told[:, :5], told[:, 5]

    images, stamps = [], []
    for stamp, pixels in image.samples:
        if poses_needed:
            try:
                around(stamp)
            except Refused as reason:
                refused[f"{image.topic}: {reason}"] += 1
                continue
        images.append(pixels)
        stamps.append(stamp)
    if not images:
        reasons = "; ".join(f"{number} x {reason}" for reason, number in refused.most_common())
        spans = ", ".join(stream.span() for stream in (image, leader, follower))
        missing = "no image with a known pose" if poses_needed else "no image"
        raise ValueError(f"{missing}: {reasons or 'no message at all'} ({spans})")
    stamps_ns = np.array(stamps, np.int64)
    return Recording(np.array(images), *poses_at(stamps_ns), stamps_ns, refused, poses_at=poses_at)
