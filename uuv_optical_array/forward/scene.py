"""The scene: lamp, array, effects, signature, table and prior, read from YAML and checked."""

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from uuv_optical_array.core.settings import Quantity, Span, check_all, unknown
from uuv_optical_array.core.storage import files, yaml_text
from uuv_optical_array.forward import scene_files
from uuv_optical_array.forward.array import ArraySettings, Shape
from uuv_optical_array.forward.effects import check_effects
from uuv_optical_array.forward.light import LampSettings


@dataclasses.dataclass(frozen=True)
class SignatureSettings:
    """How a scene's images become signatures, and how the five numbers weigh in the match."""

    peak: Literal["detector", "subdetector"] = "subdetector"
    peak_weight: Annotated[float, Quantity("weight of the peak value", "", 1e-6, 1e6)] = 2.0
    position_weight: Annotated[
        float, Quantity("weight of column and row, per half width of the array", "", 1e-6, 1e6)
    ] = 1.0
    skewness_weight: Annotated[float, Quantity("weight of both skewnesses", "", 1e-6, 1e6)] = 1.0
    lift: Annotated[
        float, Quantity("constant appended to the five, so that the angle sees scale", "", 0, 1e6)
    ] = 1.0


# The working volume, 4 to 8 m behind the lamp and 0.6 m and 20 deg about its axis, with a margin.
BEHIND_M, ASIDE_M = Span(-8.3, -3.7, 13), Span(-0.75, 0.75, 13)
TURNED_DEG = Span(-22.0, 22.0, 13)


@dataclasses.dataclass(frozen=True)
class TableSettings:
    """The grid of poses of the signature table, each as ``[from, to, how many]``."""

    x_m: Annotated[Span, Quantity("ahead of the lamp; negative is behind it", "m", -1000, 1000)] = (
        BEHIND_M
    )
    y_m: Annotated[Span, Quantity("to port", "m", -1000, 1000)] = ASIDE_M
    z_m: Annotated[Span, Quantity("up", "m", -1000, 1000)] = ASIDE_M
    pitch_deg: Annotated[Span, Quantity("bow down", "deg", -90, 90)] = TURNED_DEG
    yaw_deg: Annotated[Span, Quantity("bow to port", "deg", -180, 180)] = TURNED_DEG


# Names of what may be unknown.
POWER, BEAM_SIGMA = "lamp.power", "lamp.beam_sigma_deg"
ATTENUATION, AMBIENT = "attenuation.k_per_m", "ambient.level_counts"
GRADIENTS = "ambient.to_starboard_counts", "ambient.to_bottom_counts"
SHADES = tuple(f"shade.mode_{k}" for k in range(1, 6))
# A shade is smooth: of its modes over the array each order is so much weaker than the one before,
# and what no mode has is as strong as one of the second order. Our choice, of `plume`'s clouds.
SHADE_DECAY, SHADE_ORDERS = 1 / 4, (1, 1, 2, 2, 2)
RIM = 0.25  # depth of a cloud's rim by that of its middle
# What makes light uneven though the scene does not name it: a smooth shade, in the logarithm of the
# lamp's light, and a gradient of daylight, by full scale. Our choice, for what sets in unforeseen.
UNEVEN_DEPTH, UNEVEN_DAYLIGHT = 0.2, 0.02
# Clouds are no smooth Gaussian shade: the variance of a pose behind one is so many times larger
# than it would be. By `uuv_array study accuracy --moving` in `night_plume`.
SHADE_DOUBT = 2.5

Known = Literal["exactly", "calibrated", "as_bought"]
# What is left unknown of a rig that was calibrated once in this sea, and of one that never was;
# orders of magnitude of our choice, for want of published ones.
PRIORS: dict[str, dict[str, float]] = {
    "exactly": {},
    "calibrated": {
        "lamp_power_std": 0.1,
        "beam_sigma_std_deg": 0.3,
        "k_std_per_m": 0.02,
        "ambient_std_counts": 5.0,
        "gain_std": 0.005,
        "uneven_probability": 0.02,
    },
    "as_bought": {
        "lamp_power_std": 0.2,
        "beam_sigma_std_deg": 0.5,
        "k_std_per_m": 0.05,
        "ambient_std_counts": 10.0,
        "gain_std": 0.01,
        "uneven_probability": 0.02,
    },
}


