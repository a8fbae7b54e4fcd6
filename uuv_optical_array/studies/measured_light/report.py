"""What readings of a room show, as figures and text: parts of ``study measured``."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from uuv_optical_array.core.storage.formats import columns, plain
from uuv_optical_array.studies.measured_light.poses import positions, virtual_array
from uuv_optical_array.studies.measured_light.room import (
    ANGLES_DEG,
    CLEAR,
    LAMPS,
    LEARN,
    SHADED,
    SIDE,
    lamp_of,
    read_room,
)
from uuv_optical_array.studies.shared.errors import SIGMAS

# What is known of an array's attitude: key, words, and the numbers that are left.
ATTITUDES = ("open", "", 5), ("attitude", ", to 2 deg", 5), ("level", ", level", 3)


def measure_room(path: Path, seed: int) -> dict[str, Any]:
    """Return the figures of a room: its lamps, places in the plane, and virtual arrays."""
    room = read_room(path)
    learn = room.of(LEARN)
    lamps = [lamp_of(learn, i) for i in range(LAMPS)]
    result: dict[str, Any] = {"lamps": [], "places": {}, "arrays": []}
    for lamp in lamps:
        power, sigma = lamp.found.parameters[0], lamp.found.parameters[1]
        result["lamps"].append(
            {
                "place_m": lamp.place,
                "floor_counts": lamp.floor,
                "power": power.value,
                "sigma_deg": sigma.value,
                "sigma_std_deg": sigma.std,
                "noise_counts": lamp.noise[0],
                "noise_share": lamp.noise[1],
                "pattern": lamp.pattern._asdict(),
                "residuals": lamp.off,
            }
        )
    for name, runs in (("clear", CLEAR), ("behind a column", SHADED)):
        errors, stds = np.moveaxis(positions(room.of(runs), lamps), 1, 0)
        posed = np.isfinite(errors[:, 0])
        distance = np.linalg.norm(errors[posed], axis=1)
        ratio = errors[posed] / stds[posed]
        result["places"][name] = {
            "places": len(errors),
            "answered": int(posed.sum()),
            "beyond_6_sigma": int((np.abs(ratio) > SIGMAS).any(axis=1).sum()),
            "nees_mean": float((ratio**2).sum(axis=1).mean()),
            "median_m": float(np.median(distance)),
            "p95_m": float(np.percentile(distance, 95)),
        }
    others = room.of(CLEAR)
    for i, lamp in enumerate(lamps):
        for known in ("calibrated", "as_bought"):
            figures = virtual_array(others, lamp, known, seed)
            result["arrays"].append({"lamp": i, "known": known, **figures})
    return dict(plain(result))


def report_room(result: dict[str, Any]) -> str:
    """Return the figures of a room as tables."""
    edges = [f"{a} to {b} deg" for a, b in pairwise(ANGLES_DEG)]
    rows = [["lamp", "x, y (m)", "floor", "sigma (deg)", "noise", "share", "pattern", *edges]]
    for i, lamp in enumerate(result["lamps"]):
        rows.append(
            [
                f"{i}",
                ", ".join(f"{x:.2f}" for x in lamp["place_m"]),
                f"{lamp['floor_counts']:.0f}",
                f"{lamp['sigma_deg']:.1f}",
                f"{lamp['noise_counts']:.0f}",
                f"{lamp['noise_share']:.1%}",
                f"{lamp['pattern']['share']:.0%}, {lamp['pattern']['length_m']:.2f} m",
                *(f"{off:+.1%}" for off in lamp["residuals"]),
            ]
        )
    places = [["runs", "answered", "beyond 6 sigma", "NEES", "median (m)", "95 % (m)"]]
    for name, of in result["places"].items():
        answered = f"{of['answered']} of {of['places']}"
        sizes = f"{of['nees_mean']:.3g} of 2", f"{of['median_m']:.3g}", f"{of['p95_m']:.3g}"
        places.append([name, answered, str(of["beyond_6_sigma"]), *sizes])
    head = "lamp", "known", "answered", "beyond 6 sigma", "NEES"
    arrays = [[*head, "range (m)", "across (m)", "angle (deg)"]]
    for of in result["arrays"]:
        for told, more, size in ATTITUDES:
            each = of.get(told, {})
            if not each.get("answered"):
                continue
            keys = ["nees_mean", "rms_range_m", "rms_across_m", "rms_angle_deg"]
            figures = [f"{each[key]:.3g}" for key in keys]
            figures[0] += f" of {size}"
            if told == "level":
                figures[-1] = "-"
            answered = f"{each['answered']} of {of['centres']}"
            beyond, known = str(each["beyond_6_sigma"]), f"{of['known']}{more}"
            arrays.append([str(of["lamp"]), known, answered, beyond, *figures])
    return (
        "lamps of a room by one photodiode; mean residuals by the angle off the axis\n"
        f"{columns(rows)}\n\nplaces by four lamps; height, heading and a level vehicle are known\n"
        f"{columns(places)}\n\na virtual array of {SIDE} x {SIDE} photodiodes\n{columns(arrays, 2)}"
    )
