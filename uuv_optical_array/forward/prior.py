"""What is uncertain about a scene: standard deviations, and the light that the scene does not name.

A prior may leave settings of lamp and effects uncertain; their forms say so themselves. The other
unknowns have forms here whose value in the scene is 0: attenuation, daylight and its gradient, and
an uneven shade such as a cloud of sediment causes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Literal, NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.settings import Quantity
from uuv_optical_array.forward.effects.detectors import lens
from uuv_optical_array.forward.effects.forms import Background, Shade, Transmission
from uuv_optical_array.forward.effects.water import beer

# Names of uncertain settings.
POWER, BEAM_SIGMA, FLOOR = "lamp.power", "lamp.beam_sigma_deg", "lamp.floor_counts"
ATTENUATION, AMBIENT = "attenuation.k_per_m", "ambient.level_counts"
ABSORPTION, SCATTERING = "sea.absorption_per_m", "sea.scattering_per_m"
RESPONSE, RADIUS = "field_of_view.cosine_power", "array.radius_m"
TEMPERATURE = "responsivity.temperature_c"
ROLL = "follower.roll_rad"  # which several lamps show, as a turn about the beacon's x
# What is a lamp's own, in the order of the places of `lamps.one_of_lamps`, and its power.
OWN_GEOMETRY = "x_m", "y_m", "z_m", "pitch_deg", "yaw_deg"
OWN_POWER, OWN_FLOOR = "power", "floor_counts"
LAMP_POWER = Quantity(
    "power of the leader's lamps, one for all or one for each, relative to the scene's; 0: off",
    "",
    0,
    100,
)
NO_POWER = 1e-300  # of a lamp that is off: its logarithm has to be finite
LOGARITHMS = POWER, SCATTERING, RADIUS  # whose offset is that of their logarithm
GRADIENTS = "ambient.to_starboard_counts", "ambient.to_bottom_counts"
DAYLIGHT = AMBIENT, *GRADIENTS
SHADES = tuple(f"shade.mode_{k}" for k in range(1, 6))
# A shade is smooth: each order of its modes is weaker than the one before by this factor, and the
# rest is as strong as a mode of the second order. Our choice, after the clouds of `plume`.
SHADE_DECAY, SHADE_ORDERS = 1 / 4, (1, 1, 2, 2, 2)
RIM = 0.25  # depth of a cloud's rim relative to its middle
# Uneven light that the scene does not name: a smooth shade, in the logarithm of the lamp's light,
# and a gradient of daylight, relative to full scale. Our choice, for the unforeseen. Then its
# sizes, relative to that, with the share of each; the same with several lamps, each of which may
# differ by itself; and the least share of such frames.
UNEVEN_DEPTH, UNEVEN_DAYLIGHT = 0.2, 0.02
UNEVEN_SIZES = (0.25, 2 / 3), (1.0, 0.28), (2.0, 0.04), (3.0, 1 / 75)
SIZES_BY_LAMPS = (0.25, 2 / 3), (1.0, 1 / 3)
UNEVEN_BY_LAMPS = 3e-3

Known = Literal["exactly", "calibrated", "as_bought"]


class Uncertain(NamedTuple):
    """What a standard deviation of the prior is of, what a scene must have for it, and its size.

    Settings are dotted names, or keys of each of several lamps. A rig was calibrated once in this
    sea, or never: orders of magnitude of our choice, as none are published.
    """

    settings: tuple[str, ...]
    calibrated: float = 0.0
    as_bought: float = 0.0
    needs: str = ""


LAMPS, ONE_LAMP = "lamps", "lamp"
UNCERTAIN = {
    "lamp_power_std": Uncertain((POWER,), 0.1, 0.2),
    "beam_sigma_std_deg": Uncertain((BEAM_SIGMA,), 0.3, 0.5),
    "beam_shape_std": Uncertain((), 0.005, 0.01),  # of a beam of several Gaussians
    "lamp_behind_std_m": Uncertain((), needs=ONE_LAMP),
    "lamp_floor_std_counts": Uncertain((FLOOR,), needs=ONE_LAMP),
    "k_std_per_m": Uncertain((ATTENUATION,), 0.02, 0.05, "effects.attenuation"),
    "absorption_std_per_m": Uncertain((ABSORPTION,), 0.02, 0.05, "effects.sea"),
    "scattering_std": Uncertain((SCATTERING,), 0.5, 0.7, "effects.sea"),
    "cosine_power_std": Uncertain((RESPONSE,), 0.1, 0.2),
    "radius_std": Uncertain((RADIUS,), 0.02, 0.03, "array.radius_m"),
    "ambient_std_counts": Uncertain((AMBIENT,), 5.0, 10.0),
    "ambient_gradient_std_counts": Uncertain(GRADIENTS),
    "temperature_std_c": Uncertain((TEMPERATURE,), needs="effects.responsivity"),
    "aim_std_deg": Uncertain((), 0.3, 0.5),
    "lamp_aim_std_deg": Uncertain((), 0.5, 1.0),
    "lamps_power_std": Uncertain((OWN_POWER,), 0.03, 0.1, LAMPS),
    "lamps_aim_std_deg": Uncertain(OWN_GEOMETRY[3:], 0.2, 0.5, LAMPS),
    "lamps_place_std_m": Uncertain(OWN_GEOMETRY[:3], 0.002, 0.01, LAMPS),
    "lamps_floor_std_counts": Uncertain((OWN_FLOOR,), needs=LAMPS),
    "roll_std_deg": Uncertain((), 1.15, 1.15, LAMPS),
    "gain_std": Uncertain((), 0.005, 0.01),
    "uneven_probability": Uncertain((), 0.1, 0.1),
}
PRIORS: dict[str, dict[str, float]] = {
    "exactly": {},
    "calibrated": {key: each.calibrated for key, each in UNCERTAIN.items()},
    "as_bought": {key: each.as_bought for key, each in UNCERTAIN.items()},
}


class FrameLight(NamedTuple):
    """How the light of a kind of frame differs from that of a clear one.

    - share: of the frames, in [0, 1].
    - depth: of an uneven shade, in the logarithm of the lamp's light.
    - cloud: whether part of the shade is even, like a weaker lamp.
    - daylight_counts: standard deviation of the ambient's rise from middle to edges, counts.
    - size: of what the scene does not name, from 0 for none to 1.
    """

    share: float
    depth: float = 0.0
    cloud: bool = False
    daylight_counts: float = 0.0
    size: float = 0.0


@dataclass(frozen=True)
class PriorSettings:
    """Standard deviations of the unknown, and how often and how long light is uneven."""

    known: Annotated[
        Known, Quantity("set of values for the keys of the prior that are not given")
    ] = "exactly"
    lamp_power_std: Annotated[
        float, Quantity("relative standard deviation of the lamp's power", "", 0, 1)
    ] = 0.0
    beam_sigma_std_deg: Annotated[
        float, Quantity("standard deviation of lamp.beam_sigma_deg", "deg", 0, 10)
    ] = 0.0
    beam_shape_std: Annotated[
        float,
        Quantity("relative standard deviation of a reading by the shape of the beam", "", 0, 0.3),
    ] = 0.0
    lamp_behind_std_m: Annotated[
        float, Quantity("standard deviation of lamp.behind_m", "m", 0, 1)
    ] = 0.0
    lamp_floor_std_counts: Annotated[
        float, Quantity("standard deviation of lamp.floor_counts", "counts", 0, 1e6)
    ] = 0.0
    k_std_per_m: Annotated[
        float, Quantity("standard deviation of the attenuation coefficient K", "1/m", 0, 1)
    ] = 0.0
    absorption_std_per_m: Annotated[
        float, Quantity("standard deviation of the absorption coefficient a", "1/m", 0, 1)
    ] = 0.0
    scattering_std: Annotated[
        float, Quantity("relative standard deviation of the scattering coefficient b", "", 0, 2)
    ] = 0.0
    cosine_power_std: Annotated[
        float, Quantity("standard deviation of the exponent of the detectors' cosine", "", 0, 1)
    ] = 0.0
    radius_std: Annotated[
        float, Quantity("relative standard deviation of the radius of a curved array", "", 0, 0.2)
    ] = 0.0
    ambient_std_counts: Annotated[
        float, Quantity("standard deviation of the ambient level", "counts", 0, 1e6)
    ] = 0.0
    ambient_gradient_std_counts: Annotated[
        float,
        Quantity(
            "standard deviation of the ambient's rise from middle to edges; 0: in a track that of "
            "the level, unless the scene has ambient or a shade_probability",
            "counts",
            0,
            1e6,
        ),
    ] = 0.0
    gain_std: Annotated[
        float, Quantity("relative standard deviation of each detector's gain", "", 0, 0.3)
    ] = 0.0
    temperature_std_c: Annotated[
        float, Quantity("standard deviation of the temperature", "deg C", 0, 40)
    ] = 0.0
    aim_std_deg: Annotated[
        float,
        Quantity("standard deviation of the array's pitch and yaw on its mount", "deg", 0, 10),
    ] = 0.0
    lamp_aim_std_deg: Annotated[
        float,
        Quantity("standard deviation of the lamp's pitch and yaw on the leader", "deg", 0, 10),
    ] = 0.0
    lamps_power_std: Annotated[
        float,
        Quantity("relative standard deviation of the power of each of several lamps", "", 0, 1),
    ] = 0.0
    lamps_aim_std_deg: Annotated[
        float,
        Quantity("standard deviation of pitch and yaw of each of several lamps", "deg", 0, 10),
    ] = 0.0
    lamps_place_std_m: Annotated[
        float,
        Quantity("standard deviation of the place of each of several lamps, per axis", "m", 0, 1),
    ] = 0.0
    lamps_floor_std_counts: Annotated[
        float,
        Quantity("standard deviation of floor_counts of each of several lamps", "counts", 0, 1e6),
    ] = 0.0
    roll_std_deg: Annotated[
        float,
        Quantity(
            "standard deviation of the follower's roll; used with several lamps", "deg", 0, 45
        ),
    ] = 0.0
    shade_probability: Annotated[
        float, Quantity("share of the frames that clouds shade unevenly", "", 0, 0.99)
    ] = 0.0
    shade_depth: Annotated[
        float,
        Quantity("depth of a shade: standard deviation of the logarithm of the light", "", 0, 3),
    ] = 0.0
    shade_lasts_s: Annotated[
        float, Quantity("correlation time of shades and of uneven light", "s", 0, 1000)
    ] = 5.0
    uneven_probability: Annotated[
        float,
        Quantity(
            "share of the frames with uneven light, where shade_probability is 0; of several lamps "
            f"at least {UNEVEN_BY_LAMPS:g}",
            "",
            0,
            0.5,
        ),
    ] = 0.0

    def nuisance_std(self) -> dict[str, float]:
        """Return the standard deviation of each uncertain setting, by dotted name."""
        return {
            name: std
            for key, uncertain in UNCERTAIN.items()
            for name in uncertain.settings
            if uncertain.needs != LAMPS and (std := getattr(self, key)) > 0
        }

    def lamps_std(self, count: int) -> dict[str, float]:
        """Return the standard deviation of what is each of several lamps' own, and of the roll."""
        own = [(key, each) for key, each in UNCERTAIN.items() if each.needs == LAMPS]
        stds = {
            of_lamp(i, setting): getattr(self, key)
            for i in range(count)
            for key, uncertain in own
            for setting in uncertain.settings
        }
        stds[ROLL] = math.radians(self.roll_std_deg) if count else 0.0
        return {name: std for name, std in stds.items() if std > 0}

    def lights(self, daylight_scale_counts: float, lamps: int = 0) -> list[FrameLight]:
        """Return the kinds of frame, clear ones first.

        The scale is that of unforeseen daylight; `lamps` are how many the scene names, if any.
        """
        unclear: list[FrameLight] = []
        if share := self.shade_probability:
            depths = self.shade_depth, RIM * self.shade_depth
            unclear = [FrameLight(share / 2, depth, True) for depth in depths]
        elif share := max(self.uneven_share, UNEVEN_BY_LAMPS if lamps else 0.0):
            depth, daylight = UNEVEN_DEPTH, UNEVEN_DAYLIGHT * daylight_scale_counts
            unclear = [
                FrameLight(share * part, size * depth, False, size * daylight, size)
                for size, part in (SIZES_BY_LAMPS if lamps else UNEVEN_SIZES)
            ]
        return [FrameLight(1 - share), *unclear]

    @property
    def spread(self) -> float:
        """Relative error of a reading by its detector's gain and by the shape of the beam."""
        return math.hypot(self.gain_std, self.beam_shape_std)

    @property
    def aimed(self) -> bool:
        """Whether lamp and array are known to stand and point exactly as their frames."""
        return self.aim_std_deg == self.lamp_aim_std_deg == self.lamp_behind_std_m == 0

    @property
    def uneven_share(self) -> float:
        """Share of frames with uneven light that the scene does not name."""
        return 0.0 if self.shade_probability else self.uneven_probability

    @property
    def unclear_lasts_s(self) -> float:
        """Correlation time of light that is not clear, s; 0: it is always clear."""
        return self.shade_lasts_s if self.shade_probability or self.uneven_share else 0.0

    def std_in(self, light: FrameLight) -> dict[str, float]:
        """Return `nuisance_std` for a kind of frame."""
        stds = self.nuisance_std()
        if light.cloud or light.size:
            stds[POWER] = math.hypot(self.lamp_power_std, light.depth)
        if light.daylight_counts:
            daylight = math.hypot(self.ambient_gradient_std_counts, light.daylight_counts)
            stds |= dict.fromkeys(GRADIENTS, daylight)
        if light.depth:
            modes = (light.depth * SHADE_DECAY**order for order in SHADE_ORDERS)
            stds |= dict(zip(SHADES, modes, strict=True))
        return stds

    def gain_std_in(self, light: FrameLight) -> float:
        """Return the relative spread of readings by gains, beam, and shades beyond the modes."""
        return math.hypot(self.spread, light.depth * SHADE_DECAY ** max(SHADE_ORDERS))