class FrameLight(NamedTuple):
    """The light of a kind of frame, by what it has beside that of a clear one.

    Parameters
    ----------
    share
        Of the frames, in [0, 1].
    depth
        Of an uneven shade, in the logarithm of the lamp's light.
    cloud
        Whether the shade is even in part, too, like a weaker lamp.
    daylight_counts
        Standard deviation of the ambient's rise from the array's middle to its edges, counts.
    """

    share: float
    depth: float = 0.0
    cloud: bool = False
    daylight_counts: float = 0.0


@dataclasses.dataclass(frozen=True)
class PriorSettings:
    """How well the scene itself is known; what is not known is estimated along with the pose."""

    known: Annotated[Known, Quantity("how well the rest is known, by a set of values")] = "exactly"
    lamp_power_std: Annotated[
        float, Quantity("relative standard deviation of the lamp's power; 0: known", "", 0, 1)
    ] = 0.0
    beam_sigma_std_deg: Annotated[
        float, Quantity("standard deviation of the beam's width; 0: known", "deg", 0, 10)
    ] = 0.0
    k_std_per_m: Annotated[
        float, Quantity("standard deviation of the attenuation; 0: known", "1/m", 0, 1)
    ] = 0.0
    ambient_std_counts: Annotated[
        float, Quantity("standard deviation of the ambient level; 0: known", "counts", 0, 1e6)
    ] = 0.0
    ambient_gradient_std_counts: Annotated[
        float,
        Quantity(
            "standard deviation of the ambient's rise from the array's middle to its edges",
            "counts",
            0,
            1e6,
        ),
    ] = 0.0
    gain_std: Annotated[
        float,
        Quantity("relative standard deviation of each detector's gain; 0: known", "", 0, 0.3),
    ] = 0.0
    temperature_std_c: Annotated[
        float,
        Quantity("standard deviation of the temperature; 0: known", "deg C", 0, 40),
    ] = 0.0
    aim_std_deg: Annotated[
        float,
        Quantity("standard deviation of the array's pitch and yaw on its mount", "deg", 0, 10),
    ] = 0.0
    shade_probability: Annotated[
        float, Quantity("share of frames that clouds shade unevenly", "", 0, 0.99)
    ] = 0.0
    shade_depth: Annotated[
        float,
        Quantity("of a shade, in the logarithm of the light: mean and spread", "", 0, 3),
    ] = 0.0
    shade_lasts_s: Annotated[
        float, Quantity("time in which a shade becomes another one", "s", 0, 1000)
    ] = 5.0
    uneven_probability: Annotated[
        float,
        Quantity(
            "share of frames lit unevenly in a way that the scene does not name, where it names no "
            "shade",
            "",
            0,
            0.5,
        ),
    ] = 0.0

    def nuisance_std(self) -> dict[str, float]:
        """Return the standard deviation of each setting that is not known, by dotted name."""
        stds = {
            POWER: self.lamp_power_std,
            BEAM_SIGMA: self.beam_sigma_std_deg,
            ATTENUATION: self.k_std_per_m,
            AMBIENT: self.ambient_std_counts,
            **dict.fromkeys(GRADIENTS, self.ambient_gradient_std_counts),
            "responsivity.temperature_c": self.temperature_std_c,
        }
        return {name: std for name, std in stds.items() if std > 0}

    def lights(self, full_scale_counts: float) -> list[FrameLight]:
        """Return the kinds of frame, the clear ones first."""
        unclear: list[FrameLight] = []
        if share := self.shade_probability:
            depths = self.shade_depth, RIM * self.shade_depth
            unclear = [FrameLight(share / 2, depth, True) for depth in depths]
        elif share := self.uneven_share:
            daylight = UNEVEN_DAYLIGHT * full_scale_counts
            unclear = [FrameLight(share, UNEVEN_DEPTH, False, daylight)]
        return [FrameLight(1 - share), *unclear]

    @property
    def uneven_share(self) -> float:
        """Share of frames that are lit unevenly in a way that the scene does not name."""
        return 0.0 if self.shade_probability else self.uneven_probability

    @property
    def unclear_lasts_s(self) -> float:
        """Time in which light that is not clear becomes other light, s; 0: it is always clear."""
        return self.shade_lasts_s if self.shade_probability or self.uneven_share else 0.0

    def std_in(self, light: FrameLight) -> dict[str, float]:
        """Return what `nuisance_std` does, of a kind of frame."""
        stds = self.nuisance_std()
        if light.cloud:
            stds[POWER] = math.hypot(self.lamp_power_std, light.depth)
        if light.daylight_counts:
            daylight = math.hypot(self.ambient_gradient_std_counts, light.daylight_counts)
            stds |= dict.fromkeys(GRADIENTS, daylight)
        if light.depth:
            modes = (light.depth * SHADE_DECAY**order for order in SHADE_ORDERS)
            stds |= dict(zip(SHADES, modes, strict=True))
        return stds

    def gain_std_in(self, light: FrameLight) -> float:
        """Return the relative spread of readings by gains and by what no mode of a shade has."""
        return math.hypot(self.gain_std, light.depth * SHADE_DECAY ** max(SHADE_ORDERS))


