"""The likelihood of images at known poses as a function of the parameters of a calibration.

A reading's mean is the gain of its detector times the light of the scene's forward model. Where
poses have errors, all images of a place share its shifts: five, and with several lamps, which show
it, that of the roll. The Schur complement eliminates them, as in bundle adjustment (Triggs et al.
2000): the work grows linearly with the images. Places of several lamps were measured with a tape.
"""

import copy
import dataclasses
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.calibration.aims import appearing
from uuv_optical_array.calibration.parameters import (
    AIMS,
    BACKGROUND,
    BEHIND,
    BOUGHT,
    BY_PRIOR,
    POWER,
    SHAPE,
    SIGMA,
    Layout,
)
from uuv_optical_array.core.geometry import PITCH, Array
from uuv_optical_array.estimation.information.likelihood import information, log_likelihood
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.beam import gaussians_of, of_three
from uuv_optical_array.forward.effects.detectors import detector_gains
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.optics import reading_variance
from uuv_optical_array.forward.prior import OWN_GEOMETRY, ROLL
from uuv_optical_array.forward.scene import Scene, scene_from_settings

BLOCK_READINGS = 100_000
SHAPE_STEP = 1e-4  # of a weight of the beam, of which the light is all but linear
POSE = 6  # slopes by a pose and its roll
UNKNOWN_STD = 1e3  # m and rad: of a part of a pose that is not known


class Unknowns(NamedTuple):
    """The parameters, shape ``(p,)``, and the shift of the pose of each place, ``(k, 5 or 6)``."""

    parameters: Array
    shifts: Array


class CalibrationState(NamedTuple):
    """The likelihood at some unknowns, and what a step from there needs."""

    cost: float  # negative log-likelihood, with the log-prior of the shifts, without constants
    at: Unknowns
    gradient: Array  # of the log-likelihood by the parameters, shifts eliminated, (p,)
    information: Array  # likewise, (p, p)
    mean: Array  # of every reading, counts, (m, n)
    variance: Array  # of every reading, counts^2, (m, n)
    shift_step: Array  # of the shifts at fixed parameters, (k, s); empty where poses are exact
    shift_by_parameters: Array  # its slope by them, (k, s, p)
    shift_decrement: float  # how much `shift_step` lowers the cost, to second order


