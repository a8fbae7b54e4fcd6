"""What a user should know of a calibration's fit, in words."""

import numpy as np

from uuv_optical_array.calibration.fit import CalibrationFit
from uuv_optical_array.calibration.parameters import (
    BACKGROUND,
    GAINS,
    NAMES,
    NOISE,
    POWER,
    SIGMA,
    K,
)
from uuv_optical_array.forward.scene import Scene

MISFIT = 1.2  # mean squared residual from which the model does not explain the data
MANY = 0.05  # share of outliers from which something else is wrong


def cure(fit: CalibrationFit, kind: int) -> str:
    """Say what to record for a parameter of a kind, of the first five, to be known."""
    poses = fit.likelihood.poses
    ranges = np.linalg.norm(poses[:, :3], axis=1)
    off = np.degrees(np.arctan2(np.linalg.norm(poses[:, 1:3], axis=1), -poses[:, 0]))
    return {
        POWER: "too little light of the lamp; record closer to it and in its beam",
        SIGMA: f"record poses up to {2 * np.exp(fit.start[SIGMA]):.0f} deg off the beam's axis; "
        f"here the farthest is {off.max():.1f} deg",
        K: "record ranges that differ by a factor of 2 or more; here they run from "
        f"{ranges.min():.2f} to {ranges.max():.2f} m",
        BACKGROUND: "record some images with the lamp off, out of its beam or far away",
        GAINS: "turn and shift the array so that the lamp shines on it",
    }[kind]


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
    if blind := [divmod(i - GAINS, side) for i in sorted(fit.unknown) if i >= GAINS]:
        cells = ", ".join(f"[{row}, {column}]" for row, column in blind)
        notes.append(f"gain of {cells} is not known: {cure(fit, GAINS)}")
    return notes


def _residuals(scene: Scene, fit: CalibrationFit) -> list[str]:
    """Say what the residuals point to."""
    likelihood, agreement, notes = fit.likelihood, fit.agreement, []
    misfit = agreement.misfit
    lost = 1 - likelihood.used[:, ~likelihood.faulty].mean()
    if lost > MANY:
        notes.append(f"{lost:.0%} of the readings are outliers: look at the picture")
    # Of independent residuals it is 1, with this standard deviation.
    common = agreement.inflation() > 1 + 6 * np.sqrt(2 / len(likelihood.readings))
    if common:
        notes.append(
            "the residuals within an image are correlated: its pose or the lamp's power is off, or "
            "the model; give the poses' standard deviation, or see the picture"
        )
    if misfit > MISFIT:
        notes.append(
            f"the model does not explain the data: mean squared residual {misfit:.2f}, "
            f"not 1; standard errors were multiplied by {np.sqrt(misfit):.2f}"
        )
        if "sensor_noise" in scene.effects and not common:
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
