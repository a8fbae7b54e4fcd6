"""From an image and its signature to the pose, by one of three methods.

- ``sam``: the nearest entry of the table by spectral angle, the paper's idea;
- ``sam_interpolated``: the mean of the nearest entries;
- ``least_squares``: poses of like signature, each refined on the whole image.
"""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dposv

from uuv_optical_array.core.errors import NoPose as NoPose
from uuv_optical_array.core.errors import expect
from uuv_optical_array.core.geometry import Array, turned_about_beam, wrapped
from uuv_optical_array.core.numerics.background import BackgroundCompiler
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.estimation.estimate import Estimate as Estimate
from uuv_optical_array.estimation.fit_compiler import fit_compiler
from uuv_optical_array.estimation.information.linearised import LinearisedReadings
from uuv_optical_array.estimation.least_squares.frame import MOST_STARTS
from uuv_optical_array.estimation.least_squares.image_fit import ImageFit
from uuv_optical_array.estimation.signature.features import same_everywhere, scene_parameters
from uuv_optical_array.estimation.signature.plausibility import (
    bounds,
    check_full_scale,
    check_parameters,
)
from uuv_optical_array.estimation.signature_table import SignatureTable, build_table, grid_axes
from uuv_optical_array.estimation.unknowns.constants import constants_of
from uuv_optical_array.forward.aim import aim_slopes
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene

Method = Literal["sam", "sam_interpolated", "least_squares"]
METHODS: tuple[Method, ...] = get_args(Method)


@dataclass(frozen=True)
class EstimatorSettings:
    """How poses are found and which are refused; parameters of `Estimator` and of its node."""

    method: Annotated[Method, Quantity("method of the estimate")] = "least_squares"
    max_angle_rad: Annotated[
        float, Quantity("largest spectral angle of a match of the sam methods", "rad", 0, math.pi)
    ] = 0.25
    neighbours: Annotated[
        int,
        Quantity(
            "number of nearest rows of the table: the sam methods add their spread to the "
            "covariance, and sam_interpolated returns their mean",
            "rows",
            2,
            10_000,
        ),
    ] = 64
    candidates: Annotated[
        int,
        Quantity(
            "least number of poses from which least_squares starts",
            "poses",
            1,
            MOST_STARTS,
        ),
    ] = 3
    max_misfit: Annotated[
        float,
        Quantity(
            "largest probability that a valid image in even light is refused for its residuals",
            "",
            0,
            0.5,
        ),
    ] = 1e-5


def _check_rows(table: SignatureTable) -> None:
    """Raise ValueError for a table in which a match has no runner-up."""
    if len(table.poses) < 2:
        raise ValueError(f"table: {len(table.poses)} row; a match needs at least two")


