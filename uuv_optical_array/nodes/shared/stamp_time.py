"""Stamps on a clock that is never set, for what controls or watches over something."""

from rclpy.node import Node

from uuv_optical_array.nodes.shared.node import steady_clock

AHEAD_NS = 100_000_000  # by which a stamp may be later than the present, as clocks differ a little
OLD_NS = 5_000_000_000  # age of a first stamp beyond which it is of another clock
SLEWED_NS = 50_000_000  # a larger change of the node's clock between two stamps is a step
NOTED_NS = 1_000_000  # and a smaller one is no change
# A stamp so far behind the newest of its topic is no late one: its clock was set back.
FAR_NS = 500_000_000
# Topics with stamps of images, and the time without these after which other stamps tell the clock.
OF_IMAGES = "track", "features", "faint_features"
SILENT_NS = 2_000_000_000


class StampTime:
    """Where stamps are on a steady clock, or on the simulated one, which is that of the stamps.

    The clock of the stamps may be set at any time: that of this machine, that of the sensor, or
    both. On the steady clock a stamp cannot be ahead of the present, and its age cannot grow faster
    than time passes. Of the offsets by the node's clock and before, the one is used that changes
    the age least; if neither is possible, the age is assumed to stay.

    While images come, their stamps alone tell where that clock is: that of another vehicle or
    instrument may be off.
    """

    def __init__(self, node: Node) -> None:
        self._clock, self._steady = node.get_clock, steady_clock(node)
        self._simulated = self._steady is node.get_clock()
        self._own_ns = self._ahead_ns = 0  # by which the node's clock, and the stamps', are ahead
        self._stamp_ns: int | None = None  # the newest
        self._newest_ns: dict[str, int] = {}  # of each topic, as some lag behind others
        self._age_ns = self._judged_ns = self._imaged_ns = 0
        self._by_images = False  # whether images came last

    def now_s(self) -> float:
        """Return the present, s."""
        return self._now_ns() * 1e-9

    def of(self, stamp_ns: int, topic: str) -> float:
        """Return where a stamp that has just come is, s; one that comes again is at its place."""
        now_ns = self._now_ns()
        if topic in OF_IMAGES:
            if not self._by_images:
                self._stamp_ns = None  # that of another instrument
            self._by_images, self._imaged_ns = True, now_ns
        elif now_ns - self._imaged_ns > SILENT_NS:
            self._by_images = False
        tells = topic in OF_IMAGES or not self._by_images
        newest_ns = self._newest_ns.get(topic, stamp_ns)
        set_back = newest_ns - stamp_ns > FAR_NS
        if set_back and tells:
            self._newest_ns.clear()
        self._newest_ns[topic] = stamp_ns if set_back else max(newest_ns, stamp_ns)
        later = self._stamp_ns is None or stamp_ns > self._stamp_ns
        if not self._simulated and tells and (set_back or later):
            self._judge(stamp_ns)
        return (stamp_ns - self._ahead_ns) * 1e-9

    def _now_ns(self) -> int:
        return int(self._steady.now().nanoseconds)

    def _judge(self, stamp_ns: int) -> None:
        """Find by how much the clock of the stamps is ahead, by a stamp that is the newest."""
        now_ns = self._now_ns()
        own_ns = int(self._clock().now().nanoseconds) - now_ns
        slewed_ns = own_ns - self._own_ns
        if abs(slewed_ns) > NOTED_NS:
            self._own_ns = own_ns
            if abs(slewed_ns) <= SLEWED_NS:
                self._ahead_ns += slewed_ns
        passed_ns = OLD_NS if self._stamp_ns is None else now_ns - self._judged_ns
        ages = {ahead: now_ns + ahead - stamp_ns for ahead in (self._ahead_ns, self._own_ns)}
        ahead, age_ns = min(ages.items(), key=lambda one: abs(one[1] - self._age_ns))
        if -AHEAD_NS <= age_ns <= self._age_ns + passed_ns + AHEAD_NS:
            self._ahead_ns, self._age_ns = ahead, age_ns
        else:
            self._ahead_ns = stamp_ns + self._age_ns - now_ns
        self._stamp_ns, self._judged_ns = stamp_ns, now_ns
