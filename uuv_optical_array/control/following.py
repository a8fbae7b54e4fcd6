"""Whether a follower has its leader, and what it does about it: one state, from start to end.

- ``waiting``: no pose has steered yet.
- ``locked``: the leader's light steers.
- ``coasting``: the light is gone, and the follower goes on as the leader was moving.
- ``searching``: it moves and turns to where the leader may be by now.
- ``lost``: the search has ended without light; the follower holds.
- ``disengaged``: the follower is left to others.
"""

from typing import Literal, NamedTuple, get_args

from numpy.typing import ArrayLike

from uuv_optical_array.control.formation import FormationController, FormationSettings
from uuv_optical_array.core.geometry import Array

StateName = Literal["waiting", "locked", "coasting", "searching", "lost", "disengaged"]
STATES: tuple[StateName, ...] = get_args(StateName)


class State(NamedTuple):
    """What the follower does.

    - name: one of `STATES`.
    - since_s: since when, s, on the clock of the stamps; nan before the first command.
    - reason: why, in words.
    """

    name: StateName
    since_s: float
    reason: str


class Following:
    """Keep station while there is light, and find the leader again when it is gone."""

    def __init__(self, settings: FormationSettings) -> None:
        self._law = FormationController(settings)
        self.state = State("waiting", float("nan"), "no pose has come yet")

    def configure(self, settings: FormationSettings) -> None:
        """Use other settings from now on; what is known of the leader stays."""
        self._law.configure(settings)

    def update(
        self, stamp_s: float, pose: ArrayLike, covariance: ArrayLike, rate: ArrayLike
    ) -> None:
        """Take a relative pose and its rate; arguments and errors of `FormationController`."""
        self._law.update(stamp_s, pose, covariance, rate)

    def command(self, now_s: float) -> tuple[Array, Array] | None:
        """Return the twist to command at the present, s; ``None`` where there is nothing to do.

        It is in the follower's frame, m/s and rad/s, shape ``(3,)`` each.
        """
        command = self._law.command(now_s)
        if command is not None and self.state.name == "waiting":
            self.state = State("locked", now_s, "the leader's light steers")
        return command

    def engage(self, wanted: bool, now_s: float) -> None:
        """Steer from the next pose on, or leave the follower to others; nothing is remembered."""

    def search(self, now_s: float) -> None:
        """Search for the leader now, from where the follower is."""
