"""What a calibration found, as text and as plain values."""

import dataclasses
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from uuv_optical_array.calibration.clock import Clock
from uuv_optical_array.calibration.result import Calibration, FittedParameter
from uuv_optical_array.recording.images import Recording

SHOWN_IMAGES = 5


def _digits(std: float) -> int:
    """Return the decimals that show two digits of a standard error."""
    return int(np.clip(1 - np.floor(np.log10(std)), 0, 9)) if 0 < std < np.inf else 4


def _row(parameter: FittedParameter) -> str:
    name, unit, start, value, std, note = dataclasses.astuple(parameter)
    digits = _digits(std)
    error = "-" if np.isnan(std) else f"{std:.{digits}f}"
    values = f"{name:<27}{start:>12.6g}{value:>14.{digits}f}{error:>12}"
    return f"{values}  {unit:<11}{note}".rstrip()


def _gains(result: Calibration, names: Sequence[str] = ()) -> list[str]:
    """Return the gains as a grid, or by the names of detectors, or, of many, their spread."""
    if len(names) == 1:
        return ["gain: part of the power"]
    known = result.gain_std[np.isfinite(result.gain_std)]
    if not known.size:
        return ["gains: as they were"]
    digits = _digits(float(known.min()))
    errors = f"std errors {known.min():.{digits}f} to {known.max():.{digits}f}"
    head = f"gains, geometric mean 1, rows from the top, columns from port ({errors}):"
    gains = result.gains
    if names:
        values = zip(names, gains.ravel(), result.gain_std.ravel(), strict=False)
        each = (f"{name} {'-' if np.isnan(s) else f'{g:.{digits}f}'}" for name, g, s in values)
        named = f"gains of detectors, geometric mean 1 ({errors}): "
        return textwrap.wrap(named + ", ".join(each), 100, subsequent_indent="  ")
    if len(gains) > 9:
        low, high, std = (f"{x:.{digits}f}" for x in (gains.min(), gains.max(), gains.std()))
        return [head, f"  {gains.size} from {low} to {high}, spread {std}"]
    shown = np.where(np.isfinite(result.gain_std), gains, np.nan)
    wide = [[f"{x:.{digits}f}".replace("nan", "-").rjust(digits + 5) for x in row] for row in shown]
    return [head, *map("".join, wide)]


def report(
    result: Calibration,
    recording: Recording,
    source: str,
    start: str,
    at: str = "",
    names: Sequence[str] = (),
    timed: bool = True,
) -> str:
    """Return the fitted values and how well the model agrees, as text.

    `source` names the recording and `start` the scene before the fit; `at` says at which places, if
    they were measured; `names` are those of detectors in a layout; `timed` whether the images have
    times.
    """
    seconds, poses = recording.seconds, recording.poses
    ranges = np.linalg.norm(poses[:, :3], axis=1)
    off = np.degrees(np.arctan2(np.linalg.norm(poses[:, 1:3], axis=1), -poses[:, 0]))
    lines = [
        f"{source}: {len(seconds)} images"
        f"{f' in {np.ptp(seconds):.1f} s' * timed}{at}, "
        f"base_link {ranges.min():.2f} to {ranges.max():.2f} m from the lamp, up to "
        f"{off.max():.1f} deg off its axis",
        *(f"  {line}" for line in recording.left_out),
        "",
        f"{'parameter':<27}{'start: ' + start:>12}{'fitted':>14}{'std error':>12}  unit",
        *map(_row, result.parameters),
        "",
        *_gains(result, names),
        "",
    ]
    correlations = np.tril(np.nan_to_num(result.correlation), -1)
    i, j = np.unravel_index(np.argmax(np.abs(correlations)), correlations.shape)
    if correlations[i, j]:
        first, second = result.parameters[i].name, result.parameters[j].name
        lines.append(f"strongest correlation: {first} with {second} {correlations[i, j]:+.2f}")
    count, images = int(result.uncensored.sum()), result.outlying_images
    explained = "(1: the model explains them)"
    lines.append(f"mean squared residual {result.misfit:.3f} of {count} readings {explained}")
    if result.outliers or images:
        where = [f"{seconds[i]:.3f} s" for i in images[:SHOWN_IMAGES]]
        where += ["..."] * (len(images) > SHOWN_IMAGES)
        whole = f"{len(images)} whole images" + f" (at {', '.join(where)})" * bool(where)
        lines.append(f"outliers left out: {result.outliers} single readings, {whole}")
    return "\n".join([*lines, *(f"note: {note}" for note in result.notes)])


def as_json(
    result: Calibration, recording: Recording, clock: Clock | None = None
) -> dict[str, Any]:
    """Return the result as plain values and arrays; what is not known is nan."""
    return {
        "images": len(recording.images),
        "left_out": dict(recording.refused),
        "parameters": {
            name: {"unit": unit, "start": start, "fitted": value, "std_error": std, "note": note}
            for name, unit, start, value, std, note in map(dataclasses.astuple, result.parameters)
        },
        "residuals_off_axis": result.by_angle._asdict(),
        "gains": result.gains,
        "gain_std_errors": result.gain_std,
        "correlation": result.correlation,
        "mean_squared_residual": result.misfit,
        "outlying_readings": result.outliers,
        "outlying_images_s": recording.seconds[list(result.outlying_images)],
        "clock": clock and dataclasses.asdict(clock),
        "notes": list(result.notes),
        "refusal": result.refusal,
        "scene": result.scene.settings(),
    }