def of_lamp(i: int, setting: str) -> str:
    """Return the dotted name of a setting of one of several lamps."""
    return f"lamps.{i}.{setting}"


def shade_doubt(lamps: int) -> float:
    """Return the factor of the variance of a pose behind a cloud, which is no smooth Gaussian one.

    Several lamps show more of it. Measured by `uuv_array study accuracy --moving` in `night_plume`.
    """
    return 2.5 if lamps == 1 else 1.5


def power_offsets(powers: Sequence[float], lamps: int) -> dict[str, Array]:
    """Return the offsets of lamps with other powers, by those of the scene; 0 is off.

    `powers` are those of each lamp, or one for all; ValueError for another number of them.
    """
    if len(powers) not in (1, lamps):
        each = f", or {lamps}" if lamps > 1 else ""
        raise ValueError(f"lamp_power: {len(powers)} values; give 1{each}, one for each lamp")
    names = [POWER] if lamps == 1 else [of_lamp(i, OWN_POWER) for i in range(lamps)]
    logarithms = np.log(np.maximum(np.resize(powers, lamps), NO_POWER))
    return dict(zip(names, logarithms, strict=True))


def over_array(side: int) -> tuple[Array, Array]:
    """Return the coordinates of columns and rows, from -1 to 1, shape ``(side, side)`` each."""
    along = np.linspace(-1, 1, side)
    column, row = np.meshgrid(along, along)
    return column, row


