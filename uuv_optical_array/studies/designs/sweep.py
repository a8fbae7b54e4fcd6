"""Which designs of array and lamp are swept, and the scene of each."""

import dataclasses
import itertools
import math
import typing
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from uuv_optical_array.cli import options
from uuv_optical_array.core.settings import Setting, declared
from uuv_optical_array.forward.array import ArraySettings, Shape
from uuv_optical_array.forward.lamp.beam import LampSettings, beam_solid_angle, gaussians_of
from uuv_optical_array.forward.lamp.lamps import ring_of_lamps, spread_and_tilt
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene

# Values of settings by their names, all of `SWEPT`.
Sweep: TypeAlias = Mapping[str, Sequence[Any]]

RING = declared(ring_of_lamps)
SWEPT: dict[str, Setting] = {
    name: (declared(ArraySettings) | declared(LampSettings))[name]
    for name in ("shape", "detectors_per_side", "width_m", "radius_m", "beam_sigma_deg")
} | RING
# Radii of 0.8 widths are as curved as the paper's.
DEFAULTS: dict[str, tuple[Any, ...]] = {
    "detectors_per_side": (3, 5, 7, 9, 11, 21),
    "width_m": (0.2, 0.3, 0.4, 0.5, 0.6),
    "radius_m": (0.16, 0.24, 0.32, 0.4, 0.48, 0.64),
    "beam_sigma_deg": (4.0, 6.0, 8.0, 11.0, 15.0, 20.0),
}


@dataclass(frozen=True)
class Design:
    """An array and lamps; settings as in `ArraySettings`, `LampSettings`, `ring_of_lamps`."""

    shape: Shape
    detectors_per_side: int
    width_m: float
    radius_m: float | None
    beam_sigma_deg: float
    lamps: int
    spread_m: float
    tilt_deg: float

    @classmethod
    def of(cls, scene: Scene) -> "Design":
        """Return the design that a scene has; of several lamps with the means of their ring."""
        ring = scene.lamp_count, *spread_and_tilt(scene.lamps)
        values: dict[str, Any] = {**vars(scene.array), **vars(scene.lamp)}
        values |= dict(zip(RING, ring, strict=True))
        return cls(**{name: values[name] for name in SWEPT})

    @property
    def detectors(self) -> int:
        """How many there are."""
        return self.detectors_per_side**2

    @property
    def label(self) -> str:
        """The design in words."""
        radius = "" if self.radius_m is None else f", radius {self.radius_m:g} m"
        side, beam = self.detectors_per_side, f"beam {self.beam_sigma_deg:g} deg"
        ring = f", {self.lamps} lamps at {self.spread_m:g} m, {self.tilt_deg:g} deg"
        lamps = ring if self.lamps > 1 else ""
        return f"{self.shape} {side} x {side}, {self.width_m:g} m{radius}, {beam}{lamps}"


def sweep_of(scene: Scene, words: Sequence[str] = ()) -> Sweep:
    """Return a sweep about a scene's own design, or of lists, each ``NAME=VALUE,VALUE``.

    ValueError for an unknown name, no value, one given twice or out of bounds, or no design left.
    """
    lists: dict[str, list[Any]] = {}
    for word in words:
        name, values = options.assigned(word, SWEPT)
        if name in lists:
            raise ValueError(f"{name}: given twice; give its values once")
        lists[name] = [options.value_of(name, SWEPT[name], value) for value in values.split(",")]
        for value, count in Counter(lists[name]).items():
            if count > 1:
                raise ValueError(f"{name}: {value} is given twice; give it once")
    own = vars(Design.of(scene))
    about = {name: sorted({*values, own[name] or values[0]}) for name, values in DEFAULTS.items()}
    about |= {"shape": [*typing.get_args(Shape)], **{name: [own[name]] for name in RING}}
    sweep = about | lists
    designs, dropped = designs_of(sweep)
    if not designs:
        raise ValueError(f"radius_m: no design is left ({'; '.join(dropped)}); give a larger one")
    return sweep


def designs_of(sweep: Sweep) -> tuple[list[Design], dict[str, int]]:
    """List the designs of a sweep that can be built, and count the others by their faults."""
    # The number of detectors changes fastest.
    names = ("shape", "radius_m", "width_m", "beam_sigma_deg", *RING, "detectors_per_side")
    faults = {}
    for values in itertools.product(*(sweep[name] for name in names)):
        design = Design(**dict(zip(names, values, strict=True)))
        if design.shape == "planar":
            design = dataclasses.replace(design, radius_m=None)
        if design.lamps == 1:  # in the middle
            design = dataclasses.replace(design, spread_m=0.0, tilt_deg=0.0)
        faults[design] = _fault(design)
    dropped = Counter(filter(None, faults.values()))
    return [design for design, fault in faults.items() if not fault], dict(dropped)


def _fault(design: Design) -> str:
    """Say why a design cannot be built, alike for all that share the reason; empty: it can be."""
    try:
        ArraySettings(design.shape, 2, design.width_m, 0.0, design.radius_m)
    except ValueError:
        return f"{design.width_m:g} m wide on a sphere of {design.radius_m:g} m: corners beyond it"
    if design.lamps > 1 and not (design.spread_m or design.tilt_deg):
        return "several lamps in one place that point the same way"
    return ""


def designed(scene: Scene, design: Design) -> Scene:
    """Return a scene with the array and the lamp of a design, whose lamp emits as much light.

    The array's foremost point stays. ValueError if it cannot be built, or gets no light.
    """
    bow_m = scene.array.bow_m - ((design.radius_m or 0.0) - (scene.array.radius_m or 0.0))
    side, radius_m = design.detectors_per_side, design.radius_m
    array = ArraySettings(design.shape, side, design.width_m, bow_m, radius_m)
    lamp = dataclasses.replace(scene.lamp, beam_sigma_deg=design.beam_sigma_deg)
    own, ring = Design.of(scene), {name: getattr(design, name) for name in RING}
    lamps = scene.lamps if ring.items() <= vars(own).items() else ring_of_lamps(**ring)
    if lamps and not scene.lamps:
        raise ValueError(
            f"lamps: {design.lamps}: scene {scene.name} has one lamp, and no prior for several; "
            "take a scene that extends leading_lights"
        )
    changed = dataclasses.replace(scene, array=array, lamp=lamp).with_lamps(lamps)
    if design == own:
        return changed
    own_sr, beam_sr = (
        beam_solid_angle(math.radians(it.beam_sigma_deg), gaussians_of(lamp))
        for it in (scene.lamp, design)
    )
    brighter = ForwardModel(scene).power * own_sr / beam_sr / ForwardModel(changed).power
    lamp = dataclasses.replace(lamp, reference_counts=brighter * lamp.reference_counts)
    return dataclasses.replace(changed, lamp=lamp)
