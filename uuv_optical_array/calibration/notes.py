"""What a user should know about the fit of a calibration, in words."""

from collections.abc import Collection

import numpy as np
from scipy.special import chdtri

from uuv_optical_array.calibration.fit.beam_shape import (
    CHECK,
    FIT_SHAPE,
    PARTLY,
    drawn_places,
    missing_shape,
    wrong_beam,
)
from uuv_optical_array.calibration.fit.fit import CalibrationFit
from uuv_optical_array.calibration.fit.noise_fit import NOISE, RELATIVE, fitted_noise
from uuv_optical_array.calibration.likelihood.agreement import FALSE_REFUSAL
from uuv_optical_array.calibration.likelihood.parameters import (
    ARRAY_AIM,
    BACKGROUND,
    GAINS,
    KINDS,
    LAMP_AIM,
    LAMP_FLOOR,
    PLACE,
    SCATTER,
    SIGMA,
    WIDE,
    K,
)
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.light import HALF_SQUARE, RANGE
from uuv_optical_array.forward.scene import Scene

MISFIT = 1.2  # mean squared residual from which standard errors are widened
MAX_NOISE_FACTOR = 2.0  # times the noise of the scene; larger residuals are an error of the model
RANGE_FACTOR = 2.0  # between the ranges that separate attenuation from power
BEAM_SIGMAS = 2.0  # off the beam's axis, from where readings determine its width
NONE_AT_LOWEST = K, SCATTER, BACKGROUND, WIDE, LAMP_FLOOR  # which may be 0
MANY_OUTLIERS = 0.05  # share of the readings from which something else is wrong
LEAST_AIM, SURE = 0.002, 3.0  # rad, and standard errors, off a frame, from which it is reported
LITTLE, HARDLY = 0.8, "hardly by the images"  # of the error of a tape
MOVED_M = 0.1  # of the place that a tape gives
MORE = "record more images, with a brighter lamp, while you weave and turn"


def advice(fit: CalibrationFit, kind: int) -> str:
    """Say what to record so that a parameter, or the gains, can be determined."""
    if cure := KINDS[kind].cure:
        return cure
    rows = _lit(fit, RANGE if kind == K else HALF_SQUARE)
    if not len(rows):
        return "no detector saw the lamp"
    if kind == K:
        near, far = rows.min(), rows.max()
        enough = far >= RANGE_FACTOR * near
        there = f"{near:.2f} to {far:.2f} m from the lamp, a factor of {far / near:.2f}"
        cure = f"record ranges that differ by a factor of {RANGE_FACTOR:g} or more"
    else:
        largest = np.degrees(np.sqrt(2 * rows.max()))
        wanted = BEAM_SIGMAS * np.exp(fit.state.at.parameters[SIGMA])
        enough = largest >= wanted
        there = f"up to {largest:.1f} deg off the beam's axis"
        cure = f"record poses up to {wanted:.0f} deg off the beam's axis"
    lit = f"lit detectors were {there}"
    return f"{lit}, which is enough: {MORE}" if enough else f"{cure}; here {lit}"


def _lit(fit: CalibrationFit, row: int) -> Array:
    """Return a row of the rays, of each used reading where the lamp exceeds the noise."""
    likelihood, state = fit.likelihood, fit.state
    lamp = state.mean - likelihood.background(state.at.parameters)
    lit = likelihood.used & (lamp > np.sqrt(state.variance))
    rays = likelihood.model.rays(likelihood.poses, likelihood.rolls)
    return np.asarray(rays[row][lit])


def refusal(fit: CalibrationFit, fit_noise: bool) -> str:
    """Say why the residuals of a fit, with the noise of the scene, cannot be noise; or nothing.

    With `fit_noise`, noise of any size is accepted if the residuals are independent.
    """
    agreement, places = fit.agreement, fit.likelihood.layout.own[:, 1:4]
    shifts = np.linalg.norm((fit.state.at.parameters - fit.start)[places], axis=1).tolist()
    if moved := [
        f"lamps.{i} by {shift:.2f} m" for i, shift in enumerate(shifts) if shift > MOVED_M
    ]:
        return (
            f"lamps are not at the places of the scene: {', '.join(moved)}; check which "
            "channel is which lamp, their places in the scene, and --set beacon_position_m"
        )
    missing = missing_shape(fit)
    if wrong := wrong_beam(fit, missing):
        return wrong
    limit = MAX_NOISE_FACTOR**2
    if agreement.freedoms > 0:
        limit *= chdtri(agreement.freedoms, FALSE_REFUSAL) / agreement.freedoms
    independent = not any(_correlated(fit))
    explained = agreement.misfit <= limit or (fit_noise and independent)
    if (explained or fit.shaped) and (drawn := drawn_places(fit)):
        return drawn
    if explained:
        return _at_bound(fit)
    reason = (
        f"the model does not explain the images: mean squared residual {agreement.misfit:.6g} of "
        f"{agreement.freedoms} degrees of freedom, where noise gives at most {limit:.3g}"
    )
    cures = [CHECK]
    if unknown := [name for i, name in enumerate(fit.likelihood.layout.names) if i in fit.unknown]:
        cures.append(f"record what determines {', '.join(unknown)}")
    if missing.explains(PARTLY):
        cures.append(f"the beam's shape, which explains {missing.share:.0%} of it: {FIT_SHAPE}")
    if independent:
        cures.append("give --noise: the residuals are independent")
    return f"{reason}; {', or '.join(cures)}"


