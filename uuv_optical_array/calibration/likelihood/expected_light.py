"""The light that a calibration expects by its parameters, before the gains, and its slopes."""

import copy
import dataclasses
from operator import attrgetter
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.calibration.likelihood.aims import appearing
from uuv_optical_array.calibration.likelihood.parameters import (
    AIMS,
    BACKGROUND,
    BEHIND,
    BY_PRIOR,
    POWER,
    SHAPE,
    SIGMA,
    Layout,
)
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.array import DetectorArray
from uuv_optical_array.forward.effects.detectors import detector_gains
from uuv_optical_array.forward.lamp.beam import gaussians_of, of_three
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import OWN_GEOMETRY, ROLL
from uuv_optical_array.forward.scene import Scene, scene_from_settings

SHAPE_STEP = 1e-4  # of a weight of the beam, of which the light is all but linear
POSE = 6  # slopes by a pose and its roll

Same = TypeVar("Same", bound="ExpectedLight")


class ExpectedLight:
    """The light of a scene by the parameters of a `Layout`; `array` in place of its detectors.

    Gains and faults of the detectors are not in it, nor is a pedestal.
    """

    def __init__(self, scene: Scene, array: DetectorArray | None) -> None:
        settings = scene.settings()
        effects = settings["effects"]
        side = scene.array.detectors_per_side
        gains = np.ones(side * side)
        if responsivity := effects.pop("responsivity", None):
            responsivity.pop("drift_per_c")
            gains = detector_gains(side, **responsivity).ravel()
        faults = effects.pop("detector_faults", {})
        self.faulty: NDArray[np.bool_] = np.zeros((side, side), dtype=bool)
        for row, column in (*faults.get("dead", ()), *faults.get("stuck", ())):
            self.faulty[row, column] = True
        self.faulty = self.faulty.ravel()
        effects.setdefault("ambient", {"level_counts": 0.0})
        effects.pop("pedestal", None)
        if "demodulation" in effects:
            effects["demodulation"]["pedestal_counts"] = 0.0
        settings["prior"] = {key: getattr(scene.prior, key) for key in BY_PRIOR}
        self.scene = scene_from_settings(settings, scene.name)
        self.model = ForwardModel(self.scene)
        if array is not None:
            self.model.array = array
        self.original = ForwardModel(scene)
        self.start_gains = gains
        self.layout = Layout(self.scene)
        lacking = {*AIMS, *SHAPE, BEHIND, *self.layout.lacking}
        self._own = [i for i in range(self.layout.gains) if i not in lacking]
        self._of_model = self.start()[: self.layout.gains]
        self._of_model[POWER] = np.log(self.model.power)
        self._of_model[BACKGROUND], floors = self._levels()
        self._of_model[self.layout.own[:, -1]] = floors

    def with_shape(self: Same) -> Same:
        """Return the same with the shape of the beam among its parameters."""
        other = copy.copy(self)
        other.scene = dataclasses.replace(self.scene, lamp=of_three(self.scene.lamp))
        other.model, other.layout = ForwardModel(other.scene), Layout(other.scene)
        other.model.array = self.model.array
        return other

    def start(self) -> Array:
        """Return the parameters of the scene, gauge included, shape ``(p,)``."""
        gains = np.maximum(self.start_gains, 1e-3)
        scene, works = self.scene, ~self.faulty
        _, attenuation = scene.attenuation
        level, floors = self._levels()
        narrow, _, wide = self.layout.gaussians
        common = np.exp(np.log(gains[works]).mean()) if works.any() else 1.0
        return np.array(
            [
                np.log(self.original.power * common),
                np.log(scene.lamp.beam_sigma_deg),
                attenuation,
                np.log(scene.effects.get("sea", {}).get("scattering_per_m", 1.0)),
                scene.effects.get("field_of_view", {}).get("cosine_power", 1.0),
                np.log(scene.array.radius_m or 1.0),
                *np.zeros(len(AIMS)),
                0.0 if BACKGROUND in self.layout.lacking else level * common,
                *gaussians_of(scene.lamp)[0][[narrow, wide]],
                scene.lamp.behind_m,
                *(
                    own
                    for lamp, floor in zip(scene.lamps, floors, strict=True)
                    for own in (np.log(lamp.power), *_geometry(lamp), floor * common)
                ),
                *np.log(gains / common),
            ]
        )

    def _levels(self) -> tuple[float, list[float]]:
        """Return the background of the scene, counts, and the floor of each of several lamps."""
        scene = self.scene
        daylight = scene.effects["ambient"]["level_counts"]
        level = scene.lamp.floor_counts if self.layout.modulated else daylight
        return float(level), [lamp.floor_counts for lamp in scene.lamps]

    def background(self, parameters: Array) -> Array:
        """Return what is no light straight from a lamp, counts, of each reading, ``(n,)``."""
        layout = self.layout
        gains = np.exp(parameters[layout.gains :])
        floors = parameters[layout.own[:, -1]] if len(layout.own) else parameters[[BACKGROUND]]
        return np.outer(floors, gains).ravel()

    def apparent(self, parameters: Array, poses: Array, rolls: Array) -> tuple[Array, Array, Array]:
        """Return poses and rolls as they appear, with slopes by those given, as `appearing`."""
        seen, seen_rolls, by_seen = appearing(
            poses, rolls, parameters[AIMS], self.scene.array.bow_m
        )
        seen[:, 0] -= parameters[BEHIND] - self.scene.lamp.behind_m
        return seen, seen_rolls, by_seen

    def light(self, parameters: Array, poses: Array, rolls: Array) -> tuple[Array, Array]:
        """Return the light before the gains, ``(m, n)``, and its slopes, ``(m, n, 6 + gains)``.

        These are by pose and roll (6), and by the parameters before the gains.
        """
        names, turned = self.layout.names, {ROLL: np.zeros(len(poses))} if self.scene.lamps else {}
        sigma_deg = float(np.exp(parameters[SIGMA]))
        offsets = parameters[: self.layout.gains] - self._of_model
        offsets[SIGMA] = sigma_deg - self.scene.lamp.beam_sigma_deg
        seen, seen_rolls, by_seen = self.apparent(parameters, poses, rolls)
        own = {**turned, **{names[i]: np.full(len(poses), offsets[i]) for i in self._own}}
        shape = self._shape(parameters[list(SHAPE)])
        light, by_own = self.model.with_beam(shape).linearised(seen, seen_rolls, own)
        motions = 5 + len(turned)
        slopes = np.zeros((*light.shape, POSE + self.layout.gains))
        slopes[..., [POSE + i for i in self._own]] = by_own[..., motions:]
        by_given = by_own[..., :motions] @ by_seen[:, :motions]
        slopes[..., [*range(POSE), *(POSE + i for i in AIMS)]] = by_given
        slopes[..., POSE + SIGMA] *= sigma_deg
        slopes[..., POSE + BEHIND] = -by_own[..., 0]  # the follower is nearer by as much
        for i, off in zip(SHAPE, SHAPE_STEP * np.eye(2), strict=True):
            if i not in self.layout.lacking:
                wider = self._shape(parameters[list(SHAPE)] + off)
                there = self.model.with_beam(wider).light(seen, seen_rolls, own)
                slopes[..., POSE + i] = (there.reshape(light.shape) - light) / SHAPE_STEP
        return light, slopes

    def beam(self, parameters: Array) -> dict[str, list[float]]:
        """Return the shape of the beam as keys of a scene's lamp."""
        widths = self.scene.lamp.beam_widths or ()
        weights, _ = self._shape(parameters[list(SHAPE)])[:, : len(widths)]
        rounded = [round(weight, 9) for weight in weights.tolist()]
        return {"beam_widths": list(widths), "beam_weights": rounded}

    def _shape(self, weights: Array) -> Array:
        """Return the beam's Gaussians with weights of the narrowest and the widest."""
        narrow, middle, wide = self.layout.gaussians
        shape = gaussians_of(self.scene.lamp).copy()
        for i, place, weight in zip(SHAPE, (narrow, wide), weights.tolist(), strict=True):
            if i not in self.layout.lacking:
                shape[0, middle] += shape[0, place] - weight
                shape[0, place] = weight
        return shape


_geometry = attrgetter(*OWN_GEOMETRY)
