"""What water and electronics do to the ideal light: one function an effect, one scene key each.

An effect is a function with the name of the scene key. Its keyword-only arguments are the settings
of the key; before them it takes the ``array``. It is called once, when a scene is planned, and
returns one or more `forms`. Effects act in the order of the list below, which is the physical one.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from uuv_optical_array.core.settings import check_all, one_way, unknown
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.effects import detectors, electronics, moving, water
from uuv_optical_array.forward.effects.forms import Form, Moving


class Effect(NamedTuple):
    """An effect, with what resolves settings that can be given in several ways.

    ``resolved(settings, name)`` checks them and may convert one way into another; where there is
    nothing to convert, `ways` has the keys of both.
    """

    function: Callable[..., Form | tuple[Form, ...]]
    resolved: Callable[[dict[str, Any], str], dict[str, Any]] = lambda settings, name: settings
    ways: tuple[Sequence[str], ...] = ()


EFFECTS: dict[str, Effect] = {
    effect.function.__name__: effect
    for effect in (
        # On the way to the detectors.
        Effect(water.attenuation, water.resolved_attenuation),
        Effect(water.sea, water.resolved_sea),
        Effect(moving.lamp_flicker),
        Effect(moving.lamp_drift),
        Effect(moving.plume),
        Effect(detectors.field_of_view, detectors.resolved_field_of_view),
        Effect(detectors.window),
        # On the array.
        Effect(water.ambient, water.resolved_ambient),
        Effect(water.forward_scatter),
        Effect(detectors.responsivity, ways=(("spread", "seed"), ("gains",))),
        Effect(detectors.detector_faults),
        # In the electronics.
        Effect(electronics.sensor_noise),
        Effect(electronics.shot_noise),
        Effect(electronics.photodiode, ways=(("amps_per_count",), ("watts_per_m2_per_count",))),
        Effect(electronics.saturation),
        Effect(electronics.demodulation),
        Effect(electronics.pedestal),
        Effect(electronics.adc),
    )
}
# Effects that depend on the time of an image, and do nothing where none is given.
MOVING = {
    name
    for name, effect in EFFECTS.items()
    if inspect.signature(effect.function).return_annotation is Moving
}


def check_effects(settings: Any) -> dict[str, dict[str, Any]]:
    """Check a scene's ``effects``, fill in defaults and put them in physical order.

    ``None`` is no effect. ValueError, by name, for an unknown effect, no mapping, or a bad setting.
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
            if effect.ways:
                one_way(values, f"effects.{name}", *effect.ways)
            checked[name] = {key: value for key, value in values.items() if value is not None}
    return checked


def plan(settings: Mapping[str, Mapping[str, Any]], array: DetectorArray) -> tuple[Form, ...]:
    """Return the forms of effects that `check_effects` has checked, in physical order.

    ValueError for a setting that does not fit the array.
    """
    forms: list[Form] = []
    for name, values in settings.items():
        result = EFFECTS[name].function(array, **values)
        forms.extend(result if isinstance(result, tuple) else (result,))
    return tuple(forms)
