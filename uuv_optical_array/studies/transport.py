"""``uuv_array study transport``: compare the law of light in the sea with traced photons.

Compare the scenes' law of light in the sea with photons that benchmarks/trace_photons.py traced
scattering by scattering, without that law (config/flux/). Images of clear, coastal and harbour
water (Petzold 1972) and of lamps of 4, 8 and 16 deg are compared with the law, with the true
coefficients of the water and with fitted ones. Then poses are estimated from photon images by the
default scene, by the ready scene of that water, and by a scene that was calibrated on a drive
through it.

  uuv_array study transport                       the law, poses, and a picture of the beam
  uuv_array study transport --poses 1000 --json   one JSON object
  uuv_array study transport --output beam.svg     the picture where you want it
Ctrl-C ends it early and reports the poses it has.
"""

import argparse
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.cli import options, outputs, progress
from uuv_optical_array.core.geometry import YAW, Array, X, Y
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.core.storage.formats import columns, plain
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, load_scene, scene_from_settings
from uuv_optical_array.forward.working_volume import HIGH, LOW, MIN_PEAK_COUNTS, uniform_poses
from uuv_optical_array.plots.style import mark, new_figure, plain_log_ticks, save
from uuv_optical_array.studies import photon_transport as photons
from uuv_optical_array.studies.photon_transport import WATERS, Lamp, PhotonSea, shipped_pencil
from uuv_optical_array.studies.shared.errors import errors_of
from uuv_optical_array.studies.shared.results import until_interrupted

POSES = 300
BRIGHTEST = 1000.0  # of the images that the law is compared with, counts
DRIVE_IMAGES = 400
MIDDLE_M = 6.0  # where the error of the photons by chance is stated
# Water, phase function and beam, deg.
CASES: tuple[tuple[str, photons.Phase, float], ...] = (
    ("clear", "fournier_forand", 8.0),
    *(("coastal", "fournier_forand", beam) for beam in (4.0, 8.0, 16.0)),
    *(("harbour", "fournier_forand", beam) for beam in (4.0, 8.0, 16.0)),
    *((water, "henyey_greenstein", 8.0) for water in WATERS),
)
# The ready scene of each water, and the range of its poses, m.
SCENES = {
    "clear": ("clear_ocean", (4.0, 8.0)),
    "coastal": ("coastal", (4.0, 8.0)),
    "harbour": ("harbour", (3.5, 6.0)),
}
DEFAULT = "follow"
PROFILES_M, PROFILE_RAD = (4.0, 6.0, 8.0), np.radians(np.linspace(0, 30, 31))
COLOURS = ("#1f6fb4", "#2c9c5a", "#e08a00")


def ideal_scene(a: float, b: float, beam_deg: float) -> Scene:
    """Return the reference scene in a sea of absorption a and scattering b, 1/m."""
    settings = load_scene("reference").settings()
    settings["lamp"]["beam_sigma_deg"] = beam_deg
    settings["effects"].pop("attenuation", None)
    settings["effects"]["sea"] = {"absorption_per_m": a, "scattering_per_m": b}
    return scene_from_settings(settings, "reference")


def poses_between(ranges_m: tuple[float, float], count: int, rng: np.random.Generator) -> Array:
    """Draw poses as in the working volume, but between other ranges, m and rad, ``(count, 5)``."""
    poses = uniform_poses(count, rng)
    poses[:, X] = np.interp(poses[:, X], [LOW[X], HIGH[X]], [-ranges_m[1], -ranges_m[0]])
    return poses


