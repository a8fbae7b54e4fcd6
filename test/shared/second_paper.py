"""A second implementation of Eren et al. (2016): x ahead, y to starboard, z down."""

import functools

import numpy as np
import second_forward
from scipy import ndimage, stats


def second_image(shape, n, at, yaw_deg, *, sigma_deg=4.5, k=0.1, centre=0.0, bits=None, **blur):
    """Light on n x n detectors; `at` is the centre of mass, the lamp at the origin shines aft.

    Rotation is about the point `centre` m ahead of the centre of mass.
    """
    x, y, z = at
    x += centre * (1 - np.cos(np.radians(yaw_deg)))
    y -= centre * np.sin(np.radians(yaw_deg))
    light = unit_light(shape, n, float(x), float(y), float(z), float(yaw_deg), sigma_deg, k)
    return second_blur(light, 0.4 / (n - 1), **blur)


@functools.cache
def unit_light(shape, n, x, y, z, yaw_deg, sigma_deg, k):
    """Light of a lamp of unit power, by the second forward model: y to port, z up."""
    array = {"shape": shape, "detectors_per_side": n, "width_m": 0.4, "bow_m": 0.4}
    scene = {"lamp": {"beam_sigma_deg": sigma_deg}, "array": {**array, "radius_m": 0.32}}
    pose = (x, -y, -z, 0.0, -np.radians(yaw_deg))
    return second_forward.image_of(scene, 1.0, {"attenuation": {"k_per_m": k}}, pose)


def second_blur(image, spacing, window=0.2, samples=None, mode="reflect"):
    """Convolve with the Hanning window (eq. 6), in two dimensions at once."""
    if samples:
        ramp = np.arange(samples)
        weights = 0.5 * (1 - np.cos(2 * np.pi * ramp / (samples - 1)))
    elif window:
        half = np.arange(0, window / 2 - 1e-9, spacing)
        weights = np.cos(np.pi * np.concatenate([-half[:0:-1], half]) / window) ** 2
    else:
        return image
    return ndimage.convolve(image, np.outer(weights, weights) / weights.sum() ** 2, mode=mode)


def second_features(
    image, top, *, origin="edge", bias=True, slope=np.gradient, between=False, over=1.0
):
    n = len(image)
    row, column = np.unravel_index(image.argmax(), image.shape)
    across, down = image[row], image[:, column]
    at = np.array([column, row], dtype=float)
    if between:
        for i, (profile, index) in enumerate(((across, column), (down, row))):
            if 0 < index < n - 1:
                a, b, _ = np.polyfit([-1, 0, 1], profile[index - 1 : index + 2] / top, 2)
                at[i] -= b / (2 * a)
    scaled = {
        "edge": (at + 1) / n,
        "zero": at / n,
        "centre": (at - (n - 1) / 2) / n,
        "half width": (at - (n - 1) / 2) / ((n - 1) / 2),
    }[origin]
    skews = [stats.skew(slope(profile), bias=bias) for profile in (across, down)]
    return np.array([image.max() / top * over, *scaled, *skews])


def second_angle(shape, n, range_m, motion, step, port=False, bits=None, over=None, **options):
    """Spectral angle by arccos (eq. 13), deg."""
    of_image = ("sigma_deg", "k", "centre", "window", "samples", "mode")
    look = {key: value for key, value in options.items() if key in of_image}
    rest = {key: value for key, value in options.items() if key not in of_image}
    sign = -1 if port else 1
    shift, yaw = (sign * step, 0) if motion == "shift" else (0, sign * step)
    counts = 1000 / second_image(shape, n, [-4.0, 0, 0], 0, **look).max()
    aligned = counts * second_image(shape, n, [-range_m, 0, 0], 0, **look)
    moved = counts * second_image(shape, n, [-range_m, shift, 0], yaw, **look)
    top = aligned.max()
    if bits:
        aligned, moved = np.rint(aligned), np.rint(moved)
    if over:
        rest["over"] = top / over
    u, v = (second_features(image, top, **rest) for image in (aligned, moved))
    return np.degrees(np.arccos(min(u @ v / np.linalg.norm(u) / np.linalg.norm(v), 1)))


# What each other choice is here.
OPTIONS = {
    "as reconstructed": {},
    **{f"beam sigma {deg} deg": {"sigma_deg": deg} for deg in (3, 4, 5, 6, 8)},
    "attenuation 0.05 /m": {"k": 0.05},
    "attenuation 0.2 /m": {"k": 0.2},
    "no blur": {"window": None},
    "blur 0.1 m wide": {"window": 0.1},
    "blur 0.4 m wide": {"window": 0.4},
    "blur of 11 detectors always": {"samples": 11},
    "blur, dark beyond the border": {"mode": "constant"},
    "peak between detectors": {"between": True},
    "column, row from 0": {"origin": "zero"},
    "column, row from the centre": {"origin": "centre"},
    "the same, per half width": {"origin": "half width"},
    "peak over full scale": {"over": 1023},
    "sample skewness": {"bias": False},
    "skewness of differences": {"slope": np.diff},
    "moves to port": {"port": True},
    "yaw about the array": {"centre": 0.4},
    "10 bits": {"bits": 10},
}
