"""The kinds of trouble of ``uuv_array study envelope``, by group.

Where nothing else is said the leader goes on the demonstration's path, and what happens begins
after 15 s, in its first turn. A new kind is an entry of `KINDS`.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from uuv_optical_array.control.fleet import vee
from uuv_optical_array.studies.closed_loops.leader_courses import (
    RAMP_M_PER_S2,
    RAMP_S,
    SPEED,
    Course,
    pulse,
    speeds,
    turning,
)
from uuv_optical_array.studies.closed_loops.runs import Beside, Kind

SINCE_S = 15.0
AFTER_S = 45.0  # that a run lasts, from when all is as it will stay
BACK_S = 30.0  # after so long what comes back is as before
HOME_S = 60.0  # to find back, once there is light
START_S = 100.0  # to find the leader from the start
DARK_S = (1, 2, 5, 10, 20, 30, 60)
TURNS_DEG_PER_S = (6, 10, 15, 20, 30)
CHAIN_DEG_PER_S = (3, 4, 8)
SPEEDS_M_PER_S = (0.6, 0.9, 1.0, 1.2, 1.5)
FLEET: dict[str, Any] = {"scene": "formation", "group": "formations"}
# Lamps as bright as ours.
ASIDE = Beside(((0, 0),), ((0, 1.5),))
FAR_ASIDE = Beside(((0, 0),), ((0, 3.0),))
AHEAD = Beside(((0, 3.0),), ((0, 0),), (SINCE_S, np.inf))
INSTEAD = Beside(((0, 0),), ((0, 1.5),), (20.0, np.inf))
CROSSING = Beside(((0, -1.0),), ((SINCE_S, -6.0), (39, 6.0)), (SINCE_S, 39.0))


def _changes(name: str, field: str, value: float, usual: float, what: str) -> list[Kind]:
    """Return a change in a step, a slow one, and one that comes back."""
    step = (SINCE_S, usual), (SINCE_S, value)
    slow = (SINCE_S, usual), (SINCE_S + BACK_S, value)
    back = (*step, (SINCE_S + BACK_S, value), (SINCE_S + BACK_S, usual))
    until_s = SINCE_S + BACK_S
    group = "lamp" if field == "lamp" else "water"
    ways: tuple[tuple[str, dict[str, Any], float, str], ...] = (
        ("", {field: step}, SINCE_S, "at once"),
        ("_slow", {field: slow}, until_s, f"within {BACK_S:g} s"),
        ("_back", {field: back}, until_s, f"at once, and is as before after {BACK_S:g} s"),
    )
    return [
        Kind(
            f"{name}{way}",
            group,
            f"{what} {when}.",
            until + AFTER_S,
            until_s=until,
            **changed,
        )
        for way, changed, until, when in ways
    ]


def _darkness() -> list[Kind]:
    """Return a lamp that is off for a time, behind leaders of three kinds."""
    kinds = []
    for off_s in DARK_S:
        until_s = SINCE_S + off_s
        leaders: dict[str, tuple[str, dict[str, Any]]] = {
            "straight": ("goes straight on", {"motion": Course(speeds())}),
            "path": ("goes on its path", {}),
            "stopped": ("stops", {"motion": Course(speeds((SINCE_S, 0.0)))}),
        }
        for way, (does, settings) in leaders.items():
            kinds.append(
                Kind(
                    f"dark_{off_s}_{way}",
                    "darkness",
                    f"The lamp is off for {off_s} s; the leader {does}.",
                    until_s + HOME_S,
                    until_s=until_s,
                    dark_s=(SINCE_S, until_s),
                    **settings,
                )
            )
    return kinds


def _turns(name: str, rates: Sequence[int], does: str, **settings: Any) -> list[Kind]:
    """Return turns of a leader by a right angle, at rates, deg/s."""
    kinds = []
    for rate in rates:
        motion, until_s = turning(SINCE_S, rate)
        kinds.append(
            Kind(
                name=f"{name}_{rate}",
                what=f"{does} at {rate} deg/s.",
                duration_s=until_s + AFTER_S,
                until_s=until_s,
                motion=motion,
                **settings,
            )
        )
    return kinds


def dim_aside(kind: Kind, rng: np.random.Generator) -> Kind:
    """Draw how far, and to which side, the leader goes in the dark."""
    off_m, way = rng.uniform(3.0, 4.0), rng.uniform(0, 2 * np.pi)
    speed = off_m / (kind.until_s - SINCE_S - RAMP_S)
    side = pulse(SINCE_S, kind.until_s - RAMP_S, speed * np.cos(way))
    up = pulse(SINCE_S, kind.until_s - RAMP_S, speed * np.sin(way))
    surge = speeds((SINCE_S, 0.0), (kind.until_s, SPEED))
    return dataclasses.replace(kind, motion=Course(surge, side, up))


def dim_turned(kind: Kind, rng: np.random.Generator) -> Kind:
    """Draw how far, and to which side, the leader turns in the dark."""
    rate = rng.choice([-1, 1]) * np.radians(rng.uniform(30, 60)) / (kind.until_s - SINCE_S)
    return dataclasses.replace(
        kind, motion=Course(speeds(), yaw=pulse(SINCE_S, kind.until_s, rate))
    )


def _starts() -> list[Kind]:
    """Return followers that start off their station, also behind a leader that stays."""
    places: dict[str, tuple[str, dict[str, Any]]] = {
        "aside_1.5": ("1.5 m aside of its station", {"start_m": (0.0, 1.5, 0.0)}),
        "aside_3": ("3 m aside of its station", {"start_m": (0.0, 3.0, 0.0)}),
        "turned_100": ("turned by 100 deg", {"start_m": (0.0, 0.0, 0.0), "turned_deg": 100.0}),
        "near_1.5": ("1.5 m behind the lamp", {"start_m": (0.0, 0.0, 0.0), "behind_m": 1.5}),
        "far_12": ("12 m behind the lamp", {"start_m": (0.0, 0.0, 0.0), "behind_m": 12.0}),
    }
    return [
        Kind(
            f"start_{name}{'_stays' * stays}",
            "starts",
            f"The follower starts {where}; the leader {'stays' if stays else 'waits for it'}.",
            START_S,
            since_s=0.0,
            until_s=0.0,
            stays=stays,
            **settings,
        )
        for stays in (False, True)
        for name, (where, settings) in places.items()
        if not stays or name not in ("aside_1.5", "near_1.5")
    ]


def _lamp(value: float, what: str) -> list[Kind]:
    return _changes(f"lamp_{value:g}", "lamp", value, 1.0, what)


def _absorption(value: float) -> list[Kind]:
    more = "more" if value > 0 else "less"
    what = f"The water absorbs {abs(value):g} /m {more},"
    return _changes(f"absorption_{value:+g}", "absorption", value, 0.0, what)


LONG_S = SINCE_S + AFTER_S
# fmt: off
KINDS: tuple[Kind, ...] = (
    Kind("nothing", "lamp", "All is as the scene says.", LONG_S),
    Kind("nothing_300", "lamp", "The same for five minutes.", 300.0),
    *(kind for value in (0.9, 0.8, 1.2, 0.5)
      for kind in _lamp(value, f"The lamp has {value:g} times its power,")),
    *(kind for value in (-0.005, 0.005, -0.02, 0.02) for kind in _absorption(value)),
    *_changes("scattering_2", "scattering", 2.0, 1.0, "The water scatters twice as much,"),
    *(Kind(f"plume_{depth:g}", "water", f"Clouds of depth {depth:g} that the scene does not name.",
           LONG_S, until_s=np.inf, plume=depth) for depth in (0.5, 1.0)),
    Kind("plume_1_passes", "water", "The same of depth 1, which have passed after 10 s.",
         LONG_S + 10, until_s=SINCE_S + 10, plume=1.0),
    Kind("night_plume", "water", "The scene night_plume, with clouds that it names.",
         LONG_S, scene="night_plume"),
    Kind("response_2", "array", "The detectors' response falls off as the cosine's square.", 60.0,
         since_s=0.0, until_s=0.0, effects={"field_of_view": {"cosine_power": 2.0}}),
    Kind("dead_detector", "array", "A detector beside the middle one is dead.", 60.0, since_s=0.0,
         until_s=0.0, effects={"detector_faults": {"dead": [[2, 1]]}}),
    *_darkness(),
    Kind("told_dark_20", "darkness",
         "The lamp is off for 20 s; the leader goes on its path, and sends its motion.",
         SINCE_S + 20 + HOME_S, until_s=SINCE_S + 20, dark_s=(SINCE_S, SINCE_S + 20), told=True),
    Kind("dark_10_current", "darkness",
         "The lamp is off for 10 s; a current of 0.3 m/s sets the follower across.",
         SINCE_S + 10 + HOME_S, until_s=SINCE_S + 10, dark_s=(SINCE_S, SINCE_S + 10),
         motion=Course(speeds()), current_m_per_s=(0.0, 0.3, 0.0)),
    Kind("dark_5_fast", "darkness", "The lamp is off for 5 s; the leader goes at 1 m/s.",
         SINCE_S + 5 + HOME_S, until_s=SINCE_S + 5, dark_s=(SINCE_S, SINCE_S + 5),
         motion=Course(((0, 0), (1 / RAMP_M_PER_S2, 1.0)))),
    Kind("dim_aside", "darkness",
         "The lamp is off for 10 s; about then the leader stops and goes 3 to 4 m aside, up or "
         "down.",
         SINCE_S + 10 + HOME_S, until_s=SINCE_S + 10, dark_s=(SINCE_S, SINCE_S + 10),
         drawn=dim_aside),
    Kind("dim_turned", "darkness",
         "The lamp is off for 10 s; about then the leader turns by 30 to 60 deg.",
         SINCE_S + 10 + HOME_S, until_s=SINCE_S + 10, dark_s=(SINCE_S, SINCE_S + 10),
         drawn=dim_turned),
    *_turns("turn", TURNS_DEG_PER_S, "The leader turns through 90 deg", group="leader"),
    *_turns("told_turn", (20,), "A leader that sends its motion turns through 90 deg",
            group="leader", told=True),
    Kind("stop", "leader", "The leader stops dead.", LONG_S, until_s=SINCE_S,
         motion=Course(((0, 0), (SPEED / RAMP_M_PER_S2, SPEED), (SINCE_S, SPEED), (SINCE_S, 0)))),
    Kind("dash", "leader", "The leader speeds up to 1.2 m/s, and slows down after 15 s.",
         SINCE_S + 15 + AFTER_S, until_s=SINCE_S + 15,
         motion=Course(speeds((SINCE_S, 1.2), (SINCE_S + 15, SPEED)))),
    Kind("dive", "leader", "The leader's bow goes down by 20 deg at 5 deg/s, and up after 10 s.",
         SINCE_S + 14 + AFTER_S, until_s=SINCE_S + 14,
         motion=Course(speeds(), pitch=(*pulse(SINCE_S, SINCE_S + 4, np.radians(5)),
                                        *pulse(SINCE_S + 10, SINCE_S + 14, -np.radians(5))))),
    Kind("sink", "leader", "The leader sinks by 3 m at 0.3 m/s.", SINCE_S + 10 + AFTER_S,
         until_s=SINCE_S + 10, motion=Course(speeds(), heave=pulse(SINCE_S, SINCE_S + 10, -0.3))),
    Kind("back_up", "leader", "The leader backs up at up to 1 m/s for some 8 s, and goes on.",
         SINCE_S + 8 + AFTER_S, until_s=SINCE_S + 8,
         motion=Course(((0, 0), (1.5, SPEED), (SINCE_S, SPEED), (SINCE_S + 1, -1.0),
                        (SINCE_S + 8, -1.0), (SINCE_S + 9, SPEED)))),
    *(Kind(f"speed_{speed:g}", "leader", f"The leader goes at {speed:g} m/s.", 60.0, 0.0,
           speed / RAMP_M_PER_S2, motion=Course(((0, 0), (speed / RAMP_M_PER_S2, speed))))
      for speed in SPEEDS_M_PER_S),
    *(Kind(f"current_{way}", "sea", f"A current of 0.3 m/s {words} the leader's first way.",
           60.0, 0.0, 0.0, current_m_per_s=velocity)
      for way, words, velocity in (("across", "to port of", (0.0, 0.3, 0.0)),
                                   ("along", "along", (0.3, 0.0, 0.0)),
                                   ("against", "against", (-0.3, 0.0, 0.0)))),
    *_starts(),
    Kind("imu_silent_10", "sea", "The IMU, by which images are read, is silent for 10 s.",
         SINCE_S + 10 + AFTER_S, until_s=SINCE_S + 10, silent_s=(SINCE_S, SINCE_S + 10)),
    Kind("other_aside", "other lamps", "An equal lamp is 1.5 m aside of ours.", LONG_S,
         others=(ASIDE,)),
    Kind("other_aside_3", "other lamps", "An equal lamp is 3 m aside of ours.", LONG_S,
         others=(FAR_ASIDE,)),
    Kind("other_out", "other lamps", "Ours goes out for good, 1.5 m beside an equal one.",
         20 + AFTER_S, 20.0, 20.0, others=(ASIDE,), dark_s=(20.0, np.inf)),
    Kind("other_instead", "other lamps", "As ours goes out, an equal one lights up 1.5 m beside.",
         20 + AFTER_S, 20.0, 20.0, others=(INSTEAD,), dark_s=(20.0, np.inf)),
    Kind("other_out_10", "other lamps", "Ours goes out for 10 s, 1.5 m beside an equal one.",
         30 + HOME_S, 20.0, 30.0, others=(ASIDE,), dark_s=(20.0, 30.0)),
    Kind("other_crossing", "other lamps", "An equal lamp crosses 1 m behind ours at 0.5 m/s.",
         39 + AFTER_S, until_s=39.0, others=(CROSSING,)),
    Kind("other_ahead", "other lamps", "An equal lamp lights up 3 m ahead of ours.", LONG_S,
         others=(AHEAD,)),
    *(Kind(name=f"formation_{n}", what=f"A leader and {n} followers in a V.", duration_s=60.0,
           since_s=20.0, until_s=20.0, fleet=tuple(vee(n)), **FLEET) for n in (3, 4)),
    Kind(name="formation_dark_1", what="The first of three sees nothing for 15 s.",
         duration_s=SINCE_S + 15 + HOME_S, until_s=SINCE_S + 15, dark_s=(SINCE_S, SINCE_S + 15),
         blind=(1,), fleet=tuple(vee(3)), **FLEET),
    Kind(name="formation_dark_3", what="The third of three sees nothing for 10 s.",
         duration_s=SINCE_S + 10 + HOME_S, until_s=SINCE_S + 10, dark_s=(SINCE_S, SINCE_S + 10),
         blind=(3,), fleet=tuple(vee(3)), **FLEET),
    *_turns("chain", CHAIN_DEG_PER_S,
            "Three followers, the third behind the first; a turn of 90 deg",
            fleet=tuple(vee(3)), **FLEET),
)
# fmt: on


def kinds_named(names: str | None) -> Sequence[Kind]:
    """Choose `KINDS` by names or groups between commas; None: all. ValueError for any other."""
    if names is None:
        return KINDS
    chosen = [name.strip() for name in names.split(",")]
    known = {kind.name for kind in KINDS} | {kind.group for kind in KINDS}
    for name in chosen:
        if name not in known:
            raise ValueError(
                f"--kinds: {name!r} is unknown; choose from {', '.join(sorted(known))}"
            )
    return [kind for kind in KINDS if kind.name in chosen or kind.group in chosen]
