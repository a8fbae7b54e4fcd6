"""Which setting to take for a rate and an accuracy, from what `tradeoff` measured."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uuv_optical_array.core.storage import files
from uuv_optical_array.estimation.estimator import METHODS
from uuv_optical_array.forward.scene import Scene
from uuv_optical_array.studies.tradeoff.fronts import MOST_WITHOUT_POSE, simplicity
from uuv_optical_array.studies.tradeoff.plan import Group
from uuv_optical_array.studies.tradeoff.results import Measurement, this_machine


@dataclass(frozen=True)
class Need:
    """What is asked of a setting.

    Parameters
    ----------
    rate_hz
        Frames a second; 99 of 100 are to be done before the next one comes.
    position_m, angle_deg
        Largest root mean square error.
    """

    rate_hz: float
    position_m: float
    angle_deg: float

    @property
    def limits(self) -> dict[str, float]:
        """The largest value of each column of a `Measurement` that counts."""
        return {
            "position_m": self.position_m,
            "angle_deg": self.angle_deg,
            "p99_ms": 1e3 / self.rate_hz,
            "without_pose": MOST_WITHOUT_POSE,
        }


@dataclass(frozen=True)
class Advice:
    """A setting, and by how much it falls short.

    Parameters
    ----------
    row
        The setting as measured.
    lacks
        By how much it is beyond each limit that it does not keep; empty where it keeps all.
    """

    row: Measurement
    lacks: dict[str, float]


def _shares(row: Measurement, need: Need) -> dict[str, float]:
    """Return each measured value as a share of its limit; nan counts as infinite."""
    shares = {name: getattr(row, name) / limit for name, limit in need.limits.items()}
    return {name: math.inf if math.isnan(share) else share for name, share in shares.items()}


def advise(rows: Sequence[Measurement], need: Need) -> Advice:
    """Choose the cheapest setting that meets a need, or the nearest to it.

    The cheapest has the fewest detectors, then the smallest table, then the least median time. The
    nearest is the one whose worst value is the least multiple of its limit. Published methods are
    no choice: the estimator's node does not have them.

    Parameters
    ----------
    rows
        What was measured.
    need
        What is asked.

    Returns
    -------
    Advice
        The setting.

    Raises
    ------
    ValueError
        Where no row is of a method that the estimator has.
    """
    choices = [row for row in rows if row.method in METHODS]
    if not choices:
        raise ValueError(f"no setting of {', '.join(METHODS)} was measured; run it again to go on")
    worst = {id(row): max(_shares(row, need).values()) for row in choices}
    met = [row for row in choices if worst[id(row)] <= 1]
    if met:
        return Advice(min(met, key=simplicity), {})
    row = min(choices, key=lambda row: (worst[id(row)], simplicity(row)))
    shares = _shares(row, need)
    beyond = {
        name: getattr(row, name) - limit for name, limit in need.limits.items() if shares[name] > 1
    }
    return Advice(row, beyond)


def cache_folder(scene: Scene) -> Path:
    """Return the user's own folder of measurements in a scene on this machine."""
    machine = "".join(letter if letter.isalnum() else "-" for letter in this_machine())
    return files.cache_dir() / "tradeoff" / f"{scene.name}-{scene.fingerprint[:16]}-{machine}"


def settings_of(scene: Scene, row: Measurement) -> dict[str, Any]:
    """Return what to change for a setting: groups of the scene, and the node's parameter."""
    group = Group(row.shape, row.detectors_per_side, row.steps, (row.method,))
    settings = group.scene(scene).settings()
    return {
        "scene": {"array": settings["array"], "table": settings["table"]},
        "estimator_node": {"method": row.method},
    }