def law_beside(water: str, phase: photons.Phase, beam_deg: float, poses: Array) -> dict[str, Any]:
    """Compare the law with photons at poses: RMS in counts, power fitted, then a and b, too."""
    pencil = shipped_pencil(water, phase)
    lamp = Lamp(pencil, np.radians(beam_deg))
    seen = lamp.images(ForwardModel(load_scene("reference")), poses)
    seen *= BRIGHTEST / seen.max()

    def residual(logarithms: Array) -> Array:
        a, b = map(float, np.exp(logarithms))
        light = ForwardModel(ideal_scene(a, b, beam_deg)).light(poses)
        return np.ravel((light * seen).sum() / (light * light).sum() * light - seen)

    true = np.log([pencil.absorption_per_m, pencil.scattering_per_m])
    fit = least_squares(residual, true, diff_step=1e-4)
    i = np.abs(photons.RADII_M - MIDDLE_M).argmin()
    radius_m = photons.RADII_M[i]
    axis = lamp.vector(np.array([radius_m]), np.zeros(1))[0] * radius_m**2
    case = {"water": water, "phase": phase, "beam_deg": beam_deg, "photons": pencil.photons}
    off = {"true": residual(true), "fitted": fit.fun}
    rms = {f"rms_{name}": np.sqrt(np.mean(values**2)) for name, values in off.items()}
    by_chance = lamp.error[i, 0] / axis[0]
    return {**case, "by_chance": by_chance, **rms, "true": np.exp(true), "fitted": np.exp(fit.x)}


def poses_by(
    estimator: Estimator,
    truth: PhotonSea,
    ranges_m: tuple[float, float],
    count: int,
    seed: int,
    what: str = "",
) -> dict[str, Any]:
    """Return figures of poses from photon images; of fewer after Ctrl-C."""
    rng, poses = np.random.default_rng(seed), np.empty((0, 5))
    while len(poses) < count:
        drawn = poses_between(ranges_m, count, rng)
        lit = truth.light(drawn).max(axis=(1, 2)) > MIN_PEAK_COUNTS
        poses = np.concatenate([poses, drawn[lit]])[:count]
    images = truth.model.read(truth.light(poses), rng)
    frames = errors_of(estimator, truth.model, poses, images, what)
    return plain({"frames": len(frames.errors), **frames.summary()})


def measure_poses(count: int, seed: int) -> Iterator[dict[str, Any]]:
    """Yield figures of each water by the default, the ready and the calibrated scene.

    Ctrl-C is raised after the last ones, of fewer poses.
    """
    default = load_scene(DEFAULT)
    for water, (name, ranges_m) in SCENES.items():
        pencil, ready = shipped_pencil(water), load_scene(name)
        truth = PhotonSea(ready, pencil)
        rng = np.random.default_rng((seed, 1))
        drive = poses_between(ranges_m, DRIVE_IMAGES, rng)
        fitted, refusal = _calibrated(ready, truth.model.read(truth.light(drive), rng), drive)
        for scene, label, seen in (
            (default, DEFAULT, PhotonSea(default, pencil)),
            (ready, name, truth),
            (fitted, f"{name}, calibrated", truth),
        ):
            row = {"water": water, "scene": label}
            if scene is None:
                yield {**row, "refusal": refusal}
                continue
            estimator = Estimator(scene, "least_squares").wait()
            figures = poses_by(estimator, seen, ranges_m, count, seed, f"{water}, {label}")
            yield {**row, "refusal": "", **figures}
            if figures["frames"] < count:
                raise KeyboardInterrupt


def _calibrated(scene: Scene, images: Array, poses: Array) -> tuple[Scene | None, str]:
    """Return the scene that a drive determines, or why there is none."""
    try:
        fitted = calibrate(scene, images, poses)
    except ValueError as error:
        return None, str(error)
    return (None if fitted.refusal else fitted.scene), fitted.refusal


def report_law(rows: Sequence[dict[str, Any]]) -> str:
    """Return rows of `law_beside` as a table."""
    heads = ("beam", "photons", "a, b true", "a, b fitted", "a", "(true)", "b", "(true)")
    lines: list[Sequence[str]] = [("water", "phase function", *heads)]
    for row in rows:
        about = f"{row['beam_deg']:g} deg", f"{100 * row['by_chance']:.2f} %"
        errors = f"{row['rms_true']:.2f}", f"{row['rms_fitted']:.2f}"
        water = (f"{x:.3f}" for pair in zip(row["fitted"], row["true"], strict=True) for x in pair)
        lines.append((row["water"], row["phase"], *about, *errors, *water))
    return f"law beside photons: RMS of images up to 1000 counts\n{columns(lines, 2)}"


