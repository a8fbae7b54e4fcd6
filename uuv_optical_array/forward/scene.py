"""The scene: lamp, array, effects, signature, table and prior, read from YAML and checked."""

import dataclasses
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from uuv_optical_array.core.settings import Quantity, Span, check_all, unknown
from uuv_optical_array.core.storage import files, yaml_text
from uuv_optical_array.forward import scene_files
from uuv_optical_array.forward.array import ArraySettings, Shape
from uuv_optical_array.forward.effects import check_effects
from uuv_optical_array.forward.effects.electronics import largest_demodulated
from uuv_optical_array.forward.lamp.beam import LampSettings
from uuv_optical_array.forward.lamp.lamps import BeaconLamp, checked_lamps
from uuv_optical_array.forward.lamp.photometry import with_photometry
from uuv_optical_array.forward.prior import (
    ABSORPTION,
    AMBIENT,
    ATTENUATION,
    GRADIENTS,
    LAMPS,
    ONE_LAMP,
    PRIORS,
    UNCERTAIN,
    PriorSettings,
)


@dataclasses.dataclass(frozen=True)
class SignatureSettings:
    """How images become signatures: the peak's place, and weights of the five numbers."""

    peak: Literal["detector", "subdetector"] = "subdetector"
    peak_weight: Annotated[float, Quantity("weight of the peak value", "", 1e-6, 1e6)] = 2.0
    position_weight: Annotated[
        float,
        Quantity("weight of the peak's column and row, in half widths of the array", "", 1e-6, 1e6),
    ] = 1.0
    skewness_weight: Annotated[
        float, Quantity("weight of the horizontal and the vertical skewness", "", 1e-6, 1e6)
    ] = 1.0
    lift: Annotated[
        float,
        Quantity("constant appended, so that the spectral angle depends on the scale", "", 0, 1e6),
    ] = 1.0


# The working volume, 4 to 8 m behind the lamp and 0.6 m and 20 deg about its axis, with a margin.
BEHIND_M, ASIDE_M = Span(-8.3, -3.7, 13), Span(-0.75, 0.75, 13)
TURNED_DEG = Span(-22.0, 22.0, 13)


@dataclasses.dataclass(frozen=True)
class TableSettings:
    """The grid of poses of the signature table, each as ``[from, to, how many]``."""

    x_m: Annotated[
        Span, Quantity("position ahead of the lamp; a negative one is behind it", "m", -1000, 1000)
    ] = BEHIND_M
    y_m: Annotated[Span, Quantity("position to port of the lamp", "m", -1000, 1000)] = ASIDE_M
    z_m: Annotated[Span, Quantity("position above the lamp", "m", -1000, 1000)] = ASIDE_M
    pitch_deg: Annotated[
        Span, Quantity("pitch of the follower, positive with the bow down", "deg", -90, 90)
    ] = TURNED_DEG
    yaw_deg: Annotated[
        Span, Quantity("yaw of the follower, positive with the bow to port", "deg", -180, 180)
    ] = TURNED_DEG