def shade_modes(side: int) -> Array:
    """Return smooth patterns on the array: the polynomials of first and second order.

    They are orthogonal to each other and to an even shade, which acts like the lamp's power, and
    have a mean square of 1; with fewer than six detectors some are 0. Shape ``(5, side * side)``.
    """
    return _shade_modes(side).copy()


@cache
def _shade_modes(side: int) -> Array:
    u, v = (axis.ravel() for axis in over_array(side))
    powers = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v])
    modes: list[Array] = []
    for power in powers:
        rest = power - sum(mode * np.mean(mode * power) for mode in modes)
        size = np.sqrt(np.mean(rest * rest))
        modes.append(rest / size if size > 1e-9 else np.zeros_like(rest))
    return np.array(modes[1:])


def unknown_forms(side: int) -> dict[str, Background | Shade | Transmission]:
    """Return the forms of what is unknown and 0 in the scene, by name.

    K is in 1/m, daylight in counts, shades are logarithms, the response is a power of the cosine.
    """
    u, v = (axis.ravel() for axis in over_array(side))
    shades = zip(SHADES, shade_modes(side), strict=True)
    return {
        ATTENUATION: Transmission(beer, nuisance=ATTENUATION),
        RESPONSE: Transmission(lens, nuisance=RESPONSE),
        **{name: Shade(mode, nuisance=name) for name, mode in shades},
        AMBIENT: Background(np.ones(side * side), 0.0, AMBIENT),
        GRADIENTS[0]: Background(u, 0.0, GRADIENTS[0]),
        GRADIENTS[1]: Background(v, 0.0, GRADIENTS[1]),
    }
