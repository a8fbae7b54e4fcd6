"""The paths of a leader: what ready ones do, how files are read, and which are refused."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from uuv_optical_array.control.vehicles.bluerov2 import BlueRov2
from uuv_optical_array.control.vehicles.leader_path import PATHS, lead, leader_path, leader_twist
from uuv_optical_array.control.vehicles.sea import Sea
from uuv_optical_array.control.vehicles.vehicle import Vehicle, VehicleLimits

DT = 0.05
HEAD = "t_s,surge_m_per_s,sway_m_per_s,heave_m_per_s,pitch_rate_deg_per_s,yaw_rate_deg_per_s"


def swum(path, seconds, leader=None):
    """Return a leader that swam its path, and its states x, y, z, pitch, yaw after each step."""
    leader = leader or Vehicle(np.zeros(3))
    path_s, states = 0.0, []
    for _ in range(round(seconds / DT)):
        path_s = lead(leader, path_s, DT, path)
        states.append([*leader.position, leader.pitch, leader.yaw])
    assert path_s == pytest.approx(seconds)
    return leader, np.array(states)


def test_leader_turns_to_port_and_dives_in_the_first_minute():
    leader, pitches = Vehicle(np.zeros(3)), []
    for step in range(round(60 / DT)):
        leader.step(*leader_twist(step * DT), DT)
        pitches.append(leader.pitch)
    assert np.degrees(leader.yaw) == pytest.approx(35, abs=0.01)
    assert leader.pitch == pytest.approx(0, abs=1e-6)
    assert leader.position[2] == pytest.approx(-1.4, abs=0.02)
    assert np.degrees(max(pitches)) == pytest.approx(10, abs=0.01)
    assert min(pitches) > -1e-6


def test_leader_path_is_smooth_bounded_and_periodic():
    times = np.arange(0, 240, 0.05)
    linear, angular = (np.array(part) for part in zip(*map(leader_twist, times), strict=True))
    assert (linear == [0.5, 0, 0]).all()
    assert (angular[:, 0] == 0).all()
    assert np.degrees(np.abs(angular).max(axis=0)) == pytest.approx([0, 2.0, 3.5], abs=1e-4)
    # Never more than a vehicle with the default limits can follow.
    assert np.abs(np.diff(angular, axis=0)).max() < VehicleLimits().acceleration[4] * 0.05
    assert angular[2400:] == pytest.approx(angular[:2400], abs=1e-9)
    assert (angular[times < 12] == 0).all()


def test_every_ready_path_is_within_the_limits_of_the_vehicle():
    for name, path in PATHS.items():
        assert leader_path(name) is path
        for t_s in np.arange(0.0, 130.0, 0.25):
            linear, angular = path(t_s)
            assert (np.abs([*linear, *angular[1:]]) <= VehicleLimits().speed).all()
            assert angular[0] == 0


@pytest.mark.parametrize("kind", [Vehicle, BlueRov2])
def test_a_leader_turns_by_90_deg_at_20_deg_per_s(kind):
    leader, states = swum(PATHS["right_angles"], 20.0, kind(np.zeros(3)))
    assert np.degrees(leader.yaw) == pytest.approx(90, abs=0.1)
    at = round(14.0 / DT)
    assert np.degrees(states[at, 4] - states[at - 1, 4]) / DT == pytest.approx(20, rel=0.01)
    assert leader.linear == pytest.approx([0.5, 0, 0], abs=0.01)


def test_a_circle_closes_and_has_the_radius_of_speed_by_turn():
    _, states = swum(PATHS["circle"], 5 + 72.0)
    once = states[round(5 / DT) - 1 :]  # up to speed
    assert once[-1, 4] - once[0, 4] == pytest.approx(2 * np.pi, rel=1e-6)
    assert once[-1, :3] == pytest.approx(once[0, :3], abs=1e-3)
    assert np.ptp(once[:, 0]) / 2 == pytest.approx(0.5 / np.radians(5), rel=1e-3)


def test_a_zigzag_goes_30_deg_to_both_sides_and_comes_back_to_its_course():
    _, states = swum(PATHS["zigzag"], 80.0)
    headings = np.degrees(states[:, 4])
    assert [headings.min(), headings.max(), headings[-1]] == pytest.approx([-30, 30, 0], abs=0.01)
    assert (headings[: round(5 / DT)] == 0).all()


@pytest.mark.parametrize(
    ("name", "seconds", "speeds"),
    [
        # Speeds ahead, near the end of each row.
        ("straight", 20.0, {10: 0.5, 19: 0.5}),
        ("stop_and_go", 40.0, {9: 0.5, 15: 0.0, 29: 0.5, 35: 0.0}),
        ("dash", 60.0, {9: 0.5, 19: 1.2, 29: 0.5, 49: 1.2}),
        ("back_up", 40.0, {19: 0.5, 24: 0.0, 34: -0.3, 39: 0.0}),
        ("stand", 10.0, {5: 0.0}),
    ],
)
def test_ready_paths_have_the_speeds_of_their_names(name, seconds, speeds):
    _, states = swum(PATHS[name], seconds)
    for t_s, speed in speeds.items():
        at = round(t_s / DT)
        assert (states[at, 0] - states[at - 1, 0]) / DT == pytest.approx(speed, abs=1e-9)
    assert not states[:, 1:].any()


def test_a_dive_goes_down_by_3_m_and_comes_up_again():
    _, states = swum(PATHS["dive"], 45.0)
    assert states[:, 2].min() == pytest.approx(-3.0, abs=1e-6)
    assert states[-1, 2] == pytest.approx(0.0, abs=1e-6)


def write(folder, text, **how):
    path = folder / "path.csv"
    path.write_text(text, **({"encoding": "utf-8"} | how))
    return path


ROWS = """# from a dive
2,0.3,0.1,-0.2,1,-4

