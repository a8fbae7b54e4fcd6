"""``uuv_array budget``: compute counts, noise and reach from lamp, water and electronics.

Compute counts, noise and reach of a scene from the lamp's watts and the data sheets of photodiode,
amplifier and converter, by the same models of light and noise as all commands. The output also has
the keys for a scene file, the lamp's risk group for eyes, and the errors of a pose that building
tolerances cause. With --reach, the least watts for a reach are found.

  uuv_array budget                                     the instrument of the guide
  uuv_array budget --scene harbour --set lamp_w=2      in another water, with a brighter lamp
  uuv_array budget --reach 8                           the least watts that reach 8 m
  uuv_array budget --set daylight_w_per_m2=1 --set filter=0.7    by day, behind a filter
  uuv_array budget --write sea.yaml                    the keys as a scene file
The reach is the span of ranges at which the Cramer-Rao bound of one image, as of `uuv_array limits`
with the scene's prior, is within the specification of Eren et al. (2016), 0.2 m and 10 deg.
"""

import argparse
import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.commands.limits import aligned, reach, within
from uuv_optical_array.core.geometry import IN_DEGREES, Array
from uuv_optical_array.core.settings import Quantity, declared
from uuv_optical_array.core.storage import files
from uuv_optical_array.core.storage.yaml_text import text_of
from uuv_optical_array.estimation.information.cramer_rao import cramer_rao_bound
from uuv_optical_array.estimation.information.tolerances import tolerances
from uuv_optical_array.forward.lamp.beam import gaussians_of
from uuv_optical_array.forward.lamp.lamps import BeaconLamp
from uuv_optical_array.forward.link_budget import Instrument, keys, least_watts, scene_with
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.noise import reading_variance
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.forward.scene_files import EXTENDS, is_file_name, scene_file
from uuv_optical_array.forward.working_volume import SPECIFIED, SPECIFIED_TEXT
from uuv_optical_array.plots.style import new_figure, plain_log_ticks, save

RANGES_M = (1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0)
DRAWN_M = np.geomspace(1.0, 20.0, 120)
BUILT_M = 6.0  # where errors of building are reported
RISK = ("exempt", "group 1: low risk", "group 2: do not stare", "group 3: high risk")
REACH = Quantity("range for which the least lamp_w is found and used", "m", 0.5, 100)


def rows(scene: Scene, ranges_m: Any) -> Array:
    """Return brightest reading, its noise, and bounds in range, across and in angle, ``(n, 5)``."""
    model, poses = ForwardModel(scene), aligned(ranges_m)
    light = model.light(poses).max(axis=(-2, -1))
    noise = np.sqrt(reading_variance(light, model.own_noise))
    std = cramer_rao_bound(model, poses).std * IN_DEGREES
    return np.column_stack([light, noise, std[:, 0], std[:, 1:3].max(1), std[:, 3:].max(1)])


def report(scene: Scene, instrument: Instrument, base: str) -> str:
    """Return the budget of a scene with its instrument, as text."""
    beam, full_scale = scene.lamp.beam_sigma_deg, scene.full_scale_counts
    lamps = scene.lamps or (BeaconLamp(),)
    whole = sum(lamp.power for lamp in lamps)
    shape = gaussians_of(scene.lamp)
    group, blue, thermal = max(
        instrument.risk_group(lamp.beam_sigma_deg or beam, lamp.power / whole, shape)
        for lamp in lamps
    )
    of, dark = instrument, np.sqrt(ForwardModel(scene).noise.variance)
    lit, on_axis = f"{of.lamp_w:.4g} W in a beam of {beam:g} deg", of.intensity(beam, shape)
    names = f"{len(lamps)} lamps" if scene.lamps else "lamp"
    amplifier = f"{of.amplifier_noise():.2g} A/sqrt(Hz) in {of.bandwidth_hz:g} Hz"
    count = f"{of.amps_per_count:.3g} A, {1 / of.counts_per_w_per_m2:.3g} W/m^2"
    radiance = f"blue light {blue:.3g}, thermal {thermal:.3g} W/(m^2 sr)"
    lines = [
        f"{names}: {lit}: {on_axis:.3g} W/sr on its axis",
        f"eyes: {RISK[group]} (IEC 62471 at 0.2 m: {radiance})",
        f"a count: {count}; full scale {full_scale:g} counts",
        f"noise in the dark: {dark:.3g} counts, with rounding; amplifier and converter {amplifier}",
        "",
        "aligned, behind the lamp        bound of one image",
        "range (m)    counts     noise   range (m)  across (m)  angle (deg)",
    ]
    for range_m, (light, std, *bound) in zip(RANGES_M, rows(scene, RANGES_M), strict=True):
        full = "  full scale" if light > full_scale else ""
        shown = "".join(f"{value:>12.3g}" for value in bound)
        lines.append(f"{range_m:9g}{light:11.4g}{std:9.3g}{shown}{full}")
    span = reach(scene)
    told = f"{span[0]:g} to {span[1]:g} m" if span else "none: not even at the reference range"
    lines += [f"reach within {SPECIFIED_TEXT}: {told}", ""]
    lines.append(f"errors of building, at {BUILT_M:g} m    range (mm)  across (mm)  angle (deg)")
    for name, error in tolerances(scene, aligned([BUILT_M])[0]).items():
        x, y, z, pitch, yaw = np.round(error * IN_DEGREES * [1e3, 1e3, 1e3, 1, 1], 3)
        lines.append(f"  {name:<31}{x:11g}{max(y, z):13g}{max(pitch, yaw):13g}")
    return "\n".join([*lines, "", f"for a scene file that extends {base}:", ""])


