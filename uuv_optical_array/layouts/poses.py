"""The poses of readings of detectors in any layout, where parts of a pose may be known.

Each row is fitted by itself, by maximum a posteriori: the parts of its pose and what the scene's
prior leaves unknown, with the aims of lamp and array. All starts of a row are refined at once.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from uuv_optical_array.calibration.likelihood.aims import appearing
from uuv_optical_array.core.geometry import DOF_NAMES, DOF_UNITS, IN_DEGREES, Array
from uuv_optical_array.estimation.information.likelihood import information
from uuv_optical_array.forward.noise import reading_variance
from uuv_optical_array.forward.prior import GRADIENTS, ROLL
from uuv_optical_array.layouts.detectors import Layout
from uuv_optical_array.layouts.posterior import Row, refine

POSE, AIMS = 6, 4  # coordinates: the pose with its roll, and the aims of lamp and array
GRID = {0: 1, 1: 41, 2: 15, 3: 9, 4: 6, 5: 5}  # starts along each unknown part, by their number
STARTS = 8  # of a row that are refined
COARSE = 0.3  # by which the light of a start may be off, relative
APART, AS_GOOD = 16.0, 4.6  # squared distance of two answers, and cost, that leave both open
UNKNOWN_SHARE = 0.29  # of the table's span, the spread of an even distribution: it says no more


class Fitted(NamedTuple):
    """The pose of a row, ``(5,)``, its covariance, misfit, and why there is none, or nothing."""

    pose: Array
    covariance: Array
    misfit: float
    reason: str


class PoseFit:
    """The fit of poses in a layout's scene; `max_misfit` as of `EstimatorSettings`."""

    def __init__(self, layout: Layout, max_misfit: float) -> None:
        self._layout, self._model = layout, layout.model()
        self._max_misfit = max_misfit
        # What starts were last asked for, and their light: often the same for every row.
        self._seen: tuple[Array, Array] | None = None
        scene = layout.scene
        prior = scene.prior
        stds = scene.nuisance_std()
        self._names = [
            n for n in stds if n in self._model.nuisances and n not in {*GRADIENTS, ROLL}
        ]
        aims = np.radians([prior.lamp_aim_std_deg] * 2 + [prior.aim_std_deg] * 2)
        self._stds = np.array([*aims, *(stds[name] for name in self._names)])
        self._lamps = scene.lamp_count
        faults = scene.effects.get("detector_faults", {}).get("dead", ())
        works = np.ones(self._model.array.side**2, dtype=bool)
        works[[row * self._model.array.side + column for row, column in faults]] = False
        self._works = np.tile(works, self._lamps)
        table = scene.table
        spans = [table.x_m, table.y_m, table.z_m]
        degrees = [table.pitch_deg, table.yaw_deg]
        self._low, self._high = np.array(
            [
                *((span.start, span.stop) for span in spans),
                *((np.radians(span.start), np.radians(span.stop)) for span in degrees),
            ]
        ).T

    def fit(self, images: Array, poses: Array, stds: Array, rolls: Array) -> list[Fitted]:
        """Return the pose of each image; arguments as of `Told`, with nan where a part is unknown.

        Unknown parts are sought over the span of the scene's table, and accepted beyond it as far
        as the light determines them.
        """
        rows = zip(images, poses, stds, rolls.tolist(), strict=True)
        return [self.one(*row) for row in rows]

    def one(self, image: Array, pose: Array, std: Array, roll: float) -> Fitted:
        """Return the pose of one image, as `fit` does."""
        readings = image.reshape(-1)
        unknown = np.isnan(pose)
        middle, span = (self._low + self._high) / 2, self._high - self._low
        mean = np.append(np.where(unknown, middle, pose), roll)
        wide = np.where(unknown, np.maximum(span, 1e-3), std)
        roll_std = np.radians(self._layout.scene.prior.roll_std_deg) if self._lamps > 1 else 0.0
        scale = np.concatenate([wide, [roll_std], self._stds])
        nothing = Fitted(np.full(5, np.nan), np.full((5, 5), np.nan), np.nan, "")
        noise = self._model.noise
        lit = readings[self._works] - noise.black
        if not (lit > 3 * np.sqrt(max(noise.variance, 1e-12))).any():
            return nothing._replace(reason=f"no light: the brightest detector reads {lit.max():g}")
        starts = self._starts(readings, mean, unknown)
        at: Array = np.zeros((len(starts), len(scale)))
        np.divide(starts - mean[:5], wide, out=at[:, :5])
        at, costs, hessian, squares = self._refined(readings, mean, scale, at)
        best = int(costs.argmin())
        covariance = np.linalg.inv(hessian[best]) * np.outer(scale, scale)
        found, own = mean[:5] + at[best, :5] * wide, covariance[:5, :5]
        own = 0.5 * (own + own.T) + np.diag(np.full(5, 1e-12))
        spread = np.sqrt(own.diagonal())
        told = [
            f"{DOF_NAMES[i]} to {spread[i] * IN_DEGREES[i]:.2g} {DOF_UNITS[i]}"
            for i in np.flatnonzero(unknown & (spread > UNKNOWN_SHARE * span))
        ]
        if told:
            return nothing._replace(reason=f"not determined by these detectors: {', '.join(told)}")
        off = mean[:5] + at[:, :5] * wide - found
        far = np.einsum("ki,ij,kj->k", off, np.linalg.inv(own), off)
        if (also := (far > APART) & (costs < costs[best] + AS_GOOD)).any():
            other = found + off[int(np.flatnonzero(also)[0])]
            where = ", ".join(
                f"{DOF_NAMES[i]} {other[i] * IN_DEGREES[i]:.3g} {DOF_UNITS[i]}"
                for i in np.flatnonzero(unknown)
            )
            return nothing._replace(reason=f"ambiguous: the light fits as well at {where}")
        freedoms, square = squares[best]
        freedoms -= int(unknown.sum())
        misfit = float(chdtrc(freedoms, square)) if freedoms > 0 else np.nan
        if misfit < self._max_misfit:
            return nothing._replace(misfit=misfit, reason="outlier: residuals too large")
        return Fitted(found, own, misfit, "")

    def _starts(self, readings: Array, mean: Array, unknown: NDArray[np.bool_]) -> Array:
        """Return poses of like light, the likeliest first, apart from each other, ``(k, 5)``."""
        which = np.flatnonzero(unknown)
        count = GRID[len(which)]
        axes = [np.linspace(self._low[i], self._high[i], count) for i in which]
        poses: Array = np.tile(mean[:5], (count ** len(which), 1))
        poses[:, which] = np.array(list(product(*axes)))
        noise, asked = self._model.noise, np.append(mean, unknown)
        if self._seen is None or not np.array_equal(self._seen[0], asked):
            self._seen = asked, self._model.light(poses, float(mean[5])).reshape(len(poses), -1)
        light = self._seen[1]
        variance = reading_variance(light, noise) + (COARSE * (light - noise.black)) ** 2
        square = (readings - light) ** 2 / variance + np.log(variance)
        order = np.argsort((square * self._works).sum(axis=1))
        step = np.maximum((self._high - self._low)[which] / max(count - 1, 1), 1e-9)
        chosen: list[int] = []
        for i in order[: 50 * STARTS].tolist():
            cells = np.abs(poses[chosen][:, which] - poses[i, which]) / step
            if not len(cells) or not (cells.max(axis=1, initial=0.0) < 1.5).any():
                chosen.append(i)
            if len(chosen) == STARTS:
                break
        return np.asarray(poses[chosen])

    def _light(self, at: Array, mean: Array, scale: Array) -> tuple[Array, Array]:
        """Return the light at coordinates in standard deviations, ``(k, n)``, and its slopes."""
        values = at * scale
        poses, rolls = mean[:5] + values[:, :5], mean[5] + values[:, 5]
        aims, offsets = values[:, POSE : POSE + AIMS], values[:, POSE + AIMS :]
        seen, seen_rolls, by_seen = appearing(poses, rolls, aims, self._layout.scene.array.bow_m)
        turned = {ROLL: np.zeros(len(at))} if self._layout.scene.lamps else {}
        named = {name: offsets[:, i] for i, name in enumerate(self._names)}
        light, slopes = self._model.linearised(seen, seen_rolls, {**turned, **named})
        motions = 5 + len(turned)
        by_given = slopes[..., :motions] @ by_seen[:, :motions]
        return light, np.concatenate([by_given, slopes[..., motions:]], axis=-1) * scale

    def _refined(
        self, readings: Array, mean: Array, scale: Array, at: Array
    ) -> tuple[Array, Array, Array, list[tuple[int, float]]]:
        """Return coordinates of minima, their costs, Hessians, and freedoms with squares."""
        noise, works = self._model.noise, self._works
        row = Row(readings, works, noise, scale, mean, self._light)
        state = refine(row, at.T)
        at, light = state.at.T, state.light.T
        variance = reading_variance(light, noise)
        inside = (readings > noise.low) & (readings < noise.high) & works
        square = ((readings - light) ** 2 / variance * inside).sum(axis=1) + (at**2).sum(axis=1)
        sharp = information(light, noise) * works
        _, slopes = self._light(at, mean, scale)
        hessian = np.einsum("knp,knq->kpq", slopes * sharp[..., None], slopes) + np.eye(len(scale))
        return at, state.cost, hessian, [(int(inside.sum()), float(each)) for each in square]
