"""Whether the residuals of a calibration are those of another shape of the beam.

Poses, gains or water that are wrong leave other residuals: those of a beam depend on the angle off
its axis alone, and are relative to the light. So they are recognised in two ways: by their mean at
each angle, and, where the shape of the beam was not fitted, by how much better a fit would be with
it. That is the score test (C. R. Rao, 1948, Proc. Camb. Phil. Soc. 44, 50), which needs no such fit
and counts what poses of uncertain places, gains and all else would absorb.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from uuv_optical_array.calibration.fit.fit import MOST_SHAPE, CalibrationFit
from uuv_optical_array.calibration.likelihood.agreement import FALSE_REFUSAL
from uuv_optical_array.calibration.likelihood.parameters import SHAPE
from uuv_optical_array.core.geometry import Array, Y, Z
from uuv_optical_array.forward.lamp.beam import NARROWEST_DEG, WIDEST_DEG, WIDTHS_OF_THREE
from uuv_optical_array.forward.light import HALF_SQUARE

BINS = 24  # of the angle off the axis, with as many lit readings each
LEAST_LIGHT = 3.0  # standard deviations of a lit reading
# Share of what noise leaves unexplained from which the beam is the cause, or a part of it.
BY_BEAM, PARTLY = 0.5, 0.2
SIGNIFICANT = 5.0  # standard deviations of what noise gives
LEAST_WEIGHT = 0.05  # of a Gaussian: a smaller one changes a pose little, and looks like scattering
# Relative error of the light that the shape of the beam may leave: with more, poses are false.
MOST_LEFT = 0.015
MOST_SCALE = 0.02  # share of it by which all places may move away from the beam's axis
FIT_SHAPE = (
    "give lamp.photometry, the file of the lamp, or set prior.beam_shape_std to 0.05, by which its "
    "shape is fitted"
)
CHECK = "check odometry_axes and beacon_position_m (--set), array.wiring and the topics"


class ResidualsByAngle(NamedTuple):
    """Mean residuals of lit readings by the angle off the beam's axis, k of them.

    - angles_deg: mean angle of each, deg, increasing, shape ``(k,)``.
    - relative, std: residual relative to the light, and its standard error by noise, ``(k,)``.
    - share: of what noise leaves unexplained of the residuals, what depends on the angle alone; 0
      where that is no more than noise gives.
    """

    angles_deg: Array
    relative: Array
    std: Array
    share: float


def residuals_by_angle(fit: CalibrationFit) -> ResidualsByAngle:
    """Return the residuals of a fit by the angle off the axis; k is 0 where no reading is lit."""
    likelihood, agreement = fit.likelihood, fit.agreement
    parameters, shifts = fit.state.at
    moved = shifts[likelihood.places]
    given = likelihood.poses + moved[:, :5], likelihood.rolls + moved[:, 5:].sum(axis=1)
    poses, rolls, _ = likelihood.apparent(parameters, *given)
    angles = np.degrees(np.sqrt(2 * likelihood.model.rays(poses, rolls)[HALF_SQUARE]))
    # Of the noise alone, without what the shape of the beam was found to leave.
    std = np.sqrt(agreement.variance - (likelihood.shape_std * agreement.mean) ** 2)
    lit = agreement.uncensored & (agreement.mean > LEAST_LIGHT * std)
    residuals = (agreement.residuals * np.sqrt(agreement.variance) / std)[lit]
    light, order = (agreement.mean / std)[lit], np.argsort(angles[lit])
    groups = [group for group in np.array_split(order, BINS) if len(group)]
    weights = np.array([light[group] @ light[group] for group in groups])
    relative = np.array([light[group] @ residuals[group] for group in groups]) / weights
    explained = float((relative**2 * weights).sum()) - len(groups)
    unexplained = float((residuals**2).sum()) - len(residuals)
    significant = explained > SIGNIFICANT * np.sqrt(2 * len(groups))
    share = explained / max(unexplained, explained) if significant else 0.0
    middle = np.array([angles[lit][group].mean() for group in groups])
    return ResidualsByAngle(middle, relative, weights**-0.5, share)


class MissingShape(NamedTuple):
    """What a fit of the beam's shape would find, to first order.

    - significance: of the score test, chi-squared of two degrees of freedom for the right shape.
    - share: of what noise leaves unexplained of the residuals, what it would explain.
    - weights: that the narrower and the wider Gaussian would have more.
    """

    significance: float
    share: float
    weights: Array

    def explains(self, share: float) -> bool:
        """Whether another shape than the scene's would explain more than a share of the misfit."""
        significant = self.significance > chdtri(len(SHAPE), FALSE_REFUSAL)
        large = np.abs(self.weights).max() > LEAST_WEIGHT
        return bool(significant and large and self.share > share)


