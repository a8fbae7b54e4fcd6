"""Light that no single image shows, by the images of some seconds.

Of the images that show no light one mean follows the newest and another lags behind. What they
differ by is light that came: daylight, its slope over the array, dark readings and unequal gains
are in both, unless the array turns in daylight that comes from one side. Its part that is smooth
over the array, but not the same everywhere, is tested against the noise that the images themselves
show.
"""

import math

import numpy as np
from scipy.special import chdtri

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.signature.daylight import ODD_DAYLIGHT

# Time constants of the two means, s: of what a follower that searches sees while it moves little,
# and of what was before.
NEW_S, BEFORE_S = 1.5, 30.0
MOST_GAP_S = 2.0  # between two images, beyond which the means begin anew
ROUNDING = 1 / 12  # variance of whole counts, counts^2


class FaintLight:
    """Light in images of ``side * side`` readings that show none by themselves."""

    def __init__(self, side: int) -> None:
        across = np.linspace(-1.0, 1.0, side)
        down, along = (axis.ravel() for axis in np.meshgrid(across, across, indexing="ij"))
        bowl = along**2 + down**2
        shapes = np.stack([along, down, bowl - bowl.mean()])
        self._shapes = shapes / np.linalg.norm(shapes, axis=1, keepdims=True)
        self._side, self._most = side, float(chdtri(len(shapes), ODD_DAYLIGHT))
        self.clear()

    def clear(self) -> None:
        """Begin anew with the next image."""
        self._stamp_s = math.nan
        self._count = 0
        self._means = np.zeros((2, self._side**2))
        self._spread = np.zeros((2, 2))  # covariance of both means, in variances of a reading
        self._variance = 0.0  # of a reading

    def look(self, stamp_s: float, image: Array) -> Array | None:
        """Take an image without light, counts, ``(side, side)``; return the light that came.

        It is smooth, counts, >= 0, ``(side, side)``; ``None`` where noise explains it:
        once in 10,000 images.
        """
        since_s = stamp_s - self._stamp_s
        if not 0 < since_s <= MOST_GAP_S:
            self.clear()
        self._stamp_s, self._count = stamp_s, self._count + 1
        if self._count == 1:
            self._means[:] = image.ravel()
            self._spread[:] = 1.0
            return None
        off = image.ravel() - self._means
        gains = np.maximum(1 / self._count, -np.expm1(-since_s / np.array([NEW_S, BEFORE_S])))
        scatter = float(np.square(off[1]).mean())
        share = max(1 / (self._count - 1), float(gains[1]))
        self._variance += share * (scatter - self._variance)
        self._means += gains[:, None] * off
        kept = 1 - gains
        self._spread[:] = np.outer(kept, kept) * self._spread + np.outer(gains, gains)
        (new, both), (_, before) = self._spread
        noise = max(self._variance, ROUNDING) * (new + before - 2 * both)
        came = self._means[0] - self._means[1]
        amounts = self._shapes @ came
        if came.sum() <= 0 or float(amounts @ amounts) <= self._most * noise:
            return None
        return np.maximum(came.mean() + amounts @ self._shapes, 0.0).reshape(image.shape)
