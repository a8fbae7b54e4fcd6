"""Which reading of an image belongs to which detector, measured with a torch.

A torch is moved close to the array, from port to starboard and then from top to bottom. A reading
is brightest when the torch passes its detector, whatever the gain and the torch's other coordinate:
the order of these moments is that of columns, and then of rows, which finds any permutation. Before
a sphere this holds for a torch that follows its surface: detectors at the edge look aside, and see
one that passes straight before the array too early or too late.
"""

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.core.geometry import Array

DARK_S = 1.0  # without the torch, before, between and after the sweeps
ROUNDING = 12**-0.5  # standard deviation of rounding, counts
# The torch is seen where a reading is this many standard deviations above the background, and the
# brightest one this share of full scale.
LIT_SIGMAS, LIT_SHARE = 8.0, 0.02
MIN_IMAGES = 3  # for each column or row

FIRST = "torch off: measuring the background for {:g} s"
SWEEPS = (
    "sweep 1 of 2: move the torch slowly from beyond the port edge (at your right as you face the "
    "array) to beyond the starboard edge, 15 to 30 cm from the array; in front of a sphere, follow "
    "its surface and point the torch at its middle; then switch the torch off",
    "sweep 2 of 2: the same from above the top edge to below the bottom edge; then switch the "
    "torch off",
)
DONE = "both sweeps are complete"


