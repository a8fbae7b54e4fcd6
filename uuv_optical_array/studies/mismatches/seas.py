"""Seas that differ from the scene: the light of each at the detectors.

Noise and electronics are those of the scene; the lamp keeps its power where another setting is off.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import legvander2d
from scipy.special import ndtr

from uuv_optical_array.calibration.likelihood.aims import appearing
from uuv_optical_array.core.geometry import PITCH, Array, X, Y, Z, rotation_matrix
from uuv_optical_array.forward import prior
from uuv_optical_array.forward.light import HALF_SQUARE
from uuv_optical_array.forward.model import ForwardModel

# Products of Legendre polynomials over the array, by their degrees: its smooth uneven modes.
MODES = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
# When modulated lamps are sampled, s; the carriers are as many periods of a frame, and one apart.
FRAME_S, SAMPLES, CARRIER_HZ = 0.1, 3360, 1000.0
TIMES_S = (np.arange(SAMPLES) + 0.5) * FRAME_S / SAMPLES
WAVES_HZ, WAVES_COUNTS = 5.0, 120.0  # of daylight, 30 % of 400 counts
BUBBLE = 0.2  # width of its shadow, in half widths of the array
RING, PENUMBRA = 0.3, 0.2  # widths of a ring and of a shadow's edge, in sigmas of the beam


class Sea(NamedTuple):
    """A scene's model, poses ``(n, 5)``, and the source of what differs at random."""

    model: ForwardModel
    poses: Array
    rng: np.random.Generator

    def light(self) -> Array:
        """Return the light of the scene itself, counts, shape ``(n, side, side)``."""
        return self.model.light(self.poses)

    def offset(self, name: str, by: float) -> Array:
        """Return the light where a constant is off, as `ForwardModel.light` has its offsets."""
        return self.model.light(self.poses, 0.0, {name: np.array(by)})

    def lamps_and_rest(self) -> tuple[Array, Array]:
        """Return the light of each lamp, and that of all else, ``(n, L, side, side)``."""
        side, dark = self.model.array.side, self.offset(prior.POWER, -np.inf)
        light, rest = (it.reshape(len(it), -1, side, side) for it in (self.light(), dark))
        return light - rest, rest

    def image(self, lights: Array) -> Array:
        """Return light on the array, ``(n, L or 1, side, side)``, as an image of all lamps."""
        count, _, side, _ = lights.shape
        every = np.broadcast_to(lights, (count, self.model.scene.lamp_count, side, side))
        return every.reshape(count, -1, side)

    def dimmed(self, factor: Array) -> Array:
        """Return the light where that of the lamps is so many times as much, at each detector.

        The factor has the shape ``(n, L or 1, side, side)`` or ``(n, side, side)``.
        """
        lamps, rest = self.lamps_and_rest()
        return self.image(lamps * (factor if factor.ndim == 4 else factor[:, None]) + rest)

    def off_axis(self) -> Array:
        """Return the angle off each lamp's axis over its beam's sigma, ``(n, L, side, side)``."""
        side, scene = self.model.array.side, self.model.scene
        rays = self.model.rays(self.poses, np.zeros(len(self.poses)))
        angle = np.sqrt(2 * rays[HALF_SQUARE]).reshape(len(self.poses), -1, side, side)
        return angle / np.radians(scene.lamp.beam_sigma_deg)

    def towards(self) -> Array:
        """Return how far detectors are in a direction, from -1 to 1, in each frame another."""
        column, row = prior.over_array(self.model.array.side)
        turn = self.rng.uniform(0, 2 * np.pi, (len(self.poses), 1, 1))
        along = np.cos(turn) * column + np.sin(turn) * row
        return along / np.abs(along).max(axis=(1, 2), keepdims=True)

    def aside(self, port_m: float = 0.0, above_m: float = 0.0) -> Array:
        """Return the light of lamps that are so far from the scene's, ``(n, L, side, side)``."""
        beside = self.poses - np.array([0.0, port_m, above_m, 0.0, 0.0])
        return self._replace(poses=beside).lamps_and_rest()[0]

    def detected(self, signals: Array, carrier_hz: float = CARRIER_HZ) -> Array:
        """Return what each lamp's detection reads of signals at `TIMES_S`, ``(n, L, 1, 1)``."""
        scene = self.model.scene
        waveform, lamps = scene.effects["demodulation"]["waveform"], scene.lamp_count
        if waveform == "slots":
            slots = [modulated(waveform, carrier_hz * TIMES_S, i, lamps) for i in range(lamps + 1)]
            references = (np.array(slots[:-1]) - slots[-1]) / (lamps + 1)
        else:
            carriers_hz = carrier_hz + np.arange(lamps)[:, None] / FRAME_S
            size = 2.0 if waveform == "sine" else np.pi / 2
            references = size * np.sin(2 * np.pi * carriers_hz * TIMES_S)
        return (signals @ references.T / SAMPLES)[..., None, None]


