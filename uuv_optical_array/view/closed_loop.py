"""The closed loop as the page shows it: its conditions, and a sight of each step."""

import dataclasses
from typing import Annotated

import numpy as np

from uuv_optical_array.control.closed_loop import ClosedLoop, Light, Swimmer, clouded
from uuv_optical_array.control.following import Following
from uuv_optical_array.control.formation_settings import STATION, FormationSettings
from uuv_optical_array.control.vehicles.sea import CURRENT, Sea
from uuv_optical_array.control.vehicles.vehicle import Vehicle, start_behind
from uuv_optical_array.core.settings import Numbers, Place, Quantity, check
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.forward.prior import LAMP_POWER, power_offsets
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.view.sight import Sight, note_on, sight_of


@dataclasses.dataclass(frozen=True)
class Conditions:
    """The sea that the estimator does not know, and the station; ValueError beyond the bounds."""

    k_per_m: Annotated[float, Quantity("attenuation or absorption of the water", "1/m", 0, 10)]
    lamp_power: Annotated[Numbers, LAMP_POWER] = (1.0,)
    plume_depth: Annotated[
        float, Quantity("optical depth in the middle of a cloud; 0: none", "", 0, 20)
    ] = 0.0
    current_m_per_s: Annotated[Place, CURRENT] = (0.0, 0.0, 0.0)
    station_m: Annotated[Place, STATION] = FormationSettings.station_m

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            check(field.type, getattr(self, field.name), field.name)
        FormationSettings(station_m=self.station_m)

    @classmethod
    def of(cls, scene: Scene) -> "Conditions":
        """Return those of a scene."""
        plume_depth = scene.effects.get("plume", {}).get("depth", 0.0)
        return cls(scene.attenuation[1], (1.0,) * scene.lamp_count, plume_depth)


class ViewedLoop:
    """The closed loop of the demonstration as the page shows it, in conditions that change.

    The estimator believes its scene, of which the conditions are unless others are given.
    """

    def __init__(
        self, estimator: Estimator, rng: np.random.Generator, conditions: Conditions | None = None
    ) -> None:
        self._scene = scene = estimator.scene
        self.conditions = conditions or Conditions.of(scene)
        leader = Vehicle(np.zeros(3))
        settings = FormationSettings(station_m=self.conditions.station_m)
        self.follower = Swimmer(
            start_behind(leader, self.conditions.station_m),
            Pipeline(estimator),
            Following(settings),
            lambda t_s: self.light,
        )
        self.loop = ClosedLoop(leader, [self.follower], rng)
        self.change(self.conditions)

    @property
    def t_s(self) -> float:
        """Time since the start, s."""
        return self.loop.t_s

    def change(self, conditions: Conditions) -> None:
        """Set other conditions."""
        self.light = _light(self._scene, conditions)
        self.follower.following.configure(FormationSettings(station_m=conditions.station_m))
        self.loop.sea = Sea(conditions.current_m_per_s)
        self.conditions = conditions

    def step(self, dt: float) -> Sight:
        """Advance by `dt`, s, > 0; return what there is to see, the lamp at the leader's origin."""
        (seen,) = self.loop.step(dt)
        waits = "the leader waits for its follower to see it" if self.loop.path_s is None else ""
        return sight_of(
            seen.answer,
            seen.t_s,
            seen.image,
            seen.true_pose,
            leader=seen.lamp,
            note=note_on(seen.answer) or waits,
            station_m=self.conditions.station_m,
            state=seen.state,
            lit=tuple(power > 0 for power in self.conditions.lamp_power),
        )


def _light(scene: Scene, conditions: Conditions) -> Light:
    """Return the light of a scene in conditions."""
    name, believed = scene.attenuation
    # The offset is what differs, as the lamp stays as bright as it is in the scene.
    offsets = {name: np.array(conditions.k_per_m - believed)}
    offsets |= power_offsets(conditions.lamp_power, scene.lamp_count)
    return Light(clouded(scene, conditions.plume_depth), offsets)
