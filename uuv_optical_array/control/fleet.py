"""Several followers of one leader: who follows whom at which station, and how near they may come.

A follower sees only the lamp ahead of it, and the formation law keeps its distance to that alone.
Stations keep followers apart: by `MIN_SEPARATION_M` and by how far every follower between them may
be off its own: 0.5 m where it sees the leader, 1 m where it sees another. That is no guarantee: a
follower that lost its light and stopped is farther off.

A station swings sideways by its distance to the leader times the leader's turn rate, and at first
its follower lags. The second link of a chain is near the beam's axis, so that it stays in the beam
meanwhile, and as far behind as the law's fastest sway can follow, so that there is no third.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

from uuv_optical_array.core.settings import Place, Quantity, check

LEADER = "leader/odometry"  # topic of the leader's odometry
MIN_SEPARATION_M = 1.0  # between the centres of two vehicles, each some half a metre long
# One image of the scene `formation` gives the range to 0.2 m at the first two, not at the third.
FIRST_M: Place = (-5.0, 1.0, 0.0)  # of the first follower on the port arm of a V
SECOND_M: Place = (-3.5, 1.0, 0.0)  # of the second, seen from the first
TAIL_M: Place = (-7.0, 0.0, 0.0)  # of a third follower that sees the leader
MOST = 4  # followers in a V
MOST_BY_LEADER = 3


@dataclass(frozen=True)
class Follower:
    """One of a fleet, numbered from 1.

    Its station is in the frame of the lamp of the follower `ahead`; 0 is the leader.
    """

    number: int
    station_m: Place
    ahead: int = 0

    @property
    def namespace(self) -> str:
        """Return the namespace of its nodes."""
        return f"follower_{self.number}"

    @property
    def odometry(self) -> str:
        """Return the topic of its odometry, within the fleet's namespace."""
        return f"{self.namespace}/follower/odometry"

    @property
    def lamp_odometry(self) -> str:
        """Return the topic of the odometry of the vehicle that it follows, within the fleet's."""
        return f"follower_{self.ahead}/follower/odometry" if self.ahead else LEADER

    @property
    def lamp_frame(self) -> str:
        """Return the frame of that vehicle, where each follower's frames have its namespace."""
        return self.lamp_odometry.replace("odometry", "base_link")

    def others(self, fleet: Iterable["Follower"]) -> list[str]:
        """Return the topics of the odometry of all vehicles but itself and the one it follows."""
        topics = [LEADER, *(follower.odometry for follower in fleet)]
        return [topic for topic in topics if topic not in (self.odometry, self.lamp_odometry)]


def vee(followers: int, chain: bool = True) -> list[Follower]:
    """Return a V behind a leader: odd followers to port, even ones to starboard.

    In a `chain`, of up to `MOST`, the third and fourth see the lamp of the one ahead on their arm;
    else all see the leader's, up to three, the third in the middle. ValueError for other numbers.
    """
    way, most = ("in a chain", MOST) if chain else ("without a chain", MOST_BY_LEADER)
    check(Annotated[int, Quantity("", way, 1, most)], followers, "followers")
    fleet = []
    for number in range(1, followers + 1):
        x, y, z = FIRST_M if number <= 2 else SECOND_M
        station = x, y if number % 2 else -y, z
        fleet.append(Follower(number, station, max(number - 2, 0)))
    if not chain:
        fleet[2:] = [Follower(follower.number, TAIL_M) for follower in fleet[2:]]
    return fleet
