"""What the measured beams of lamps do to a calibration and to poses: parts of ``study measured``.

A lamp's photometric file is shone, as it was measured, into clear water that absorbs. Then the
array is calibrated on drives whose poses are known exactly or by an odometry, and poses are
estimated.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.core.geometry import Array
from uuv_optical_array.core.storage.formats import columns, plain
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.forward.lamp.photometric_files import Photometry, read
from uuv_optical_array.forward.lamp.photometry import fitted, points_of
from uuv_optical_array.forward.light import COSINE, HALF_SQUARE, RANGE
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import Scene, load_scene, scene_from_settings
from uuv_optical_array.forward.working_volume import MIN_PEAK_COUNTS, uniform_poses
from uuv_optical_array.studies.shared.errors import bounds, errors_of

SUFFIXES = ".ies", ".ldt"
DRIVE_IMAGES = 300
K_PER_M, REFERENCE = 0.1, 900.0  # of the water, and the largest reading at 4 m, counts
LARGEST = 1023.0
# Standard deviations of an odometry, m and rad, by what the tables call a calibration with it.
ODOMETRIES: dict[str, tuple[float, float]] = {
    "calibrated, exact": (0.0, 0.0),
    "0.02 m, 0.5 deg": (0.02, np.radians(0.5)),
    "0.1 m, 2 deg": (0.1, np.radians(2.0)),
}
BOUGHT = "as_bought"
SCENE = {
    "attenuation": {"k_per_m": K_PER_M},
    "sensor_noise": {"sigma_counts": 1.0},
    "saturation": {"level_counts": LARGEST},
    "adc": {"bits": 10},
}


def files_in(folder: Path) -> list[Path]:
    """Return the photometric files of a folder and of those in it, in order."""
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)


def gaussian_rms(lamp: Photometry) -> float:
    """Return the rms of the best Gaussian beside a lamp's mean, of 1000, as `fitted` weighs it."""
    points = points_of(lamp)
    sigmas = np.linspace(0.4, 1.8, 281, dtype=np.float64) * lamp.half_width_deg
    return min(points.weights_of(sigmas[k : k + 1])[1] for k in range(len(sigmas)))


def scene_of(beam: dict[str, Any]) -> Scene:
    """Return the scene of the study with a beam, as settings of a lamp."""
    settings = load_scene("reference").settings()
    lamp = {"reference_counts": REFERENCE, "reference_range_m": 4.0}
    settings |= {"lamp": lamp | beam, "effects": SCENE, "prior": {"known": "as_bought"}}
    return scene_from_settings(settings, "measured")


