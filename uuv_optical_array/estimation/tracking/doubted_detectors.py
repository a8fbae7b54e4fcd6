"""Detectors that recently read something other than the light.

Dirt, the hull's shadow or a dead detector last, and far from the lamp a single image does not
always show them. Their readings are then off in the same way in many images, and a track becomes
sure of it. So a detector that one image rejected has little weight in the track for a while: by our
choice that fades in the alarm's window. The weight is the squared probability that it is sound, as
what is left of a fault adds up from image to image.
"""

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.estimation.tracking.mismatch import WINDOW_S
from uuv_optical_array.estimation.unknowns.constants import drift


class DoubtedDetectors:
    """Remembers which readings of a track's images were not believed."""

    def __init__(self) -> None:
        self._doubts: Array = np.zeros(1)
        self._stamp_ns = 0

    def trust(self, stamp_ns: int, believed: Array) -> Array:
        """Return how far readings are believed by the images before, and take one more.

        - stamp_ns: of the image, ns.
        - believed: its readings by itself, from 0 to 1, shape ``(n,)``.
        - returned: from 0 to 1, shape ``(n,)``.
        """
        before = drift(WINDOW_S, abs(stamp_ns - self._stamp_ns) * 1e-9) * self._doubts
        self._doubts, self._stamp_ns = np.maximum(before, 1 - believed), stamp_ns
        return np.square(np.ones(len(believed)) - before)
