"""What water and electronics do to the ideal light: one function an effect, one scene key each.

An effect is a function with the scene key's name. Its keyword-only arguments are the key's
settings; before them it asks by name for the ``array`` and, where it needs it, the ``lamp``. It is
called once, when a scene is planned, and returns the step that runs on every image; what a scene
does not name never runs. Effects run stage by stage and, within a stage, in the order of the list
below, which is the physical one.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import check_all, unknown
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.effects.detectors import (
    detector_faults,
    field_of_view,
    resolved_field_of_view,
    resolved_responsivity,
    responsivity,
)
from uuv_optical_array.forward.effects.electronics import (
    Variance,
    adc,
    photodiode,
    resolved_photodiode,
    saturation,
    sensor_noise,
    shot_noise,
)
from uuv_optical_array.forward.effects.moving import lamp_drift, lamp_flicker, plume
from uuv_optical_array.forward.effects.water import (
    ambient,
    attenuation,
    beam_spread,
    forward_scatter,
    resolved_ambient,
    resolved_attenuation,
)
from uuv_optical_array.forward.light import LampSettings, Light, Rays


class Stage(Enum):
    """Where an effect acts, in physical order, and the step that it returns."""

    LIGHT = "step(light, rays): the light on its way and on the array, changed in place"
    NOISE = "step(image) -> variance in counts^2 and its slope, independent of other noise"
    ANALOGUE = "step(image) -> image: electronics before the converter"
    DIGITAL = "step(image) -> image: the converter"


EFFECTS: dict[str, tuple[Stage, Callable[..., Callable[..., Any]]]] = {}


def effect(stage: Stage) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Register a function as the effect of its name, at `stage`."""

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        EFFECTS[function.__name__] = stage, function
        return function

    return register


for _stage, _functions in {
    Stage.LIGHT: (
        attenuation,
        lamp_flicker,
        lamp_drift,
        plume,
        beam_spread,
        field_of_view,
        ambient,
        forward_scatter,
        responsivity,
        detector_faults,
    ),
    Stage.NOISE: (sensor_noise, shot_noise, photodiode),
    Stage.ANALOGUE: (saturation,),
    Stage.DIGITAL: (adc,),
}.items():
    for _function in _functions:
        effect(_stage)(_function)

# Effects that act at the moment of an image, and do nothing where none is given.
MOVING = {function.__name__ for function in (lamp_flicker, lamp_drift, plume)}

# Where settings may be given in one of several ways: the check, which may turn them into one.
RESOLVED: dict[str, Callable[[dict[str, Any], str], dict[str, Any]]] = {
    "attenuation": resolved_attenuation,
    "field_of_view": resolved_field_of_view,
    "ambient": resolved_ambient,
    "responsivity": resolved_responsivity,
    "photodiode": resolved_photodiode,
}

Settings = Mapping[str, Mapping[str, Any]]


def check_effects(settings: Any) -> dict[str, dict[str, Any]]:
    """Check a scene's ``effects`` and put them in physical order.

    Parameters
    ----------
    settings
        Mapping from the name of an effect to its settings; ``None`` is no effect.

    Returns
    -------
    dict
        The checked settings by name, in physical order.

    Raises
    ------
    ValueError
        For an unknown effect or a bad setting, by name.
    """
    settings = {} if settings is None else settings
    if not isinstance(settings, Mapping):
        raise ValueError(f"effects: {settings!r} is not a mapping of effects to their settings")
    for name in settings:
        if name not in EFFECTS:
            raise unknown(name, EFFECTS, "effects")
    stages = list(Stage)
    in_order = sorted(EFFECTS, key=lambda name: stages.index(EFFECTS[name][0]))
    checked = {}
    for name in in_order:
        if name in settings:
            values = check_all(EFFECTS[name][1], settings[name], f"effects.{name}")
            if name in RESOLVED:
                values = RESOLVED[name](values, f"effects.{name}")
            checked[name] = {key: value for key, value in values.items() if value is not None}
    return checked


@dataclass(frozen=True)
class Plan:
    """The steps that a scene names, and no others, by stage."""

    light: tuple[Callable[[Light, Rays], None], ...]
    noise: tuple[Callable[[Array], Variance], ...]
    analogue: tuple[Callable[[Array], Array], ...]
    digital: tuple[Callable[[Array], Array], ...]


def plan(settings: Settings, array: DetectorArray, lamp: LampSettings) -> Plan:
    """Plan the effects of a scene for an array and a lamp, once.

    Parameters
    ----------
    settings
        What `check_effects` returned.
    array
        The scene's detectors.
    lamp
        The scene's lamp.

    Returns
    -------
    Plan
        The steps, kernels built.

    Raises
    ------
    ValueError
        For a setting that does not fit the array.
    """
    rig: dict[str, Any] = {"array": array, "lamp": lamp}
    steps: dict[Stage, list[Callable[..., Any]]] = {stage: [] for stage in Stage}
    for name, values in settings.items():
        stage, function = EFFECTS[name]
        asked = [rig[name] for name in inspect.signature(function).parameters if name in rig]
        steps[stage].append(function(*asked, **values))
    return Plan(*(tuple(steps[stage]) for stage in Stage))
