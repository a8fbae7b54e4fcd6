"""What an array sees of several vehicles: the light of every lamp, and the shadow of every body.

Light adds up on its way: that of the lamp that is followed and of all others comes to the array
before daylight, blur, gains and noise, which it has once. An array that demodulates reads the lamps
of one code; those of other codes are as daylight to it.

A body is a capsule along the vehicle's x, with ``base_link`` in its middle. Where it stands on the
line from a lamp to a detector it takes all light of that lamp, also what the water would scatter
around it. No vehicle shades its own lamp, and the follower not its array.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import PITCH, YAW, Array, relative_pose, rotation_matrix
from uuv_optical_array.core.settings import Place
from uuv_optical_array.forward.aim import apparent
from uuv_optical_array.forward.drawn_sea import DrawnSea
from uuv_optical_array.forward.lamp.lamps import AXIS_PITCH, lamps_in_numbers, together
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.prior import FLOOR, OWN_FLOOR, POWER, of_lamp, power_offsets

BODY_LENGTH_M, BODY_RADIUS_M = 0.8, 0.25  # of a small vehicle


@dataclass(frozen=True, eq=False)
class Other:
    """A vehicle in the world, with a lamp like the scene's.

    - position, rotation: of its ``base_link``, m, shape ``(3,)``, and from its axes to the world's,
      shape ``(3, 3)``.
    - power: of its lamps, relative to the scene's; 0: they are off, or it has none.
    - code: of the lamp's modulation; those of vehicles with one code are alike.
    - lamp_m: the lamp's frame ``beacon`` in ``base_link``, m.
    """

    position: Array
    rotation: Array
    power: float = 1.0
    code: int = 0
    lamp_m: Place = (0.0, 0.0, 0.0)

    @property
    def beacon(self) -> Array:
        """Return where its lamp is in the world, m, shape ``(3,)``."""
        return np.asarray(self.position + self.rotation @ np.array(self.lamp_m))


class Sight(NamedTuple):
    """What comes to the detectors, each of shape ``(L side, side)`` and in counts.

    - light: of all lamps that the array reads, with daylight, as `ForwardModel.light`.
    - beside: of lamps with other codes, which `ForwardModel.read` takes; none is 0.
    """

    light: Array
    beside: Array


def sight(
    model: ForwardModel,
    follower: tuple[Array, Array],
    leader: Other,
    others: Sequence[Other] = (),
    offsets: Mapping[str, Array] = MappingProxyType({}),
    time_s: float | None = None,
    sea: DrawnSea | None = None,
) -> Sight:
    """Return what a follower's array sees of the leader's lamp and of other vehicles.

    Parameters
    ----------
    model
        Of the scene; a lamp with a code other than the leader's is told apart only where it has
        ``demodulation``, and not by slots.
    follower
        Position, m, shape ``(3,)``, and rotation to the world, shape ``(3, 3)``, of its
        ``base_link``.
    leader, others
        The vehicle that it follows, and all others but the follower itself.
    offsets
        As of `ForwardModel.light`; those of power are the leader's alone.
    time_s
        As of `ForwardModel.light`, for all lamps.
    sea
        By what all this differs from the model's scene, beside the offsets.
    """
    if sea is not None:
        follower = _aimed(model, follower, leader, sea)
        moved = dict(sea.offsets)
        for name, offset in offsets.items():
            moved[name] = offset + moved.get(name, np.zeros(()))
        offsets = moved
    position, rotation = follower
    vehicles = [leader, *others]
    placed = [relative_pose(each.beacon, each.rotation, position, rotation) for each in vehicles]
    poses, rolls = np.array([pose for pose, _ in placed]), np.array([roll for _, roll in placed])
    count = model.scene.lamp_count
    of_leader = {POWER, *power_offsets([1.0], count)}
    common = {name: offset for name, offset in offsets.items() if name not in of_leader}
    arriving = model.light(poses, rolls, common, time_s, on_array=False)
    powers = np.array([np.full(count, each.power) for each in vehicles])
    powers[0] *= np.exp(_logarithms(offsets, count))
    arriving *= np.repeat(powers, model.array.side, axis=1)[..., None]
    if others:
        arriving = arriving * _passed(model, position, rotation, vehicles)
    waveform = model.scene.effects.get("demodulation", {}).get("waveform", "slots")
    alike = np.array([waveform == "slots" or each.code == leader.code for each in vehicles])
    common |= _floors(model, common, powers[alike].sum(axis=0))
    light = model.on_array(arriving[alike].sum(axis=0), common)
    beside = np.zeros_like(light)
    if not alike.all():
        stray = together(arriving[~alike].sum(axis=0))
        dark = np.zeros_like(light)
        whole = np.concatenate([stray] * count)
        beside = model.on_array(whole, common) - model.on_array(dark, common)
    if sea is not None:
        light, beside = model.with_gains(light, sea.gains), np.tile(sea.gains, (count, 1)) * beside
    return Sight(light, beside)


def _aimed(
    model: ForwardModel, follower: tuple[Array, Array], leader: Other, sea: DrawnSea
) -> tuple[Array, Array]:
    """Return where a follower would be whose array and leader's lamp were aimed as they should."""
    pose, roll = relative_pose(leader.beacon, leader.rotation, *follower)
    (aimed,) = apparent(model.scene, pose[None], sea.aims[None])
    turned = rotation_matrix(aimed[PITCH], aimed[YAW], roll)
    return leader.beacon + leader.rotation @ aimed[:PITCH], leader.rotation @ turned