def modulated(waveform: str, turns: Array, i: int, lamps: int) -> Array:
    """Return the light of lamp i, of mean 1, by the phase of its carrier or of the slots, turns."""
    if waveform == "slots":
        return np.where(np.floor(turns % 1 * (lamps + 1)) == i, lamps + 1.0, 0.0)
    sine = np.sin(2 * np.pi * turns)
    return 1 + sine if waveform == "sine" else np.where(sine > 0, 2.0, 0.0)


# Light at the detectors, counts, shape (n, side, side), in a sea that differs `by` so much.


def second_lamp(sea: Sea, by: float, port_m: float = 0.0, above_m: float = 0.0) -> Array:
    """Add another lamp, parallel to the first, of a share of its power."""
    return sea.light() + by * sea.image(sea.aside(port_m, above_m))


def waves(sea: Sea, by: float) -> Array:
    """Add daylight that waves modulate, in each detector its own phase; carriers from `by`, Hz."""
    turns = WAVES_HZ * TIMES_S + np.array([[0.0], [0.25]])
    leak = WAVES_COUNTS * sea.detected(np.sin(2 * np.pi * turns), by)
    side = sea.model.array.side
    phase = sea.rng.uniform(0, 2 * np.pi, (len(sea.poses), 1, side, side))
    return sea.light() + sea.image(np.cos(phase) * leak[0] + np.sin(phase) * leak[1])


def another_leader(sea: Sea, by: float, off_hz: float = 0.0) -> Array:
    """Add another leader's lamps of a share of the power, 0.3 m to port and of a random phase."""
    scene = sea.model.scene
    turns = (CARRIER_HZ + off_hz) * TIMES_S + sea.rng.uniform(size=(len(sea.poses), 1))
    signals = modulated(scene.effects["demodulation"]["waveform"], turns, 0, scene.lamp_count)
    lamp = by * sea.aside(port_m=0.3).sum(axis=1, keepdims=True)
    return sea.light() + sea.image(sea.detected(signals) * lamp)


def late_slots(sea: Sea, by: float) -> Array:
    """Let each lamp light up and go out a share of a slot too late."""
    lamps, rest = sea.lamps_and_rest()
    # A lamp shines into the slot of the next one, and the last one into that for daylight.
    before = np.concatenate([0 * lamps[:, :1], lamps[:, :-1]], axis=1)
    return sea.image((1 - by) * lamps + by * (before - lamps[:, -1:]) + rest)


def one_lamp(sea: Sea, by: float) -> Array:
    """Let one of several lamps, in each frame another, have a share of its power."""
    lamps, rest = sea.lamps_and_rest()
    lamps[np.arange(len(lamps)), sea.rng.integers(lamps.shape[1], size=len(lamps))] *= by
    return sea.image(lamps + rest)


def other_gains(sea: Sea, by: float) -> Array:
    """Give each detector a gain of its own, in each frame another."""
    side = sea.model.array.side
    gains = 1 + by * sea.rng.standard_normal((len(sea.poses), side, side))
    return sea.model.with_gains(sea.light(), np.maximum(gains, 0.0))


def response_power(percent: float) -> float:
    """Return the power of the cosine by which detectors read so much less at 30 deg."""
    return float(np.log(1 - percent / 100) / np.log(np.cos(np.radians(30))))


def one_detector(sea: Sea, full_scales: float) -> Array:
    """Let one detector, in each frame another, read a constant."""
    image, side = sea.light(), sea.model.array.side
    row, column = sea.rng.integers(side, size=(2, len(image)))
    of_lamps = image.reshape(len(image), -1, side, side)
    frame = np.arange(len(image))
    of_lamps[frame, :, row, column] = full_scales * sea.model.scene.full_scale_counts
    return image


def some_detectors(sea: Sea, number: int, gain: float = 1.0, counts: float = 0.0) -> Array:
    """Let some detectors, in each frame others, read a share of their light, or more of it."""
    image = sea.light()
    of_lamps = image.reshape(len(image), -1, sea.model.array.side**2)
    every = np.tile(np.arange(of_lamps.shape[2]), (len(image), 1))
    frame, chosen = np.arange(len(image))[:, None], sea.rng.permuted(every, axis=1)[:, :number]
    of_lamps[frame, :, chosen] = gain * of_lamps[frame, :, chosen] + counts
    return image


def two_rows(sea: Sea, gain: float) -> Array:
    """Let two neighbouring rows, in each frame others, read a share of their light."""
    side, count = sea.model.array.side, len(sea.poses)
    first, row = sea.rng.integers(side - 1, size=(count, 1, 1)), np.arange(side)[:, None]
    gains = np.where((row == first) | (row == first + 1), gain, 1.0)
    return sea.model.with_gains(sea.light(), np.broadcast_to(gains, (count, side, side)))


def wider(sea: Sea, by: float) -> Array:
    """Let the array be wider, on the same sphere and under the same lamp."""
    scene = sea.model.scene
    array = dataclasses.replace(scene.array, width_m=by * scene.array.width_m)
    wide = ForwardModel(dataclasses.replace(scene, array=array))
    return sea._replace(model=wide).offset(prior.POWER, np.log(sea.model.power / wide.power))


