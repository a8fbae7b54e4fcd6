"""The BlueROV2 Heavy: its published parameters, its thrusters, and an autopilot for ``cmd_vel``.

Parameters, thrusters' places and greatest thrust are of von Benzon et al., An Open-Source Benchmark
Simulator: Control of a BlueROV2 Underwater Robot, J. Mar. Sci. Eng. 10(12):1898, 2022, table A1, in
fresh water. The thrusters' lag, some 70 ms, and the tether are left out.

Publications differ by a factor of about seven in the drag of surge: by von Benzon et al. full
thrust holds 0.73 m/s, by Wu, 6-DoF Modelling and Control of a Remotely Operated Vehicle, Flinders
University, 2018, tables 5.2 and 5.3, 2.1 m/s. So there is a model by either, with the same hull and
thrusters.

The autopilot has a gyroscope, an attitude and no velocity log. So surge, sway and heave get the
thrust that drag and momentum ask for at the commanded velocity through the water. The roll is
steered to level by its rate, and the rates of roll, pitch and yaw by proportional and integral
action on the gyroscope. Weight, buoyancy and righting moment are known and cancelled.
"""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from uuv_optical_array.control.vehicles.hydrodynamics import Body, advance, coriolis
from uuv_optical_array.control.vehicles.sea import STILL_SEA, Sea
from uuv_optical_array.control.vehicles.vehicle import Vehicle, VehicleLimits
from uuv_optical_array.core.geometry import FLU_FRD, Array

BLUEROV2 = Body(
    inertia=np.array([13.5, 13.5, 13.5, 0.26, 0.23, 0.37]),
    added_mass=np.array([6.36, 7.12, 18.68, 0.189, 0.135, 0.222]),
    linear_damping=np.array([13.7, 0.0, 33.0, 0.0, 0.8, 0.0]),
    quadratic_damping=np.array([141.0, 217.0, 190.0, 1.19, 0.47, 1.5]),
    volume_m3=0.0134,
    buoyancy_at=np.array([0.0, 0.0, -0.01]),
)
BLUEROV2_WU = replace(
    BLUEROV2,
    added_mass=np.array([5.5, 12.7, 14.57, 0.12, 0.12, 0.12]),
    linear_damping=np.array([4.03, 6.22, 5.18, 0.07, 0.07, 0.07]),
    quadratic_damping=np.array([18.18, 21.66, 36.99, 1.55, 1.55, 1.55]),
)
# Places (m, FRD) and directions of the eight thrusters: four level ones at 45 deg, four upright.
THRUSTER_PLACES = np.array(
    [[x, y, 0.085] for x in (0.156, -0.156) for y in (0.111, -0.111)]
    + [[x, y, 0.0] for x in (0.12, -0.12) for y in (0.218, -0.218)]
)
THRUSTER_DIRECTIONS = np.array(
    [[x, y, 0.0] for x, y in math.sqrt(0.5) * np.array([[1, -1], [1, 1], [-1, -1], [-1, 1]])]
    + [[0.0, 0.0, -1.0]] * 4
)
# Thrust of one at full voltage, either way: the paper's polynomial at 1, N.
MAX_THRUST_N = -140.3 + 389.9 - 404.1 + 176.0 + 8.9
# Force and moment of each thruster per newton, shape (6, 8).
ALLOCATION: Array = np.vstack(
    [THRUSTER_DIRECTIONS.T, np.cross(THRUSTER_PLACES, THRUSTER_DIRECTIONS).T]
)
_TO_THRUSTERS = np.linalg.pinv(ALLOCATION)

STEP_S = 0.05  # longest step of integration and period of the autopilot
LEVELLING_PER_S = 1.0  # roll rate per roll
RATE_GAIN_PER_S, RATE_INTEGRAL_PER_S2 = 10.0, 25.0  # both poles of the rates at -5/s


def flu_to_frd(vectors: Array) -> Array:
    """Turn vectors, ``(3,)`` or ``(6,)``, from REP 103's axes to Fossen's; its own inverse."""
    turned: Array = (vectors.reshape(-1, 3) * FLU_FRD).reshape(vectors.shape)
    return turned


