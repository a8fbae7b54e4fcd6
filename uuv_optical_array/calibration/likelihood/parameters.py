"""What a calibration fits: the parameters of a scene in their order, their bounds, gauge and prior.

First what all lamps share: power, width of the beam, attenuation (K, or the absorption of a sea),
scattering, power of the detectors' cosine, radius of the sphere, pitch and yaw of the lamp on the
leader and of the array on its mount, background (daylight, or the floor of a modulated lamp), the
shape of the beam, and how far behind its face a lamp's light comes from; then power, place, pitch,
yaw and floor of each of several lamps; and the gain of each detector. `KINDS` says which are
logarithms. Powers and mean gain are one product, so the geometric means of gains and of lamps' own
powers stay: the gauge. What a scene lacks is held, and so is the aim of several lamps, which turns
all axes and places. Shape, floors and the place behind the face are there where the prior has them.
"""

from collections.abc import Collection
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from scipy.linalg import null_space

from uuv_optical_array.core.geometry import Array
from uuv_optical_array.forward.prior import (
    AMBIENT,
    BEAM_SIGMA,
    FLOOR,
    OWN_FLOOR,
    OWN_GEOMETRY,
    OWN_POWER,
    PRIORS,
    RADIUS,
    RESPONSE,
    SCATTERING,
    PriorSettings,
    of_lamp,
)
from uuv_optical_array.forward.prior import POWER as LAMP_POWER
from uuv_optical_array.forward.scene import Scene

# Kinds of parameters, rows of `KINDS`. Up to the shape there is one of each, at this place.
POWER, SIGMA, K, SCATTER, COSINE_POWER, SIZE = range(6)
LAMP_AIM, ARRAY_AIM = [6, 7], [8, 9]  # pitch and yaw
AIMS = [*LAMP_AIM, *ARRAY_AIM]
BACKGROUND = 10
SHAPE = NARROW, WIDE = 11, 12  # weights of the beam's narrowest and widest Gaussian
BEHIND = 13
SHARE, PLACE, AXIS, LAMP_FLOOR, GAINS = range(14, 19)
OWN = SHARE, PLACE, PLACE, PLACE, AXIS, AXIS, LAMP_FLOOR  # of each of several lamps
OWN_NAMES = OWN_POWER, *OWN_GEOMETRY, OWN_FLOOR
AIM_NAMES = tuple(
    f"{part}.aim_{angle}_rad" for part in ("lamp", "array") for angle in ("pitch", "yaw")
)
BEHIND_M = "lamp.behind_m"
# What a calibration fits where the prior leaves it uncertain.
BY_PRIOR = "lamp_behind_std_m", "lamp_floor_std_counts", "lamps_floor_std_counts"


class Kind(NamedTuple):
    """What holds for parameters of a kind."""

    unit: str
    low: float  # bounds, of a logarithm if it is one
    high: float
    # Standard error beyond which one counts as undetermined: a water type, a tape, or a look at the
    # array in the dark, gives as much. Of the background relative to full scale.
    largest: float
    prior: str  # key of the prior for their standard error; empty: by the scene's water
    cure: str = ""  # what to record to determine one; empty: it depends on the record
    logarithm: bool = False