def turned_lamp(sea: Sea, by: float) -> Array:
    """Turn the lamp to port, deg, so that its beam, which points astern, goes to starboard."""
    aims, bow_m = np.radians([0.0, by, 0.0, 0.0]), sea.model.scene.array.bow_m
    poses, rolls, _ = appearing(sea.poses, np.zeros(len(sea.poses)), aims, bow_m)
    return sea.model.light(poses, rolls)


def turned_mount(sea: Sea, by: float) -> Array:
    """Turn the array about its middle, deg, in each frame in another direction."""
    direction = sea.rng.uniform(0, 2 * np.pi, len(sea.poses))
    aimed = sea.poses.copy()
    aimed[:, PITCH:] += np.radians(by) * np.stack([np.sin(direction), np.cos(direction)], axis=1)
    # Where base_link would be if it turned with the array.
    before, after = (rotation_matrix(*at[:, PITCH:].T)[..., X] for at in (sea.poses, aimed))
    aimed[:, : Z + 1] += sea.model.scene.array.bow_m * (before - after)
    return sea.model.light(aimed)


def shade(sea: Sea, by: float) -> Array:
    """Shade the lamp unevenly and smoothly, the logarithm off by so much over the array, RMS."""
    column, row = prior.over_array(sea.model.array.side)
    modes = np.stack([legvander2d(column, row, degrees)[..., -1] for degrees in MODES])
    modes /= np.sqrt(np.mean(modes**2, axis=(1, 2), keepdims=True))
    depths = sea.rng.standard_normal((len(sea.poses), len(MODES))) * by / np.sqrt(len(MODES))
    return sea.dimmed(np.exp(np.tensordot(depths, modes, axes=1)))


def half_shadow(sea: Sea) -> Array:
    """Let the lamp reach one half of the array, in each frame another, with a hard edge."""
    return sea.dimmed(np.where(sea.towards() > 0, 0.0, 1.0))


def hidden_row(sea: Sea, by: float) -> Array:
    """Let the lowest row see a share of the lamp."""
    factor = np.ones((len(sea.poses), *[sea.model.array.side] * 2))
    factor[:, -1] = by
    return sea.dimmed(factor)


def fouled(sea: Sea, by: float) -> Array:
    """Let a window lose a share of its light at one edge, and less than a tenth of that mid-way."""
    return sea.dimmed(1 - by * np.exp((sea.towards() - 1) / 0.3))


def bubble(sea: Sea, by: float) -> Array:
    """Let a bubble take a share of the light of one detector and some of that of those around."""
    side, count = sea.model.array.side, len(sea.poses)
    column, row = prior.over_array(side)
    at = sea.rng.uniform(-1, 1, (2, count, 1, 1))
    squares = (column - at[0]) ** 2 + (row - at[1]) ** 2
    return sea.dimmed(1 - by * np.exp(-squares / (2 * BUBBLE**2)))


def moffat_lobe(sea: Sea) -> Array:
    """Shape the beam as a Moffat function of exponent 3, as wide at half of its peak."""
    squares = sea.off_axis() ** 2
    lobe = (1 + (2 ** (1 / 3) - 1) * squares / (2 * np.log(2))) ** -3
    return sea.dimmed(lobe * np.exp(squares / 2))


def ring(sea: Sea, by: float) -> Array:
    """Put a ring of so much more light into the beam, about a standard deviation off its axis."""
    return sea.dimmed(1 + by * np.exp(-(((sea.off_axis() - 1) / RING) ** 2) / 2))


def cut_off(sea: Sea) -> Array:
    """Let a hull cut off the beam to port, one standard deviation off its axis."""
    side, lamp = sea.model.array.side, sea.model.scene.lamp
    turned = rotation_matrix(*sea.poses[:, PITCH:].T) @ sea.model.array.positions.T
    x, y = (sea.poses[:, axis, None] + turned[:, axis] for axis in (X, Y))
    angle = np.arctan2(y, -x).reshape(len(x), side, side) / np.radians(lamp.beam_sigma_deg)
    return sea.dimmed(ndtr((1 - angle) / PENUMBRA))


def bent(sea: Sea, by: float) -> Array:
    """Bend the response, S-shaped, by so much of the full scale."""
    light, full = sea.light(), sea.model.scene.full_scale_counts
    return light + by * full * np.sin(2 * np.pi * light / full)


def blob(sea: Sea) -> Array:
    """Return a Gaussian blob of any place, width and brightness."""
    column, row = prior.over_array(sea.model.array.side)
    count = len(sea.poses)
    at = sea.rng.uniform(-1, 1, (2, count, 1, 1))
    width = sea.rng.uniform(0.3, 1, (2, count, 1, 1))
    peak = sea.rng.uniform(0.1, 1, (count, 1, 1)) * sea.model.scene.full_scale_counts
    squares = ((column - at[0]) / width[0]) ** 2 + ((row - at[1]) / width[1]) ** 2
    return sea.image((peak * np.exp(-squares / 2))[:, None])
