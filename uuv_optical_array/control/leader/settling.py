"""When poses are believed: light that comes back may be false, so they have to agree for a time."""

import math


class Settling:
    """Whether poses of a light have settled.

    They have once they agree for long enough, more than half of the images since the first have
    given one, and none came too late after the one before. A pose of an image that had come before
    the last pose did is of an estimator that is busy: it left out what else came meanwhile, which
    does not count against the light.
    """

    def __init__(self) -> None:
        self._stamps: list[float] = []  # of the poses that agree
        self._images_since_first = 0
        self._images_since_last = 0
        self._image_s = -math.inf
        self._heard_s = -math.inf  # stamp of the newest image as the last pose came

    def look(self, stamp_s: float) -> None:
        """Note that an image was taken, s."""
        self._image_s = stamp_s
        self._images_since_last += 1

    def clear(self) -> None:
        """Begin anew with the next pose."""
        self._stamps.clear()

    def take(self, stamp_s: float, timeout_s: float, settle_s: float) -> bool:
        """Take a pose, s, that agrees with those before; say whether they have settled.

        - timeout_s: from one pose to the next, at most.
        - settle_s: from the first to the last, at least.
        """
        stamps = self._stamps
        if stamps and not 0 <= stamp_s - stamps[-1] <= timeout_s:
            stamps.clear()
        of = 1 if stamp_s <= self._heard_s else self._images_since_last
        self._images_since_first = self._images_since_first + of if stamps else 1
        self._images_since_last, self._heard_s = 0, self._image_s
        stamps.append(stamp_s)
        of_most_images = 2 * len(stamps) > self._images_since_first
        return of_most_images and stamp_s - stamps[0] >= settle_s
