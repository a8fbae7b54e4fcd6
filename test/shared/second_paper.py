"""A second implementation of Eren et al. (2016): x ahead, y to starboard, z down."""

import functools

import numpy as np
import second_forward
from scipy import ndimage, stats


def second_image(shape, n, at, yaw_deg, window=0.2):
    """Light on n x n detectors; `at` is the centre of mass, the lamp at the origin shines aft."""
    light = unit_light(shape, n, *map(float, at), float(yaw_deg))
    return second_blur(light, 0.4 / (n - 1), window)


@functools.cache
def unit_light(shape, n, x, y, z, yaw_deg):
    """Light of a lamp of unit power, by the second forward model: y to port, z up."""
    array = {"shape": shape, "detectors_per_side": n, "width_m": 0.4, "bow_m": 0.4}
    scene = {"lamp": {"beam_sigma_deg": 4.5}, "array": {**array, "radius_m": 0.32}}
    pose = (x, -y, -z, 0.0, -np.radians(yaw_deg))
    return second_forward.image_of(scene, 1.0, {"attenuation": {"k_per_m": 0.1}}, pose)


def second_blur(image, spacing, window):
    """Convolve with the Hanning window (eq. 6), in two dimensions at once."""
    if not window:
        return image
    half = np.arange(0, window / 2 - 1e-9, spacing)
    weights = np.cos(np.pi * np.concatenate([-half[:0:-1], half]) / window) ** 2
    return ndimage.convolve(image, np.outer(weights, weights) / weights.sum() ** 2)


def second_features(image, top, between=False):
    n = len(image)
    row, column = np.unravel_index(image.argmax(), image.shape)
    across, down = image[row], image[:, column]
    at = np.array([column, row], dtype=float)
    if between:
        for i, (profile, index) in enumerate(((across, column), (down, row))):
            if 0 < index < n - 1:
                a, b, _ = np.polyfit([-1, 0, 1], profile[index - 1 : index + 2] / top, 2)
                at[i] -= b / (2 * a)
    skews = [stats.skew(np.gradient(profile)) for profile in (across, down)]
    return np.array([image.max() / top, *(at + 1) / n, *skews])


def second_angle(shape, n, range_m, motion, step, port=False, window=0.2):
    """Spectral angle by arccos (eq. 13), deg."""
    sign = -1 if port else 1
    shift, yaw = (sign * step, 0) if motion == "shift" else (0, sign * step)
    counts = 1000 / second_image(shape, n, [-4.0, 0, 0], 0, window).max()
    aligned = counts * second_image(shape, n, [-range_m, 0, 0], 0, window)
    moved = counts * second_image(shape, n, [-range_m, shift, 0], yaw, window)
    u, v = (second_features(image, aligned.max()) for image in (aligned, moved))
    return np.degrees(np.arccos(min(u @ v / np.linalg.norm(u) / np.linalg.norm(v), 1)))
