"""Whether daylight alone explains an image, so that it shows no lamp."""

import numpy as np
from scipy.special import chdtri

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.daylight import without_lamps
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.noise import reading_variance
from uuv_optical_array.forward.prior import DAYLIGHT

# Share of images of daylight that are so odd that something else seems to shine.
ODD_DAYLIGHT = 1e-4


class Daylight:
    """Daylight of a scene as its prior knows it: Gaussian, of a variance ``noise + slopes^2``."""

    def __init__(self, model: ForwardModel) -> None:
        scene, stds = model.scene, model.scene.nuisance_std()
        names = [name for name in DAYLIGHT if name in stds]
        self._light, slopes = without_lamps(model, names)
        spread = np.array([stds[name] for name in names]).reshape(-1, 1) * slopes
        # Few directions in which an image differs by more than noise.
        directions, sizes, _ = np.linalg.svd(spread.T, full_matrices=False)
        self._directions, self._variances = directions.T, np.square(sizes)
        self._own = np.square(spread).sum(axis=0).max(initial=0.0)
        gains = scene.prior.spread**2 + model.analogue_noise.square
        self._noise = model.noise._replace(square=gains)
        self._most = float(chdtri(len(self._light), ODD_DAYLIGHT))

    def explains(self, image: Array) -> bool:
        """Say whether `ODD_DAYLIGHT` or more of daylight's images are as odd as one, counts."""
        brightest, most = float(image.max()), self._most
        over = max(brightest - float(self._light.max()), 0.0)
        # No image is more probable than its brightest reading is by itself.
        if over * over > most * (float(reading_variance(brightest, self._noise)) + self._own):
            return False
        off = image.ravel() - self._light
        noise = float(reading_variance(float(image.mean()), self._noise))
        along = np.square(self._directions @ off)
        known = float(along @ (self._variances / (noise + self._variances)))
        return bool(float(off @ off) - known <= most * noise)
