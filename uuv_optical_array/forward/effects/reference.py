"""What documents, benchmarks and tests need to know of every effect, read off the list itself."""

import inspect
import itertools
import math
import types
import typing
from typing import Any, Literal, NamedTuple

from uuv_optical_array.core.settings import Cells, Grid, Quantity
from uuv_optical_array.forward.effects import EFFECTS, check_effects


class Setting(NamedTuple):
    """How a setting of an effect is declared.

    Parameters
    ----------
    kind
        Its type: ``float``, ``int``, `Cells`, `Grid` or a ``Literal``.
    quantity
        Meaning, unit and bounds.
    default
        ``inspect.Parameter.empty`` where it must be given; ``None`` where it belongs to one of
        several `ways`.
    """

    kind: Any
    quantity: Quantity
    default: Any


def declared(name: str) -> dict[str, Setting]:
    """Return the settings of an effect as its function declares them."""
    function = EFFECTS[name].function
    hints = typing.get_type_hints(function, include_extras=True)
    found = {}
    for key, parameter in inspect.signature(function).parameters.items():
        if parameter.kind is not parameter.KEYWORD_ONLY:
            continue
        kind, quantity = hints[key], Quantity("")
        # Python 3.10 wraps the whole hint of an argument with the default None once more.
        while typing.get_origin(kind) in (typing.Annotated, types.UnionType, typing.Union):
            if typing.get_origin(kind) is typing.Annotated:
                kind, quantity = typing.get_args(kind)
            else:
                (kind,) = (part for part in typing.get_args(kind) if part is not type(None))
        found[key] = Setting(kind, quantity, parameter.default)
    return found


def ways(name: str) -> list[tuple[str, ...]]:
    """Return the settings without a value of their own that an effect takes together.

    Parameters
    ----------
    name
        Of the effect.

    Returns
    -------
    list of tuple of str
        Each way to give the effect, the shortest first.
    """
    settings = declared(name)
    needed = [key for key in settings if settings[key].default is inspect.Parameter.empty]
    free = [key for key in settings if settings[key].default is None]
    found = []
    for count in range(len(free) + 1):
        for chosen in itertools.combinations(free, count):
            keys = [key for key in settings if key in (*needed, *chosen)]
            try:
                check_effects({name: {key: middle(settings[key]) for key in keys}})
            except ValueError:
                continue
            found.append(tuple(keys))
    return found


def middle(setting: Setting) -> Any:
    """Return a value from the middle of a setting's bounds, its first choice, or one place."""
    if typing.get_origin(setting.kind) is Literal:
        return typing.get_args(setting.kind)[0]
    if setting.kind == Cells:
        return [[0, 0]]
    low, high = setting.quantity.low, setting.quantity.high
    # Bounds of several orders of magnitude have their middle between their logarithms.
    value = math.sqrt(low * high) if low > 0 and high > 100 * low else 0.5 * (low + high)
    if setting.kind == Grid:
        return [[value] * 5] * 5
    return int(value) if setting.kind is int else value


def middle_settings(name: str) -> dict[str, Any]:
    """Return settings of an effect in the middle of their bounds, the shortest way."""
    settings = declared(name)
    return {key: middle(settings[key]) for key in ways(name)[0]}
