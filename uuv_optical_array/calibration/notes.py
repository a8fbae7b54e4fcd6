"""What a user should know of a calibration's fit, in words."""

import numpy as np
from scipy.special import chdtri

from uuv_optical_array.calibration.maximum_likelihood.fit import CalibrationFit
from uuv_optical_array.calibration.parameters import (
    BACKGROUND,
    GAINS,
    NAMES,
    NOISE,
    POWER,
    SIGMA,
    K,
)
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.light import HALF_SQUARE, RANGE
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene

MISFIT = 1.2  # mean squared residual from which the model does not explain the data
MOST_NOISE = 2.0  # times that of the scene; what residuals need more of is no noise but the model
SURE = 1e-6  # chance that a right model is refused
FACTOR = 2.0  # between the ranges that tell attenuation from power
BEAMS = 2.0  # standard deviations of the beam off its axis that tell its width
CHECK = "check --odometry-axes, --beacon-position, array.wiring and the topics"
SUFFICE = "suffice: record more images, the lamp brighter, and weave and nose about meanwhile"
MANY = 0.05  # share of outliers from which something else is wrong


def cure(fit: CalibrationFit, kind: int) -> str:
    """Say what to record for a parameter of a kind, of the first five, to be known."""
    return {
        POWER: "too little light of the lamp; record closer to it and in its beam",
        SIGMA: _wider(fit),
        K: _farther(fit),
        BACKGROUND: "record some images with the lamp off, out of its beam or far away",
        GAINS: "turn and shift the array so that the lamp shines on it",
    }[kind]


def _lit(fit: CalibrationFit, row: int) -> Array:
    """Return a row of the rays, of each used reading in which the lamp stands out of the noise."""
    likelihood, state = fit.likelihood, fit.state
    values = state.at.parameters
    lamp = state.mean - values[BACKGROUND] * np.exp(values[GAINS:])
    seen = likelihood.used & (lamp > np.sqrt(state.variance))
    rays = ForwardModel(likelihood.scene).rays(likelihood.poses, likelihood.rolls)
    return np.asarray(rays[row][seen])


def _farther(fit: CalibrationFit) -> str:
    """Say which ranges tell the attenuation, beside those of the detectors that saw the lamp."""
    ranges = _lit(fit, RANGE)
    if not len(ranges):
        return "no detector saw the lamp"
    near, far = ranges.min(), ranges.max()
    told = f"{near:.2f} to {far:.2f} m, a factor of {far / near:.2f}"
    if far >= FACTOR * near:
        return f"the ranges of lit detectors, {told}, {SUFFICE}"
    return (
        f"record ranges that differ by a factor of {FACTOR:g} or more; here those of lit "
        f"detectors run from {told}"
    )


def _wider(fit: CalibrationFit) -> str:
    """Say which angles tell the beam's width, beside those of the detectors that saw the lamp."""
    off = np.degrees(np.sqrt(2 * _lit(fit, HALF_SQUARE)))
    if not len(off):
        return "no detector saw the lamp"
    wanted = BEAMS * np.exp(fit.state.at.parameters[SIGMA])
    if off.max() >= wanted:
        return f"the angles of lit detectors off the beam's axis, to {off.max():.1f} deg, {SUFFICE}"
    return (
        f"record poses up to {wanted:.0f} deg off the beam's axis; here the farthest lit detector "
        f"was {off.max():.1f} deg off it"
    )


def refusal(fit: CalibrationFit, fit_noise: bool) -> str:
    """Say why the residuals of a fit are no noise; empty where they may be.

    Parameters
    ----------
    fit
        With the noise of the scene.
    fit_noise
        Whether any noise is believed whose residuals are independent.
    """
    agreement = fit.agreement
    most = MOST_NOISE**2
    if agreement.freedoms > 0:
        most *= chdtri(agreement.freedoms, SURE) / agreement.freedoms
    independent = not any(_correlated(fit))
    if agreement.misfit <= most or (fit_noise and independent):
        return ""
    told = (
        f"the model does not explain the images: mean squared residual {agreement.misfit:.6g} of "
        f"{agreement.freedoms} degrees of freedom, where at most {most:.3g} would be noise"
    )
    cures = [CHECK]
    if held := [NAMES[i] for i in range(GAINS) if i in fit.unknown]:
        cures.append(f"record what tells {', '.join(held)}")
    if independent:
        cures.append("give --noise: the residuals are independent")
    return f"{told}; {', or '.join(cures)}"