def _at_bound(fit: CalibrationFit) -> str:
    """Say which setting ends at its bound, unless that is the natural one of nothing at all."""
    layout, values = fit.likelihood.layout, fit.state.at.parameters
    for i in sorted(fit.at_bound):
        if layout.kinds[i] in NONE_AT_LOWEST and values[i] <= layout.low[i]:
            continue
        name, unit = (layout.names[i], layout.units[i]) if i < layout.gains else ("a gain", "")
        value = np.exp(values[i]) if layout.logarithm[i] else values[i]
        return (
            f"{name} ends at its bound, {f'{value:.4g} {unit}'.strip()}: the model does not "
            f"explain the images; {CHECK}, or --hold what is known"
        )
    return ""


def notes_of(scene: Scene, fit: CalibrationFit, little: Collection[int]) -> tuple[str, ...]:
    """Return the notes of a fit, a line each.

    `scene` has the noise that the fit assumed; images hardly improve the places `little`.
    """
    told = _dead_detectors(fit), _undetermined(fit), _aim(fit), _residuals(scene, fit)
    notes = [note for group in told for note in group]
    if names := ", ".join(fit.likelihood.layout.names[i] for i in little):
        tape = f"{fit.likelihood.tape_std_m:g} m of the tape"
        notes.append(f"{names}: hardly better than the {tape}: {advice(fit, PLACE)}")
    return tuple(notes)


def _aim(fit: CalibrationFit) -> list[str]:
    notes, values = [], fit.state.at.parameters
    errors = np.sqrt(np.diag(fit.covariance(max(1.0, fit.agreement.misfit))))
    certain = np.abs(values) > np.maximum(LEAST_AIM, SURE * errors)
    for rows, part, frame, prior in (
        (LAMP_AIM, "lamp", "the frame beacon", "lamp_aim_std_deg"),
        (ARRAY_AIM, "array", "base_link's static transform", "aim_std_deg"),
    ):
        if {*rows} & fit.held() or not certain[rows].any():
            continue
        pitch, yaw = np.degrees(values[rows])
        notes.append(
            f"the {part} is turned by {pitch:+.2f} deg in pitch and {yaw:+.2f} deg in yaw: turn it "
            f"back, or {frame} by as much; until then {prior} covers it"
        )
    return notes


def _dead_detectors(fit: CalibrationFit) -> list[str]:
    side = fit.likelihood.scene.array.detectors_per_side
    return [
        f"detector [{i // side}, {i % side}] always reads {fit.likelihood.readings[0, i]:g} "
        "counts: dead or stuck; it was left out, name it in effects.detector_faults"
        for i in fit.dead
    ]


def _undetermined(fit: CalibrationFit) -> list[str]:
    layout, side = fit.likelihood.layout, fit.likelihood.scene.array.detectors_per_side
    names, first = layout.names, layout.gains
    notes, kinds = [], layout.kinds[:first]
    for kind in dict.fromkeys(kinds.tolist()):
        if told := [names[i] for i in np.flatnonzero(kinds == kind).tolist() if i in fit.unknown]:
            verb = "is" if len(told) == 1 else "are"
            notes.append(f"{', '.join(told)} {verb} not known: {advice(fit, kind)}")
    gains = sorted(i for i in fit.unknown if i >= first)
    for cause in sorted({fit.correlated[i] for i in gains if i in fit.correlated}):
        most = names[cause] if cause < first else f"the gain of {[*divmod(cause - first, side)]}"
        notes.append(
            "the gains are not known: they are correlated with the parameters above that are not "
            f"known, most with {most}; they keep their values"
        )
    if unlit := [divmod(i - first, side) for i in gains if i not in fit.correlated]:
        cells = ", ".join(f"[{row}, {column}]" for row, column in unlit)
        notes.append(f"gain of {cells} is not known: {advice(fit, GAINS)}")
    return notes


def _correlated(fit: CalibrationFit) -> tuple[bool, bool]:
    """Say whether the residuals of an image are correlated, and those of a detector."""
    images, readings = fit.likelihood.readings.shape
    agreement, images = fit.agreement, images * fit.likelihood.scene.lamp_count
    # Of independent residuals both are 1, with these standard deviations.
    return (
        agreement.inflation() > 1 + 6 * np.sqrt(2 / (3 * images)),
        agreement.pattern() > 1 + 6 * np.sqrt(2 / readings),
    )


def _residuals(scene: Scene, fit: CalibrationFit) -> list[str]:
    agreement, notes = fit.agreement, []
    misfit = agreement.misfit
    outliers = 1 - fit.likelihood.used[:, fit.likelihood.works].mean()
    if outliers > MANY_OUTLIERS:
        notes.append(f"{outliers:.0%} of the readings are outliers: look at the picture")
    common, pattern = _correlated(fit)
    if common:
        notes.append(
            "the residuals within an image are correlated: its pose or the lamp's power is off, or "
            "the model; give the poses' standard deviation, or see the picture"
        )
    if pattern:
        notes.append(
            "each detector has the same error in all images: gains or beam, which were held, are "
            "not the scene's"
        )
    if misfit > MISFIT:
        notes.append(
            f"the model does not explain the data: mean squared residual {misfit:.2f}, "
            f"not 1; standard errors were multiplied by {np.sqrt(misfit):.2f}"
        )
        if "sensor_noise" in scene.effects and not (common or pattern):
            noise = fitted_noise(fit, scene)
            told = zip((NOISE, RELATIVE), noise.values, strict=True)
            words = " and ".join(f"{name} {value:.3g}" for name, value in told)
            notes.append(f"the residuals are independent, like noise: {words} would explain them")
    elif misfit < 1 / MISFIT and agreement.uncensored.any():
        notes.append(
            f"mean squared residual {misfit:.2f}, below 1: the noise is less than the scene "
            "says, and the standard errors are too large"
        )
    return notes
