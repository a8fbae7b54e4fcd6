"""Fossen's equations against closed forms and a second implementation by matrices and angles."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from uuv_optical_array.control.vehicles.bluerov2 import BLUEROV2
from uuv_optical_array.control.vehicles.hydrodynamics import advance
from uuv_optical_array.control.vehicles.sea import Sea, WaveSettings

G = 9.82
NEUTRAL = replace(BLUEROV2, volume_m3=13.5 / 1000)
NO_DRAG = {"linear_damping": np.zeros(6), "quadratic_damping": np.zeros(6)}
MASS = NEUTRAL.inertia + NEUTRAL.added_mass
TUMBLING = np.array([0.5, -0.3, 0.2, 0.4, -0.3, 0.5])


def still(_, __):
    return np.zeros(3), np.zeros(3)


def at_rest(*, roll=0.0, pitch=0.0, yaw=0.0, velocity=None):
    attitude = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    return np.concatenate([np.zeros(3), attitude, np.zeros(6) if velocity is None else velocity])


def run(body, state, seconds, thrust=None, water=still, step_s=0.02):
    """Return the states on the way, a row a step."""
    states = [state]
    for step in range(round(seconds / step_s)):
        wrench = np.zeros(6) if thrust is None else thrust
        states.append(advance(body, states[-1], wrench, water, step * step_s, step_s))
    return np.array(states)


def energy(body, states):
    """Return kinetic and potential energy, the water's share of both included, J."""
    kinetic = states[:, 7:] ** 2 @ (body.inertia + body.added_mass) / 2
    lifted = Rotation.from_quat(states[:, 3:7]).apply(body.buoyancy_at)[:, 2]
    buoyancy = 1000 * G * body.volume_m3
    potential = (buoyancy - body.inertia[0] * G) * states[:, 2] + buoyancy * lifted
    return kinetic + potential


def test_energy_is_lost_to_drag_alone():
    body = BLUEROV2
    start = at_rest(roll=0.5, pitch=-0.8, yaw=1.0, velocity=TUMBLING)
    free = energy(replace(body, **NO_DRAG), run(replace(body, **NO_DRAG), start, 5))
    assert free == pytest.approx(np.full(len(free), free[0]), abs=1e-5)
    states = run(body, start, 4, step_s=0.01)
    power = np.array([body.damping(row) @ row for row in states[:, 7:]])
    lost = np.concatenate([[0], np.cumsum((power[1:] + power[:-1]) / 2 * 0.01)])
    assert energy(body, states) + lost == pytest.approx(np.full(len(lost), free[0]), abs=4e-3)
    assert lost[-1] > 1.0


@pytest.mark.parametrize("current", [(0.3, 0.0, 0.0), (-0.2, 0.4, 0.1)])
def test_a_current_carries_the_motion_in_still_water_along(current):
    def flow(_, __):
        return np.array(current), np.zeros(3)

    thrust = np.array([20.0, -8.0, 5.0, 0.2, -0.3, 0.4])
    start = at_rest(roll=0.2, pitch=-0.4, yaw=1.0, velocity=TUMBLING)
    carried = start.copy()
    carried[7:10] += Rotation.from_quat(start[3:7]).inv().apply(current)
    alone, with_flow = run(BLUEROV2, start, 4, thrust), run(BLUEROV2, carried, 4, thrust, flow)
    times = 0.02 * np.arange(len(alone))[:, None]
    assert with_flow[:, :3] - alone[:, :3] == pytest.approx(times * current, abs=1e-5)
    assert with_flow[:, 3:7] == pytest.approx(alone[:, 3:7], abs=1e-5)


def test_a_neutral_body_moves_as_the_water_that_it_displaces_would():
    def surge(_, t_s):
        along = np.array([0.8, -0.3, 0.5])
        return 0.3 * np.sin(2 * t_s) * along, 0.6 * np.cos(2 * t_s) * along

    turning = np.array([0.0, 0.0, 0.0, 0.3, 0.2, -0.4])
    states = run(NEUTRAL, at_rest(pitch=0.3, velocity=turning), 5, water=surge)
    velocity = Rotation.from_quat(states[:, 3:7]).apply(states[:, 7:10])
    expected = np.array([surge(np.zeros(3), 0.02 * i)[0] for i in range(len(states))])
    assert velocity == pytest.approx(expected, abs=1e-5)


def skew(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def coriolis(mass, velocity):
    """Fossen's skew-symmetric C of a full 6 x 6 inertia."""
    upper = skew(mass[:3] @ velocity)
    return np.block([[np.zeros((3, 3)), -upper], [-upper, -skew(mass[3:] @ velocity)]])


def test_general_motion_in_waves_agrees_with_matrices_angles_and_another_integrator():
    waves = WaveSettings(wave_height_m=1.0, wave_period_s=5.0, wave_direction_deg=40, depth_m=4.0)
    sea, flip = Sea((0.2, 0.1, 0.0), waves), np.array([1.0, -1.0, -1.0])
    rigid, added = np.diag(BLUEROV2.inertia), np.diag(BLUEROV2.added_mass)
    thrust = np.array([25.0, -10.0, 8.0, 0.1, -0.3, 0.5])

    def water(place, t_s):
        velocity, change = sea.velocity(place * flip, t_s), sea.acceleration(place * flip, t_s)
        return velocity * flip, change * flip

    def slope(t_s, state):
        (roll, pitch, yaw), velocity = state[3:6], state[6:]
        to_world = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        flow, change = (to_world.T @ part for part in water(state[:3], t_s))
        flow_6 = np.concatenate([flow, np.zeros(3)])
        flow_change = np.concatenate([change - np.cross(velocity[3:], flow), np.zeros(3)])
        through = velocity - flow_6
        damping = np.diag(BLUEROV2.linear_damping + BLUEROV2.quadratic_damping * np.abs(through))
        weight, buoyancy = 13.5 * G, 13.4 * G
        sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
        net, arm = weight - buoyancy, 0.01 * buoyancy
        g = [net * sp, -net * cp * sr, -net * cp * cr, arm * cp * sr, arm * sp, 0]
        pressure = np.concatenate([13.4 * change, np.zeros(3)])
        force = thrust - coriolis(rigid, velocity) @ velocity - coriolis(added, through) @ through
        force = force - damping @ through - g + added @ flow_change + pressure
        p, q, r = velocity[3:]
        spin = [p + (q * sr + r * cr) * sp / cp, q * cr - r * sr, (q * sr + r * cr) / cp]
        turned = np.linalg.solve(rigid + added, force)
        return np.concatenate([to_world @ velocity[:3], spin, turned])

    start = np.concatenate([np.zeros(3), [0.1, -0.3, 0.5], TUMBLING])
    end = solve_ivp(slope, (0, 4), start, rtol=1e-8, atol=1e-9).y[:, -1]
    found = run(
        BLUEROV2,
        at_rest(roll=0.1, pitch=-0.3, yaw=0.5, velocity=TUMBLING),
        4,
        thrust,
        water,
        step_s=0.05,
    )[-1]
    assert found[:3] == pytest.approx(end[:3], abs=1e-4)
    turn = Rotation.from_quat(found[3:7]).inv() * Rotation.from_euler("ZYX", end[5:2:-1])
    assert turn.magnitude() < 1e-4
    assert found[7:] == pytest.approx(end[6:], abs=1e-4)