RIM = 1.001  # times the distance of the corners from the axis: the least radius
FACTOR, BOUGHT = float(np.log(1e3)), PRIORS["as_bought"]
NEARER = "too little light of the lamp; record closer to it and in its beam"
TURN = "turn the array up to 30 deg while the lamp shines on it"
ASIDE = "record poses on all sides of the beam's axis"
WIDELY = "record poses from the beam's axis to twice its width off it"
OFF = "record some images from out of the beam or far away"
OUT_OF_BEAM = "record some images out of this lamp's beam or far away"
DARK = "too little light of this lamp; switch it on, and record in its beam"
AROUND = "record closer to the lamps, on all sides of them and at several ranges"
NEAR_AND_FAR = "record from close to the lamp to far from it, near its axis"
SHIFT = "turn and shift the array so that the lamp shines on it"
KINDS = (
    Kind("counts m^2", -50.0, 50.0, 0.15, "lamp_power_std", NEARER, True),
    Kind("deg", np.log(0.1), np.log(90), 0.15, "beam_sigma_std_deg", "", True),
    Kind("1/m", 0.0, 10.0, 0.02, ""),
    Kind("1/m", np.log(1e-6), np.log(10), 0.5, "scattering_std", "", True),
    Kind("", 0.5, 1000.0, 0.2, "cosine_power_std", TURN),
    Kind("m", np.log(0.01), np.log(100), 0.03, "radius_std", TURN, True),
    *[Kind("rad", -0.3, 0.3, 0.02, "lamp_aim_std_deg", ASIDE)] * 2,
    *[Kind("rad", -0.3, 0.3, 0.02, "aim_std_deg", ASIDE)] * 2,
    Kind("counts", 0.0, 1e6, 0.02, "ambient_std_counts", OFF),
    *[Kind("", -5.0, 5.0, 0.2, "", WIDELY)] * 2,
    Kind("m", -1.0, 1.0, 0.05, "lamp_behind_std_m", NEAR_AND_FAR),
    Kind("", -FACTOR, FACTOR, BOUGHT["lamps_power_std"], "lamps_power_std", DARK, True),
    Kind("m", -10.0, 10.0, 1.0, "lamps_place_std_m", AROUND),  # a tape gives more
    Kind("deg", -45.0, 45.0, BOUGHT["lamps_aim_std_deg"], "lamps_aim_std_deg", ASIDE),
    Kind("counts", 0.0, 1e6, 0.02, "lamps_floor_std_counts", OUT_OF_BEAM),
    Kind("", -FACTOR, FACTOR, 0.15, "gain_std", SHIFT, True),
)
# Which of several correlated parameters is held first; the power absorbs what the others leave.
HOLD_ORDER = (
    *(*SHAPE, BEHIND, SIZE, COSINE_POWER, SCATTER, *AIMS, AXIS),
    *(K, SIGMA, BACKGROUND, LAMP_FLOOR, SHARE, GAINS, PLACE, POWER),
)