class MeasuredLamp:
    """The light of a lamp as its file has it, about the axis, on the study's array."""

    def __init__(self, lamp: Photometry, model: ForwardModel) -> None:
        self._lamp, self._model, self._power = lamp, model, 1.0
        self._power = REFERENCE / self.light(np.array([[-4.0, 0, 0, 0, 0]])).max()

    def light(self, poses: Array) -> Array:
        """Return the light at poses ``(m, 5)``, counts, shape ``(m, side, side)``."""
        rays = self._model.rays(poses, np.zeros(len(poses)))
        eta = np.degrees(np.sqrt(2 * rays[HALF_SQUARE]))
        intensity = self.intensity(eta, poses)
        facing = np.maximum(rays[COSINE], 0.0)
        light = self._power * intensity * facing / rays[RANGE] ** 2 * np.exp(-K_PER_M * rays[RANGE])
        return np.asarray(light.reshape(len(poses), *self._model.image_shape))

    def intensity(self, eta_deg: Array, poses: Array) -> Array:
        """Return the intensity at angles off the axis, of the detectors at poses ``(m, 5)``."""
        return np.interp(eta_deg, self._lamp.angles_deg, self._lamp.mean, right=0.0)

    def lit(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return poses that are lit, ``(count, 5)``, m and rad, and their images."""
        poses = np.empty((0, 5))
        while len(poses) < count:
            drawn = uniform_poses(4 * count, rng)
            bright = self.light(drawn).max(axis=(1, 2)) > MIN_PEAK_COUNTS
            poses = np.concatenate([poses, drawn[bright]])[:count]
        return poses, self._model.read(self.light(poses), rng)


def measure_lamps(files: Sequence[Path], count: int, seed: int) -> Iterator[dict[str, Any]]:
    """Yield the figures of each lamp by a Gaussian and by the Gaussians of its file."""
    for path in files:
        lamp = read(path)
        row: dict[str, Any] = {"lamp": path.stem, "half_width_deg": lamp.half_width_deg}
        row["gaussian_rms"] = gaussian_rms(lamp)
        half = lamp.half_width_deg
        beams = {"one Gaussian": {"beam_sigma_deg": half / np.sqrt(2 * np.log(2))}}
        row["file_rms"] = None
        try:
            beam = fitted(lamp)
        except ValueError as error:
            row["refusal"] = str(error)
        else:
            row |= {"file_rms": beam.rms, "planes_rms": beam.planes_rms}
            beams["its file"] = beam.settings()
        row["scenes"] = {
            name: poses_by(scene_of(settings), lamp, count, seed, f"{path.stem}, {name}")
            for name, settings in beams.items()
        }
        yield plain(row)


def poses_by(
    scene: Scene,
    lamp: Photometry,
    count: int,
    seed: int,
    what: str,
    shone: Callable[[Photometry, ForwardModel], MeasuredLamp] = MeasuredLamp,
) -> dict[str, Any]:
    """Return a scene's poses as bought and calibrated on a drive, or its refusal, by odometry.

    - shone: makes the light of the lamp.
    """
    rng, model = np.random.default_rng(seed), ForwardModel(scene)
    truth = shone(lamp, model)
    places, images = truth.lit(DRIVE_IMAGES, rng)
    errors = rng.standard_normal(places.shape)
    poses, seen = truth.lit(count, rng)

    def poses_of(one: Scene) -> dict[str, Any]:
        range_m = bounds(ForwardModel(one), poses)[1][:, 0]
        return {
            **errors_of(Estimator(one).wait(), model, poses, seen, what).summary(),
            "bound_range_m": float(np.sqrt(np.mean(range_m**2))),
        }

    result: dict[str, Any] = {BOUGHT: poses_of(scene)}
    for name, (metres, radians) in ODOMETRIES.items():
        std = np.array([metres, metres, metres, radians, radians])
        found = calibrate(scene, images, places + std * errors, pose_std=std if metres else None)
        result[name] = {"misfit": found.misfit, "refusal": found.refusal}
        if not found.refusal:
            result[name] |= poses_of(found.scene)
    return result


def report_lamps(rows: Sequence[dict[str, Any]], count: int) -> str:
    """Return the figures of lamps as tables."""
    head = ["lamp", "half-width (deg)", "one Gaussian", "its file", "planes"]
    beams = [head]
    table = [
        ["lamp", "beam of the scene", "known", "misfit", "answered", "beyond 6 sigma", "NEES",
         "range (m)", "bound (m)", "across (m)"]
    ]  # fmt: skip
    for row in rows:
        fit = "refused" if row["file_rms"] is None else f"{row['file_rms']:.1f}"
        apart = f"{row['planes_rms']:.0f}" if "planes_rms" in row else "-"
        half = f"{row['half_width_deg']:.1f}"
        beams.append([row["lamp"], half, f"{row['gaussian_rms']:.1f}", fit, apart])
        for beam, result in row["scenes"].items():
            for known, of in result.items():
                misfit = f"{of['misfit']:.2f}" if "misfit" in of else "-"
                first = [row["lamp"], beam, known, misfit]
                if of.get("refusal"):
                    named = "beam" if "beam" in of["refusal"] else "another"
                    table.append([*first, f"refused: {named}", *["-"] * 5])
                    continue
                nees = "-" if of["nees_mean"] is None else f"{of['nees_mean']:.3g}"
                keys = "rms_range_m", "bound_range_m", "rms_across_m"
                rms = (f"{of[name] or np.nan:.3g}" for name in keys)
                answered = f"{of['answered']} of {count}"
                table.append([*first, answered, str(of["beyond_6_sigma"]), nees, *rms])
    return (
        "beams: rms of 1000 on the axis, out to 2.2 half-widths\n"
        f"{columns(beams)}\n\nposes in clear water, by light as it was measured\n"
        f"{columns(table, 3)}"
    )
