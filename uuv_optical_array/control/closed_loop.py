"""The whole loop without ROS: vehicles, sea, lamps, arrays, estimators, tracks and laws."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from uuv_optical_array.control.following import Following, State
from uuv_optical_array.control.leader.motion import Glow
from uuv_optical_array.control.leader.told_motion import Message
from uuv_optical_array.control.vehicles.leader_path import LeaderPath, lead, leader_twist
from uuv_optical_array.control.vehicles.sea import STILL_SEA, Sea
from uuv_optical_array.control.vehicles.vehicle import Vehicle
from uuv_optical_array.core.errors import NoPose
from uuv_optical_array.core.geometry import Array, relative_pose
from uuv_optical_array.estimation.pipeline import Answer, Pipeline
from uuv_optical_array.estimation.signature.faint_light import FaintLight
from uuv_optical_array.estimation.tracking.track import RATE
from uuv_optical_array.forward.drawn_sea import DrawnSea
from uuv_optical_array.forward.lamp.lamps import together
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.others import Other, sight
from uuv_optical_array.forward.scene import Scene, load_scene, scene_from_settings

CLOUDS = "night_plume"  # the ready scene whose clouds drift where a scene has none


class Light(NamedTuple):
    """What images are made from at an instant, independent of the estimator.

    - model: of the true scene.
    - offsets: of its nuisances, as `ForwardModel.light` has them.
    - others: vehicles with lamps beside leader and followers, in the frame of the lamp to follow
      instead of the world's.
    - sea: by what the follower's sea differs from the scene beside; ``None``: by nothing.
    """

    model: ForwardModel
    offsets: Mapping[str, Array] = MappingProxyType({})
    others: Sequence[Other] = ()
    sea: DrawnSea | None = None


class Swimmer:
    """A follower: its vehicle, what makes its images, and what answers them.

    Parameters
    ----------
    vehicle
        At its start.
    pipeline
        From its images to its track.
    following
        From its track to its command.
    light
        Of an instant, s since the start of the loop.
    ahead
        Whose lamp it follows: 0 is the leader's, k that of the k-th follower.
    imu
        Roll that its estimator is given of its true one, rad, and the time, s; ``None``: the IMU is
        silent, and its last roll counts.
    sounder
        Range from the lamp and its standard deviation, m, that its estimator is given of the true
        one, m, and the time, s; ``None``: there is none then.
    modem
        Message of its motion that the vehicle it follows sends, as it arrives at the time, s;
        ``None``: nothing.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        pipeline: Pipeline,
        following: Following,
        light: Callable[[float], Light],
        ahead: int = 0,
        imu: Callable[[float, float], float | None] = lambda roll, t_s: 0.0,
        sounder: Callable[[float, float], tuple[float, float] | None] = lambda range_m, t_s: None,
        modem: Callable[[Vehicle, float], Message | None] = lambda ahead, t_s: None,
    ) -> None:
        self.vehicle, self.pipeline, self.following = vehicle, pipeline, following
        self.light, self.ahead, self.imu = light, ahead, imu
        self.sounder, self.modem = sounder, modem
        self.command: tuple[Array, Array] = np.zeros(3), np.zeros(3)
        self.roll = 0.0  # of the last IMU message
        self.faint = FaintLight(pipeline.estimator.scene.array.detectors_per_side)


class Instant(NamedTuple):
    """What a follower saw and did at an instant.

    - t_s: since the start of the loop, s.
    - true_pose: of the follower in the frame of the lamp that it follows, m and rad, ``(5,)``.
    - image: counts, ``(side, side)``.
    - answer: to the image; its reason says too why the law refused the track.
    - state: of its law.
    - lamp: position, m, and rotation in the world of the lamp that it follows.
    - commanded: linear and angular twist from now on, m/s and rad/s, ``(3,)`` each.
    """

    t_s: float
    true_pose: Array
    image: Array
    answer: Answer
    state: State
    lamp: tuple[Array, Array]
    commanded: tuple[Array, Array]