class Layout:
    """The p parameters of a scene."""

    def __init__(self, scene: Scene) -> None:
        lamps, (water, _) = range(len(scene.lamps)), scene.attenuation
        # Places of the narrowest, a middle and the widest of the beam's Gaussians; of two Gaussians
        # the narrowest is the middle one, whose weight is what the others leave.
        widths = scene.lamp.beam_widths or (1.0,)
        order = sorted(range(len(widths)), key=lambda k: widths[k])
        self.gaussians = order[0], order[(len(order) - 1) // 2], order[-1]
        self.modulated = "demodulation" in scene.effects
        background = FLOOR if self.modulated else AMBIENT
        # Of those before the gains, dotted as in scenes.
        self.names = (
            *(LAMP_POWER, BEAM_SIGMA, water, SCATTERING, RESPONSE, RADIUS, *AIM_NAMES, background),
            *(f"lamp.beam_weights.{self.gaussians[k]}" for k in (0, 2)),
            BEHIND_M,
            *(of_lamp(i, key) for i in lamps for key in OWN_NAMES),
        )
        self.gains = len(self.names)  # the place of the first
        # Places of those of each of several lamps, (L, 7).
        self.own = np.arange(SHARE, self.gains).reshape(-1, len(OWN))
        detectors = scene.array.detectors_per_side**2
        self.kinds = np.array([*range(SHARE), *OWN * len(lamps), *[GAINS] * detectors])
        has = {
            SCATTER: "sea" in scene.effects,
            COSINE_POWER: "half_angle_deg" not in scene.effects.get("field_of_view", {}),
            SIZE: scene.array.radius_m is not None,
            **dict.fromkeys(LAMP_AIM, not lamps),
            BACKGROUND: not self.modulated or scene.prior.lamp_floor_std_counts > 0,
            NARROW: len(widths) > 2,
            WIDE: len(widths) > 1,
            BEHIND: scene.prior.lamp_behind_std_m > 0,
            **dict.fromkeys(self.own[:, -1].tolist(), scene.prior.lamps_floor_std_counts > 0),
        }
        # Those that the scene does not have.
        self.lacking = frozenset(i for i, there in has.items() if not there)
        kinds = [KINDS[kind] for kind in self.kinds]
        self.units = [kind.unit for kind in kinds[: self.gains]]
        # Of each as in `Kind`, (p,).
        self.logarithm = np.array([kind.logarithm for kind in kinds])
        self.low, self.high, self.largest = np.array(
            [(kind.low, kind.high, kind.largest) for kind in kinds]
        ).T
        self.largest[np.isin(self.kinds, (BACKGROUND, LAMP_FLOOR))] *= scene.full_scale_counts
        # A sphere reaches the corner detectors.
        rim_m = RIM * scene.array.width_m / np.sqrt(2)
        self.low[SIZE] = max(self.low[SIZE], np.log(rim_m))
        self.low[WIDE] = 0.0  # else there is no light far off the axis
        self.low[SIGMA] -= np.log(min(widths))
        self.high[SIGMA] -= np.log(max(widths))
        self._directions: dict[frozenset[int], Array] = {}  # by what is held

    def free_directions(self, held: Collection[int]) -> Array:
        """Return orthogonal directions of what is not `held`, as columns, which keep the gauge."""
        # Every step of a fit asks for them, and few of its steps hold what others do not.
        key = frozenset(held)
        if key not in self._directions:
            self._directions[key] = self._orthogonal(key)
        return self._directions[key]

    def _orthogonal(self, held: Collection[int]) -> Array:
        free = np.setdiff1d(np.arange(len(self.kinds)), list(held))
        bound = [free[self.kinds[free] == kind] for kind in (SHARE, GAINS)]
        columns = [np.eye(len(self.kinds))[:, np.setdiff1d(free, np.concatenate(bound))]]
        for rows in bound:
            across = null_space(np.ones((1, len(rows)))) if len(rows) else np.zeros((0, 0))
            columns.append(np.zeros((len(self.kinds), across.shape[1])))
            columns[-1][rows] = across
        directions = np.hstack(columns)
        directions.flags.writeable = False  # they are kept
        return directions

    def prior(
        self, start: PriorSettings, values: Array, errors: Array, unknown: Collection[int]
    ) -> dict[str, Any]:
        """Return standard errors as keys of `PriorSettings`, within their bounds.

        What was held or is `unknown` keeps the prior of the start; what is unknown gets that of a
        rig as bought where the start is exact. A scene has no aims, so these stay uncertain.
        """
        hints = get_type_hints(PriorSettings, include_extras=True)
        prior: dict[str, Any] = {"known": "calibrated"}
        relative = np.where(self.logarithm, values, 1.0)
        relative[SIGMA] = 1.0
        sizes = errors / relative
        sizes[AIMS] = np.degrees(np.hypot(errors[AIMS], values[AIMS]))
        water = "k_std_per_m" if SCATTER in self.lacking else "absorption_std_per_m"
        keys = np.array([KINDS[kind].prior or water for kind in self.kinds], dtype=object)
        keys[list(SHAPE)] = ""
        if self.modulated:
            keys[BACKGROUND] = "lamp_floor_std_counts"
        for key in dict.fromkeys(keys[keys != ""].tolist()):
            rows = np.flatnonzero(keys == key)
            stds = sizes[rows]
            stds, std = stds[np.isfinite(stds)], getattr(start, key)
            if not set(rows.tolist()).isdisjoint(unknown):
                std = max([std or BOUGHT[key], *stds])
            elif stds.size:
                std = float(np.sqrt((stds**2).mean()))
            (quantity,) = hints[key].__metadata__
            prior[key] = float(f"{min(std, quantity.high):.3g}")
        return prior
