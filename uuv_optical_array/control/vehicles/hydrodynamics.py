"""Motion of a body under water in six degrees of freedom, by Fossen's equations.

The frames are Fossen's: the world is x, y and z down, the body forward, right and down (FRD), its
origin the centre of gravity. With the velocity of the body over ground ``v``, that of the water
``w`` and that through the water ``r = v - w``, all in the body's frame,

    M dv/dt + C(M) v + A dr/dt + C(A) r + D(r) r + g = thrust + V rho dw/dt

with the rigid body's inertia M, the added mass A, C by Kirchhoff's equations from the momenta
``M v`` and ``A r``, damping D linear and quadratic, restoring forces g, and the pressure of
accelerated water on the displaced volume V (Fossen, Handbook of Marine Craft Hydrodynamics and
Motion Control, 2011, chapters 3, 4, 6 and 8; Newman, Marine Hydrodynamics, 1977, chapter 4). How
the water turns and shears within the length of the body is left out. The classical Runge-Kutta rule
with a fixed step integrates it: runs repeat exactly, and the parameters err far more.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from uuv_optical_array.control.vehicles.sea import GRAVITY_M_PER_S2
from uuv_optical_array.core.geometry import Array

# Velocity and acceleration of the water, m/s and m/s^2, at a place in the world (m) and a time (s).
Water = Callable[[Array, float], tuple[Array, Array]]
PLACE, ATTITUDE, VELOCITY = slice(0, 3), slice(3, 7), slice(7, 13)  # of a state


@dataclass(frozen=True, eq=False)
class Body:
    """What moves: diagonal inertia and damping, surge, sway, heave, roll, pitch, yaw.

    - inertia: mass, kg, thrice, and moments of inertia, kg m^2, shape ``(6,)``, > 0.
    - added_mass: of the water that moves along, kg and kg m^2, shape ``(6,)``, >= 0.
    - linear_damping, quadratic_damping: per velocity through the water, N s/m and N m s, and per
      its square; shape ``(6,)``, >= 0.
    - volume_m3, water_density: of the displaced water, m^3 and kg/m^3.
    - buoyancy_at: centre of buoyancy from that of gravity, FRD, m, shape ``(3,)``.
    """

    inertia: Array
    added_mass: Array
    linear_damping: Array
    quadratic_damping: Array
    volume_m3: float
    buoyancy_at: Array
    water_density: float = 1000.0

    def damping(self, through_water: Array) -> Array:
        """Return force and moment, N and N m, at a velocity through the water, shape ``(6,)``."""
        return (self.linear_damping + self.quadratic_damping * abs(through_water)) * through_water

    def restoring(self, down: Array) -> Array:
        """Return what holds weight and buoyancy, N and N m, ``(6,)``; `down` is a unit vector."""
        buoyancy = self.water_density * GRAVITY_M_PER_S2 * self.volume_m3
        net = self.inertia[0] * GRAVITY_M_PER_S2 - buoyancy
        return np.concatenate([-net * down, buoyancy * _cross(self.buoyancy_at, down)])


def coriolis(mass: Array, velocity: Array) -> Array:
    """Return the force and moment that turn a momentum, N and N m, shape ``(6,)``.

    `mass` is a diagonal, `velocity` in the body's frame, m/s and rad/s, shape ``(6,)`` each.
    """
    momentum, speed, turn = mass * velocity, velocity[:3], velocity[3:]
    moment = _cross(turn, momentum[3:]) + _cross(speed, momentum[:3])
    return np.concatenate([_cross(turn, momentum[:3]), moment])


def advance(
    body: Body, state: Array, thrust: Array, water: Water, t_s: float, step_s: float
) -> Array:
    """Return the state after one step from a time, under a thrust, N and N m, shape ``(6,)``.

    A state is the place in the world (m), the attitude (unit quaternion x, y, z, w from the body to
    the world) and the velocity over ground in the body's frame (m/s and rad/s), shape ``(13,)``.
    """

    def slope(at: Array, after_s: float) -> Array:
        return _slope(body, at, thrust, *water(at[PLACE], t_s + after_s))

    half_s = step_s / 2
    k1 = slope(state, 0.0)
    k2 = slope(state + half_s * k1, half_s)
    k3 = slope(state + half_s * k2, half_s)
    k4 = slope(state + step_s * k3, step_s)
    new: Array = state + step_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    new[ATTITUDE] /= np.linalg.norm(new[ATTITUDE])
    return new


def _slope(
    body: Body, state: Array, thrust: Array, water_velocity: Array, water_acceleration: Array
) -> Array:
    rotation, velocity = Rotation.from_quat(state[ATTITUDE]).as_matrix(), state[VELOCITY]
    turn = velocity[3:]
    flow, flow_acceleration = rotation.T @ water_velocity, rotation.T @ water_acceleration
    # As the body sees it, the flow turns the other way.
    flow_change = flow_acceleration - _cross(turn, flow)
    through_water = velocity.copy()
    through_water[:3] -= flow
    force = thrust - body.damping(through_water) - body.restoring(rotation[2])
    force -= coriolis(body.inertia, velocity) + coriolis(body.added_mass, through_water)
    force[:3] += body.added_mass[:3] * flow_change
    force[:3] += body.water_density * body.volume_m3 * flow_acceleration
    vector, w = state[3:6], state[6]
    spin = np.array([*(w * turn + _cross(vector, turn)), -vector @ turn]) / 2
    acceleration = force / (body.inertia + body.added_mass)
    return np.concatenate([rotation @ velocity[:3], spin, acceleration])


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of two triples; `numpy.cross` takes ten times as long."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
