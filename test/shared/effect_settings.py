"""Settings of every effect from the middle of their bounds, for tests and benchmarks."""

import inspect
import itertools
import math
import typing
from typing import Literal

from uuv_optical_array.core import settings
from uuv_optical_array.core.settings import Cells, Grid
from uuv_optical_array.forward.effects import EFFECTS, check_effects


def declared(name):
    return settings.declared(EFFECTS[name].function)


def ways(name):
    """Return the required settings of each way to give an effect, the shortest first."""
    keyed = declared(name)
    required = [key for key in keyed if keyed[key].default is inspect.Parameter.empty]
    optional = [key for key in keyed if keyed[key].default is None]
    result = []
    for count in range(len(optional) + 1):
        for chosen in itertools.combinations(optional, count):
            keys = [key for key in keyed if key in (*required, *chosen)]
            try:
                check_effects({name: {key: middle(keyed[key]) for key in keys}})
            except ValueError:
                continue
            result.append(tuple(keys))
    return result


def middle(setting):
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


def middle_settings(name):
    """Return settings of an effect in the middle of their bounds, the shortest way."""
    keyed = declared(name)
    return {key: middle(keyed[key]) for key in ways(name)[0]}
