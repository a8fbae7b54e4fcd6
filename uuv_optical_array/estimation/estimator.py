"""From an image and its signature to the pose, by one of three methods.

- ``sam``: the nearest entry of the table by spectral angle, the paper's idea;
- ``sam_interpolated``: the mean of the nearest entries;
- ``least_squares``: the nearest entries, each refined on the whole image, and the best kept.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from uuv_optical_array.core.errors import NoPose as NoPose
from uuv_optical_array.core.geometry import DOF_NAMES, Array, turned_about_beam
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.estimation.least_squares.compiled_fit import image_fit
from uuv_optical_array.estimation.least_squares.posterior import Posterior, rivalling
from uuv_optical_array.estimation.least_squares.solver import DISTINCT, Fit, ImageFit, Prior
from uuv_optical_array.estimation.table.signature_table import SignatureTable, grid_axes
from uuv_optical_array.forward.model import ForwardModel

Method = Literal["sam", "sam_interpolated", "least_squares"]
METHODS: tuple[Method, ...] = get_args(Method)
# The pose's prior is Gaussian about the middle of the table, this many half extents wide: too
# wide to be seen where the image says much, and finite where it says nothing.
PRIOR_HALF_EXTENTS = 3.0
# A degree of freedom is unobservable where the image leaves more than this of the prior.
UNOBSERVABLE = 0.5
# Fits start from those of the nearest rows, this many for each start, that are farthest apart:
# neighbours in the table lead to one minimum, and rivals are what the starts are for.
POOL = 8
MOST_STARTS = 64
# So few lit detectors fit many poses, and all starts are tried at once.
FEW_LIT = 10
# Share of honest images whose best fit is taken for a missed pose, and looked into farther.
IMPLAUSIBLE = 0.01


@dataclass(frozen=True)
class EstimatorSettings:
    """How poses are found and which are refused; parameters of `Estimator` and of its node."""

    method: Annotated[Method, Quantity("how the pose is found")] = "least_squares"
    max_angle_rad: Annotated[
        float, Quantity("spectral angle beyond which a match is no pose", "rad", 0, math.pi)
    ] = 0.25
    neighbours: Annotated[
        int, Quantity("nearest table rows that the sam methods average", "rows", 2, 10_000)
    ] = 64
    candidates: Annotated[
        int, Quantity("nearest table rows that least_squares starts from", "rows", 1, MOST_STARTS)
    ] = 4
    max_misfit: Annotated[
        float, Quantity("mean squared residual beyond which a fit is no pose", "", 1, 1e9)
    ] = 4.0


@dataclass(frozen=True)
class Estimate:
    """A pose and how far it can be trusted.

    Parameters
    ----------
    pose
        ``(x, y, z, pitch, yaw)`` of the follower in ``beacon``, m and rad, shape ``(5,)``.
    covariance
        Of `pose`, m^2, m rad and rad^2, shape ``(5, 5)``, positive definite; the roll is taken
        as given.
    angle_rad
        Spectral angle to the nearest signature of the table, in [0, pi].
    runner_up_pose
        The second choice: the second nearest entry, or the next minimum of the fit; ``None``
        where every start of the fit led to one.
    runner_up_angle_rad
        Spectral angle to the second nearest signature.
    misfit
        Mean squared residual in standard deviations, near 1 for an honest image; nan unless
        the image was fitted.
    runner_up_misfit
        The same of the runner-up.
    unobservable
        Degrees of freedom of which the image says next to nothing.
    """

    pose: Array
    covariance: Array
    angle_rad: float
    runner_up_pose: Array | None
    runner_up_angle_rad: float
    misfit: float = field(default=float("nan"))
    runner_up_misfit: float = field(default=float("nan"))
    unobservable: tuple[str, ...] = ()


class Estimator:
    """Estimate poses in the scene of a signature table.

    Its settings are fixed; another estimator on the same table takes milliseconds to make, because
    the table keeps its index.

    Parameters
    ----------
    table
        The signature table, of at least two rows.
    method
        One of `METHODS`.
    max_angle_rad
        A nearest signature farther away than this is no match; not asked by ``least_squares``,
        whose `misfit` tells more.
    neighbours
        Nearest rows whose spread is the covariance of ``sam``, and whose mean is the pose of
        ``sam_interpolated``. On a 13^5 table 64 give a mean normalised squared error near its
        expectation of 5; fewer are overconfident.
    candidates
        Rows near by angle and far apart in pose from which ``least_squares`` starts; up to
        `MOST_STARTS` where these leave doubt.
    max_misfit
        A fit with a larger misfit is no pose: the image is not of this scene.
    compiled
        As in `compiled_fit.image_fit`, for ``least_squares``.

    Raises
    ------
    ValueError
        For an unknown method, a table of fewer than two rows, or fewer than two neighbours.
    """

    def __init__(
        self,
        table: SignatureTable,
        method: Method = EstimatorSettings.method,
        max_angle_rad: float = EstimatorSettings.max_angle_rad,
        neighbours: int = EstimatorSettings.neighbours,
        candidates: int = EstimatorSettings.candidates,
        max_misfit: float = EstimatorSettings.max_misfit,
        compiled: bool | None = None,
    ) -> None:
        if method not in METHODS:
            raise ValueError(f"method: {method!r} is unknown; choose {' or '.join(METHODS)}")
        if len(table.poses) < 2:
            raise ValueError(f"table: {len(table.poses)} row; a match needs at least two")
        if neighbours < 2:
            raise ValueError(f"neighbours: {neighbours}; the runner-up needs at least 2")
        self.table = table
        self.settings = EstimatorSettings(method, max_angle_rad, neighbours, candidates, max_misfit)
        self._index = table.index
        axes = grid_axes(table.scene.table)
        # A pose is known no better than its cell of the grid, uniform: step^2 / 12.
        steps = [(axis[-1] - axis[0]) / max(len(axis) - 1, 1) for axis in axes]
        self._cell = np.diag(np.maximum(np.square(steps) / 12, 1e-8))
        readings = table.scene.array.detectors_per_side**2
        self._plausible_misfit = chi2.isf(IMPLAUSIBLE, max(readings - 5, 1)) / readings
        self._compiled = compiled
        if method == "least_squares":
            # So that the first frame takes no longer than the next; compiling the fit takes some
            # ten seconds, once a machine.
            _ = self._posterior

    @cached_property
    def _fit(self) -> ImageFit:
        scene = self.table.scene
        axes = grid_axes(scene.table)
        middle = np.array([(axis[0] + axis[-1]) / 2 for axis in axes])
        half = np.array([(axis[-1] - axis[0]) / 2 for axis in axes])
        prior_std = PRIOR_HALF_EXTENTS * np.maximum(half, 0.2)
        prior = Prior(middle, prior_std, scene.prior.nuisance_std())
        return image_fit(ForwardModel(scene), prior, self._compiled)

    @cached_property
    def _posterior(self) -> Posterior:
        # The same numbers in every run: an image has one answer.
        return Posterior(self._fit, np.random.default_rng(0))

    def estimate(
        self, parameters: ArrayLike, image: ArrayLike | None = None, roll: float = 0.0
    ) -> Estimate:
        """Estimate the pose from one image.

        Parameters
        ----------
        parameters
            Key parameters of the image, shape ``(5,)``.
        image
            The image itself, counts, shape ``(side, side)``; ``least_squares`` needs it.
        roll
            Roll of the follower, as its own sensors know it, rad.

        Returns
        -------
        Estimate
            The pose, never without a covariance.

        Raises
        ------
        NoPose
            For parameters that are not finite or hold no light, for a signature or an image that
            belongs to no pose of the scene.
        """
        parameters = np.asarray(parameters, dtype=float)
        # Far beyond any image's, and yet safe to weigh.
        if parameters.shape != (5,) or not (np.abs(parameters) < 1e100).all():
            raise NoPose(f"not five finite numbers: {parameters.tolist()}")
        if parameters[0] <= 0:
            raise NoPose(f"no light: the peak is {parameters[0]:g} of full scale")
        if self.settings.method == "least_squares":
            return self._least_squares(parameters, image, roll)
        vector, count = self.table.vectors(parameters), self.settings.neighbours
        angles, rows = self._index.nearest(vector, count)
        # Rows that look exactly alike are all possible, however many there are.
        while angles[-1] == angles[0] and count < len(self.table.poses):
            count *= 4
            angles, rows = self._index.nearest(vector, count)
        if angles[0] > self.settings.max_angle_rad:
            raise NoPose(
                f"no match: the nearest signature is {angles[0]:.3f} rad away, "
                f"more than {self.settings.max_angle_rad:g}; the pose lies outside the table "
                "or the scene differs from the sea"
            )
        poses = turned_about_beam(self.table.poses[rows], roll)
        mean = self.settings.method == "sam_interpolated"
        pose = poses.mean(axis=0) if mean else np.array(poses[0])
        spread = poses - pose
        covariance = spread.T @ spread / len(poses) + self._cell
        return Estimate(pose, covariance, float(angles[0]), poses[1], float(angles[1]))

    @np.errstate(under="ignore")  # of probabilities
    def _least_squares(self, parameters: Array, image: ArrayLike | None, roll: float) -> Estimate:
        side = self.table.scene.array.detectors_per_side
        readings = np.array(image, dtype=float, order="C")
        if readings.shape != (side, side) or not np.isfinite(readings).all():
            raise NoPose(f"no image: least_squares needs {side} x {side} finite readings")
        readings = readings.ravel()
        vector = self.table.vectors(parameters)
        count = MOST_STARTS if self._fit.lit(readings) < FEW_LIT else self.settings.candidates
        angles, rows = self._index.nearest(vector, POOL * count)
        try:
            minima, misfit = self._minima(readings, vector, rows, count, roll)
            if not minima:
                raise NoPose("no fit: no start led to a finite likelihood")
            if not misfit <= self.settings.max_misfit:
                raise NoPose(
                    f"no fit: the best pose leaves a misfit of {misfit:.3g}, more than "
                    f"{self.settings.max_misfit:g}; the image is not of this scene"
                )
            pose, covariance = self._posterior.moments(readings, minima, roll)
        except np.linalg.LinAlgError:
            raise NoPose("no fit: the image leaves the pose without a covariance") from None
        runner_up = minima[1] if len(minima) > 1 else None
        runner_up_misfit = float("nan")
        if runner_up is not None:
            runner_up_misfit = self._fit.misfit(readings, runner_up, roll)
        covariance = (covariance + covariance.T) / 2
        if not (np.isfinite(pose).all() and np.isfinite(covariance).all()):
            raise NoPose("no fit: the pose is not finite")
        known = np.sqrt(covariance.diagonal()) <= UNOBSERVABLE * self._fit.prior.pose_std
        return Estimate(
            pose,
            covariance,
            float(angles[0]),
            None if runner_up is None else runner_up.pose,
            float(angles[1]),
            misfit,
            runner_up_misfit,
            tuple(name for name, is_known in zip(DOF_NAMES, known, strict=True) if not is_known),
        )

    def _minima(
        self, readings: Array, vector: Array, rows: NDArray[np.intp], count: int, roll: float
    ) -> tuple[list[Fit], float]:
        """Return the best fit of each minimum that is found, best first, and its misfit.

        Where the first `count` starts, from the nearest rows, lead to rivals or to a fit that
        noise can hardly explain, there are more of them.
        """
        minima: list[Fit] = []
        misfit = float("inf")
        tried = 0
        while True:
            chosen = rows[self._far_apart(rows, count)][tried:]
            starts = turned_about_beam(self.table.poses[chosen], roll)
            minima = _distinct(minima + self._fit.refine(readings, starts, roll))
            if minima:
                misfit = self._fit.misfit(readings, minima[0], roll)
                settled = tried > 0 or len(rivalling(minima)) == 1
                if settled and misfit <= self._plausible_misfit:
                    return minima, misfit
            tried, count = count, 4 * count
            if tried >= min(MOST_STARTS, len(self.table.poses)):
                return minima, misfit
            _, rows = self._index.nearest(vector, POOL * count)

    def _far_apart(self, rows: NDArray[np.intp], count: int) -> list[int]:
        """Choose the first of table rows, and then always the one farthest from those chosen."""
        poses = np.asarray(self.table.poses)[rows] / self._fit.prior.pose_std
        chosen = [0]
        distance = np.full(len(rows), np.inf)
        while len(chosen) < min(count, len(rows)):
            apart = poses - poses[chosen[-1]]
            np.minimum(distance, np.einsum("ij,ij->i", apart, apart), out=distance)
            chosen.append(int(distance.argmax()))
        return chosen


def _distinct(fits: list[Fit]) -> list[Fit]:
    """Keep the best fit of each minimum, best first."""
    minima: list[Fit] = []
    for fit in sorted(fits, key=lambda fit: fit.cost):
        offsets = (fit.coordinates - other.coordinates for other in minima)
        near = (
            off @ other.information @ off < DISTINCT**2
            for off, other in zip(offsets, minima, strict=True)
        )
        if not any(near):
            minima.append(fit)
    return minima