def missing_shape(fit: CalibrationFit) -> MissingShape:
    """Return what a shape of the beam that was held would have explained; nothing if it was not."""
    lamp, shape = fit.likelihood.scene.lamp, list(SHAPE)
    sigmas = np.multiply(lamp.beam_widths or WIDTHS_OF_THREE, lamp.beam_sigma_deg)
    if fit.shaped or sigmas.min() < NARROWEST_DEG or sigmas.max() > WIDEST_DEG:
        return MissingShape(0.0, 0.0, np.zeros(len(shape)))
    likelihood, parameters = fit.likelihood.with_shape(), fit.state.at.parameters.copy()
    parameters[shape] = likelihood.start()[shape]
    state = likelihood.evaluate(fit.state.at._replace(parameters=parameters), expected=True)
    freed = likelihood.layout.free_directions((fit.held() - {*shape}) | likelihood.layout.lacking)
    information, gradient = freed.T @ state.information @ freed, freed.T @ state.gradient
    step = np.linalg.lstsq(information, gradient, rcond=None)[0]
    explained, misfit = float(gradient @ step), fit.agreement.misfit
    unexplained = max(1.0, fit.agreement.freedoms * (misfit - 1))
    share = min(1.0, explained / unexplained)
    return MissingShape(explained / max(1.0, misfit), share, (freed @ step)[shape])


def common_scale(fit: CalibrationFit) -> tuple[float, float]:
    """Return by which share of it all places move away from the beam's axis, and its error.

    The latter is that of a mean of places with independent errors of their given size.
    """
    likelihood = fit.likelihood
    if likelihood.pose_std is None:
        return 0.0, np.inf
    _, first = np.unique(likelihood.places, return_index=True)
    shifts = fit.state.at.shifts[:, Y : Z + 1]
    aside = likelihood.poses[first, Y : Z + 1] + shifts
    weights = likelihood.pose_std[:, Y : Z + 1] ** -2.0
    told = float((aside**2 * weights).sum())
    return float((aside * shifts * weights).sum()) / told, float(told**-0.5)


def wrong_beam(fit: CalibrationFit, missing: MissingShape) -> str:
    """Say that the beam has another shape than the scene's, where residuals say so; or nothing.

    - missing: what `missing_shape` returns of the fit.
    """
    left = fit.likelihood.shape_std
    if fit.shaped and left > MOST_LEFT:
        if left < MOST_SHAPE and residuals_by_angle(fit).share > BY_BEAM:
            return (
                "no beam of the scene's Gaussians explains the images: over the angle off its axis "
                f"{left:.1%} of the light remain, more than {MOST_LEFT:.1%}; give "
                "lamp.photometry, the file of the lamp, or use a diffuser or a softer beam"
            )
        return (
            f"the model does not explain the images: {left:.1%} of the light remain, and another "
            f"shape of the beam leaves {MOST_LEFT:.1%} at most; {CHECK}, and whether the beam is "
            "round: `uuv_array scenes` says by how much the planes of its file differ"
        )
    if missing.explains(BY_BEAM):
        return (
            "the beam of the lamp has another shape than the scene's: the residuals depend on the "
            f"angle off its axis; {FIT_SHAPE}"
        )
    return ""


def drawn_places(fit: CalibrationFit) -> str:
    """Say that the images draw all places to the beam's axis, or from it, if so; or nothing.

    Places with independent errors do not; these follow a beam that is not the scene's.
    """
    scale, error = common_scale(fit)
    if abs(scale) <= max(SIGNIFICANT * error, MOST_SCALE):
        return ""
    nearer = "nearer to" if scale < 0 else "farther from"
    cure = "use a diffuser or a softer beam" if fit.shaped else FIT_SHAPE
    return (
        f"by the images all places are {abs(scale):.1%} {nearer} the beam's axis, "
        f"{abs(scale) / error:.0f} of their standard errors: the beam differs from the scene's "
        f"Gaussians; measure places better, or {cure}"
    )
