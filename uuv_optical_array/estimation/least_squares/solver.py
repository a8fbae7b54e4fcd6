"""The pose that makes the whole image most probable, from several starts at once."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.least_squares.coordinates import Chart
from uuv_optical_array.estimation.likelihood import log_likelihood
from uuv_optical_array.forward.model import ForwardModel

MAX_STEP = 0.3  # in every coordinate of the chart: farther, the linear model is no guide
MAX_ITERATIONS = 40
# Newton decrement from which the next step arrives: it is a tenth of a standard deviation, and
# what it leaves is second order of that.
ARRIVED = 5e-3
# Fits closer together than this, in standard deviations, are in one minimum.
DISTINCT = 3.0
TINY = 1e-6  # counts, inside of a limit


@dataclass(frozen=True)
class Prior:
    """A Gaussian prior, independent by parameter.

    Parameters
    ----------
    pose_mean, pose_std
        Of x, y, z, pitch and yaw, m and rad, shape ``(5,)`` each.
    nuisance_std
        Of the offset of each setting that is estimated along, by name; the mean is 0.
    """

    pose_mean: Array
    pose_std: Array
    nuisance_std: Mapping[str, float]


@dataclass(frozen=True)
class Fit:
    """One refined start.

    Parameters
    ----------
    pose
        The most probable pose, m and rad, shape ``(5,)``.
    coordinates
        The same in the chart, then the offsets of the nuisances, shape ``(p,)``.
    information
        Of the coordinates, prior included, shape ``(p, p)``.
    cost
        Negative log-posterior, without constants.
    """

    pose: Array
    coordinates: Array
    information: Array
    cost: float


class Evaluation(NamedTuple):
    """The posterior of an image at places of the chart.

    Parameters
    ----------
    cost
        As that of a `Fit`, shape ``(k,)``.
    gradient
        Of the opposite of the cost by the coordinates, shape ``(k, p)``.
    information
        As that of a `Fit`, shape ``(k, p, p)``.
    poses
        m and rad, shape ``(k, 5)``.
    log_volume
        Of the poses that a unit volume of the chart holds, shape ``(k,)``.
    """

    cost: Array
    gradient: Array
    information: Array
    poses: Array
    log_volume: Array


def _cost(fit: Fit) -> float:
    return fit.cost


class ImageFit:
    """Fit images by damped Gauss-Newton on the exact likelihood (Levenberg and Marquardt).

    Parameters
    ----------
    model
        The scene's forward model.
    prior
        What is known before the image: wide for the pose, as given for the nuisances.

    Attributes
    ----------
    chart : Chart
        In which the fit moves.
    names : tuple of str
        Nuisances that are estimated along; their offsets follow the chart's coordinates.
    mean, std
        Of the prior: pose, then nuisances, shape ``(p,)``.
    reach
        Longest step by coordinate, shape ``(p,)``.
    """

    def __init__(self, model: ForwardModel, prior: Prior) -> None:
        self.model = model
        self.prior = prior
        self.names = tuple(prior.nuisance_std)
        effects = model.scene.effects
        self.chart = Chart(
            model.array.positions.mean(axis=0),
            float(np.radians(model.scene.lamp.beam_sigma_deg)),
            effects.get("attenuation", {}).get("k_per_m", 0.0),
            model.scene.array.shape == "planar",
        )
        nuisance_std = np.array(list(prior.nuisance_std.values()))
        self.std = np.concatenate([prior.pose_std, nuisance_std])
        self.mean = np.concatenate([prior.pose_mean, np.zeros(len(nuisance_std))])
        self.reach = np.concatenate([np.full(5, MAX_STEP), 2 * nuisance_std])
        self._dark_std = float(np.sqrt(model.variance(np.zeros(1))[0][0]))

    def _offsets(self, coordinates: Array) -> dict[str, Array]:
        return {name: coordinates[..., 5 + i] for i, name in enumerate(self.names)}

    @np.errstate(under="ignore")  # light too dim for a float64 is no light
    def evaluate(
        self, readings: Array, coordinates: Array, roll: float, mean: Array | None = None
    ) -> Evaluation:
        """Evaluate the posterior, with derivatives.

        Parameters
        ----------
        readings
            Counts, finite, shape ``(n,)`` or, those of each place, ``(k, n)``.
        coordinates
            In the chart, then the nuisances, shape ``(k, p)``.
        roll
            Roll of the follower, rad.
        mean
            Of the prior: pose, then nuisances, shape ``(p,)`` or ``(k, p)``; ``None``: its own.

        Returns
        -------
        Evaluation
            Of k places.
        """
        mean = self.mean if mean is None else mean
        chart = self.chart.to_lamp(coordinates[:, :5], roll)
        lamp, axis, by_chart, poses, pose_by_chart, log_volume = chart
        light, by_lamp = self.model.linearised_by_lamp(lamp, axis, self._offsets(coordinates))
        variance, slope = self.model.variance(light)
        value, score, curvature = log_likelihood(
            readings, light, variance, slope, self.model.limits
        )
        jacobian = by_lamp[..., :6] @ by_chart
        # The prior is another five readings, of the pose, and one of each nuisance.
        off, by_coordinate = poses, pose_by_chart
        if self.names:
            jacobian = np.concatenate([jacobian, by_lamp[..., 6:]], axis=-1)
            off = np.concatenate([poses, coordinates[:, 5:]], axis=-1)
            by_coordinate = np.zeros((len(off), len(self.std), len(self.std)))
            by_coordinate[:, :5, :5] = pose_by_chart
            by_coordinate[:, 5:, 5:] = np.eye(len(self.names))
        off = (off - mean) / self.std
        by_coordinate = by_coordinate / self.std[:, None]
        gradient = (score[:, None, :] @ jacobian - off[:, None, :] @ by_coordinate)[:, 0, :]
        information = np.swapaxes(jacobian * curvature[..., None], -1, -2) @ jacobian
        information += np.swapaxes(by_coordinate, -1, -2) @ by_coordinate
        cost = 0.5 * (off * off).sum(axis=1) - value
        return Evaluation(cost, gradient, information, poses, log_volume)

    @np.errstate(under="ignore")
    def refine(self, readings: Array, starts: Array, roll: float = 0.0) -> list[Fit]:
        """Refine poses until each is the most probable nearby.

        Parameters
        ----------
        readings
            Counts, finite, shape ``(n,)``, row-major.
        starts
            Poses to start from, m and rad, shape ``(k, 5)``, k >= 1.
        roll
            Roll of the follower, rad.

        Returns
        -------
        list of Fit
            One for each start whose likelihood is finite, best first; a planar array's also
            from where it would see nearly what it sees at the best.
        """
        coordinates: Array = np.zeros((len(starts), 5 + len(self.names)))
        coordinates[:, :5] = self.chart.from_pose(starts, roll)
        fits = self._fits_from(readings, coordinates, roll)
        if fits and len(others := self.chart.lookalikes(fits[0].coordinates)):
            fits = sorted(fits + self._fits_from(readings, others, roll), key=_cost)
        return fits

    def _fits_from(
        self, readings: Array, coordinates: Array, roll: float, mean: Array | None = None
    ) -> list[Fit]:
        """Refine coordinates, shape ``(k, p)``, in place; best first.

        Readings and the prior's mean may be those of each start, ``(k, n)`` and ``(k, p)``.
        """
        cost, information, poses = self.descend(readings, coordinates, roll, mean)
        fits = [
            Fit(poses[i], coordinates[i], information[i], float(cost[i]))
            for i in np.flatnonzero(np.isfinite(cost))
        ]
        return sorted(fits, key=_cost)

    def descend(
        self, readings: Array, coordinates: Array, roll: float, mean: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Move coordinates, in place, to where each is most probable nearby.

        Parameters
        ----------
        readings, coordinates, roll, mean
            As in `evaluate`.

        Returns
        -------
        cost, information : Array
            As those of a `Fit`, shapes ``(k,)`` and ``(k, p, p)``.
        poses : Array
            m and rad, shape ``(k, 5)``.
        """
        count, size = coordinates.shape
        now = self.evaluate(readings, coordinates, roll, mean)
        cost, gradient, information, *_ = now
        damping: Array = np.full(count, 1e-3)
        arrived: NDArray[np.bool_] = np.zeros(count, dtype=bool)
        diagonal = np.arange(size)
        for _ in range(MAX_ITERATIONS):
            damped = information.copy()
            damped[:, diagonal, diagonal] *= 1 + damping[:, None]
            step = np.linalg.solve(damped, gradient[..., None])[..., 0]
            decrement = 0.5 * (gradient * step).sum(axis=1)
            # A heavily damped step is short wherever it is taken, so it proves nothing.
            last = (decrement < ARRIVED) & (damping < 1e-1) & ~arrived
            coordinates[last] += step[last]
            cost[last] -= decrement[last]
            arrived |= last
            if arrived.all():
                break
            excess = (np.abs(step) / self.reach).max(axis=1)
            step /= np.maximum(excess, 1.0)[:, None]
            trial = coordinates + step
            new = self.evaluate(readings, trial, roll, mean)
            gain = np.where(arrived, 0.0, cost - new.cost)
            better = gain > 0
            coordinates[better] = trial[better]
            for mine, other in zip(now, new, strict=True):
                mine[better] = other[better]
            # On the edge where a detector turns away from the lamp the slope jumps, and a fit
            # that sits there gains nothing either way.
            arrived |= (better & (gain < ARRIVED)) | (damping > 1e4)
            damping = np.where(better, damping * 0.1, damping * 10)
        poses, *_ = self.chart.to_pose(coordinates[:, :5], roll)
        return cost, information, poses

    @np.errstate(under="ignore")
    def randomised(
        self, readings: Array, fits: list[Fit], noise: Array, pull: Array, roll: float
    ) -> Array:
        """Fit images and priors that might as well have been, each from one of the fits in turn.

        What comes out is spread much as the posterior is, along all its bends: were the model
        linear, it would be a sample of it (D. Oliver, N. He and A. Reynolds, 1996).

        Parameters
        ----------
        readings
            Counts, shape ``(n,)``; those at a limit stay there.
        fits
            Fits to them, one at least.
        noise, pull
            Standard normal numbers for readings and prior, shape ``(k, n)`` and ``(k, p)``.
        roll
            Roll of the follower, rad.

        Returns
        -------
        Array
            Coordinates and nuisances, shape ``(at most k, p)``.
        """
        limits = self.model.limits
        starts = np.stack([fit.coordinates for fit in fits])[np.arange(len(noise)) % len(fits)]
        variance, _ = self.model.variance(self.light(fits[0].coordinates, roll))
        moved = np.clip(readings + np.sqrt(variance) * noise, limits.low + TINY, limits.high - TINY)
        free = (readings > limits.low) & (readings < limits.high)
        mean = self.mean + pull * self.std
        found = self._fits_from(np.where(free, moved, readings), starts.copy(), roll, mean)
        return np.stack([fit.coordinates for fit in found]) if found else starts

    def light(self, coordinates: Array, roll: float) -> Array:
        """Return the light of the readings at one place.

        Parameters
        ----------
        coordinates
            In the chart, then the nuisances, shape ``(p,)``.
        roll
            Roll of the follower, rad.

        Returns
        -------
        Array
            Counts, shape ``(n,)``.
        """
        _, lamp, axis, _ = self.chart.to_pose(coordinates[:5], roll)
        return self.model.light_by_lamp(lamp, axis, self._offsets(coordinates)).ravel()

    def lit(self, readings: Array) -> int:
        """Count the readings, shape ``(n,)``, that are clearly lit and not at a limit."""
        seen = (readings > 3 * self._dark_std) & (readings < self.model.limits.high)
        return int(np.count_nonzero(seen))

    @np.errstate(under="ignore")
    def misfit(self, readings: Array, fit: Fit, roll: float) -> float:
        """Return the mean squared residual of a fit, in standard deviations of a reading.

        A censored reading counts by how far the light is from where it would not be censored.
        """
        light = self.light(fit.coordinates, roll)
        variance, _ = self.model.variance(light)
        expected = np.clip(light, self.model.limits.low, self.model.limits.high)
        return float(np.mean((readings - expected) ** 2 / variance))

    @np.errstate(under="ignore")
    def cost(self, readings: Array, coordinates: Array, roll: float) -> tuple[Array, Array, Array]:
        """Return the poses and negative log-posteriors at coordinates, without derivatives.

        Parameters
        ----------
        readings
            Counts, shape ``(n,)``.
        coordinates
            In the chart, then the nuisances, shape ``(k, p)``.
        roll
            Roll of the follower, rad.

        Returns
        -------
        poses : Array
            m and rad, shape ``(k, 5)``.
        cost : Array
            As that of a `Fit`, without constants, shape ``(k,)``.
        log_volume : Array
            Of the poses that a unit volume of the chart holds, shape ``(k,)``.
        """
        poses, lamp, axis, log_volume = self.chart.to_pose(coordinates[:, :5], roll)
        light = self.model.light_by_lamp(lamp, axis, self._offsets(coordinates))
        light = light.reshape(len(poses), -1)
        variance, slope = self.model.variance(light)
        value, _, _ = log_likelihood(readings, light, variance, slope, self.model.limits)
        off = (np.concatenate([poses, coordinates[:, 5:]], axis=-1) - self.mean) / self.std
        return poses, 0.5 * (off * off).sum(axis=1) - value, log_volume
