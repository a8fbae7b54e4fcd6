"""How far a lamp's planes are from a round beam, and from an elliptic one: FILE.ies or .ldt ...

Each plane is compared with the mean of all, out to 2.2 half-widths and weighed by the solid angle:
as it is, with the axis tilted, which a calibration finds as the lamp's aim, and with a width that
varies about the axis as that of an ellipse does, too. Figures are of 1000 on the axis.

Then poses as in ``uuv_array study measured``, in the scene of the file, by its mean, but with light
by its planes, which are interpolated about the axis.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from uuv_optical_array.core.storage.formats import columns
from uuv_optical_array.forward.lamp.photometric_files import Photometry, read
from uuv_optical_array.forward.lamp.photometry import fitted
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.studies.measured_light.lamps import MeasuredLamp, poses_by, scene_of

OUT_TO = 2.2  # half-widths
POSES, SEED = 200, 1
KNOWN = ["lamp", "known", "misfit", "answered", "beyond 6 sigma", "NEES", "range (m)", "across (m)"]
HEAD = ["lamp", "planes", "as they are", "aim (deg)", "aimed", "elliptic (%)", "aimed, elliptic"]


def planes_of(lamp: Photometry, azimuths: np.ndarray) -> dict[str, float]:
    """Return by how much planes, at azimuths in rad, differ from each beam, of 1000, and its fit.

    Every plane counts alike: they go all around.
    """
    inside = lamp.angles_deg <= OUT_TO * lamp.half_width_deg
    angles, mean = lamp.angles_deg, lamp.mean
    rows = lamp.intensities[:, inside] / (lamp.shares @ lamp.intensities)[0]
    polar, around = np.radians(angles[inside]), azimuths[:, None]
    weights = np.sin(polar) / np.sin(polar).sum()
    rays = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around)])

    def rms(tilt: np.ndarray, stretch: float = 0.0, along: float = 0.0) -> float:
        """Return what is left beside the mean, its axis tilted by two angles, rad."""
        axis = np.sin(tilt)
        cosine = np.tensordot(axis, rays, 1) + np.cos(polar) * np.sqrt(1 - axis @ axis)
        off = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        off = off / (1 + stretch * np.cos(2 * (around - along)))
        left = np.square(rows - np.interp(off, angles, mean)).mean(axis=0)
        return float(1e3 * np.sqrt(weights @ left))

    def best(start: list[float]) -> tuple[float, np.ndarray]:
        options = {"maxiter": 5000, "xatol": 1e-6, "fatol": 1e-6}
        found = minimize(lambda p: rms(p[:2], *p[2:]), start, method="Nelder-Mead", options=options)
        return float(found.fun), found.x

    aimed, tilt = best([0.0, 0.0])
    starts = [[*tilt, 0.02, along] for along in np.radians([0, 45, 90, 135])]
    elliptic, found = min((best(start) for start in starts), key=lambda each: each[0])
    return {
        "planes": rms(np.zeros(2)),
        "aim_deg": float(np.degrees(np.hypot(*tilt))),
        "aimed": aimed,
        "stretch": abs(float(found[2])),
        "elliptic": elliptic,
    }


class Planes(MeasuredLamp):
    """The light of a lamp by its planes, which go all around from port, where y is, upwards."""

    def __init__(self, lamp: Photometry, model: ForwardModel) -> None:
        self._rows = lamp.intensities / (lamp.shares @ lamp.intensities)[0]
        self._places = model.array.positions
        super().__init__(lamp, model)

    def intensity(self, eta_deg: np.ndarray, poses: np.ndarray) -> np.ndarray:
        """Return the intensity at angles off the axis, of the detectors at poses ``(m, 5)``."""
        body = Rotation.from_euler("ZYX", np.stack([poses[:, 4], poses[:, 3], 0 * poses[:, 0]], 1))
        turned = np.einsum("mij,kj->mki", body.as_matrix(), self._places)
        y, z = np.moveaxis(poses[:, None, 1:3] + turned[..., 1:], -1, 0)
        count = len(self._rows)
        plane = (np.arctan2(z, y) % (2 * np.pi) * count / (2 * np.pi)).reshape(np.shape(eta_deg))
        low, share = np.floor(plane).astype(int), plane % 1
        by_plane = np.array(
            [np.interp(eta_deg, self._lamp.angles_deg, row, right=0.0) for row in self._rows]
        )
        near, far = (np.take_along_axis(by_plane, k[None] % count, 0)[0] for k in (low, low + 1))
        return near * (1 - share) + far * share


def all_around(lamp: Photometry) -> bool:
    """Say whether a file has planes all around the axis."""
    return len(lamp.intensities) >= 4 and float(np.ptp(lamp.shares)) < 1e-9


def report(files: list[Path]) -> str:
    """Return how far the planes of files are from round; those that are not all around: none."""
    rows = [HEAD]
    for path in files:
        lamp = read(path)
        count = len(lamp.intensities)
        if not all_around(lamp):
            rows.append([path.stem, str(count), *["-"] * (len(HEAD) - 2)])
            continue
        of = planes_of(lamp, np.arange(count) * 2 * np.pi / count)
        figures = (of["planes"], of["aim_deg"], of["aimed"], 100 * of["stretch"], of["elliptic"])
        rows.append([path.stem, str(count), *(f"{figure:.1f}" for figure in figures)])
    return columns(rows)


def report_poses(files: list[Path], count: int = POSES) -> str:
    """Return the poses by lamps whose planes go all around."""
    rows = [KNOWN]
    for path in files:
        lamp = read(path)
        if not all_around(lamp):
            continue
        scene = scene_of(fitted(lamp).settings())
        for known, of in poses_by(scene, lamp, count, SEED, path.stem, Planes).items():
            misfit = f"{of['misfit']:.2f}" if "misfit" in of else "-"
            if of.get("refusal"):
                rows.append([path.stem, known, misfit, "refused", *["-"] * 4])
                continue
            figures = (of["nees_mean"], of["rms_range_m"], of["rms_across_m"])
            told = [f"{of['answered']} of {count}", str(of["beyond_6_sigma"])]
            rows.append([path.stem, known, misfit, *told, *(f"{each:.3g}" for each in figures)])
    return columns(rows, 2)


if __name__ == "__main__":
    named = [Path(name) for name in sys.argv[1:]]
    print(f"{report(named)}\n\nposes by the light of its planes\n{report_poses(named)}")
