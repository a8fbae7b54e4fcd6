"""What each way to drive tells a calibration, for docs/tutorials/calibration.md."""

import dataclasses

import numpy as np

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.calibration.result import FittedParameter
from uuv_optical_array.core.storage.formats import columns
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

IMAGES = 300
# Least and greatest distance (m), how far aside (m), how far the bow swings (deg), and the errors
# of the odometry that are told to the fit, as they are (m, deg).
DRIVES = {
    "on the axis at 6 m": (6.0, 6.0, 0.0, 0.0, None),
    "on the axis, 3 to 8 m": (3.0, 8.0, 0.0, 0.0, None),
    "weaving, 3 to 8 m": (3.0, 8.0, 0.9, 0.0, None),
    "weaving and turning, 3 to 8 m": (3.0, 8.0, 0.9, 20.0, None),
    "  odometry to 0.02 m, 0.5 deg": (3.0, 8.0, 0.9, 20.0, (0.02, 0.5)),
    "  odometry to 0.1 m, 2 deg": (3.0, 8.0, 0.9, 20.0, (0.1, 2.0)),
}
# Columns and their units: parameters whose largest error is shown, its unit in that of the
# parameter; a relative one is in per cent.
COLUMNS = {
    ("power", "%"): (["lamp.power"], None),
    ("sigma", "deg"): (["lamp.beam_sigma_deg"], 1.0),
    ("a", "1/m"): (["sea.absorption_per_m"], 1.0),
    ("b", "%"): (["sea.scattering_per_m"], None),
    ("response", ""): (["field_of_view.cosine_power"], 1.0),
    ("radius", "mm"): (["array.radius_m"], 1e-3),
    ("lamp", "deg"): (["lamp.aim_pitch_rad", "lamp.aim_yaw_rad"], np.pi / 180),
    ("array", "deg"): (["array.aim_pitch_rad", "array.aim_yaw_rad"], np.pi / 180),
    ("ambient", "counts"): (["ambient.level_counts"], 1.0),
}


def cell(parameters: list[FittedParameter], unit: float | None) -> str:
    """Return the largest standard error, or that there is none."""
    if any(parameter.note for parameter in parameters):
        return "-"
    return f"{max(p.std / (unit or p.value / 100) for p in parameters):.2g}"


def main() -> None:
    """Print the standard errors, row by row."""
    start = load_scene("follow")
    effects = {
        **start.effects,
        "ambient": {"level_counts": 10.0},
        "responsivity": {"spread": 0.03, "seed": 5, "drift_per_c": 0.0},
    }
    model = ForwardModel(dataclasses.replace(start, effects=effects))
    heads = [("", "drive"), *COLUMNS, ("gain", "%"), ("misfit", "")]
    rows = [list(row) for row in zip(*heads, strict=True)]
    for name, (near, far, aside, swing, odometry) in DRIVES.items():
        rng = np.random.default_rng(1)
        angle = np.radians(swing)
        poses = rng.uniform(
            [-far, -aside, -aside, -angle, -angle], [-near, aside, aside, angle, angle], (IMAGES, 5)
        )
        # The same distance means that of the whole vehicle from the lamp.
        poses[:, 0] = -np.sqrt(poses[:, 0] ** 2 - (poses[:, 1:3] ** 2).sum(axis=1))
        images, std = model.expose(poses, rng), None
        if odometry:
            std = np.array([*[odometry[0]] * 3, *[np.radians(odometry[1])] * 2])
            poses = poses + std * rng.standard_normal(poses.shape)
        found = calibrate(start, images, poses, pose_std=std)
        named = {parameter.name: parameter for parameter in found.parameters}
        told = [cell([named[key] for key in keys], unit) for keys, unit in COLUMNS.values()]
        errors = found.gain_std[np.isfinite(found.gain_std)]
        gain = f"{100 * np.median(errors):.2g}" if errors.size else "-"
        rows.append([name, *told, gain, f"{found.misfit:.2f}"] + ["refused"] * bool(found.refusal))
    print(columns(rows))


if __name__ == "__main__":
    main()
