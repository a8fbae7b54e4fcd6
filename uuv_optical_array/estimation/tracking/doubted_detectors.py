"""Detectors that lately read something else than the light.

Dirt, the hull's shadow or a dead detector last, and from afar an image by itself does not always
tell them. What it takes for light then is off in the same way in many images, and a track becomes
sure of it. So a detector that one image did not believe is hardly believed by the track for long.
"""

import math

import numpy as np

from uuv_optical_array.core.geometry import Array

LASTS_S = 30.0  # in which a doubt fades, by our choice as long as the alarm's window
FORGOTTEN = 0.01  # probability below which there is no doubt


class DoubtedDetectors:
    """Remembers which readings of a track's images were not believed."""

    def __init__(self) -> None:
        self._doubts: Array | None = None
        self._stamp_ns = 0

    def trust(self, stamp_ns: int, believed: Array) -> Array | None:
        """Return how far readings are believed by the images before, and take one more.

        - stamp_ns: of the image, ns.
        - believed: its readings by itself, from 0 to 1, shape ``(n,)``.
        - returned: from 0 to 1, shape ``(n,)``; ``None``: all are.
        """
        before, since_s = self._doubts, abs(stamp_ns - self._stamp_ns) * 1e-9
        if before is not None:
            before = math.exp(-since_s / LASTS_S) * before
        doubts = 1 - believed if before is None else np.maximum(before, 1 - believed)
        self._doubts, self._stamp_ns = doubts if doubts.max() > FORGOTTEN else None, stamp_ns
        return None if before is None else 1 - before
