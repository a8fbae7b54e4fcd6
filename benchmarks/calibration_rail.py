"""What a rail and a tape tell a calibration, for docs/how_to/build_calibration.md.

The median standard errors of several afternoons, and how large the true errors are beside them.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from calibration_drives import COLUMNS

from uuv_optical_array.calibration.calibrate import calibrate
from uuv_optical_array.core.storage.formats import columns
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene

AFTERNOONS, EACH = 6, 10  # and images at a place


class Rig(NamedTuple):
    """Nearest and farthest place (m), and errors: along and across (m), angles (deg)."""

    near: float
    far: float
    places: int
    along: float
    across: float
    angle: float
    zero: float = 0.0  # share of these that is the same at all places, such as the tape's zero


RIGS = {
    "60 places, 2 to 5 m; 2 mm, 3 mm, 0.3 deg": Rig(2, 5, 60, 0.002, 0.003, 0.3),
    "  20 places": Rig(2, 5, 20, 0.002, 0.003, 0.3),
    "  2 to 3 m": Rig(2, 3, 60, 0.002, 0.003, 0.3),
    "  2 to 8 m": Rig(2, 8, 60, 0.002, 0.003, 0.3),
    "  1 cm, 1 cm, 1 deg": Rig(2, 5, 60, 0.01, 0.01, 1.0),
    "  half of each error common to all": Rig(2, 5, 60, 0.002, 0.003, 0.3, 0.5**0.5),
}


def main() -> None:
    """Print the standard errors, row by row."""
    start = load_scene("follow")
    effects = {
        **start.effects,
        "ambient": {"level_counts": 10.0},
        "responsivity": {"spread": 0.03, "seed": 5, "drift_per_c": 0.0},
    }
    scene = dataclasses.replace(start, effects=effects)
    model = ForwardModel(scene)
    gains = np.maximum(1 + 0.03 * np.random.default_rng(5).standard_normal((5, 5)), 0)
    common = np.exp(np.log(gains).mean())
    truth = {
        "lamp.power": model.power * common,
        "lamp.beam_sigma_deg": 8.0,
        "sea.absorption_per_m": 0.145,
        "sea.scattering_per_m": 0.09,
        "field_of_view.cosine_power": 1.0,
        "array.radius_m": 0.32,
        "ambient.level_counts": 10 * common,
    }
    heads = [("", "rig"), *COLUMNS, ("error /", "std error")]
    rows = [list(row) for row in zip(*heads, strict=True)]
    for name, rig in RIGS.items():
        std = np.array([rig.along, rig.across, rig.across, *np.radians([rig.angle] * 2)])
        errors: dict[tuple[str, str], list[float]] = {column: [] for column in COLUMNS}
        pulls = []
        for seed in range(AFTERNOONS):
            rng = np.random.default_rng(seed)
            side = np.array([0.6, 0.6, *np.radians([25, 25])])
            true = rng.uniform([-rig.far, *-side], [-rig.near, *side], (rig.places, 5))
            own = np.sqrt(1 - rig.zero**2) * rng.standard_normal(true.shape)
            told = true + std * (own + rig.zero * rng.standard_normal(5))
            places = np.repeat(np.arange(rig.places), EACH)
            images = model.expose(true[places], rng)
            found = calibrate(start, images, told[places], pose_std=std, places=places)
            named = {parameter.name: parameter for parameter in found.parameters}
            for column, (keys, unit) in COLUMNS.items():
                sizes = [named[k].std / (unit or named[k].value / 100) for k in keys]
                errors[column].append(max(sizes))
            pulls += [(named[k].value - value) / named[k].std for k, value in truth.items()]
        known = [np.mean(np.isfinite(sizes)) for sizes in errors.values()]
        cells = [
            f"{np.nanmedian(sizes):.2g}" if share > 0.5 else "-"
            for sizes, share in zip(errors.values(), known, strict=True)
        ]
        rows.append([name, *cells, f"{np.sqrt(np.nanmean(np.square(pulls))):.2f}"])
    print(columns(rows))


if __name__ == "__main__":
    main()