def report_poses(rows: Sequence[dict[str, Any]]) -> str:
    """Return rows of `measure_poses` as a table."""
    keys = ("nees_mean", "rms_range_m", "rms_across_m", "rms_angle_deg")
    heads = ("answered", "beyond 6 sigma", "NEES", "range (m)", "across (m)", "angle (deg)")
    lines: list[Sequence[object]] = [("water", "scene", *heads)]
    for row in rows:
        about, answers = (row["water"], row["scene"]), ("refused",)
        if not row["refusal"]:
            figures = ("-" if row[key] is None else f"{row[key]:.3g}" for key in keys)
            answers = f"{row['answered']} of {row['frames']}", row["beyond_6_sigma"], *figures
        lines.append((*about, *answers))
    reasons = [f"{row['scene']}: {row['refusal']}" for row in rows if row["refusal"]]
    return "\n".join(["poses from photon images: RMS errors", columns(lines, 2), *reasons])


def draw(beam_deg: float = 8.0) -> Any:
    """Draw the beam of the law and of photons in each water at `PROFILES_M`."""
    figure = new_figure(12, 6.4)
    grid = figure.subplots(2, len(WATERS), sharex=True, sharey="row", height_ratios=(2, 1))
    middle = load_scene("reference").array.detectors_per_side // 2
    for (profile, ratio), (water, (a, b)) in zip(grid.T, WATERS.items(), strict=True):
        model = ForwardModel(ideal_scene(a, b, beam_deg))
        lamp = Lamp(shipped_pencil(water), np.radians(beam_deg))
        ahead = float(model.array.positions[:, X].max())
        vacuum = model.power * np.exp(-a * np.array(PROFILES_M)) / np.array(PROFILES_M) ** 2
        for range_m, dimmed, colour in zip(PROFILES_M, vacuum, COLOURS, strict=True):
            # The middle detector faces the lamp.
            poses = np.zeros((len(PROFILE_RAD), 5))
            poses[:, X] = -(range_m + ahead) * np.cos(PROFILE_RAD)
            poses[:, Y] = (range_m + ahead) * np.sin(PROFILE_RAD)
            poses[:, YAW] = -PROFILE_RAD
            law = model.light(poses)[:, middle, middle] / dimmed
            seen = lamp.images(model, poses)[:, middle, middle] * model.power / dimmed
            degrees = np.degrees(PROFILE_RAD)
            profile.plot(degrees, law, color=colour, lw=1.5)
            profile.plot(degrees, seen, "o", color=colour, ms=3.5)
            ratio.plot(degrees, 100 * (law - seen) / seen[0], color=colour, lw=1.5)
        straight = np.exp(-0.5 * (PROFILE_RAD / np.radians(beam_deg)) ** 2)
        profile.plot(degrees, straight, color="0.5", lw=1, ls="--")
        profile.set(yscale="log", ylim=(3e-3, 1.3))
        plain_log_ticks(profile.yaxis)
        profile.set_title(f"{water}: a {a:g}, b {b:g} /m")
        ratio.set_xlabel("angle off the beam's axis (deg)")
        for axes in (profile, ratio):
            axes.grid(alpha=0.4)
    grid[0, 0].set_ylabel("light, of the axis without scattering")
    grid[1, 0].set_ylabel("law less photons\n(% of the axis)")
    handles = [mark(f"{r:g} m", "s", color=c) for r, c in zip(PROFILES_M, COLOURS, strict=True)]
    handles += [mark("photons"), mark("law", "", lw=1.5, ls="-")]
    handles.append(mark("without scattering", "", lw=1, ls="--"))
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    figure.suptitle(f"A beam of {beam_deg:g} deg in three waters, law and photons")
    return figure


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_number(parser, "poses", Quantity("poses in each water", "", 1, 1e6), POSES)
    options.add_seed(parser)
    options.add_json(parser)
    outputs.add_picture(parser, "transport.png")


def run(args: argparse.Namespace) -> int:
    """Run the study, print and draw it."""
    count, seed = args.poses, args.seed
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    save(draw(), output)
    compared = uniform_poses(count, np.random.default_rng(seed))
    law = [law_beside(*case, compared) for case in progress.over(CASES, unit="case")]
    poses, complete = until_interrupted(measure_poses(count, seed))
    result: dict[str, Any] = {"seed": seed, "complete": complete, "picture": str(output)}
    text = f"{report_law(law)}\n\n{report_poses(poses)}\n\npicture: {output}"
    result |= {"law": law, "poses": poses}
    return outputs.finish(args, result, text, complete, "the table ends where the work ended")