class TorchSweeps:
    """Takes the images of an array one by one until both sweeps are complete.

    The array has `side` rows of as many detectors. The torch is looked for in the sum of several
    lamps' images. `show` is called with a sentence that says what to do next.
    """

    first_dark_s = DARK_S

    def __init__(
        self, side: int, full_scale_counts: float, show: Callable[[str], None] = lambda text: None
    ) -> None:
        self._side, self._full_scale, self._show = side, full_scale_counts, show
        self._recent: deque[tuple[int, Array]] = deque()
        self._dark: list[tuple[int, Array]] = []
        self._sweep: list[tuple[int, Array]] = []
        self._places: list[NDArray[np.intp]] = []  # column of each reading, then its row
        self._background: Array | None = None
        self._lit_ns, self._last_ns, self._rise = 0, 0, 0.0
        show(FIRST.format(self.first_dark_s))

    @property
    def wiring(self) -> list[int] | None:
        """The wiring, as in `ArraySettings`; ``None`` until both sweeps are complete."""
        if len(self._places) < 2:
            return None
        column, row = self._places
        return np.argsort(row * self._side + column).tolist()

    @property
    def complete(self) -> bool:
        """Whether all is seen."""
        return self.wiring is not None

    def take(self, stamp_ns: int, image: Array) -> None:
        """Take one image, its readings as they are wired, ``(L side, side)``; stamps ascend.

        ValueError where a sweep does not separate columns or rows, with what to do about it.
        """
        readings, self._last_ns = self._by_lamp(image), stamp_ns
        if not self._sweep and not self._places:
            self._take_dark(stamp_ns, readings)
        if self._background is None:
            return
        light = readings.sum(axis=0) - self._background
        self._rise = float(light.max())
        if self._rise > self._lit:
            self._sweep.append((stamp_ns, np.maximum(light, 0.0)))
            self._lit_ns = stamp_ns
        elif self._sweep and stamp_ns - self._lit_ns >= DARK_S * 1e9 and self.wiring is None:
            self.end_sweep()

    def _take_dark(self, stamp_ns: int, readings: Array) -> None:
        """Let the darkest `first_dark_s` before the first sweep be the background."""
        self._recent.append((stamp_ns, readings))
        while len(self._recent) > 1 and stamp_ns - self._recent[1][0] >= self.first_dark_s * 1e9:
            self._recent.popleft()
        if stamp_ns - self._recent[0][0] < self.first_dark_s * 1e9:
            return
        dark = np.array([image.sum(axis=0) for _, image in self._recent])
        if self._background is None:
            self._show(SWEEPS[0])
        elif dark.mean() >= self._background.mean():
            return
        self._dark, self._background = list(self._recent), dark.mean(axis=0)
        self._visible = LIT_SIGMAS * max(float(dark.std(axis=0).max()), ROUNDING)
        self._lit = max(self._visible, LIT_SHARE * self._full_scale)

    @property
    def missing(self) -> str:
        """What was not seen so far, and what to look at; empty where all was."""
        if not self._recent:
            return "no image: start the node that publishes them, and compare the topic's name"
        if self._background is None:
            seen = (self._last_ns - self._recent[0][0]) * 1e-9
            return f"the background: {seen:.2g} of {self.first_dark_s:g} s of images were seen"
        if self.wiring is not None:
            return ""
        name = f"sweep {len(self._places) + 1} of 2"
        if self._sweep:
            return f"the end of {name}: the torch was not off for {DARK_S:g} s"
        return (
            f"the torch of {name}: {self._brightest()}; hold it nearer, or check whether the array "
            "has power"
        )

    def _brightest(self) -> str:
        """Say how bright the last image is, and what would be seen."""
        return (
            f"the brightest reading is {self._rise:.3g} counts above the dark; light is seen "
            f"above {self._lit:.3g} counts"
        )

    def _by_lamp(self, image: Array) -> Array:
        return np.reshape(image, (-1, self._side**2))

    def end_sweep(self) -> None:
        """Complete a sweep that has begun, such as where a recording ends."""
        if not self._sweep or self.wiring is not None:
            return
        seconds = np.array([stamp for stamp, _ in self._sweep]) * 1e-9
        light = np.array([image for _, image in self._sweep])
        self._sweep = []
        self._places.append(self._ordered(seconds - seconds[0], light))
        if len(self._places) < 2:
            self._show(SWEEPS[1])
            return
        column, row = self._places
        if len(set(zip(column.tolist(), row.tolist(), strict=True))) < len(column):
            raise ValueError(
                "both sweeps give the same order: sweep from port to starboard first, and then "
                "from top to bottom"
            )
        self._show(DONE)

    def _ordered(self, seconds: Array, light: Array) -> NDArray[np.intp]:
        """Return the column, or row, of each reading by the time when the torch passed it."""
        name, side = ("columns", "rows")[len(self._places)], self._side
        if len(seconds) < MIN_IMAGES * side:
            raise ValueError(
                f"{name}: {len(seconds)} images of the sweep, fewer than {MIN_IMAGES} for each; "
                "move the torch more slowly"
            )
        unlit = np.flatnonzero(light.max(axis=0) <= self._visible)
        if unlit.size:
            raise ValueError(
                f"{name}: the torch is not seen by {unlit.size} of {side * side} readings, the "
                f"first at row {unlit[0] // side}, column {unlit[0] % side} of the image; "
                "pass all detectors, or repair the dead ones"
            )
        weights = light**2  # so that the passing itself counts more than light from far away
        passed = seconds @ (weights / weights.sum(axis=0))
        order = np.argsort(passed)
        groups = passed[order].reshape(side, side)
        spread = float(np.ptp(groups, axis=1).max())
        gap = float((groups[1:, 0] - groups[:-1, -1]).min())
        if gap <= spread:
            raise ValueError(
                f"{name} cannot be separated: the torch passes neighbouring {name} within "
                f"{gap:.2g} s, and the detectors of one of them within {spread:.2g} s; hold the "
                "torch nearer to the array, move it straight and evenly, and beyond both edges"
            )
        places = np.empty(side * side, dtype=np.intp)
        places[order] = np.repeat(np.arange(side), side)
        return places


def description(wiring: Sequence[int], side: int) -> str:
    """Say in words how a wiring, as in `ArraySettings`, changes the image that is sent."""
    places, own = np.reshape(wiring, (side, side)), np.arange(side * side).reshape(side, side)
    known = {
        "in reading order": own,
        "mirrored, port with starboard": own[:, ::-1],
        "mirrored, top with bottom": own[::-1],
        "turned by half a turn": own[::-1, ::-1],
        "turned by a quarter, clockwise": np.rot90(own),
        "turned by a quarter, anticlockwise": np.rot90(own, -1),
        "transposed": own.T,
        "transposed about the other diagonal": own[::-1, ::-1].T,
    }
    for words, order in known.items():
        if np.array_equal(places, order):
            return words
    return f"{np.count_nonzero(places != own)} of {own.size} readings are of other detectors"
