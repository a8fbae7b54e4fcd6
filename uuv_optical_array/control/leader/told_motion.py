"""The leader's own motion, as a modem or a test tank sends it, beside that which the light shows.

A message is late and becomes less certain, because leaders change their motion. Both are weighted
by their covariances once messages have agreed with the light. Light determines the motion better
than most modems do; without it the messages guide a follower that coasts.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from uuv_optical_array.core.geometry import (
    DOF_NAMES,
    Array,
    turned_about_lamp,
)
from uuv_optical_array.core.messages import MAX_TWIST

OLDEST_S, AHEAD_S = 3.0, 0.3  # of a told motion's stamp, before and after the present
MOST_STDS = 4.0  # standard deviations of both, by which it may be off what the light shows
# Messages count once so many in a row agree with light within this time, s, before or after; light
# shows a change after this lag, s.
AGREE, BESIDE_S, LAG_S = 3, 0.5, 0.2
# How leaders change their motion (R. A. Singer, Estimating Optimal Tracking Filter Performance for
# Manned Maneuvering Targets, 1970, of the rate instead of its change): standard deviations of the
# three velocities, m/s, and of the turns, rad/s, among all leaders, and how long each goes on.
CHANGES, CHANGES_S = np.array([0.3, 0.3, 0.3, *np.radians([8.0, 8.0])]), 5.0
MAX_VARIANCE = 1e8  # beyond any motion, (m/s)^2 or (rad/s)^2
FIVE = [0, 1, 2, 4, 5]  # of a twist, without the roll rate
UNITS = ("m/s", "m/s", "m/s", "rad/s", "rad/s")


class Message(NamedTuple):
    """A leader's motion, as it is sent.

    - stamp_s: when it moved so, s, later than the one before.
    - linear, angular: velocity of the lamp through the water and turn, in the leader's frame, m/s
      and rad/s, ``(3,)`` each. The roll rate does not count.
    - covariance: of both, ``(6, 6)``, positive definite but for the roll rate's.
    """

    stamp_s: float
    linear: ArrayLike
    angular: ArrayLike
    covariance: ArrayLike


class Told(NamedTuple):
    """A `Message` that was checked.

    - twist: of the lamp in the leader's axes: surge, sway, heave, pitch and yaw rate, ``(5,)``.
    - covariance: of `twist`, ``(5, 5)``.
    """

    stamp_s: float
    twist: Array
    covariance: Array

    def aged(self, age_s: float) -> Array:
        """Return the covariance of `twist` as that of another time, so many s apart."""
        grown = 2 * CHANGES**2 * -math.expm1(-abs(age_s) / CHANGES_S)
        spread: Array = self.covariance + np.diag(grown)
        return spread


class _Shown(NamedTuple):
    """A leader's motion as the light showed it: the pose's rate by it, and its covariance."""

    stamp_s: float
    pose: Array
    rate: Array
    covariance: Array


class ToldMotion:
    """The newest motion that was sent, and what the light showed recently.

    It counts once `AGREE` in a row have agreed with the light: a sender that is wrong in the light
    is not believed in the dark.
    """

    def __init__(self) -> None:
        self._told: Told | None = None
        self._agreed = 0  # how many in a row
        self._shown: list[_Shown] = []  # of the last `OLDEST_S` of light

    def take(self, now_s: float, message: Message) -> None:
        """Take a message at the present, s.

        ValueError for what is not finite or out of bounds, a stamp that is not later, too old or
        ahead, and a motion that the light contradicts; the message before stays.
        """
        told, before = _checked(now_s, message), self._told
        # A stamp ahead of the present is left from before the clock was set back.
        if before and told.stamp_s <= before.stamp_s <= now_s + AHEAD_S:
            raise ValueError(
                f"stamp not later: {told.stamp_s:.3f} s came after {before.stamp_s:.3f} s; give "
                "each motion of the leader its own stamp"
            )
        self._judge(told)
        self._told = told

    def _judge(self, told: Told) -> None:
        """Raise ValueError where light of about the same time contradicts."""
        if not self._shown:
            return
        shown = min(self._shown, key=lambda one: abs(told.stamp_s - one.stamp_s))
        apart_s = abs(told.stamp_s - shown.stamp_s)
        rate, spread = as_rate(told, shown.pose, max(apart_s, LAG_S))
        off = _stds_off(rate - shown.rate, spread + shown.covariance)
        worst, beside = int(off.argmax()), apart_s <= BESIDE_S
        if off[worst] > MOST_STDS:
            if beside:
                self._agreed = 0
            raise ValueError(
                f"false motion: the leader changes {DOF_NAMES[worst]} by {rate[worst]:.2g} "
                f"{UNITS[worst]} by its message, and by {shown.rate[worst]:.2g} by the light, "
                f"{off[worst]:.2g} standard deviations apart"
            )
        self._agreed += beside

    def told(self, now_s: float) -> Told | None:
        """Return the motion that was told last; ``None`` where it is old at a time, s, or doubted.

        It is doubted until `AGREE` in a row have agreed with the light.
        """
        told = self._told
        if told is None or self._agreed < AGREE:
            return None
        return told if -AHEAD_S <= now_s - told.stamp_s <= OLDEST_S else None

    def light(self, stamp_s: float, pose: Array, rate: Array, covariance: Array) -> None:
        """Note what the light shows, by which messages are judged; arguments as of `fused`."""
        self._shown = [one for one in self._shown if 0 < stamp_s - one.stamp_s <= OLDEST_S]
        self._shown.append(_Shown(stamp_s, pose, rate, covariance))

    def fused(self, stamp_s: float, pose: Array, rate: Array, covariance: Array) -> Array:
        """Return the rate of a pose by the leader's motion, by the light and by what was told.

        - stamp_s: of the pose, s; pose: ``(5,)``.
        - rate: by the light, m/s and rad/s, ``(5,)``; covariance: of it, ``(5, 5)``.
        """
        told = self.told(stamp_s)
        if told is None:
            return rate
        expected, spread = as_rate(told, pose, stamp_s - told.stamp_s)
        off, both = expected - rate, spread + covariance
        if _stds_off(off, both).max() > MOST_STDS:  # the leader has changed its motion since
            return rate
        weighed: Array = rate + covariance @ np.linalg.solve(both, off)
        return weighed


def as_rate(told: Told, pose: Array, apart_s: float) -> tuple[Array, Array]:
    """Return the rate of a pose by a told motion that is some time apart, s, and its covariance."""
    by_twist = np.hstack([-np.eye(5, 3), turned_about_lamp(pose)])
    spread = by_twist @ told.aged(apart_s) @ by_twist.T
    return by_twist @ told.twist, spread


def twist_of_lamp(place: ArrayLike, twist: Array, covariance: Array) -> tuple[Array, Array]:
    """Return the twist of a lamp, and its covariance, by those of its vehicle.

    - place: of the lamp in the vehicle's ``base_link``, m, shape ``(3,)``.
    - twist: linear and angular, m/s and rad/s, ``(6,)``; covariance: of it, ``(6, 6)``.
    """
    x, y, z = np.asarray(place, dtype=float)
    shift = np.eye(6)
    shift[:3, 3:] = (0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)  # angular velocity x place
    return shift @ twist, shift @ covariance @ shift.T


def checked_spread(covariance: ArrayLike) -> Array:
    """Return a copy of a covariance of five rates, ``(5, 5)``; ValueError where it is none."""
    spread = np.array(covariance, dtype=float)
    variances = spread.diagonal() if spread.shape == (5, 5) else np.zeros(1)
    if not (np.isfinite(spread).all() and (variances > 0).all()):
        raise ValueError(f"covariance: variances {variances.tolist()}; give five greater than 0")
    if (variances > MAX_VARIANCE).any():
        raise ValueError(
            f"covariance: variances {variances.tolist()}; give at most {MAX_VARIANCE:g}"
        )
    correlations = spread / np.sqrt(np.outer(variances, variances))
    if np.abs(spread - spread.T).max() > 1e-6 * variances.max() or not (
        np.linalg.eigvalsh(correlations)[0] > 0
    ):
        raise ValueError(f"covariance: {spread.tolist()}; give a positive definite one")
    return spread


def _checked(now_s: float, message: Message) -> Told:
    """Return a checked message; ValueError where it cannot be a recent motion."""
    stamp_s, linear, angular, covariance = message
    age_s = now_s - stamp_s
    if not age_s <= OLDEST_S:
        raise ValueError(
            f"late motion: the leader's motion is {age_s:.3g} s old, more than {OLDEST_S:g} s; "
            "send it sooner, stamped by the same clock"
        )
    if age_s < -AHEAD_S:
        raise ValueError(
            f"stamp ahead: {-age_s:.3g} s later than the clock, beyond {AHEAD_S:g} s; stamp the "
            "leader's motion by a synchronised clock"
        )
    twist: Array = np.concatenate([linear, angular]).astype(float)
    if twist.shape != (6,) or not (np.abs(twist) <= MAX_TWIST).all():
        raise ValueError(
            f"motion: {twist.tolist()}; give three within +-{MAX_TWIST[0]:g} m/s and three within "
            f"+-{MAX_TWIST[-1]:g} rad/s"
        )
    spread = np.asarray(covariance, dtype=float)
    if spread.shape != (6, 6):
        raise ValueError(f"covariance: its shape is {spread.shape}; give 6 x 6 numbers")
    # The light shows no roll: the pose is in the frame of a level lamp.
    five = checked_spread(spread[np.ix_(FIVE, FIVE)])
    return Told(stamp_s, twist[FIVE], five)


def _stds_off(off: Array, covariance: Array) -> Array:
    deviations: Array = np.abs(off) / np.sqrt(covariance.diagonal())
    return deviations