# Groups of a scene file except `effects`, with the classes that declare their keys.
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
    lamps
        Several lamps that together have the power of the `lamp`; empty: it is one, at the origin.
    """

    name: str
    lamp: LampSettings
    array: ArraySettings
    effects: Mapping[str, Mapping[str, Any]]
    signature: SignatureSettings
    table: TableSettings
    prior: PriorSettings
    lamps: tuple[BeaconLamp, ...] = ()

    @property
    def black_counts(self) -> float:
        """Reading of darkness, counts."""
        modulated = self.effects.get("demodulation", {}).get("pedestal_counts", 0.0)
        return float(self.effects.get("pedestal", {}).get("level_counts", modulated))

    @property
    def lamp_count(self) -> int:
        """How many lamps there are."""
        return max(len(self.lamps), 1)

    @property
    def full_scale_counts(self) -> float:
        """Largest reading of the array (the paper's I_max), counts.

        The lower of saturation and converter; the lamp's reference reading in a scene without both.
        """
        limits = []
        if "saturation" in self.effects:
            level = self.effects["saturation"]["level_counts"]
            if demodulation := self.effects.get("demodulation"):
                daylight = self.effects.get("ambient", {}).get("level_counts", 0.0)
                level = largest_demodulated(level, daylight, self.lamp_count, **demodulation)
            limits.append(level)
        if "adc" in self.effects:
            limits.append(2.0 ** self.effects["adc"]["bits"] - 1)
        return min(limits, default=self.lamp.reference_counts)

    @property
    def daylight_scale_counts(self) -> float:
        """What unforeseen daylight is relative to: full scale, or 0 where a reading has none."""
        return 0.0 if "demodulation" in self.effects else self.full_scale_counts

    @property
    def attenuation(self) -> tuple[str, float]:
        """Name and value, 1/m, of what dims the light with the range: K, or the absorption."""
        if "sea" in self.effects:
            return ABSORPTION, float(self.effects["sea"]["absorption_per_m"])
        return ATTENUATION, float(self.effects.get("attenuation", {}).get("k_per_m", 0.0))

    def nuisance_std(self) -> dict[str, float]:
        """Return the standard deviation of each uncertain setting, by dotted name."""
        return {**self.prior.nuisance_std(), **self.prior.lamps_std(len(self.lamps))}

    def constants_std(self) -> dict[str, float]:
        """Return `nuisance_std`, with that of the gradient of daylight.

        In one image the gradient looks like a turn of the array, but many images determine it.
        Where the scene names neither daylight nor a shade, it is as uncertain as daylight itself.
        """
        stds = self.nuisance_std()
        if AMBIENT in stds and "ambient" not in self.effects and not self.prior.shade_probability:
            for name in GRADIENTS:
                stds.setdefault(name, stds[AMBIENT])
        return stds

    def with_shape(self, shape: Shape) -> "Scene":
        """Return the scene with an array of another shape, as `ArraySettings.with_shape`."""
        return dataclasses.replace(self, array=self.array.with_shape(shape))

    def with_lamps(self, lamps: tuple[BeaconLamp, ...]) -> "Scene":
        """Return the scene with other lamps; without any it has no prior of them."""
        unused: dict[str, Any] = dict.fromkeys(
            without_meaning(self.effects, self.array, lamps), 0.0
        )
        prior = dataclasses.replace(self.prior, **unused)
        return dataclasses.replace(self, lamps=lamps, prior=prior)

    def settings(self) -> dict[str, Any]:
        """Return the whole scene as plain values, as in a scene file."""
        groups = {
            group: {
                key: list(value) if isinstance(value, Span) else value
                for key, value in dataclasses.asdict(getattr(self, group)).items()
                if value is not None
            }
            for group in GROUPS
        }
        plain = {**groups, "effects": {name: dict(values) for name, values in self.effects.items()}}
        if self.lamps:
            lamps = map(dataclasses.asdict, self.lamps)
            plain["lamps"] = [{k: v for k, v in lamp.items() if v is not None} for lamp in lamps]
        return plain

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


DAYLIGHT_STDS = "ambient_std_counts", "ambient_gradient_std_counts"  # which demodulation removes
FLOOR_STDS = ("lamp_floor_std_counts",)  # of what is daylight without it

NO_FLOOR = "without demodulation this light counts as daylight; give effects.ambient"


def without_meaning(
    effects: Mapping[str, Any], array: ArraySettings, lamps: Sequence[BeaconLamp]
) -> list[str]:
    """Return the keys of the prior that are about what a scene does not have."""
    there = {f"effects.{name}" for name in effects} | {LAMPS if lamps else ONE_LAMP}
    there |= {f"array.{name}" for name, value in vars(array).items() if value is not None}
    unused = [key for key, each in UNCERTAIN.items() if each.needs and each.needs not in there]
    return [*unused, *(DAYLIGHT_STDS if "demodulation" in effects else FLOOR_STDS)]


def scene_from_settings(settings: Any, name: str) -> Scene:
    """Check a scene given as plain values, by groups; the name is for errors.

    ValueError for an unknown or missing key, a wrong type or a value out of bounds, with the key,
    the value, the bound and the cure.
    """
    try:
        if not isinstance(settings, Mapping):
            raise ValueError(f"{settings!r} is not a mapping of groups")
        for group in settings:
            if group not in (*GROUPS, "effects", "lamps"):
                raise unknown(group, (*GROUPS, "effects", "lamps"), "")
        effects = check_effects(settings.get("effects"))
        lamps = checked_lamps(settings.get("lamps"))
        groups: dict[str, Any] = {}
        for group, declared in GROUPS.items():
            given = settings.get(group)
            values = check_all(
                declared, with_photometry(given) if group == "lamp" else given, group
            )
            if group == "prior":
                given, defaults = settings.get(group) or {}, PRIORS[values["known"]]
                if groups["lamp"].beam_weights is None:  # one Gaussian is exact, unless given
                    defaults = {**defaults, "beam_shape_std": 0.0}
                values |= {key: std for key, std in defaults.items() if key not in given}
                # A set's values do not apply to what the scene does not have.
                for key in without_meaning(effects, groups["array"], lamps):
                    if key not in given:
                        values[key] = 0.0
                    elif values[key] > 0 and key in DAYLIGHT_STDS:
                        raise ValueError(f"prior.{key}: demodulation removes daylight; give 0")
                    elif values[key] > 0 and UNCERTAIN[key].needs == ONE_LAMP and lamps:
                        raise ValueError(f"prior.{key}: each of the lamps has its own; give 0")
                    elif values[key] > 0 and key in FLOOR_STDS:
                        raise ValueError(f"prior.{key}: {NO_FLOOR}")
                    elif values[key] > 0:
                        needs = UNCERTAIN[key].needs
                        raise ValueError(f"prior.{key}: the scene has no {needs}; add it")
            try:
                groups[group] = declared(**values)
            except ValueError as error:
                raise ValueError(f"{group}.{error}") from None
        scene = Scene(name=name, effects=effects, lamps=lamps, **groups)
        if "sea" in effects and "attenuation" in effects:
            raise ValueError("effects.attenuation: effects.sea absorbs already; leave one out")
        if "pedestal" in effects and "demodulation" in effects:
            raise ValueError("effects.pedestal: demodulation has a pedestal; leave this one out")
        if lamps and "demodulation" not in effects:
            raise ValueError(
                "lamps: only demodulation separates their light; add effects.demodulation"
            )
        if scene.lamp.floor_counts and not lamps and "demodulation" not in effects:
            raise ValueError(f"lamp.floor_counts: {NO_FLOOR}")
        for key in ("floor_counts", "behind_m"):
            if lamps and (value := getattr(scene.lamp, key)):
                own = {"behind_m": "x_m"}.get(key, key)
                raise ValueError(
                    f"lamp.{key}: {value:g}, but each of the lamps has its own; give lamps[0].{own}"
                )
        if lamps and "forward_scatter" in effects:
            raise ValueError("effects.forward_scatter: it takes one lamp only; use effects.sea")
    except ValueError as error:
        raise ValueError(f"scene {name}: {error}") from None
    return scene


def save_scene(scene: Scene, path: Path, comment: str, like: str = "") -> None:
    """Write a scene as a YAML file that `load_scene` reads, whole or not at all.

    The comment is its first line; those of the scene file that it came from, `like`, are kept.
    """
    text = yaml_text.text_of(scene.settings(), like)
    head = f"# {comment}\n"
    files.write_text(path, text if text.startswith(head) else f"{head}\n{text}")


def load_scene(path: str | Path) -> Scene:
    """Read and check a scene file with those that it ``extends``.

    Parameters
    ----------
    path
        A file, or the bare name of a ready scene such as ``follow``.

    Raises
    ------
    ValueError
        For text that is not YAML, as `scene_files.layers`, or as `scene_from_settings`.
    FileNotFoundError
        Where neither a file nor a ready scene has that name, or one that is extended.
    """
    file = scene_files.scene_file(path)
    return scene_from_settings(
        scene_files.merged(scene_files.layers(file)), Path(files.shown(file)).stem
    )