def draw(scene: Scene) -> Any:
    """Draw counts and noise, and the bounds in m and in degrees, by the range."""
    figure = new_figure(13, 5.6)
    light, noise, x, across, angle = rows(scene, DRAWN_M).T
    full, black = scene.full_scale_counts, scene.black_counts
    most_m, most_deg = SPECIFIED
    panels = (
        ("counts", {"brightest reading": light, "its noise": noise}, full, "full scale"),
        ("m", {"range": x, "across": across}, most_m, f"{most_m:g} m (paper)"),
        ("deg", {"angle": angle}, most_deg, f"{most_deg:g} deg (paper)"),
    )
    for axes, (unit, curves, limit, label) in zip(figure.subplots(1, 3), panels, strict=True):
        for (name, curve), style in zip(curves.items(), ("-", "--"), strict=False):
            axes.plot(DRAWN_M, curve, style, lw=2, label=name)
        axes.axhline(limit, color="k", lw=1, ls=":", label=label)
        if unit == "counts" and black:
            axes.axhline(black, color="grey", lw=1, ls="-.", label="darkness")
        if (light > full).any():
            nearest = DRAWN_M[light > full].max()
            shaded = "a detector at full scale" if unit == "counts" else None
            axes.axvspan(DRAWN_M[0], nearest, color="0.9", zorder=0, label=shaded)
        axes.set(xscale="log", yscale="log", xlabel="base_link behind the lamp (m)")
        axes.set_ylabel(unit if unit == "counts" else f"least std of one image ({unit})")
        if unit != "counts":
            plain_log_ticks(axes.yaxis)
        axes.set_xticks([1, 2, 3, 5, 10, 20], ["1", "2", "3", "5", "10", "20"])
        axes.grid(alpha=0.4)
        axes.legend()
    figure.suptitle(f"Link budget in the water of {scene.name}")
    return figure


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    options.add_scene(parser, "follow")
    options.add_set(parser, declared(Instrument))
    options.add_number(parser, "reach", REACH, None, float)
    outputs.add_picture(parser, "budget.png")
    about = "scene file of the printed keys, which extends the scene"
    parser.add_argument("--write", type=Path, metavar="FILE", help=about)


def extended_from(name: str, file: Path) -> str:
    """Return the name by which a file extends a scene: a path is one from the file's folder.

    ValueError where the file is the scene itself.
    """
    if not is_file_name(name):
        return name
    base = scene_file(name)
    if file.exists() and file.samefile(base):
        raise ValueError(f"--write {file}: it is the scene that it would extend; name another file")
    return os.path.relpath(base.resolve(), file.resolve().parent)


def run(args: argparse.Namespace) -> int:
    """Print the budget, or the watts for a reach, and draw it."""
    base, instrument = options.scene_of(args), Instrument(**dict(args.set))
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    write = args.write and outputs.file_to_write(args.write, "--write", outputs.SCENE)
    with options.checking_options():
        extends = extended_from(args.scene, write) if write else args.scene
    if args.reach is not None:
        watts = least_watts(base, instrument, lambda scene: bool(within(scene, [args.reach])[0]))
        if watts is None:
            raise ValueError(
                f"--reach {args.reach:g}: no lamp reaches so far; the limit is full scale, the "
                "array, or what the prior leaves uncertain: calibrate, or see `uuv_array limits`"
            )
        instrument = dataclasses.replace(instrument, lamp_w=float(f"{watts:.4g}"))
    scene = scene_with(base, instrument)
    print(report(scene, instrument, args.scene))
    text = text_of({EXTENDS: extends, **keys(base, instrument)})
    print(text, end="")
    if write:
        files.write_text(write, text)
        print(f"scene: {write}")
    save(draw(scene), output)
    print(f"picture: {output}")
    return 0
