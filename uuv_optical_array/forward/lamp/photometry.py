"""The beam of a lamp from its photometric file, as a sum of up to three Gaussians.

They are fitted to the mean of the file's planes, weighted by the solid angle, out to `REACH`
half-widths. Beyond, there is little light for a pose.
"""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.lamp.beam import WIDEST_DEG, dark_angle
from uuv_optical_array.forward.lamp.photometric_files import Photometry, read

REACH = 2.2  # half-widths
LARGEST_RMS = 10.0  # of 1000 on the axis: beyond it poses would be false more than wide
ENOUGH_RMS = 0.3  # of 1000: further Gaussians would fit nothing, with weights that cancel out
LEAST_RATIO = 1.3  # of two widths: nearer ones have large weights that cancel out
WIDEST = 1.9  # half-widths: a wider Gaussian shines beyond the reach, where the lamp does not
POINTS = 100  # of the fit
BEAM = "beam_sigma_deg", "beam_widths", "beam_weights"  # keys of a lamp that a file stands for


class FittedBeam(NamedTuple):
    """Gaussians that were fitted to a photometric file.

    - sigma_deg: standard deviation of the Gaussian of the same half-width, deg.
    - widths, weights: as `beam.LampSettings` has them.
    - rms: of the residual, of 1000 on the axis, out to reach_deg.
    - planes_rms: by how much the planes differ from their mean, likewise.
    - on_axis: their light over that of the file, on the axis; elsewhere it is nearer to 1.
    """

    sigma_deg: float
    widths: list[float]
    weights: list[float]
    rms: float
    planes_rms: float
    reach_deg: float
    on_axis: float

    def settings(self) -> dict[str, Any]:
        """Return what a scene's lamp says of it."""
        if len(self.widths) == 1:
            return {"beam_sigma_deg": round(self.sigma_deg * self.widths[0], 3)}
        shape = {"beam_widths": self.widths, "beam_weights": self.weights}
        return {"beam_sigma_deg": self.sigma_deg, **shape}

    def text(self) -> str:
        """Return how well it fits, in a sentence."""
        many = len(self.widths)
        count = f"{many} Gaussians are" if many > 1 else "one Gaussian is"
        return (
            f"{count} within {self.rms:.1f} of 1000 (rms out to "
            f"{self.reach_deg:.1f} deg) of the file, whose planes differ by {self.planes_rms:.0f}"
        )


def with_photometry(lamp: Any) -> Any:
    """Return a scene's lamp, as plain values, with the beam of its photometric file, if it has one.

    ValueError as `read` and `fitted`, for a file that is not there, or a beam that is given twice.
    """
    file = lamp.get("photometry") if isinstance(lamp, dict) else None
    if file is None:
        return lamp
    for key in BEAM:
        if lamp.get(key) is not None:
            raise ValueError(
                f"lamp.photometry: given together with {key}, which it replaces; give one of them"
            )
    if not isinstance(file, str):
        raise ValueError(f"lamp.photometry: {file!r} is not a text; give a file, .ies or .ldt")
    try:
        beam = fitted(read(Path(file)))
    except (OSError, ValueError) as error:
        raise ValueError(f"lamp.photometry: {file}: {error}") from None
    return {**{k: v for k, v in lamp.items() if k != "photometry"}, **beam.settings()}


class Points(NamedTuple):
    """Angles off the axis at which a beam is fitted, out to the reach, shape ``(k,)`` each.

    - angles_deg: from 0 on, deg.
    - wanted: mean light of the file's planes there, 1 on the axis.
    - root: square roots of weights by the solid angle, 1 in all.
    """

    angles_deg: Array
    wanted: Array
    root: Array

    def weights_of(self, sigmas_deg: Array) -> tuple[Array, float]:
        """Return weights of Gaussians that fit best, and the rms of their residual, of 1000."""
        rows = np.exp(-0.5 * (self.angles_deg[:, None] / sigmas_deg) ** 2)
        weighed = rows * self.root[:, None], self.wanted * self.root
        found = np.asarray(np.linalg.lstsq(*weighed, rcond=None)[0], dtype=float)
        return found, 1000 * float(np.linalg.norm((rows @ found - self.wanted) * self.root))


def points_of(file: Photometry) -> Points:
    """Return the points at which a beam is fitted to a file."""
    angles = np.linspace(0, min(REACH * file.half_width_deg, file.angles_deg[-1], 90.0), POINTS)
    root = np.sqrt(np.sin(np.radians(angles)) + 1e-9)
    root /= math.sqrt(float(np.sum(root**2)))
    return Points(angles, np.interp(angles, file.angles_deg, file.mean), root)


def fitted(file: Photometry) -> FittedBeam:
    """Fit up to three Gaussians to what a file says, as few as are enough.

    ValueError where they do not come within `LARGEST_RMS`.
    """
    # Imported here because it takes a tenth of a second, which nodes need not spend.
    from scipy.optimize import minimize

    half, points = file.half_width_deg, points_of(file)
    angles, reach = points.angles_deg, points.angles_deg[-1]
    least, most = 0.25 * half, min(WIDEST * half, WIDEST_DEG)

    def sigmas_of(at: Array) -> Array:
        """Return widths that are in order and apart, by unbounded numbers."""
        steps = math.log(LEAST_RATIO) + np.exp(np.minimum(at[1:], 3.0))
        sigmas: Array = np.exp(at[0] + np.append(0.0, np.cumsum(steps)))
        return np.clip(sigmas, least, most)

    def cost(at: Array) -> float:
        sigmas = sigmas_of(at)
        weights, rms = points.weights_of(sigmas)
        outside = 1e3 if weights.sum() <= 0 or _dark(weights, sigmas) else 0.0
        return rms + outside

    firsts, steps = np.log(np.multiply((0.3, 0.5, 0.8), half)), np.log((0.1, 0.5))
    starts = [np.array([first]) for first in firsts]
    for more in (1, 2):
        starts += [np.array([first, *[step] * more]) for first in firsts for step in steps]
    best: tuple[float, Array] = math.inf, np.zeros(0)
    for at in starts:
        if best[0] < ENOUGH_RMS and len(at) > len(best[1]):
            break
        options = {"maxiter": 400, "xatol": 1e-4, "fatol": 1e-3}
        found = minimize(cost, at, method="Nelder-Mead", options=options)
        if found.fun < best[0]:
            best = float(found.fun), sigmas_of(found.x)
    rms, sigmas = best
    if rms > LARGEST_RMS:
        raise ValueError(
            f"its beam differs by {rms:.0f} of 1000 (rms out to {reach:.1f} deg) from every sum of "
            f"three Gaussians, of which {LARGEST_RMS:g} are allowed; its edge is too sharp, so "
            "take a diffuser, or a lamp with a softer beam"
        )
    weights, _ = points.weights_of(sigmas)
    sigma = round(half / math.sqrt(2 * math.log(2)), 3)
    planes = np.array([np.interp(angles, file.angles_deg, row) for row in file.intensities])
    scale = float(file.shares @ file.intensities[:, 0])
    off = (planes / scale - points.wanted) * points.root
    apart = 1000 * math.sqrt(float(file.shares @ np.sum(off**2, axis=1)))
    shares = (weights / weights.sum()).round(4)
    shares[-1] = round(1 - shares[:-1].sum(), 4)
    widths = (sigmas / sigma).round(4).tolist()
    on_axis = float(weights.sum())
    return FittedBeam(sigma, widths, shares.tolist(), rms, apart, float(reach), on_axis)


def _dark(weights: Array, sigmas: Array) -> bool:
    return dark_angle(np.array([weights, sigmas])) is not None
