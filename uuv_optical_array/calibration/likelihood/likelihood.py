"""The likelihood of images at known poses as a function of the parameters of a calibration.

A reading's mean is the gain of its detector times the light of the scene's forward model. Where
poses have errors, all images of a place share its shifts: five, and with several lamps, which show
it, that of the roll. The Schur complement eliminates them, as in bundle adjustment (Triggs et al.
2000): the work grows linearly with the images. Places of several lamps were measured with a tape.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.calibration.likelihood.expected_light import POSE, ExpectedLight
from uuv_optical_array.calibration.likelihood.parameters import BOUGHT
from uuv_optical_array.core.geometry import PITCH, Array
from uuv_optical_array.estimation.information.likelihood import information, log_likelihood
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.noise import reading_variance
from uuv_optical_array.forward.scene import Scene

BLOCK_READINGS = 100_000
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


class CalibrationLikelihood(ExpectedLight):
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
        super().__init__(scene, array)
        original = self.original
        noise = original.noise
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
        self.taped = self.layout.own[:, 1:4].ravel()
        # How well these places of lamps are known without images: as a rig as bought, or worse.
        self.tape_std_m = max(scene.prior.lamps_place_std_m, BOUGHT["lamps_place_std_m"])
        # Without the prior's spread of the gains, which are fitted, and without the pedestal.
        low, high = noise.low - noise.black, noise.high - noise.black
        self.noise = noise._replace(black=0.0, low=low, high=high)
        self._own_square = original.analogue_noise.square
        self.widen(scene.prior.beam_shape_std)

    def widen(self, shape_std: float) -> None:
        """Let readings differ by so much, relative to the light, from the shape of the beam."""
        self.shape_std = shape_std
        self.noise = self.noise._replace(square=shape_std**2 + self._own_square)

    @property
    def works(self) -> NDArray[np.bool_]:
        """Whether the detector of a reading works, shape ``(n,)``."""
        return np.tile(~self.faulty, self._lamps)

    def unshifted(self, parameters: Array) -> Unknowns:
        """Return unknowns with the poses as they were recorded."""
        return Unknowns(parameters, np.zeros((self.places.max() + 1, self._shifts)))

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
            lamp = slopes[..., POSE:].reshape(-1, first)
            weighted = lamp * weight.reshape(-1, 1)
            own = mean[part]  # the slope by the logarithm of the gain
            gradient[:first] += score.ravel() @ lamp
            gradient[first:] += self._by_detector((score * own).sum(axis=0))
            joint[:first, :first] += weighted.T @ lamp
            crossed = np.einsum("mni,mn->ni", weighted.reshape(*own.shape, first), own)
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
            crossed = np.swapaxes(cross, 0, 1).reshape(size, -1)
            gradient -= crossed @ shift_step.ravel()
            joint += crossed @ by_parameters.reshape(-1, size)
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
        by_reading = own[..., None] * weighted
        by_gain = by_reading.reshape(len(own), self._lamps, -1, self._shifts).sum(axis=1)
        cross = np.concatenate([np.swapaxes(lamp, 1, 2) @ weighted, by_gain], axis=1)
        return np.swapaxes(weighted, 1, 2) @ by_pose, cross, (score[:, None, :] @ by_pose)[:, 0]