6.5,-0.2,0,0,0,10
9,0,0,0,0,0
"""


@pytest.mark.parametrize(
    "text",
    [
        f"{HEAD}\n{ROWS}",
        f"{HEAD}\r\n{ROWS}\r\n\r\n  \n,,,,,\n",
        f"\ufeff{HEAD}\n{ROWS}\n",  # the byte order mark of a spreadsheet
        f"{HEAD.replace(',', ', ')}\n{ROWS.replace(',', ' , ')}",
        f'"{HEAD.replace(",", chr(34) + "," + chr(34))}"\n{ROWS}',
    ],
    ids=["plain", "blank ends", "byte order mark", "blanks", "quotes"],
)
def test_each_row_of_a_file_holds_until_the_next_and_the_last_for_ever(tmp_path, text):
    path = leader_path(write(tmp_path, text, newline=""))
    rows = {
        0.0: [0, 0, 0, 0, 0],
        1.999: [0, 0, 0, 0, 0],
        2.0: [0.3, 0.1, -0.2, 1, -4],
        6.499: [0.3, 0.1, -0.2, 1, -4],
        6.5: [-0.2, 0, 0, 0, 10],
        9.0: [0, 0, 0, 0, 0],
        1e6: [0, 0, 0, 0, 0],
    }
    for t_s, row in rows.items():
        linear, angular = path(t_s)
        assert linear == pytest.approx(row[:3])
        assert np.degrees(angular) == pytest.approx([0, *row[3:]])


def test_columns_may_stand_in_any_order(tmp_path):
    head = ",".join(reversed(HEAD.split(",")))
    linear, angular = leader_path(str(write(tmp_path, f"{head}\n5,4,0.3,0.2,0.1,0\n")))(0.0)
    assert linear == pytest.approx([0.1, 0.2, 0.3])
    assert angular == pytest.approx(np.radians([0, 4, 5]))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "columns none; give the columns t_s,surge"),
        ("0,1,0,0,0,0\n", "columns 0, 1, 0, 0, 0, 0; give the columns t_s,surge"),
        (HEAD.replace("yaw", "jaw"), "jaw_rate_deg_per_s; give"),
        (HEAD.replace(",", ";"), "give the columns"),
        (f"{HEAD},{HEAD}", "give the columns"),
        (HEAD, "no row below the columns"),
        (f"{HEAD}\n0,0.5,0,0,0\n", "line 2: 5 cells; give 6"),
        (f"{HEAD}\n\n#\n0,0.5,0,0,0,fast\n", "line 4: yaw_rate_deg_per_s: 'fast' is not a num"),
        (f"{HEAD}\n0,,0,0,0,0\n", "line 2: surge_m_per_s: '' is not a number"),
        (f"{HEAD}\n0,nan,0,0,0,0\n", "line 2: surge_m_per_s: nan is out of bounds"),
        (f"{HEAD}\n0,0,0,-3.1,0,0\n", r"heave_m_per_s: -3.1 is out of .*from -3 to 3 m/s"),
        (f"{HEAD}\n0,0,0,0,0,91\n", r"yaw_rate_deg_per_s: 91.0 is out of .* -90 to 90 deg/s"),
        (f"{HEAD}\n-1,0,0,0,0,0\n", "t_s: -1.0 is out of bounds; it must be from 0 to 1e\\+06 s"),
        (f"{HEAD}\n0,0,0,0,0,0\n0,1,0,0,0,0\n", "line 3: t_s: 0 is not later than 0 s"),
        (f"{HEAD}\n5,0,0,0,0,0\n4,1,0,0,0,0\n", "line 3: t_s: 4 is not later than 5 s"),
    ],
)
def test_a_bad_file_is_refused_with_its_line_value_and_bound(tmp_path, text, words):
    file = write(tmp_path, text)
    with pytest.raises(ValueError, match=words) as error:
        leader_path(file)
    assert str(file) in str(error.value)


@pytest.mark.parametrize("made", [lambda path: path.write_bytes(b"\xff\xfe\x00"), lambda path: 0])
def test_what_is_no_text_or_no_file_is_refused(tmp_path, made):
    path = tmp_path / "path.csv"
    words = "give a table as CSV in UTF-8" if made(path) else "nor a file; choose"
    with pytest.raises(ValueError, match=words):
        leader_path(path)
    for wrong, cure in (("zigzags", "did you mean zigzag"), ("", "choose demonstration")):
        with pytest.raises(ValueError, match=cure):
            leader_path(wrong)


def test_a_path_is_over_ground_whatever_the_current():
    sea = Sea((0.2, -0.3, 0.1))
    leader, _ = swum(PATHS["circle"], 30.0, Vehicle(np.zeros(3), sea=sea))

    def slope(_, state):
        return [0.5 * np.cos(state[2]), 0.5 * np.sin(state[2]), np.radians(5)]

    # Up to speed it drifts, by a second's current at most; from then on it is as without one.
    end = solve_ivp(slope, (0, 30), [0, 0, 0], rtol=1e-9).y[:, -1]
    assert leader.position[:2] == pytest.approx(end[:2], abs=0.5)
    over_ground = 0.5 * np.array([np.cos(leader.yaw), np.sin(leader.yaw), 0.0])
    assert leader.rotation @ leader.linear == pytest.approx(over_ground, abs=0.003)