def _floors(model: ForwardModel, offsets: Mapping[str, Array], powers: Array) -> dict[str, Array]:
    """Return the offsets of the floors of lamps of these powers, ``(L,)``, whose light they are."""
    scene = model.scene
    if "demodulation" not in scene.effects:
        return {}
    floors = {of_lamp(i, OWN_FLOOR): lamp.floor_counts for i, lamp in enumerate(scene.lamps)}
    moved = {}
    for (name, floor), power in zip(
        (floors or {FLOOR: scene.lamp.floor_counts}).items(), powers, strict=True
    ):
        whole = floor + offsets.get(name, 0.0)
        if floor or name in offsets:
            moved[name] = power * whole - floor
    return moved


def _logarithms(offsets: Mapping[str, Array], count: int) -> Array:
    """Return the logarithm of the power of each of the leader's lamps, by the scene's, ``(L,)``."""
    names = power_offsets([1.0], count)
    own = [float(offsets.get(name, 0.0)) for name in names]
    return np.array(own) + (float(offsets.get(POWER, 0.0)) if count > 1 else 0.0)


def _passed(
    model: ForwardModel, position: Array, rotation: Array, vehicles: Sequence[Other]
) -> Array:
    """Return 1 where the light of a vehicle's lamps passes all bodies, ``(K, L side, side)``."""
    places = lamps_in_numbers(model.scene.lamps, 0.0)[:AXIS_PITCH].T
    detectors = position + model.array.positions @ rotation.T
    centres = np.array([each.position for each in vehicles])
    axes = np.array([each.rotation[:, 0] for each in vehicles])
    passed = []
    for i, each in enumerate(vehicles):
        lamps = each.beacon + places @ each.rotation.T
        others = [k for k in range(len(vehicles)) if k != i]
        off_m = _distance(lamps[:, None, None], detectors[:, None], centres[others], axes[others])
        passed.append((off_m > BODY_RADIUS_M).all(axis=-1))
    return np.array(passed, dtype=float).reshape(len(vehicles), *model.image_shape)


def _distance(start: Array, end: Array, centre: Array, axis: Array) -> Array:
    """Return the least distance of lines from `start` to `end`, m, to the core lines of bodies.

    All have shape ``(..., 3)``, the axis is a unit vector, and the result ``(...)``.
    """
    half_m = max(BODY_LENGTH_M / 2 - BODY_RADIUS_M, 0.0)
    along, from_centre = end - start, start - centre
    square = (along * along).sum(axis=-1)
    common = (along * axis).sum(axis=-1)
    ahead, aside = (along * from_centre).sum(axis=-1), (axis * from_centre).sum(axis=-1)
    # Nearest on both infinite lines, then on the body's piece, then on the light's.
    across = np.maximum(square - common * common, 1e-12 * square)
    share = np.clip((common * aside - ahead) / across, 0.0, 1.0)
    on_body = np.clip(aside + share * common, -half_m, half_m)
    share = np.clip((common * on_body - ahead) / square, 0.0, 1.0)
    gap = from_centre + share[..., None] * along - on_body[..., None] * axis
    return np.asarray(np.linalg.norm(gap, axis=-1))