class CalibrationLikelihood:
    """The likelihood of m images of n readings; arguments as of `calibrate`, places from 0 on."""

    def __init__(
        self,
        scene: Scene,
        images: Array,
        poses: Array,
        rolls: Array,
        pose_std: Array | None,
        places: NDArray[np.intp] | None = None,
        array: DetectorArray | None = None,
    ) -> None:
        settings = scene.settings()
        effects = settings["effects"]
        side = scene.array.detectors_per_side
        gains = np.ones(side * side)
        if responsivity := effects.pop("responsivity", None):
            responsivity.pop("drift_per_c")
            gains = detector_gains(side, **responsivity).ravel()
        faults = effects.pop("detector_faults", {})
        self.faulty: NDArray[np.bool_] = np.zeros((side, side), dtype=bool)
        for row, column in (*faults.get("dead", ()), *faults.get("stuck", ())):
            self.faulty[row, column] = True
        self.faulty = self.faulty.ravel()
        effects.setdefault("ambient", {"level_counts": 0.0})
        effects.pop("pedestal", None)
        if "demodulation" in effects:
            effects["demodulation"]["pedestal_counts"] = 0.0
        settings["prior"] = {key: getattr(scene.prior, key) for key in BY_PRIOR}
        self.scene = scene_from_settings(settings, scene.name)
        self.model, original = ForwardModel(self.scene), ForwardModel(scene)
        if array is not None:
            self.model.array = array
        self.power, noise = original.power, original.noise
        self.start_gains = gains
        self.readings: Array = images.reshape(len(images), -1) - noise.black
        self.poses, self.rolls = poses, rolls
        self.places = np.arange(len(poses)) if places is None else places
        self.pose_std = pose_std
        self._lamps = scene.lamp_count
        shifts = [*range(5), PITCH] if scene.lamps else [*range(5)]
        self._shifts = len(shifts)
        if pose_std is not None:
            _, first = np.unique(self.places, return_index=True)
            self.pose_std = np.broadcast_to(pose_std, poses.shape)[first][:, shifts]
        self.used: NDArray[np.bool_] = np.broadcast_to(self.works, self.readings.shape).copy()
        self.layout = Layout(self.scene)
        lacking = {*AIMS, *SHAPE, BEHIND, *self.layout.lacking}
        self._own = [i for i in range(self.layout.gains) if i not in lacking]
        self._of_model = self.start()[: self.layout.gains]
        self._of_model[POWER] = np.log(self.model.power)
        self.taped = self.layout.own[:, 1:4].ravel()
        # How well these places of lamps are known without images: as a rig as bought, or worse.
        self.tape_std_m = max(scene.prior.lamps_place_std_m, BOUGHT["lamps_place_std_m"])
        self._of_model[BACKGROUND], floors = self._levels()
        self._of_model[self.layout.own[:, -1]] = floors
        # Without the prior's spread of the gains, which are fitted, and without the pedestal.
        low, high = noise.low - noise.black, noise.high - noise.black
        self.noise = noise._replace(black=0.0, low=low, high=high)
        self._own_square = original.analogue_noise.square
        self.widen(scene.prior.beam_shape_std)

    def with_shape(self) -> "CalibrationLikelihood":
        """Return the likelihood with the shape of the beam among its parameters."""
        other = copy.copy(self)
        other.scene = dataclasses.replace(self.scene, lamp=of_three(self.scene.lamp))
        other.model, other.layout = ForwardModel(other.scene), Layout(other.scene)
        other.model.array = self.model.array
        return other

    def widen(self, shape_std: float) -> None:
        """Let readings differ by so much, relative to the light, from the shape of the beam."""
        self.shape_std = shape_std
        self.noise = self.noise._replace(square=shape_std**2 + self._own_square)

    @property
    def works(self) -> NDArray[np.bool_]:
        """Whether the detector of a reading works, shape ``(n,)``."""
        return np.tile(~self.faulty, self._lamps)

    def start(self) -> Array:
        """Return the parameters of the scene, gauge included, shape ``(p,)``."""
        gains = np.maximum(self.start_gains, 1e-3)
        scene, works = self.scene, ~self.faulty
        _, attenuation = scene.attenuation
        level, floors = self._levels()
        narrow, _, wide = self.layout.gaussians
        common = np.exp(np.log(gains[works]).mean()) if works.any() else 1.0
        return np.array(
            [
                np.log(self.power * common),
                np.log(scene.lamp.beam_sigma_deg),
                attenuation,
                np.log(scene.effects.get("sea", {}).get("scattering_per_m", 1.0)),
                scene.effects.get("field_of_view", {}).get("cosine_power", 1.0),
                np.log(scene.array.radius_m or 1.0),
                *np.zeros(len(AIMS)),
                0.0 if BACKGROUND in self.layout.lacking else level * common,
                *gaussians_of(scene.lamp)[0][[narrow, wide]],
                scene.lamp.behind_m,
                *(
                    own
                    for lamp, floor in zip(scene.lamps, floors, strict=True)
                    for own in (np.log(lamp.power), *_geometry(lamp), floor * common)
                ),
                *np.log(gains / common),
            ]
        )

    def _levels(self) -> tuple[float, list[float]]:
        """Return the background of the scene, counts, and the floor of each of several lamps."""
        scene = self.scene
        daylight = scene.effects["ambient"]["level_counts"]
        level = scene.lamp.floor_counts if self.layout.modulated else daylight
        return float(level), [lamp.floor_counts for lamp in scene.lamps]

    def background(self, parameters: Array) -> Array:
        """Return what is no light straight from a lamp, counts, of each reading, ``(n,)``."""
        layout = self.layout
        gains = np.exp(parameters[layout.gains :])
        floors = parameters[layout.own[:, -1]] if len(layout.own) else parameters[[BACKGROUND]]
        return np.outer(floors, gains).ravel()

    def apparent(self, parameters: Array, poses: Array, rolls: Array) -> tuple[Array, Array, Array]:
        """Return poses and rolls as they appear, with slopes by those given, as `appearing`."""
        seen, seen_rolls, by_seen = appearing(
            poses, rolls, parameters[AIMS], self.scene.array.bow_m
        )
        seen[:, 0] -= parameters[BEHIND] - self.scene.lamp.behind_m
        return seen, seen_rolls, by_seen

    def unshifted(self, parameters: Array) -> Unknowns:
        """Return unknowns with the poses as they were recorded."""
        return Unknowns(parameters, np.zeros((self.places.max() + 1, self._shifts)))

    def light(self, parameters: Array, poses: Array, rolls: Array) -> tuple[Array, Array]:
        """Return the light before the gains, ``(m, n)``, and its slopes, ``(m, n, 6 + gains)``.

        These are by pose and roll (6), and by the parameters before the gains.
        """
        names, turned = self.layout.names, {ROLL: np.zeros(len(poses))} if self.scene.lamps else {}
        sigma_deg = float(np.exp(parameters[SIGMA]))
        offsets = parameters[: self.layout.gains] - self._of_model
        offsets[SIGMA] = sigma_deg - self.scene.lamp.beam_sigma_deg
        seen, seen_rolls, by_seen = self.apparent(parameters, poses, rolls)
        own = {**turned, **{names[i]: np.full(len(poses), offsets[i]) for i in self._own}}
        shape = self._shape(parameters[list(SHAPE)])
        light, by_own = self.model.with_beam(shape).linearised(seen, seen_rolls, own)
        motions = 5 + len(turned)
        slopes = np.zeros((*light.shape, POSE + self.layout.gains))
        slopes[..., [POSE + i for i in self._own]] = by_own[..., motions:]
        by_given = by_own[..., :motions] @ by_seen[:, :motions]
        slopes[..., [*range(POSE), *(POSE + i for i in AIMS)]] = by_given
        slopes[..., POSE + SIGMA] *= sigma_deg
        slopes[..., POSE + BEHIND] = -by_own[..., 0]  # the follower is nearer by as much
        for i, off in zip(SHAPE, SHAPE_STEP * np.eye(2), strict=True):
            if i not in self.layout.lacking:
                wider = self._shape(parameters[list(SHAPE)] + off)
                there = self.model.with_beam(wider).light(seen, seen_rolls, own)
                slopes[..., POSE + i] = (there.reshape(light.shape) - light) / SHAPE_STEP
        return light, slopes

    def beam(self, parameters: Array) -> dict[str, list[float]]:
        """Return the shape of the beam as keys of a scene's lamp."""
        widths = self.scene.lamp.beam_widths or ()
        weights, _ = self._shape(parameters[list(SHAPE)])[:, : len(widths)]
        rounded = [round(weight, 9) for weight in weights.tolist()]
        return {"beam_widths": list(widths), "beam_weights": rounded}

    def _shape(self, weights: Array) -> Array:
        """Return the beam's Gaussians with weights of the narrowest and the widest."""
        narrow, middle, wide = self.layout.gaussians
        shape = gaussians_of(self.scene.lamp).copy()
        for i, place, weight in zip(SHAPE, (narrow, wide), weights.tolist(), strict=True):
            if i not in self.layout.lacking:
                shape[0, middle] += shape[0, place] - weight
                shape[0, place] = weight
        return shape

    @np.errstate(under="ignore")
    def evaluate(self, at: Unknowns, expected: bool = False) -> CalibrationState:
        """Return the likelihood, with Fisher's `expected` information or that of Gauss-Newton."""
        parameters, shifts = at
        count, pixels = self.readings.shape
        size, first = len(parameters), self.layout.gains
        gains = np.tile(np.exp(parameters[first:]), self._lamps)
        cost, gradient, joint = 0.0, np.zeros(size), np.zeros((size, size))
        mean, variance = np.empty((2, count, pixels))
        free, shift_decrement = self.pose_std is not None, 0.0
        many = len(shifts) if free else 0
        inner: Array = np.zeros((many, self._shifts, self._shifts))
        cross: Array = np.zeros((many, size, self._shifts))
        pull: Array = np.zeros((many, self._shifts))
        shift_step: Array = pull
        by_parameters: Array = np.swapaxes(cross, 1, 2)
        block = max(1, BLOCK_READINGS // pixels)
        diagonal = np.arange(first, size)
        for start in range(0, count, block):
            part = slice(start, start + block)
            moved = shifts[self.places[part]]
            poses, rolls = self.poses[part] + moved[:, :5], self.rolls[part] + moved[:, 5:].sum(1)
            light, slopes = self.light(parameters, poses, rolls)
            mean[part] = light * gains
            slopes *= gains[:, None]
            variance[part] = reading_variance(mean[part], self.noise)
            values, score, weight = log_likelihood(self.readings[part], mean[part], self.noise)
            if expected:
                weight = information(mean[part], self.noise)
            used = self.used[part]
            score, weight = score * used, weight * used
            cost -= float(values[used].sum())
            lamp = slopes[..., POSE:]
            weighted = lamp * weight[..., None]
            own = mean[part]  # the slope by the logarithm of the gain
            gradient[:first] += np.einsum("mn,mni->i", score, lamp)
            gradient[first:] += self._by_detector((score * own).sum(axis=0))
            joint[:first, :first] += np.einsum("mni,mnj->ij", weighted, lamp)
            crossed = np.einsum("mni,mn->ni", weighted, own)
            joint[:first, first:] += self._by_detector(crossed).T
            joint[diagonal, diagonal] += self._by_detector((weight * own**2).sum(axis=0))
            if free:
                equations = self._shift_equations(slopes, own, score, weight)
                for total, each in zip((inner, cross, pull), equations, strict=True):
                    np.add.at(total, self.places[part], each)
        if self.pose_std is not None:
            precision = self.pose_std**-2.0
            cost += 0.5 * float((shifts**2 * precision).sum())
            pull -= shifts * precision
            inverse: Any = np.linalg.inv(inner + precision[:, None] * np.eye(self._shifts))
            shift_step = np.einsum("mij,mj->mi", inverse, pull)
            shift_decrement = 0.5 * float((pull * shift_step).sum())
            by_parameters = -inverse @ np.swapaxes(cross, 1, 2)
            gradient -= np.einsum("mpi,mi->p", cross, shift_step)
            joint += np.swapaxes(cross, 0, 1).reshape(size, -1) @ by_parameters.reshape(-1, size)
        off = parameters[self.taped] - self._of_model[self.taped]
        cost += 0.5 * float((off**2).sum()) / self.tape_std_m**2
        gradient[self.taped] -= off / self.tape_std_m**2
        joint[self.taped, self.taped] += self.tape_std_m**-2.0
        joint[first:, :first] = joint[:first, first:].T
        shift = shift_step, by_parameters, shift_decrement
        return CalibrationState(cost, at, gradient, joint, mean, variance, *shift)

    def residuals(self, state: CalibrationState) -> Array:
        """Return readings less their mean, clipped to the limits, in standard deviations."""
        clipped = np.clip(state.mean, self.noise.low, self.noise.high)
        return (self.readings - clipped) / np.sqrt(state.variance)

    def uncensored(self, state: CalibrationState) -> NDArray[np.bool_]:
        """Say which means are 3 standard deviations off both limits, shape ``(m, n)``."""
        margin = 3 * np.sqrt(state.variance)
        above = state.mean - margin > self.noise.low
        return above & (state.mean + margin < self.noise.high)

    def _by_detector(self, values: Array) -> Array:
        """Return the sum over the lamps of values by reading, shape ``(n, ...)``."""
        return np.asarray(values.reshape(self._lamps, -1, *values.shape[1:]).sum(axis=0))

    def _shift_equations(
        self, slopes: Array, own: Array, score: Array, weight: Array
    ) -> tuple[Array, Array, Array]:
        """Return the shifts' information, theirs with the parameters, and the score, by image."""
        by_pose, lamp = slopes[..., : self._shifts], slopes[..., POSE:]
        weighted = by_pose * weight[..., None]
        by_gain = np.stack([self._by_detector(each) for each in own[..., None] * weighted])
        cross = np.concatenate([np.swapaxes(lamp, 1, 2) @ weighted, by_gain], axis=1)
        return np.swapaxes(weighted, 1, 2) @ by_pose, cross, (score[:, None, :] @ by_pose)[:, 0]


_geometry = attrgetter(*OWN_GEOMETRY)
