"""What a scene may leave unknown although it names no effect for it: forms whose scene value is 0.

A prior may leave settings of lamp and effects uncertain, whose forms say so themselves; here is
the rest: daylight that the scene does not mention, its gradient over the array, and an uneven shade
such as a cloud of sediment throws.
"""

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.effects.forms import Background, Shade
from uuv_optical_array.forward.scene import AMBIENT, GRADIENTS, SHADES


def over_array(side: int) -> tuple[Array, Array]:
    """Return where columns and rows are, from -1 to 1, shape ``(side, side)`` each."""
    along = np.linspace(-1, 1, side)
    column, row = np.meshgrid(along, along)
    return column, row


def shade_modes(side: int) -> Array:
    """Return smooth patterns on the array: the polynomials of first and second order.

    They are orthogonal to each other and to an even shade, which is one of the lamp's power, and
    their mean square is 1; fewer than six detectors have modes of 0 among them.

    Parameters
    ----------
    side
        Detectors in a row.

    Returns
    -------
    Array
        Shape ``(5, side * side)``.
    """
    u, v = (place.ravel() for place in over_array(side))
    powers = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v])
    modes: list[Array] = []
    for power in powers:
        rest = power - sum(mode * np.mean(mode * power) for mode in modes)
        size = np.sqrt(np.mean(rest * rest))
        modes.append(rest / size if size > 1e-9 else np.zeros_like(rest))
    return np.array(modes[1:])


def unknown_forms(side: int) -> dict[str, Background | Shade]:
    """Return the forms by the name of what is unknown: counts of daylight, shades as logarithms.

    Parameters
    ----------
    side
        Detectors in a row.
    """
    u, v = (place.ravel() for place in over_array(side))
    shades = zip(SHADES, shade_modes(side), strict=True)
    return {
        **{name: Shade(mode, name) for name, mode in shades},
        AMBIENT: Background(np.ones(side * side), 0.0, AMBIENT),
        GRADIENTS[0]: Background(u, 0.0, GRADIENTS[0]),
        GRADIENTS[1]: Background(v, 0.0, GRADIENTS[1]),
    }