class Estimator:
    """Estimate poses in a scene.

    Parameters
    ----------
    source
        The scene; or its signature table, of at least two rows, which the sam methods search and
        otherwise build in memory in seconds, or less where it is compiled.
    method
        One of `METHODS`. ``least_squares`` needs no table.
    max_angle_rad
        Largest spectral angle of a match; ``least_squares`` goes by the misfit instead.
    neighbours
        Nearest rows whose spread enters the covariance of the sam methods, and whose mean is the
        pose of ``sam_interpolated``. On a 13^5 table 64 give a mean normalised squared error near
        its expectation of 5; fewer are overconfident.
    candidates
        Poses of like signature from which ``least_squares`` starts; of one lamp `MOST_STARTS` where
        few detectors are lit, and `RING` at least where all lie in a plane.
    max_misfit
        An image whose residuals are less probable than this, under scene and prior, is not of this
        scene and has no pose. Gains that the prior leaves unknown may be twice as large.
    compiled
        Whether Numba compiles the fit, which takes half a minute once on a machine and changes no
        answer; ``None``: in the background while the fit answers as it stands, where Numba is
        installed. The sam methods check their matches of images by the fit.

    Raises
    ------
    ValueError
        For an unknown method, a table of fewer than two rows, fewer than two neighbours, a scene
        without light, or where the fit is to be compiled without Numba.
    """

    def __init__(
        self,
        source: Scene | SignatureTable,
        method: Method = EstimatorSettings.method,
        max_angle_rad: float = EstimatorSettings.max_angle_rad,
        neighbours: int = EstimatorSettings.neighbours,
        candidates: int = EstimatorSettings.candidates,
        max_misfit: float = EstimatorSettings.max_misfit,
        compiled: bool | None = None,
    ) -> None:
        expect(source, (Scene, SignatureTable), "source", "a scene, as load_scene returns it")
        if method not in METHODS:
            raise ValueError(f"method: {method!r} is unknown; choose {' or '.join(METHODS)}")
        if isinstance(source, SignatureTable):
            _check_rows(source)
        if neighbours < 2:
            raise ValueError(f"neighbours: {neighbours}; the runner-up needs at least 2")
        self._source, self._asked = source, compiled
        self.scene = scene = source.scene if isinstance(source, SignatureTable) else source
        self.settings = EstimatorSettings(method, max_angle_rad, neighbours, candidates, max_misfit)
        self._bounds, self._side = bounds(scene), scene.array.detectors_per_side
        axes = grid_axes(scene.table)
        # A pose is known no better than its cell of the grid, uniform: step^2 / 12.
        steps = [(axis[-1] - axis[0]) / max(len(axis) - 1, 1) for axis in axes]
        self._cell = np.diag(np.maximum(np.square(steps) / 12, 1e-8))
        self._model = ForwardModel(scene)
        self.constants = constants_of(self._model)
        # Made now, so that the first frame takes no longer than the next.
        _ = self._fit if method == "least_squares" else self.table.index

    @cached_property
    def table(self) -> SignatureTable:
        """The signature table that the sam methods search."""
        if isinstance(self._source, SignatureTable):
            return self._source
        table = build_table(self._source)
        _check_rows(table)
        return table

    @cached_property
    def _compiler(self) -> BackgroundCompiler | None:
        """What compiles the fit in the background; ``None`` where nothing is to be."""
        return fit_compiler() if self._asked is None else None

    @cached_property
    def _own_fit(self) -> ImageFit:
        """The fit: made at once by its method, by the others at the first image."""
        s, compiled = self.settings, bool(self._asked)
        return ImageFit(self._model, self.constants, s.candidates, s.max_misfit, compiled)

    @property
    def _fit(self) -> ImageFit:
        """The fit, compiled from when that is done."""
        fit, compiler = self._own_fit, self._compiler
        if compiler is not None and compiler.done and not compiler.failure and not fit.compiled:
            fit.run(compiled=True)
        return fit

    @property
    def state_of_fit(self) -> str:
        """How the fit runs: compiled, or as it stands and why, in words."""
        if self._fit.compiled:
            return "compiled"
        if self._compiler is None:
            return "as it stands"
        return f"as it stands: {self._compiler.failure or 'it is being compiled'}"

    def wait(self) -> "Estimator":
        """Wait until the fit is compiled, where it is to be; returns the estimator itself."""
        if self._compiler is not None and not self._compiler.done:
            logging.getLogger(__name__).warning(
                "compiling the fit; this takes about half a minute, once on a machine"
            )
            self._compiler.wait()
        return self

    def estimate(
        self,
        image: ArrayLike | None = None,
        parameters: ArrayLike | None = None,
        roll: float = 0.0,
        uneven: float | None = None,
    ) -> Estimate:
        """Estimate the pose from one image.

        Parameters
        ----------
        image
            Counts, shape ``(side, side)``. ``least_squares`` fits it; the other methods hold their
            match to it, and believe the key parameters without it.
        parameters
            Key parameters of the image, shape ``(5,)``; ``None``: worked out from the image, as
            ``least_squares`` always does.
        roll
            Roll of the follower, as its own sensors know it, rad.
        uneven
            Probability that it is lit unevenly, by the images before, as of `Tracker.uneven`; the
            estimate then has the readings for the track. ``None``: the image stands by itself.

        Raises
        ------
        NoPose
            For parameters that are not finite, hold no light or are beyond what an array can give,
            for a signature or an image that belongs to no pose of the scene.
        """
        estimate = self._estimate(image, parameters, float(roll), uneven)
        if self.scene.prior.aimed:
            return estimate
        covariance = estimate.covariance + self.aim_covariance(estimate.pose, roll)
        return estimate._replace(covariance=covariance)

    def aim_covariance(self, pose: Array, roll: float) -> Array:
        """Return the covariance of a pose by the aim of array and lamp, shape ``(5, 5)``."""
        slopes = aim_slopes(self.scene, pose, roll)
        return slopes @ slopes.T

    def _estimate(
        self,
        image: ArrayLike | None,
        parameters: ArrayLike | None,
        roll: float,
        uneven: float | None,
    ) -> Estimate:
        fits = self.settings.method == "least_squares"
        if parameters is None:
            readings = self._readings(image)
            if fits:
                return self._fit(readings, roll, uneven)
            image = readings.reshape(self._model.image_shape)
            parameters = scene_parameters(image, self.scene)
        parameters = np.asarray(parameters, dtype=float)
        # Far beyond any image's, and yet safe to weigh.
        if parameters.shape != (5,) or not all(abs(each) < 1e100 for each in parameters.tolist()):
            raise NoPose(f"not five finite numbers: {parameters.tolist()}")
        if parameters[0] <= 0:
            raise NoPose(f"no light: the peak is {parameters[0]:g} of full scale")
        check_parameters(parameters, self._bounds)
        if fits:
            return self._fit(self._readings(image), roll, uneven)
        match, level = self._match(self.table.vectors(parameters), roll)
        if image is None:
            return match
        return self._verified(match, level, self._readings(image), roll, uneven)

    def check_shape(self, image: ArrayLike | None) -> None:
        """Raise `NoPose` for what is no image of the scene's array."""
        wanted, shape = self._model.image_shape, np.asarray(image).shape
        if shape != wanted:
            raise NoPose(f"no image: of shape {shape}, not {wanted}")

    def _readings(self, image: ArrayLike | None) -> Array:
        """Return what an image of the scene's array reads, shape ``(n,)``; else `NoPose`."""
        self.check_shape(image)
        readings = np.array(image, dtype=float, order="C").reshape(-1)
        brightest, darkest = float(readings.max()), float(readings.min())
        if not (math.isfinite(brightest) and math.isfinite(darkest)):
            raise NoPose("no image: nan or infinite readings")
        check_full_scale(brightest, self.scene)
        if not brightest > 0:
            raise NoPose(f"no light: the brightest detector reads {brightest:g}")
        if brightest == darkest:
            raise NoPose(same_everywhere(brightest))
        noise = self._model.noise
        if brightest >= noise.high and not ((noise.low < readings) & (readings < noise.high)).any():
            raise NoPose("no pattern: no detector reads more than darkness and less than full")
        return readings

    def _match(self, vector: Array, roll: float) -> tuple[Estimate, Array]:
        """Estimate by the nearest rows of the table; return the pose of the nearest, level, too."""
        count = self.settings.neighbours
        index = self.table.index
        angles, rows = index.nearest(vector, count)
        # Rows that look exactly alike are all possible, however many there are.
        while angles[-1] == angles[0] and count < len(self.table.poses):
            count *= 4
            angles, rows = index.nearest(vector, count)
        if angles[0] > self.settings.max_angle_rad:
            raise NoPose(
                f"no match: the nearest signature is {angles[0]:.3f} rad away, "
                f"more than {self.settings.max_angle_rad:g}; the pose lies outside the table "
                "or the scene differs from the sea"
            )
        level = np.asarray(self.table.poses[rows], dtype=float)
        poses = turned_about_beam(level, roll)
        mean = self.settings.method != "sam"
        pose = np.add.reduce(poses) / len(poses) if mean else np.array(poses[0])
        spread = poses - pose
        covariance = spread.T @ spread / len(poses) + self._cell
        match = Estimate(pose, covariance, float(angles[0]), poses[1], float(angles[1]))
        return match, level[0]

    def _verified(
        self,
        match: Estimate,
        level: Array,
        readings: Array,
        roll: float,
        uneven: float | None,
    ) -> Estimate:
        """Hold a match to the image: a fit tells whether it is of the scene, and how far off.

        Where no fit from the match explains the image, one from the usual starts has the answer.
        """
        try:
            fitted = self._fit(readings, roll, uneven, level)
        except NoPose:  # perhaps of the match alone, as beside a faulty detector
            return self._fit(readings, roll, uneven)
        off = wrapped(match.pose - fitted.pose)
        # The grid's cell and the neighbours' spread, more where the match is off, and the fit's
        # own.
        _, weighed_off, _ = dposv(match.covariance + fitted.covariance, off)
        excess = float(off @ weighed_off) / 5
        covariance = max(excess, 1.0) * match.covariance + fitted.covariance
        return match._replace(
            covariance=0.5 * (covariance + covariance.T),
            misfit=fitted.misfit,
            runner_up_misfit=fitted.runner_up_misfit,
            clear=fitted.clear,
            left_out=fitted.left_out,
            dark_lamp=fitted.dark_lamp,
        )

    def lineariser(
        self, estimate: Estimate, image: ArrayLike, roll: float = 0.0
    ) -> Callable[[Array], LinearisedReadings]:
        """Return what linearises an image, whose estimate and roll are given, near any place."""
        self.check_shape(image)
        readings = np.array(image, dtype=float).reshape(-1)
        weights = np.ones(len(readings)) if estimate.believed is None else estimate.believed
        return lambda at: self._fit.near(readings, at, roll, weights)
