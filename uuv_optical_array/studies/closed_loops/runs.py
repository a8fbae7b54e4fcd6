"""A kind of trouble for a follower, and one run of the closed loop in it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.control.closed_loop import ClosedLoop, Instant, Light, Swimmer, clouded
from uuv_optical_array.control.fleet import Follower
from uuv_optical_array.control.following import Following
from uuv_optical_array.control.formation_settings import FormationSettings
from uuv_optical_array.control.vehicles.leader_path import PATHS, LeaderPath, leader_twist
from uuv_optical_array.control.vehicles.models import MODELS, Model
from uuv_optical_array.control.vehicles.sea import Sea
from uuv_optical_array.control.vehicles.vehicle import Vehicle, VehicleLimits
from uuv_optical_array.core.geometry import Array, wrapped
from uuv_optical_array.core.settings import Place
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.pipeline import Pipeline
from uuv_optical_array.forward.drawn_sea import DrawnSea, draw_sea
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.others import Other
from uuv_optical_array.forward.prior import SCATTERING, power_offsets
from uuv_optical_array.forward.scene import scene_from_settings
from uuv_optical_array.studies.closed_loops.leader_courses import Points, at
from uuv_optical_array.studies.closed_loops.modem import Modem

STEP_S = 0.1  # 10 images a second
# Of a leader that moves as its course says.
OBEDIENT = VehicleLimits((5.0, 5.0, 5.0, 2.0, 2.0), (50.0, 50.0, 50.0, 20.0, 20.0))
ALONE = (Follower(1, FormationSettings.station_m),)


@dataclass(frozen=True)
class Beside:
    """Another vehicle with an equal lamp, parallel to ours: where it is in our lamp's frame, m."""

    x: Points
    y: Points
    lit_s: tuple[float, float] = (0.0, np.inf)

    def vehicle(self, t_s: float) -> list[Other]:
        """Return its vehicle at a time, s; none while it is off."""
        if not self.lit_s[0] <= t_s < self.lit_s[1]:
            return []
        return [Other(np.array([at(self.x, t_s), at(self.y, t_s), 0.0]), np.eye(3))]


@dataclass(frozen=True)
class Kind:
    """A trouble that a follower meets.

    - since_s, until_s: when it begins and ends; what lasts ends as it begins.
    - lamp, scattering: relative to the scene; absorption: beyond it, 1/m.
    - plume: depth of clouds that the estimator does not know of, between the two times.
    - effects: what they have in truth, beside the scene, from the start.
    - dark_s: from when to when the lamp is off, for the followers `blind`; none: for all.
    - start_m: of the follower, off its station; behind_m: how far behind the lamp instead;
      turned_deg: its yaw.
    - stays: whether the leader does.
    - silent_s: from when to when the IMU says nothing; none: there is no IMU.
    - told: whether the leader sends its motion, as `modem` says.
    - drawn: returns the kind of one run.
    """

    name: str
    group: str
    what: str
    duration_s: float
    since_s: float = 15.0
    until_s: float = 15.0
    scene: str = "follow"
    lamp: Points = ()
    absorption: Points = ()
    scattering: Points = ()
    plume: float = 0.0
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    dark_s: tuple[float, float] = (np.inf, np.inf)
    blind: tuple[int, ...] = ()
    motion: LeaderPath = leader_twist
    current_m_per_s: Place = (0.0, 0.0, 0.0)
    start_m: Place = (-0.5, -0.2, 0.0)
    behind_m: float | None = None
    turned_deg: float = 0.0
    stays: bool = False
    silent_s: tuple[float, float] = (np.inf, np.inf)
    others: tuple[Beside, ...] = ()
    told: bool = False
    fleet: tuple[Follower, ...] = ALONE
    drawn: "Callable[[Kind, np.random.Generator], Kind] | None" = None

    def dark(self, number: int, t_s: float) -> bool:
        """Say whether the lamp that a follower follows is off at a time, s."""
        return self.dark_s[0] <= t_s < self.dark_s[1] and number in (self.blind or (number,))


class Run(NamedTuple):
    """What one follower of a run did, a row for each image.

    - t_s: ``(n,)``.
    - off_m: distance from its station, ``(n,)``.
    - errors, stds: of the track, m and rad, nan without one, ``(n, 5)``.
    - steered: whether the track steered, ``(n,)``.
    - dark: whether the lamp was off, ``(n,)``.
    - states: their names.
    - reasons: of the states.
    - station_m: from its lamp.
    """

    t_s: Array
    off_m: Array
    errors: Array
    stds: Array
    steered: NDArray[np.bool_]
    dark: NDArray[np.bool_]
    states: list[str]
    reasons: list[str]
    station_m: float


def run_kind(
    kind: Kind,
    seed: int,
    vehicle: Model,
    estimator: Estimator,
    follow: Callable[[FormationSettings], Following] = Following,
    drawn_sea: bool = False,
) -> list[Run]:
    """Run the loop once in a kind of trouble; return what each follower did.

    The `estimator` is of the kind's scene, `vehicle` a key of `MODELS`, the followers' model. Where
    it is to be drawn, the sea of each follower, lamp and array included, is one of the prior's.
    """
    rng = np.random.default_rng(seed)
    if kind.drawn is not None:
        kind = kind.drawn(kind, rng)
    loop = loop_of(kind, seed, vehicle, estimator, rng, follow, drawn_sea)
    steps = [loop.step(STEP_S) for _ in range(round(kind.duration_s / STEP_S))]
    ways = zip(*steps, strict=True)
    return [_recorded(kind, one, list(way)) for one, way in zip(kind.fleet, ways, strict=True)]