# Groups of a scene file, but for `effects`, and who declares their keys.
GROUPS: dict[str, Any] = {
    "lamp": LampSettings,
    "array": ArraySettings,
    "signature": SignatureSettings,
    "table": TableSettings,
    "prior": PriorSettings,
}


@dataclasses.dataclass(frozen=True)
class Scene:
    """A checked scene.

    Parameters
    ----------
    name
        For messages; the file's stem when it was read from a file.
    lamp, array, effects, signature, table, prior
        Settings by group; `effects` maps the name of each effect to its settings, in
        physical order.
    """

    name: str
    lamp: LampSettings
    array: ArraySettings
    effects: Mapping[str, Mapping[str, Any]]
    signature: SignatureSettings
    table: TableSettings
    prior: PriorSettings

    @property
    def full_scale_counts(self) -> float:
        """Largest reading of the array (the paper's I_max), counts.

        The lower of saturation and converter; a scene with neither has no limit, and
        its lamp's reference reading takes the place.
        """
        limits = []
        if "saturation" in self.effects:
            limits.append(self.effects["saturation"]["level_counts"])
        if "adc" in self.effects:
            limits.append(2.0 ** self.effects["adc"]["bits"] - 1)
        return min(limits, default=self.lamp.reference_counts)

    def constants_std(self) -> dict[str, float]:
        """Return the prior's `nuisance_std`, and that of what no image tells but many together do.

        That is the gradient of daylight, which in one image looks like a turn of the array. Where
        the scene names neither daylight nor a shade, it is as unknown as daylight itself.
        """
        stds = self.prior.nuisance_std()
        if AMBIENT in stds and "ambient" not in self.effects and not self.prior.shade_probability:
            for name in GRADIENTS:
                stds.setdefault(name, stds[AMBIENT])
        return stds

    def with_shape(self, shape: Shape) -> "Scene":
        """Return the scene with an array of another shape, as `ArraySettings.with_shape`."""
        return dataclasses.replace(self, array=self.array.with_shape(shape))

    def settings(self) -> dict[str, Any]:
        """Return the whole scene as plain values, as a scene file holds it."""
        groups = {
            group: {
                key: list(value) if isinstance(value, Span) else value
                for key, value in dataclasses.asdict(getattr(self, group)).items()
                if value is not None
            }
            for group in GROUPS
        }
        return {**groups, "effects": {name: dict(values) for name, values in self.effects.items()}}

    @property
    def fingerprint(self) -> str:
        """SHA-256 of every setting, in hexadecimal; the name does not count."""
        text = json.dumps(self.settings(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def differences(self, other: "Scene") -> list[str]:
        """List where two scenes differ, a line a key."""

        def flat(values: Any, name: str) -> dict[str, Any]:
            if not isinstance(values, dict) or not values:
                return {name: values}
            return {
                full: leaf
                for key, value in values.items()
                for full, leaf in flat(value, f"{name}.{key}".lstrip(".")).items()
            }

        ours, theirs = flat(self.settings(), ""), flat(other.settings(), "")
        return [
            f"{key} is {theirs.get(key, 'absent')} there and {ours.get(key, 'absent')} here"
            for key in sorted(ours.keys() | theirs.keys())
            if ours.get(key) != theirs.get(key)
        ]


def scene_from_settings(settings: Any, name: str) -> Scene:
    """Check a scene given as plain values.

    Parameters
    ----------
    settings
        Mapping of the groups ``lamp`` and ``array``, and as far as they differ from the defaults
        ``effects``, ``signature``, ``table`` and ``prior``.
    name
        Name of the scene, which starts every error.

    Returns
    -------
    Scene
        The scene.

    Raises
    ------
    ValueError
        For an unknown or missing key, a wrong type or a value out of bounds: the key,
        the value, the bound and the cure.
    """
    try:
        if not isinstance(settings, Mapping):
            raise ValueError(f"{settings!r} is not a mapping of groups")
        for group in settings:
            if group not in (*GROUPS, "effects"):
                raise unknown(group, (*GROUPS, "effects"), "")
        effects = check_effects(settings.get("effects"))
        groups = {}
        for group, declared in GROUPS.items():
            values = check_all(declared, settings.get(group), group)
            if group == "prior":
                given = settings.get(group) or {}
                values |= {
                    key: std for key, std in PRIORS[values["known"]].items() if key not in given
                }
                # Of water that does not attenuate, the set has nothing to say.
                usual = PRIORS[values["known"]].get("k_std_per_m")
                if "attenuation" not in effects and values["k_std_per_m"] == usual:
                    values["k_std_per_m"] = 0.0
            try:
                groups[group] = declared(**values)
            except ValueError as error:
                raise ValueError(f"{group}.{error}") from None
        scene = Scene(name=name, effects=effects, **groups)
        for key, effect in (
            ("k_std_per_m", "attenuation"),
            ("temperature_std_c", "responsivity"),
        ):
            if getattr(scene.prior, key) > 0 and effect not in scene.effects:
                raise ValueError(f"prior.{key}: the scene has no effects.{effect}; add it")
    except ValueError as error:
        raise ValueError(f"scene {name}: {error}") from None
    return scene


def save_scene(scene: Scene, path: Path, comment: str, like: str = "") -> None:
    """Write a scene as a YAML file that `load_scene` reads, whole or not at all.

    Parameters
    ----------
    scene
        The scene.
    path
        The file; one that exists is replaced.
    comment
        First line.
    like
        Text of the scene file that it came from, whose comments are kept.
    """
    text = yaml_text.text_of(scene.settings(), like)
    head = f"# {comment}\n"
    files.write_text(path, text if text.startswith(head) else f"{head}\n{text}")


def load_scene(path: str | Path) -> Scene:
    """Read a scene from a YAML file, and the ones that it ``extends``.

    Parameters
    ----------
    path
        A file, or the bare name of a ready scene such as ``follow``.

    Returns
    -------
    Scene
        The checked scene.

    Raises
    ------
    ValueError
        For text that is not YAML, as `scene_files.layers`, or as `scene_from_settings`.
    FileNotFoundError
        Where neither a file nor a ready scene has that name, or that of one that is extended.
    """
    file = scene_files.scene_file(path)
    return scene_from_settings(scene_files.merged(scene_files.layers(file)), file.stem)
