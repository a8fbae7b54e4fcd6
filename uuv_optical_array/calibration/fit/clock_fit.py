"""The step of the clocks' offset from the fit of a calibration."""

import numpy as np

from uuv_optical_array.calibration.fit.fit import CalibrationFit
from uuv_optical_array.calibration.likelihood.expected_light import POSE
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.information.likelihood import information, log_likelihood

BLOCK_READINGS = 10_000
LEAST_INFORMATION = 1e-9  # of the offset beside all else, relative to its own


def offset_step(fit: CalibrationFit, rates: Array) -> tuple[float, float]:
    """Return the Gauss-Newton step of the offset, s, and its standard error; inf: undetermined.

    Rates are those of poses and rolls, m/s and rad/s, shape ``(m, 6)``.
    """
    likelihood, (values, shifts) = fit.likelihood, fit.state.at
    layout, first = likelihood.layout, likelihood.layout.gains
    basis = layout.free_directions(fit.held() | fit.at_bound)
    detectors = len(values) - first
    lamps = likelihood.readings.shape[1] // detectors
    gains, own = np.tile(np.exp(values[first:]), lamps), np.tile(np.eye(detectors), (lamps, 1))
    size, moves = basis.shape[1] + 1, shifts.shape[1] if likelihood.pose_std is not None else 0
    joint, score = np.zeros((size, size)), np.zeros(size)
    inner = np.zeros((len(shifts), moves, moves))
    cross, pull = np.zeros((len(shifts), size, moves)), np.zeros((len(shifts), moves))
    count, pixels = likelihood.readings.shape
    block = max(1, BLOCK_READINGS // pixels)
    for start in range(0, count, block):
        part = slice(start, start + block)
        places = likelihood.places[part]
        poses = likelihood.poses[part] + shifts[places, :5]
        rolls = likelihood.rolls[part] + shifts[places, 5:].sum(axis=1)
        light, slopes = likelihood.light(values, poses, rolls)
        mean, slopes = light * gains, slopes * gains[:, None]
        _, by_mean, _ = log_likelihood(likelihood.readings[part], mean, likelihood.noise)
        used = likelihood.used[part]
        by_mean, weight = by_mean * used, information(mean, likelihood.noise) * used
        by_all = slopes[..., POSE:] @ basis[:first] + mean[..., None] * (own @ basis[first:])
        by_clock = (slopes[..., :POSE] @ rates[part][:, :, None])[..., 0]
        rows = np.concatenate([by_all, by_clock[..., None]], axis=-1)
        weighed = rows * weight[..., None]
        joint += np.einsum("mni,mnj->ij", weighed, rows)
        score += np.einsum("mni,mn->i", rows, by_mean)
        if moves:
            by_shift = slopes[..., :moves]
            np.add.at(inner, places, np.swapaxes(by_shift * weight[..., None], 1, 2) @ by_shift)
            np.add.at(cross, places, np.swapaxes(weighed, 1, 2) @ by_shift)
            np.add.at(pull, places, (by_mean[:, None, :] @ by_shift)[:, 0])
    if moves and likelihood.pose_std is not None:
        precision = likelihood.pose_std**-2.0
        inverse = np.linalg.inv(inner + precision[:, None] * np.eye(moves))
        eliminated = cross @ inverse
        joint -= np.einsum("kis,kjs->ij", eliminated, cross)
        score -= np.einsum("kis,ks->i", eliminated, pull - shifts * precision)
    taped = basis[likelihood.taped] / likelihood.tape_std_m
    joint[:-1, :-1] += taped.T @ taped
    # At the fit the score of all else is 0, so the offset's own step is left.
    others = joint[:-1, -1] @ np.linalg.pinv(joint[:-1, :-1], hermitian=True)
    left = float(joint[-1, -1] - others @ joint[:-1, -1])
    if left <= LEAST_INFORMATION * max(joint[-1, -1], 1e-300):
        return 0.0, float(np.inf)
    step = float(score[-1] - others @ score[:-1]) / left
    return step, float(np.sqrt(max(1.0, fit.agreement.misfit) / left))
