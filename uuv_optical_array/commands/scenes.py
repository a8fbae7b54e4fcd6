"""``uuv_array scenes``: list ready scenes, or explain a scene or a key.

List the ready scenes with their key figures, or explain one name. For a scene, ready or a file, it
prints all settings, including those of the scenes that it extends, as a file that can be used. For
a group, an effect or a key it prints unit, bounds, default and source.

  uuv_array scenes                        all ready scenes
  uuv_array scenes coastal > sea.yaml     all its settings
  uuv_array scenes plume                  an effect; lamp: a group; seed: all keys of that name
  uuv_array scenes effects                every effect, one line each
  uuv_array scenes sea.yaml --output beam.png  its beam beside the photometric file that it names
  uuv_array scenes schema > scene.schema.json
An editor with a YAML language server completes and checks a scene by the schema, if a line of it
says: # yaml-language-server: $schema=scene.schema.json
The reach is the span of ranges, within 0.5 to 25 m, at which the Cramer-Rao bound of one image of
the aligned array is at most 0.2 m and 10 deg, with all that the scene's prior leaves uncertain.
Beyond the reach, as far as the scene's table, errors are larger, and so are the covariances.
"""

import argparse
import inspect
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from uuv_optical_array.cli import options, outputs
from uuv_optical_array.commands.limits import REACH_M, reach
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Setting, Span, declared, hint, summary
from uuv_optical_array.core.storage import files, yaml_text
from uuv_optical_array.forward import scene_files
from uuv_optical_array.forward.effects import EFFECTS
from uuv_optical_array.forward.lamp.beam import radiance
from uuv_optical_array.forward.lamp.lamps import BeaconLamp
from uuv_optical_array.forward.lamp.photometric_files import read
from uuv_optical_array.forward.lamp.photometry import FittedBeam, fitted
from uuv_optical_array.forward.scene import GROUPS, Scene, load_scene, scene_from_settings
from uuv_optical_array.forward.scene_files import ready_scenes, scene_file, sentence
from uuv_optical_array.forward.working_volume import SPECIFIED_TEXT
from uuv_optical_array.plots.style import new_figure, save

