"""Which reading of an image is which detector, found with a torch.

A torch is moved close before the array, from port to starboard and then from top to bottom. Each
reading is brightest when the torch passes its detector, whatever the detector's gain and the other
coordinate of the torch: the order of these moments is that of columns, and then of rows. Any
permutation is found so, mirrored, turned and transposed arrays among them.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import Array

DARK_S = 1.0  # without the torch, before and between the sweeps and after
ROUNDING = 12**-0.5  # counts, standard deviation of whole ones
# What is the torch's light: this far above the noise in each reading, and this share of full scale
# in the brightest.
LIT_SIGMAS, LIT_SHARE = 8.0, 0.02
LEAST_IMAGES = 3  # for each column or row

FIRST = "torch off: measuring the background"
SWEEPS = (
    "sweep 1 of 2: move the torch, a hand or two before the array, slowly from beyond its port "
    "edge, at your right as you face it, to beyond its starboard edge; then switch it off",
    "sweep 2 of 2: the same from above the top edge to below the bottom edge; then switch it off",
)
DONE = "both sweeps seen"


class TorchSweeps:
    """Takes the images of an array one by one until it has seen both sweeps.

    Parameters
    ----------
    side
        Detectors in a row.
    full_scale_counts
        Largest reading.
    tell
        Told what to do next, in a sentence.
    """

    def __init__(
        self, side: int, full_scale_counts: float, tell: Callable[[str], None] = lambda text: None
    ) -> None:
        self._side, self._full_scale, self._tell = side, full_scale_counts, tell
        self._dark: list[tuple[int, Array]] = []
        self._sweep: list[tuple[int, Array]] = []
        self._places: list[NDArray[np.intp]] = []  # column of each reading, then its row
        self._background: Array | None = None
        self._lit_ns = 0
        tell(FIRST)

    @property
    def wiring(self) -> list[int] | None:
        """The wiring, as `ArraySettings` has it; ``None`` until both sweeps are over."""
        if len(self._places) < 2:
            return None
        column, row = self._places
        return np.argsort(row * self._side + column).tolist()

    def take(self, stamp_ns: int, image: Array) -> None:
        """Take one image.

        Parameters
        ----------
        stamp_ns
            Ascending, ns.
        image
            Readings as they are wired, counts, shape ``(side, side)``.

        Raises
        ------
        ValueError
            Where a sweep does not tell columns or rows apart, with what to do about it.
        """
        readings = np.ravel(image)
        if self._background is None:
            self._dark.append((stamp_ns, readings))
            if stamp_ns - self._dark[0][0] >= DARK_S * 1e9:
                dark = np.array([each for _, each in self._dark])
                self._seen = LIT_SIGMAS * max(float(dark.std(axis=0).max()), ROUNDING)
                self._lit = max(self._seen, LIT_SHARE * self._full_scale)
                self._background = dark.mean(axis=0)
                self._tell(SWEEPS[0])
            return
        light = readings - self._background
        if light.max() > self._lit:
            self._sweep.append((stamp_ns, np.maximum(light, 0.0)))
            self._lit_ns = stamp_ns
        elif self._sweep and stamp_ns - self._lit_ns >= DARK_S * 1e9 and self.wiring is None:
            self.end_sweep()

    def end_sweep(self) -> None:
        """Count the sweep as over that is on its way, if any, as a recording that ends does."""
        if not self._sweep or self.wiring is not None:
            return
        seconds = np.array([stamp for stamp, _ in self._sweep]) * 1e-9
        light = np.array([each for _, each in self._sweep])
        self._sweep = []
        self._places.append(self._ordered(seconds - seconds[0], light))
        if len(self._places) < 2:
            self._tell(SWEEPS[1])
            return
        column, row = self._places
        if len(set(zip(column.tolist(), row.tolist(), strict=True))) < len(column):
            raise ValueError(
                "both sweeps tell the same order apart: sweep from port to starboard first, and "
                "then from top to bottom"
            )
        self._tell(DONE)

    def _ordered(self, seconds: Array, light: Array) -> NDArray[np.intp]:
        """Return the column, or row, of each reading by when the torch passed it."""
        what, side = ("columns", "rows")[len(self._places)], self._side
        if len(seconds) < LEAST_IMAGES * side:
            raise ValueError(
                f"{what}: {len(seconds)} images of the sweep, fewer than {LEAST_IMAGES} for each; "
                "move the torch more slowly"
            )
        unseen = np.flatnonzero(light.max(axis=0) <= self._seen)
        if unseen.size:
            raise ValueError(
                f"{what}: the torch is not seen by {unseen.size} of {side * side} readings, the "
                f"first at row {unseen[0] // side}, column {unseen[0] % side} of the image; "
                "pass all detectors, or mend what is dead"
            )
        weights = light**2  # the moment of passing counts more than what is seen from afar
        passed = seconds @ (weights / weights.sum(axis=0))
        order = np.argsort(passed)
        groups = passed[order].reshape(side, side)
        spread = float(np.ptp(groups, axis=1).max())
        gap = float((groups[1:, 0] - groups[:-1, -1]).min())
        if gap <= spread:
            raise ValueError(
                f"{what}: they cannot be told apart, as the torch passes neighbours within "
                f"{gap:.2g} s and those of one within {spread:.2g} s; hold it nearer to the array, "
                "move it straight and evenly, and well beyond both edges"
            )
        places = np.empty(side * side, dtype=np.intp)
        places[order] = np.repeat(np.arange(side), side)
        return places


def description(wiring: Sequence[int], side: int) -> str:
    """Say in words what a wiring does to the image that is sent.

    Parameters
    ----------
    wiring
        As `ArraySettings` has it.
    side
        Detectors in a row.
    """
    found, own = np.reshape(wiring, (side, side)), np.arange(side * side).reshape(side, side)
    known = {
        "as it should be": own,
        "mirrored, port with starboard": own[:, ::-1],
        "mirrored, top with bottom": own[::-1],
        "turned by half a turn": own[::-1, ::-1],
        "turned by a quarter, clockwise": np.rot90(own),
        "turned by a quarter, anticlockwise": np.rot90(own, -1),
        "transposed": own.T,
        "transposed about the other diagonal": own[::-1, ::-1].T,
    }
    for words, places in known.items():
        if np.array_equal(found, places):
            return words
    return f"{np.count_nonzero(found != own)} of {own.size} readings are of other detectors"
