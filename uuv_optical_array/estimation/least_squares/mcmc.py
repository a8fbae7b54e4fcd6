"""Markov chains over all poses that an image leaves possible."""

from contextlib import suppress
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.least_squares.solver import Fit, ImageFit

# Chains, their steps, and how many of these come before the first that counts.
CHAINS, STEPS, SETTLING = 64, 120, 40
WIDTHS = 1.0, 0.5, 0.2  # of a chain's own steps, in standard deviations there
WHOLE = 0.2  # share of the jumps that are as long as two other chains are apart
# Below this share of the largest, an eigenvalue of the information is rounding.
RESOLVED = 1e-15


@dataclass
class _Places:
    """Where chains are, and what the image says there.

    Parameters
    ----------
    coordinates, poses
        Shapes ``(m, p)`` and ``(m, 5)``.
    log_posterior
        Per volume of the chart, shape ``(m,)``.
    towards
        The Gauss-Newton step, shape ``(m, p)``.
    spread, whitening
        Of the Gaussian: a root of its covariance, and the inverse, shapes ``(m, p, p)``.
    log_size
        Logarithm of the root's determinant, shape ``(m,)``.
    """

    coordinates: Array
    poses: Array
    log_posterior: Array
    towards: Array
    spread: Array
    whitening: Array
    log_size: Array

    def move(self, there: "_Places", accepted: NDArray[np.bool_]) -> None:
        """Go there where that is accepted."""
        for part in fields(self):
            getattr(self, part.name)[accepted] = getattr(there, part.name)[accepted]


class Chains:
    """Sample the poses an image leaves possible, whatever shape they form.

    Each chain starts from a fit to a randomised image and prior, which spreads them along every
    valley (D. Oliver, N. He and A. Reynolds, 1996). They take turns with steps of their own, in the
    Gaussian that the image makes of the place (M. Girolami and B. Calderhead, 2011, their
    simplified manifold Langevin), and jumps by what two others are apart (C. ter Braak, 2006),
    both accepted by Metropolis's rule. Importance sampling would count no more than a few of its
    points where the valley is a bent sheet.

    Parameters
    ----------
    image_fit
        The posterior of an image.
    rng
        Source of the numbers, drawn here, once, so that an image has one answer.
    """

    def __init__(self, image_fit: ImageFit, rng: np.random.Generator) -> None:
        self._fit = image_fit
        size = 5 + len(image_fit.names)
        self._noise = rng.standard_normal((CHAINS, image_fit.model.array.side**2))
        self._pull = rng.standard_normal((CHAINS, size))
        self._normal = rng.standard_normal((STEPS, CHAINS, size))
        self._widths = rng.choice(WIDTHS, (STEPS, CHAINS))
        self._others = rng.integers(CHAINS, size=(STEPS, 2, CHAINS))
        usual = 2.38 / np.sqrt(2 * size)  # ter Braak's, best for a Gaussian
        self._lengths = np.where(rng.random((STEPS, CHAINS)) < WHOLE, 1.0, usual)
        self._log_chances = np.log(rng.random((STEPS, CHAINS)))

    def sample(self, readings: Array, fits: list[Fit], roll: float) -> tuple[Array, int]:
        """Draw poses.

        Parameters
        ----------
        readings
            Counts, shape ``(n,)``.
        fits
            Fits to them, best first, one for each minimum that counts.
        roll
            Roll of the follower, rad.

        Returns
        -------
        poses : Array
            m and rad, all alike probable, shape ``(k, 5)``.
        chains : int
            How many chains drew them.
        """
        starts = self._fit.randomised(readings, fits, self._noise, self._pull, roll)
        chains = len(starts)
        now = self._places(readings, starts, roll)
        visited = []
        for step in range(STEPS):
            propose = self._jump if step % 2 else self._own
            there, log_odds = propose(readings, now, step, roll)
            gain = there.log_posterior - now.log_posterior + log_odds
            now.move(there, self._log_chances[step, :chains] < gain)
            if step >= SETTLING:
                visited.append(now.poses.copy())
        return np.concatenate(visited), chains

    def _own(
        self, readings: Array, now: _Places, step: int, roll: float
    ) -> tuple[_Places, Array | float]:
        """Propose a step in the Gaussian of the place; with it the odds of the way back."""
        chains = len(now.coordinates)
        normal, width = self._normal[step, :chains], self._widths[step, :chains, None]
        drift = 0.5 * width**2 * now.towards
        turned = (now.spread @ normal[..., None])[..., 0]
        there = self._places(readings, now.coordinates + drift + width * turned, roll)
        back = now.coordinates - there.coordinates - 0.5 * width**2 * there.towards
        returned = (there.whitening @ back[..., None])[..., 0] / width
        log_odds = 0.5 * (normal**2 - returned**2).sum(axis=1)
        return there, log_odds + now.log_size - there.log_size

    def _jump(
        self, readings: Array, now: _Places, step: int, roll: float
    ) -> tuple[_Places, Array | float]:
        """Propose to jump by what two chains are apart, which is as likely both ways."""
        chains = len(now.coordinates)
        one, other = self._others[step, :, :chains] % chains
        apart = now.coordinates[one] - now.coordinates[other]
        jump = self._lengths[step, :chains, None] * apart
        return self._places(readings, now.coordinates + jump, roll), 0.0

    def _places(self, readings: Array, coordinates: Array, roll: float) -> _Places:
        found = self._fit.evaluate(readings, coordinates, roll)
        log_posterior = found.log_volume - found.cost
        lost = ~(np.isfinite(log_posterior) & np.isfinite(found.information).all(axis=(1, 2)))
        log_posterior[lost] = -np.inf
        found.information[lost] = np.eye(coordinates.shape[1])
        spread, whitening, log_size = _roots(found.information)
        towards = spread @ (np.swapaxes(spread, -1, -2) @ found.gradient[..., None])
        towards[lost] = 0.0
        return _Places(
            coordinates,
            found.poses,
            log_posterior,
            towards[..., 0],
            spread,
            whitening,
            log_size,
        )


def _roots(information: Array) -> tuple[Array, Array, Array]:
    """Return a root of the covariance, its inverse, and the logarithm of its determinant."""
    with suppress(np.linalg.LinAlgError):
        factor = np.linalg.cholesky(information)
        spread = np.swapaxes(np.linalg.inv(factor), -1, -2)
        diagonal = np.diagonal(factor, axis1=-2, axis2=-1)
        return spread, np.swapaxes(factor, -1, -2), -np.log(diagonal).sum(axis=-1)
    # Somewhere rounding has taken its positive definiteness.
    values, axes = np.linalg.eigh(information)
    deviations = 1 / np.sqrt(np.maximum(values, RESOLVED * values[:, -1:]))
    spread = axes * deviations[:, None, :]
    whitening = np.swapaxes(axes / deviations[:, None, :], -1, -2)
    return spread, whitening, np.log(deviations).sum(axis=-1)