OWNERS: dict[str, Callable[..., Any]] = {
    **GROUPS,
    "lamps": BeaconLamp,
    **{f"effects.{name}": effect.function for name, effect in EFFECTS.items()},
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    names = "of a scene, a group, an effect or a key; schema: the JSON schema of scenes"
    parser.add_argument("name", nargs="?", help=f"{names} (default: list the ready scenes)")
    outputs.add_picture(parser, None, about="picture of the beam beside a scene's photometric file")


def figures(scene: Scene) -> list[str]:
    """Return the key figures of a scene, in lines."""
    lamp, array, span = scene.lamp, scene.array, reach(scene)
    side, (_, k_per_m) = array.detectors_per_side, scene.attenuation
    water = f"K {k_per_m:.3g} /m"
    if "sea" in scene.effects:
        water = f"a {k_per_m:.3g}, b {scene.effects['sea']['scattering_per_m']:.3g} /m"
    full = f" of {scene.full_scale_counts:g}" if scene.effects else ""
    text = "nowhere"
    if span is not None:
        beyond = "beyond " if span[1] == REACH_M[-1] else ""
        text = f"{span[0]:.1f} to {beyond}{span[1]:.1f} m"
    known = scene.prior.known
    named = scene_from_settings({**scene.settings(), "prior": {"known": known}}, scene.name).prior
    # The keys in which the prior differs from the one of its name.
    others = [key for key, value in vars(scene.prior).items() if value != vars(named)[key]]
    prior = known + f" except {', '.join(others)}" * bool(others)
    counts = f"{lamp.reference_counts:g}{full} counts"
    if scene.lamps:  # the full scale is that of the image of each
        counts = f"{lamp.reference_counts:g} counts by {len(scene.lamps)} lamps"
        counts += f", each{full},"
    return [
        f"{array.shape} {side} x {side}, {counts} at "
        f"{lamp.reference_range_m:g} m, beam {lamp.beam_sigma_deg:g} deg, {water}",
        f"reach within {SPECIFIED_TEXT}: {text}, table to {-scene.table.x_m.start:g} m; "
        f"known {prior}",
        f"effects: {', '.join(scene.effects) or 'none'}",
    ]


def settings_text(name: str) -> str:
    """Return a scene with all its settings, as a file that can be used."""
    file = scene_file(name)
    bases = [layer.extends for layer in scene_files.layers(file) if layer.extends]
    about = f"{file.stem} extends {', which extends '.join(bases)}." if bases else ""
    comment = "".join(
        f"# {line}\n" for line in (sentence(file), about, *beside(photometry_of(file))) if line
    )
    return f"{comment}\n{yaml_text.text_of(load_scene(name).settings())}".strip()


def photometry_of(file: Path) -> Path | None:
    """Return the photometric file that a scene names; ``None`` without one."""
    lamp = scene_files.merged(scene_files.layers(file)).get("lamp") or {}
    return Path(lamp["photometry"]) if lamp.get("photometry") else None


def light_of(beam: FittedBeam, angles_deg: Array) -> Array:
    """Return the intensity of a fitted beam, over that of the file on the axis."""
    shape = np.array([beam.weights, beam.widths])
    return beam.on_axis * radiance(shape, angles_deg / beam.sigma_deg)


def beside(path: Path | None) -> list[str]:
    """Return the beam of a photometric file beside it, in lines; none without one."""
    if path is None:
        return []
    measured = read(path)
    beam = fitted(measured)
    angles: Array = beam.reach_deg * np.arange(9.0) / 8
    of_file = np.interp(angles, measured.angles_deg, measured.mean)
    half = f"half-width {measured.half_width_deg:.1f} deg"
    return [
        f"lamp.photometry {path.name}: {half}; {beam.text()}.",
        "deg of 1000: " + ", ".join(f"{angle:.1f}" for angle in angles),
        "       file: " + ", ".join(f"{1000 * value:.0f}" for value in of_file),
        "       beam: " + ", ".join(f"{1000 * value:.0f}" for value in light_of(beam, angles)),
    ]


def draw(path: Path) -> Any:
    """Draw the beam of a photometric file beside its planes, and what is left of 1000."""
    measured = read(path)
    beam, figure = fitted(measured), new_figure(8, 7)
    light, rest = figure.subplots(2, sharex=True, height_ratios=(2, 1))
    angles: Array = min(1.5 * beam.reach_deg, measured.angles_deg[-1]) * np.arange(301.0) / 300
    mean = np.interp(angles, measured.angles_deg, measured.mean)
    scale = float(measured.shares @ measured.intensities[:, 0]) / 1000
    for k, plane in enumerate(measured.intensities):
        about = {"label": "planes of the file"} if k == 0 else {}
        light.plot(measured.angles_deg, plane / scale, color="0.7", lw=0.8, **about)
    light.plot(angles, 1000 * mean, "k", lw=2, label="their mean")
    light.plot(angles, 1000 * light_of(beam, angles), "C1--", lw=2, label="scene")
    rest.plot(angles, 1000 * (light_of(beam, angles) - mean), "C1", lw=2)
    for axes in (light, rest):
        axes.axvline(beam.reach_deg, color="k", lw=1, ls=":")
        axes.grid(alpha=0.4)
    light.set(ylabel="intensity (1000: on the axis)", title=f"{path.name}: {beam.rms:.1f} rms")
    light.legend()
    rest.set(xlabel="off the axis (deg); dotted: end of the fit", ylabel="scene less mean")
    rest.set_xlim(0, angles[-1])
    return figure


def bounds_text(setting: Setting) -> str:
    """Return the bounds or the words of a setting, and its default."""
    bounds = " or ".join(setting.choices) or setting.quantity.bounds()
    if setting.kind is str:
        bounds = "a text"
    if setting.kind is Span:
        bounds += ", as [from, to, how many]"
    if setting.required:
        return f"{bounds}; must be given"
    if setting.default is None:
        return f"{bounds}; no default"
    default = list(setting.default) if isinstance(setting.default, tuple) else setting.default
    return f"{bounds}; default {f'{default:g}' if isinstance(default, float) else default}"


def explanation(name: str) -> Iterator[str]:
    """Yield what a group, an effect or the keys of a name mean; nothing for another name."""

    def matches(full: str) -> bool:
        return full == name or full.endswith(f".{name}")

    if name == "effects":
        yield "A scene has only the effects that it, or one that it extends, names:"
        for effect, entry in EFFECTS.items():
            yield f"  {effect:<17}{summary(entry.function)}"
    for owner_name, owner in OWNERS.items():
        keys = declared(owner)
        if matches(owner_name):
            yield f"{owner_name}: {inspect.getdoc(owner)}\n"
        else:
            keys = {key: keys[key] for key in keys if matches(f"{owner_name}.{key}")}
        for key, setting in keys.items():
            text = f": {setting.quantity.text}" if setting.quantity.text else ""
            yield f"{owner_name}.{key}{text}\n  {bounds_text(setting)}"
        if keys and not matches(owner_name):
            yield textwrap.indent(f"of {owner_name}: {inspect.getdoc(owner)}", "  ")


def _picture(args: argparse.Namespace) -> int:
    output = outputs.file_to_write(args.output, "--output", outputs.PICTURE)
    with options.checking_options():
        path = photometry_of(scene_file(args.name)) if args.name else None
        if path is None:
            fault = f"{args.name or 'no scene'} names no lamp.photometry; give a scene that does"
            raise options.OptionError(f"--output {output}: {fault}")
        figure = draw(path)
    save(figure, output)
    print("\n".join(beside(path)))
    print(f"picture: {output}")
    return 0


def run(args: argparse.Namespace) -> int:
    """Print the list, the schema or an explanation."""
    name = args.name
    if args.output:
        return _picture(args)
    if name == "schema":
        print(files.shared_file("config/scene.schema.json").read_text("utf-8"), end="")
    elif name is None:
        for ready in ready_scenes():
            lines = ready, sentence(scene_file(ready)), *figures(load_scene(ready))
            print("\n  ".join(lines))
    elif scene_files.is_file_name(name) or name in ready_scenes():
        with options.checking_options():
            text = settings_text(name)
        print(text)
    elif text := "\n".join(explanation(name)):
        print(text.replace("``", "`"))
    else:
        keys = [f"{owner}.{key}" for owner in OWNERS for key in declared(OWNERS[owner])]
        known = [*ready_scenes(), "effects", *OWNERS, *keys]
        known += [full.rpartition(".")[2] for full in known if "." in full]
        kinds = "ready scene, .yaml file, group, effect or key"
        text = hint(name, known, "uuv_array scenes lists the ready ones")
        raise options.OptionError(f"{name}: no {kinds}; {text}")
    return 0
