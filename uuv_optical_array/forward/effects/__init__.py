"""What water and electronics do to the ideal light: one function an effect, one scene key each.

An effect is a function with the scene key's name. Its keyword-only arguments are the key's
settings; before them it asks by name for the ``array`` and, where it needs it, the ``lamp``. It is
called once, when a scene is planned, and returns what it does in one or more `forms`; what a scene
does not name never runs. Effects act in the order of the list below, which is the physical one.
"""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from uuv_optical_array.core.settings import check_all, unknown
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.effects.detectors import (
    detector_faults,
    field_of_view,
    resolved_field_of_view,
    resolved_responsivity,
    responsivity,
    window,
)
from uuv_optical_array.forward.effects.electronics import (
    adc,
    photodiode,
    resolved_photodiode,
    saturation,
    sensor_noise,
    shot_noise,
)
from uuv_optical_array.forward.effects.forms import Form, Moving
from uuv_optical_array.forward.effects.moving import lamp_drift, lamp_flicker, plume
from uuv_optical_array.forward.effects.water import (
    ambient,
    attenuation,
    beam_spread,
    forward_scatter,
    resolved_ambient,
    resolved_attenuation,
)
from uuv_optical_array.forward.light import LampSettings


class Effect(NamedTuple):
    """An effect of the list.

    Parameters
    ----------
    function
        As the module has it.
    resolved
        Where settings may be given in one of several ways: ``resolved(settings, name)``, the check,
        which may turn them into one.
    """

    function: Callable[..., Form | tuple[Form, ...]]
    resolved: Callable[[dict[str, Any], str], dict[str, Any]] = lambda settings, name: settings


EFFECTS: dict[str, Effect] = {
    effect.function.__name__: effect
    for effect in (
        # On the way to the detectors.
        Effect(attenuation, resolved_attenuation),
        Effect(lamp_flicker),
        Effect(lamp_drift),
        Effect(plume),
        Effect(beam_spread),
        Effect(field_of_view, resolved_field_of_view),
        Effect(window),
        # On the array.
        Effect(ambient, resolved_ambient),
        Effect(forward_scatter),
        Effect(responsivity, resolved_responsivity),
        Effect(detector_faults),
        # In the electronics.
        Effect(sensor_noise),
        Effect(shot_noise),
        Effect(photodiode, resolved_photodiode),
        Effect(saturation),
        Effect(adc),
    )
}
# Effects that act at the moment of an image, and do nothing where none is given.
MOVING = {
    name
    for name, effect in EFFECTS.items()
    if inspect.signature(effect.function).return_annotation is Moving
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
        The checked settings by effect, defaults filled in.

    Raises
    ------
    ValueError
        For an unknown effect, one without a mapping, or a bad setting, by name.
    """
    settings = {} if settings is None else settings
    if not isinstance(settings, Mapping):
        raise ValueError(f"effects: {settings!r} is not a mapping of effects to their settings")
    for name in settings:
        if name not in EFFECTS:
            raise unknown(name, EFFECTS, "effects")
    checked = {}
    for name, effect in EFFECTS.items():
        if name in settings:
            if settings[name] is None:
                raise ValueError(f"effects.{name}: empty; give its settings, or {{}} for defaults")
            values = check_all(effect.function, settings[name], f"effects.{name}")
            values = effect.resolved(values, f"effects.{name}")
            checked[name] = {key: value for key, value in values.items() if value is not None}
    return checked


def plan(settings: Settings, array: DetectorArray, lamp: LampSettings) -> tuple[Form, ...]:
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
    tuple of Form
        What they do, in physical order.

    Raises
    ------
    ValueError
        For a setting that does not fit the array.
    """
    rig: dict[str, Any] = {"array": array, "lamp": lamp}
    forms: list[Form] = []
    for name, values in settings.items():
        function = EFFECTS[name].function
        asked = [rig[name] for name in inspect.signature(function).parameters if name in rig]
        found = function(*asked, **values)
        forms.extend(found if isinstance(found, tuple) else (found,))
    return tuple(forms)