def loop_of(
    kind: Kind,
    seed: int,
    vehicle: Model,
    estimator: Estimator,
    rng: np.random.Generator,
    follow: Callable[[FormationSettings], Following] = Following,
    drawn_sea: bool = False,
) -> ClosedLoop:
    """Return the closed loop of a kind; arguments as of `run`."""
    leader = Vehicle(np.zeros(3))
    if kind.motion is not leader_twist:
        leader.limits = OBEDIENT
    model = MODELS[vehicle]
    swimmers: list[Swimmer] = []
    imu = partial(_imu, kind.silent_s) if np.isfinite(kind.silent_s[0]) else _no_imu
    clear, cloudy = _models(kind, estimator, seed)
    places = [np.zeros(3)]
    for one in kind.fleet:
        place = places[one.ahead] + np.array(one.station_m)
        places.append(place)
        start, sea = place + kind.start_m, None
        if drawn_sea:  # apart from the noise, which is the same in either sea
            sea = draw_sea(estimator.scene, np.random.default_rng((seed, 1, one.number)))
        if kind.behind_m is not None:
            start[0] = -kind.behind_m
        swimmers.append(
            Swimmer(
                model(start, yaw=float(np.radians(kind.turned_deg))),
                Pipeline(estimator),
                follow(_law(one.station_m, model.limits)),
                partial(_light, kind, one.number, clear, cloudy, sea),
                one.ahead,
                imu,
                # Its own noise: the images of a kind are those of its twin without a modem.
                modem=Modem(np.random.default_rng((seed, one.number))) if kind.told else _untold,
            )
        )
    motion = PATHS["stand"] if kind.stays else kind.motion
    return ClosedLoop(leader, swimmers, rng, motion, Sea(kind.current_m_per_s))


def _law(station_m: Place, limits: VehicleLimits) -> FormationSettings:
    """Return the settings of an operator who knows what the vehicle's thrusters can hold."""
    surge, sway = limits.speed[:2]
    return FormationSettings(
        station_m=station_m,
        max_surge_m_per_s=min(FormationSettings.max_surge_m_per_s, surge),
        max_sway_m_per_s=min(FormationSettings.max_sway_m_per_s, sway),
    )


def _untold(ahead: Vehicle, t_s: float) -> None:
    return None


def _no_imu(roll: float, t_s: float) -> float:
    return 0.0


def _imu(silent_s: tuple[float, float], roll: float, t_s: float) -> float | None:
    return None if silent_s[0] <= t_s < silent_s[1] else roll


def _models(kind: Kind, estimator: Estimator, seed: int) -> tuple[ForwardModel, ForwardModel]:
    """Return the models of the sea before and in the kind's clouds, which the seed draws."""
    settings = estimator.scene.settings()
    for name, values in kind.effects.items():
        settings["effects"][name] = {**settings["effects"].get(name, {}), **values}
    scene = scene_from_settings(settings, estimator.scene.name)
    own = scene.effects.get("plume", {}).get("depth", 0.0)
    clear = clouded(scene, own, seed)
    return clear, clouded(scene, kind.plume, seed) if kind.plume else clear


def _light(
    kind: Kind,
    number: int,
    clear: ForwardModel,
    cloudy: ForwardModel,
    sea: DrawnSea | None,
    t_s: float,
) -> Light:
    """Return the light of an instant."""
    power = at(kind.lamp, t_s) if kind.lamp else 1.0
    if kind.dark(number, t_s):
        power = 0.0
    scene = clear.scene
    offsets: dict[str, Any] = power_offsets([power], scene.lamp_count)
    if kind.absorption:
        offsets[scene.attenuation[0]] = np.array(at(kind.absorption, t_s))
    if kind.scattering:
        offsets[SCATTERING] = np.log(at(kind.scattering, t_s))
    model = cloudy if kind.since_s <= t_s < kind.until_s else clear
    others = [one for other in kind.others for one in other.vehicle(t_s)]
    return Light(model, offsets, others, sea)


def _recorded(kind: Kind, one: Follower, way: Sequence[Instant]) -> Run:
    """Return what a follower did, by its instants."""
    station = np.array(one.station_m)
    errors, stds = np.full((2, len(way), 5), np.nan)
    for i, instant in enumerate(way):
        track = instant.answer.track
        if track is not None:
            errors[i] = wrapped(track.pose - instant.true_pose)
            stds[i] = np.sqrt(track.covariance.diagonal())
    states = [instant.state.name for instant in way]
    return Run(
        np.round([instant.t_s for instant in way], 6),
        np.array([np.linalg.norm(instant.true_pose[:3] - station) for instant in way]),
        errors,
        stds,
        np.array(
            [
                instant.answer.track is not None
                and not instant.answer.reason
                and instant.state.name == "locked"
                for instant in way
            ]
        ),
        np.array([kind.dark(one.number, instant.t_s) for instant in way]),
        list(states),
        [instant.state.reason for instant in way],
        float(np.linalg.norm(station)),
    )
