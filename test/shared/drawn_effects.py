"""Settings of effects for hypothesis, drawn from what each effect declares: type and bounds."""

import inspect
import typing

from effect_settings import declared, ways
from hypothesis import assume
from hypothesis import strategies as st
from scenes import SHAPES, changed, make_scene

from uuv_optical_array.core.settings import Cells, Grid
from uuv_optical_array.forward.effects import EFFECTS, check_effects

WAYS = {name: ways(name) for name in EFFECTS}

places = st.tuples(st.floats(-9, -2), st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
angles = st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
poses = st.builds(lambda place, angle: (*place, *angle), places, angles)


def values_of(setting, side):
    """Values of a declared setting for an array of side x side detectors."""
    low, high = setting.quantity.low, setting.quantity.high
    if typing.get_origin(setting.kind) is typing.Literal:
        return st.sampled_from(typing.get_args(setting.kind))
    if setting.kind == Cells:
        place = st.integers(int(low), min(int(high), side - 1))
        return st.lists(st.lists(place, min_size=2, max_size=2), max_size=3)
    if setting.kind is int:
        return st.integers(int(low), int(high))
    # Uniform, as hypothesis itself prefers the ends, of which each light is 0 or the same.
    numbers = st.floats(low, high) | st.floats(0, 1).map(lambda u: low + u * (high - low))
    if low > 0:
        numbers |= st.floats(0, 1).map(lambda u: min(max(low * (high / low) ** u, low), high))
    if setting.kind == Grid:
        return st.lists(
            st.lists(numbers, min_size=side, max_size=side), min_size=side, max_size=side
        )
    return numbers


@st.composite
def settings_of(draw, name, side):
    """Settings of one effect anywhere in their bounds, any way it can be given."""
    settings = declared(name)
    chosen = draw(st.sampled_from(WAYS[name]))
    for key, setting in settings.items():
        has_default = setting.default not in (None, inspect.Parameter.empty)
        if has_default and draw(st.booleans()):
            chosen = (*chosen, key)
    values = {key: draw(values_of(settings[key], side)) for key in chosen}
    try:
        check_effects({name: values})
    except ValueError:  # together they may be out of bounds, as daylight at the surface
        assume(False)
    return values


@st.composite
def scenes(draw, names):
    """Scenes with some effects anywhere in their bounds, any lamp, and an array of any size."""
    side = draw(st.sampled_from([3, 4, 5]))
    effects = {name: draw(settings_of(name, side)) for name in names}
    shape, width_m = draw(st.sampled_from(SHAPES)), draw(st.floats(0.1, 0.6))
    radius_m = width_m * draw(st.floats(0.8, 2)) if shape == "curved" else None
    array = {"width_m": width_m, "bow_m": draw(st.floats(0, 1)), "radius_m": radius_m}
    lamp = {"beam_sigma_deg": draw(st.floats(3, 60)), "reference_range_m": draw(st.floats(3, 9))}
    lamp["behind_m"] = draw(st.just(0.0) | st.floats(-0.3, 0.3))
    if "demodulation" in names:
        lamp["floor_counts"] = draw(st.just(0.0) | st.floats(0, 100))
    return changed(make_scene(shape, side, effects, **lamp), array=array)


@st.composite
def any_scenes(draw):
    """Scenes with any of the effects."""
    names = draw(st.lists(st.sampled_from(list(EFFECTS)), unique=True, max_size=6))
    assume(not {"attenuation", "sea"} <= set(names))  # one water at a time
    assume(not {"pedestal", "demodulation"} <= set(names))  # which has its own
    return draw(scenes(names))