def notes_of(scene: Scene, fit: CalibrationFit) -> tuple[str, ...]:
    """Return the notes of a fit, a line each.

    Parameters
    ----------
    scene
        With the noise that the fit believed.
    fit
        The fit.
    """
    return (*_detectors(scene, fit), *_unknown(scene, fit), *_residuals(scene, fit))


def _detectors(scene: Scene, fit: CalibrationFit) -> list[str]:
    """Name the detectors that were found to be at fault."""
    side = scene.array.detectors_per_side
    return [
        f"detector [{i // side}, {i % side}] always reads {fit.likelihood.readings[0, i]:g} "
        "counts: dead or stuck; it was left out, name it in effects.detector_faults"
        for i in fit.dead
    ]


def _unknown(scene: Scene, fit: CalibrationFit) -> list[str]:
    """Name what the images do not tell."""
    side = scene.array.detectors_per_side
    notes = [f"{NAMES[i]} is not known: {cure(fit, i)}" for i in range(GAINS) if i in fit.unknown]
    gains = sorted(i for i in fit.unknown if i >= GAINS)
    for by in sorted({fit.mixed[i] for i in gains if i in fit.mixed}):
        notes.append(
            f"the gains are not known, as they mix with what is not known above, {NAMES[by]} the "
            "most; they stay as they were"
        )
    if blind := [divmod(i - GAINS, side) for i in gains if i not in fit.mixed]:
        cells = ", ".join(f"[{row}, {column}]" for row, column in blind)
        notes.append(f"gain of {cells} is not known: {cure(fit, GAINS)}")
    return notes


def _correlated(fit: CalibrationFit) -> tuple[bool, bool]:
    """Say whether the residuals of an image are correlated, and those of a detector."""
    images, detectors = fit.likelihood.readings.shape
    agreement = fit.agreement
    # Of independent residuals both are 1, with these standard deviations.
    return (
        agreement.inflation() > 1 + 6 * np.sqrt(2 / (3 * images)),
        agreement.pattern() > 1 + 6 * np.sqrt(2 / detectors),
    )


def _residuals(scene: Scene, fit: CalibrationFit) -> list[str]:
    """Say what the residuals point to."""
    agreement, notes = fit.agreement, []
    misfit = agreement.misfit
    lost = 1 - fit.likelihood.used[:, ~fit.likelihood.faulty].mean()
    if lost > MANY:
        notes.append(f"{lost:.0%} of the readings are outliers: look at the picture")
    common, pattern = _correlated(fit)
    if common:
        notes.append(
            "the residuals within an image are correlated: its pose or the lamp's power is off, or "
            "the model; give the poses' standard deviation, or see the picture"
        )
    if pattern:
        notes.append(
            "detectors are off by the same in all images: their gains or the beam are not those "
            "that were held"
        )
    if misfit > MISFIT:
        notes.append(
            f"the model does not explain the data: mean squared residual {misfit:.2f}, "
            f"not 1; standard errors were multiplied by {np.sqrt(misfit):.2f}"
        )
        if "sensor_noise" in scene.effects and not (common or pattern):
            sigma, _ = agreement.noise(scene.effects["sensor_noise"]["sigma_counts"])
            notes.append(
                f"the residuals are independent, as noise is: {NOISE} {sigma:.3g} would explain "
                "them"
            )
    elif misfit < 1 / MISFIT and agreement.fair.any():
        notes.append(
            f"mean squared residual {misfit:.2f}, below 1: the noise is less than the scene "
            "says, and the standard errors are too large"
        )
    return notes