class ClosedLoop:
    """A leader that moves, and followers that keep station by its light or by one another's.

    As on ROS the leader waits until every follower is locked, and the sea is still until then.

    Parameters
    ----------
    leader
        At its start, with the lamp at its origin.
    followers
        One or more.
    rng
        Of the noise of the images.
    motion
        Of the leader over ground, by its time on the path, s; it steers against the current.
    sea
        That carries all vehicles.
    """

    def __init__(
        self,
        leader: Vehicle,
        followers: Sequence[Swimmer],
        rng: np.random.Generator,
        motion: LeaderPath = leader_twist,
        sea: Sea = STILL_SEA,
    ) -> None:
        self.leader, self.followers, self.motion, self.sea = leader, followers, motion, sea
        self._rng = rng
        self.t_s = 0.0
        self.path_s: float | None = None  # on the leader's path, once all followers are locked

    def step(self, dt: float) -> list[Instant]:
        """Advance by `dt`, s, > 0; return what each follower saw and did then."""
        if self.path_s is not None:
            for vehicle in (self.leader, *(swimmer.vehicle for swimmer in self.followers)):
                vehicle.sea = self.sea
            self.path_s = lead(self.leader, self.path_s, dt, self.motion)
        for swimmer in self.followers:
            swimmer.vehicle.step(*swimmer.command, dt)
        self.t_s += dt
        seen = [self._answer(swimmer) for swimmer in self.followers]
        if self.path_s is None and all(one.state.name == "locked" for one in seen):
            self.path_s = 0.0
        return seen

    def _answer(self, swimmer: Swimmer) -> Instant:
        """Let a follower see, and command."""
        vehicle, stamp_ns = swimmer.vehicle, round(self.t_s * 1e9)
        lamp = self._ahead(swimmer).position, self._ahead(swimmer).rotation
        pose, roll = relative_pose(*lamp, vehicle.position, vehicle.rotation)
        image = self._image(swimmer, pose, roll)
        sounded = swimmer.sounder(float(np.linalg.norm(pose[:3])), self.t_s)
        if sounded is not None:
            with suppress(NoPose, ValueError):  # without light, or no range at all
                swimmer.pipeline.range(stamp_ns, *sounded)
        told = swimmer.imu(vehicle.roll, self.t_s)
        if told is not None:
            swimmer.roll = told
        message = swimmer.modem(self._ahead(swimmer), self.t_s)
        if message is not None:
            with suppress(ValueError):  # it is refused
                swimmer.following.leader_moves(self.t_s, message)
        answer = swimmer.pipeline.answer(stamp_ns, image, swimmer.roll)
        lit = swimmer.pipeline.lit(image)
        swimmer.following.looked(self.t_s, glow(image) if lit else None)
        faint = None if lit else swimmer.faint.look(self.t_s, together(image))
        if faint is not None:
            swimmer.following.glimmered(self.t_s, glow(faint))
        track = answer.track
        if track is not None:
            try:
                swimmer.following.update(
                    self.t_s,
                    track.pose,
                    track.covariance,
                    track.rate,
                    track.joint_covariance[RATE, RATE],
                )
            except (NoPose, ValueError) as reason:
                answer = answer._replace(reason=str(reason))
        command = swimmer.following.command(self.t_s)
        if command is not None:
            swimmer.pipeline.command(stamp_ns, *command)
        # A vehicle without a command stops.
        swimmer.command = (np.zeros(3), np.zeros(3)) if command is None else command
        state = swimmer.following.state
        return Instant(self.t_s, pose, image, answer, state, lamp, swimmer.command)

    def _image(self, swimmer: Swimmer, pose: Array, roll: float) -> Array:
        """Return what a follower's array reads of all lamps, each with its code, behind bodies."""
        model, offsets, others, sea = swimmer.light(self.t_s)
        own, ahead = swimmer.vehicle, self._ahead(swimmer)
        vehicles = [self.leader, *(follower.vehicle for follower in self.followers)]
        known = [
            Other(vehicle.position, vehicle.rotation, code=code)
            for code, vehicle in enumerate(vehicles)
            if vehicle is not own and vehicle is not ahead
        ]
        known += [
            dataclasses.replace(
                other,
                position=ahead.position + ahead.rotation @ other.position,
                rotation=ahead.rotation @ other.rotation,
            )
            for other in others
        ]
        if not known and sea is None:
            return model.read(model.light(pose, roll, offsets, self.t_s), self._rng)
        lamp = Other(ahead.position, ahead.rotation, code=swimmer.ahead)
        seen = sight(model, (own.position, own.rotation), lamp, known, offsets, self.t_s, sea)
        return model.read(seen.light, self._rng, seen.beside)

    def _ahead(self, swimmer: Swimmer) -> Vehicle:
        """Return the vehicle whose lamp a follower follows."""
        return self.followers[swimmer.ahead - 1].vehicle if swimmer.ahead else self.leader


def glow(image: Array) -> Glow:
    """Return where an image, ``(side, side)``, is brightest."""
    row, column = np.unravel_index(int(image.argmax()), image.shape)
    half = max((image.shape[1] - 1) / 2, 0.5)
    return Glow(
        1 - float(column) / half, 1 - float(row % image.shape[1]) / half, float(image.max())
    )


def clouded(scene: Scene, depth: float, seed: int | None = None) -> ForwardModel:
    """Return the model of a scene whose clouds have another depth in their middle; 0: no clouds.

    A scene without clouds has those of `CLOUDS`. A `seed` draws others.
    """
    settings = scene.settings()
    effects = settings["effects"]
    clouds = effects.pop("plume", None) or load_scene(CLOUDS).effects["plume"]
    if depth > 0:
        effects["plume"] = {**clouds, "depth": depth}
        if seed is not None:
            effects["plume"]["seed"] = seed
    return ForwardModel(scene_from_settings(settings, scene.name))
