"""What became of the runs of a kind of trouble: kept, strayed or lost, how far off, how long."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uuv_optical_array.control.darkness import DOUBT
from uuv_optical_array.control.following import STATES
from uuv_optical_array.core.storage.formats import plain
from uuv_optical_array.studies.closed_loops.runs import Kind, Run
from uuv_optical_array.studies.shared.errors import SIGMAS

KEPT_M = 1.0  # a follower that was never farther off has kept its leader
BACK_M = 0.5  # within which it is back
LOST_SHARE = 0.5  # of the station's distance to the lamp, beyond which it is lost
END_S = 1.0  # at the end of a run over which the distance is averaged
LAST_S = 10.0  # at its end in which false poses that steer most of the time are another lamp
OUTCOMES = "kept", "strayed", "lost"


def outcome(run: Run, since_s: float) -> str:
    """Say what became of a follower: a key of `OUTCOMES`."""
    if _at_the_end(run, run.steered & false_frames(run)):
        return "lost"  # it follows another lamp, or nothing
    if run.dark[-1]:
        return "kept"  # there is nothing to follow, and it follows nothing
    if end_m(run) > LOST_SHARE * run.station_m or run.states[-1] in ("searching", "lost"):
        return "lost"
    return "kept" if farthest_m(run, since_s) <= KEPT_M else "strayed"


def silent(run: Run) -> bool:
    """Say whether in the end false poses steer a follower that does not say it doubts them."""
    said = np.array([DOUBT in reason for reason in run.reasons])
    return _at_the_end(run, run.steered & false_frames(run) & ~said)


def _at_the_end(run: Run, frames: NDArray[np.bool_]) -> bool:
    """Say whether some frames are most of the last."""
    return bool(frames[run.t_s > run.t_s[-1] - LAST_S].mean() > 0.5)


def farthest_m(run: Run, since_s: float) -> float:
    """Return how far off its station a follower was at most since a time, m."""
    return float(run.off_m[run.t_s >= since_s].max())


def end_m(run: Run) -> float:
    """Return how far off its station a follower was in the end, m."""
    return float(run.off_m[run.t_s > run.t_s[-1] - END_S].mean())


def back_s(run: Run, until_s: float) -> float | None:
    """Return after how long from a time a follower stayed within `BACK_M`, s; None: never."""
    away = run.t_s[run.off_m > BACK_M]
    if end_m(run) > BACK_M:
        return None
    return float(max(0.0, away[-1] - until_s)) if len(away) else 0.0


def false_frames(run: Run) -> NDArray[np.bool_]:
    """Say which frames have a track that is off by more than `SIGMAS` of its own, ``(n,)``."""
    return np.asarray((np.abs(run.errors) > SIGMAS * run.stds).any(axis=1))


def figures(kind: Kind, runs: Sequence[Sequence[Run]]) -> dict[str, Any]:
    """Return plain values of the runs of a kind, by seed and follower; None for what is unknown.

    Of several followers the one that fared worst counts.
    """
    every = [run for one in runs for run in one]
    outcomes = [
        max((outcome(run, kind.since_s) for run in one), key=OUTCOMES.index) for one in runs
    ]
    until_s = kind.until_s if np.isfinite(kind.until_s) else kind.since_s
    backs = [[s for run in one if (s := back_s(run, until_s)) is not None] for one in runs]
    came = [max(times) for times, one in zip(backs, runs, strict=True) if len(times) == len(one)]
    counted = [run.t_s >= kind.since_s for run in every]
    false = [false_frames(run) & part for run, part in zip(every, counted, strict=True)]
    seen = {state for run in every for state in run.states}
    return plain(
        {
            **{"kind": kind.name, "group": kind.group, "what": kind.what, "runs": len(runs)},
            **{name: outcomes.count(name) for name in OUTCOMES},
            "off_m": max(farthest_m(run, kind.since_s) for run in every),
            "off_median_m": float(np.median([farthest_m(run, kind.since_s) for run in every])),
            "end_m": max(map(end_m, every)),
            "back": len(came),
            "back_s": max(came, default=None),
            "frames": sum(
                int((part & ~np.isnan(run.errors[:, 0])).sum())
                for run, part in zip(every, counted, strict=True)
            ),
            "false": sum(int(part.sum()) for part in false),
            "false_steered": sum(
                int((part & run.steered).sum()) for run, part in zip(every, false, strict=True)
            ),
            "silent": sum(any(map(silent, one)) for one in runs),
            "states": [state for state in STATES if state in seen],
        }
    )