def saturated(wrench: Array) -> Array:
    """Return the force and moment that the thrusters give for one wanted, N and N m, ``(6,)``.

    The thrusts have the least sum of squares. The moment comes first, so that the vehicle stays
    upright; the force is scaled down where a thruster is at its limit.
    """
    turning = np.clip(_TO_THRUSTERS[:, 3:] @ wrench[3:], -MAX_THRUST_N, MAX_THRUST_N)
    pushing = _TO_THRUSTERS[:, :3] @ wrench[:3]
    spare = MAX_THRUST_N - np.sign(pushing) * turning
    share = min(1.0, float(np.min(spare / np.maximum(np.abs(pushing), 1e-9))))
    result: Array = ALLOCATION @ (turning + share * pushing)
    return result


class BlueRov2(Vehicle):
    """A `Vehicle` that obeys as well as a BlueROV2 Heavy's autopilot can, at any pitch."""

    body: ClassVar[Body] = BLUEROV2
    limits = VehicleLimits(speed=(0.7, 0.55, 0.6, 0.6, 0.6))  # what the thrusters can hold

    def __init__(
        self, position: ArrayLike, pitch: float = 0.0, yaw: float = 0.0, sea: Sea = STILL_SEA
    ) -> None:
        super().__init__(position, pitch, yaw, sea)
        self._velocity: Array = np.zeros(6)  # over ground, in the body's frame
        self._turned = np.zeros(3)  # integral of the missing turn rates, FRD, rad

    @property
    def linear(self) -> Array:
        """Velocity over ground in the body frame, m/s, shape ``(3,)``."""
        return self._velocity[:3].copy()

    @property
    def angular(self) -> Array:
        """Angular velocity in the body frame, rad/s, shape ``(3,)``."""
        return self._velocity[3:].copy()

    def step(self, linear: ArrayLike, angular: ArrayLike, dt: float) -> None:
        """Move on; parameters and errors are those of `Vehicle.step`."""
        self._ramped(linear, angular, dt)  # refuses before anything has changed
        steps = math.ceil(dt / STEP_S)
        for _ in range(steps):
            step_s = dt / steps
            rate = self._ramped(linear, angular, step_s)
            ramp, self._rate = (rate - self._rate) / step_s, rate
            self._advance(self._thrust(rate, ramp, step_s), step_s)

    def _thrust(self, rate: Array, ramp: Array, step_s: float) -> Array:
        """Return force and moment, FRD, that the autopilot makes for a rate and its change."""
        target, change = (flu_to_frd(np.insert(values, 3, 0.0)) for values in (rate, ramp))
        target[3] = -LEVELLING_PER_S * self.roll
        missing = target[3:] - flu_to_frd(self.angular)
        change[3:] += RATE_GAIN_PER_S * missing + RATE_INTEGRAL_PER_S2 * self._turned
        down = flu_to_frd(-self.rotation[2])
        mass = self.body.inertia + self.body.added_mass
        wanted = (
            mass * change
            + coriolis(mass, target)
            + self.body.damping(target)
            + self.body.restoring(down)
        )
        wrench = saturated(wanted)
        if np.allclose(wrench[3:], wanted[3:]):  # an integral that cannot act would wind up
            self._turned += missing * step_s
        return wrench

    def _advance(self, thrust: Array, step_s: float) -> None:
        # The same half turn of world and body leaves the angles' size and changes their sign.
        pitch, yaw = -self.pitch, -self.yaw
        state = np.concatenate(
            [
                flu_to_frd(self.position),
                Rotation.from_euler("ZYX", [yaw, pitch, self.roll]).as_quat(),
                flu_to_frd(self._velocity),
            ]
        )
        state = advance(self.body, state, thrust, self._water_frd, self.t_s, step_s)
        self.position = flu_to_frd(state[:3])
        yaw, pitch, roll = Rotation.from_quat(state[3:7]).as_euler("ZYX")
        turned = math.remainder(-float(yaw) - self.yaw, 2 * math.pi)
        self.roll, self.pitch, self.yaw = float(roll), -float(pitch), self.yaw + turned
        self._velocity = flu_to_frd(state[7:])
        self.t_s += step_s

    def _water_frd(self, place: Array, t_s: float) -> tuple[Array, Array]:
        position = flu_to_frd(place)
        return (
            flu_to_frd(self.sea.velocity(position, t_s)),
            flu_to_frd(self.sea.acceleration(position, t_s)),
        )


class BlueRov2Wu(BlueRov2):
    """The same with added mass and damping of Wu (2018), by which it is as fast as `Vehicle`."""

    body = BLUEROV2_WU
    limits = Vehicle.limits
