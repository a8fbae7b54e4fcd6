"""What RViz shows: a beam, a body and a station where they are, by files that name our topics."""

import re

import numpy as np
import pytest
import yaml
from rclpy.parameter import Parameter
from visualization_msgs.msg import MarkerArray

from uuv_optical_array.control.following import State
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.lamp.lamps import BeaconLamp
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.nodes.estimator_node import EstimatorNode
from uuv_optical_array.nodes.formation_node import FormationNode
from uuv_optical_array.nodes.shared import markers


def corners(marker):
    return np.array([[point.x, point.y, point.z] for point in marker.points])


@pytest.mark.parametrize("name", ["follow", "leading_lights"])
def test_a_lamp_has_cones_of_one_and_two_standard_deviations_from_its_place_along_its_axis(name):
    scene = load_scene(name)
    lamps, drawn = scene.lamps or [BeaconLamp()], markers.beam(scene, "leader/beacon", 9.0)
    assert {(marker.ns, marker.id) for marker in drawn} == {
        (f"beam_{stds}_sigma", i) for stds in (1, 2) for i in range(len(lamps))
    }
    for marker in drawn:
        assert (marker.header.frame_id, marker.frame_locked) == ("leader/beacon", True)
        assert len(marker.points) % 3 == 0
        lamp = lamps[marker.id]
        places = corners(marker) - [lamp.x_m, lamp.y_m, lamp.z_m]
        ends = places[np.linalg.norm(places, axis=1) > 1e-9]
        assert 0 < len(ends) < len(places)
        up, starboard = np.radians([lamp.pitch_deg, lamp.yaw_deg])
        axis = [-np.cos(up) * np.cos(starboard), -np.cos(up) * np.sin(starboard), np.sin(up)]
        np.testing.assert_allclose(ends @ axis, 9.0)
        off_axis = np.degrees(np.arccos(9.0 / np.linalg.norm(ends, axis=1)))
        sigma = lamp.beam_sigma_deg or scene.lamp.beam_sigma_deg
        np.testing.assert_allclose(off_axis, int(marker.ns[5]) * sigma)


@pytest.mark.parametrize(("end", "up"), [("", 1), ("_frd", -1), ("_ned", -1)])
def test_body_and_station_are_upright_in_the_axes_of_their_frames(end, up):
    scene = load_scene("follow")
    hull, fin = map(corners, markers.body(scene, f"base_link{end}"))
    assert np.abs(hull).max() == pytest.approx(scene.array.bow_m)
    assert (up * fin[:, 2]).min() == 0 < (up * fin[:, 2]).max()
    place = markers.station(np.array([-5.0, 1.0, 2.0]), f"beacon{end}").pose.position
    assert (place.x, place.y, place.z) == (-5.0, up * 1.0, up * 2.0)


@pytest.mark.parametrize(("end", "up"), [("", 1), ("_frd", -1)])
def test_the_state_stands_above_the_follower_in_words_and_a_colour_of_its_own(end, up):
    texts = {
        name: markers.state(State(name, 3.0, "it is so"), f"rov/base_link{end}")
        for name in ("locked", "coasting", "lost")
    }
    assert texts["lost"].text == "lost\nit is so"
    assert {up * text.pose.position.z for text in texts.values()} == {1.2}
    red = texts["lost"].color
    green = texts["locked"].color
    assert red.r > 2 * red.g
    assert green.g > 2 * green.r
    assert texts["coasting"].color not in (red, green)


def test_they_reach_a_listener_that_comes_later_again_and_again(lab, scene_file):
    lab.begin({"scene": scene_file, "estimator_node:method": "sam", "frame_prefix": "rov/"})
    lab.start(EstimatorNode)
    formation = lab.start(FormationNode)
    formation.show_station("rov/leader/beacon")
    arrays = lab.listen_late(MarkerArray, "markers")  # as in rviz/

    def heard():
        return [marker for array in arrays for marker in array.markers]

    def times(name, x=None):
        """Count how often a marker came, at a place if one is given."""
        return sum(marker.ns == name and x in (None, marker.pose.position.x) for marker in heard())

    # What lasts comes once to a listener.
    lab.until(lambda: times("hull") > 1 and times("station") > 1, "the markers of two nodes, again")
    beam, body = "rov/leader/beacon", "rov/base_link_by_light"
    assert {marker.ns: marker.header.frame_id for marker in heard()} == {
        **{"beam_1_sigma": beam, "beam_2_sigma": beam, "station": beam},
        **{"hull": body, "fin": body, "state": "rov/follower/base_link"},
    }
    formation.set_parameters([Parameter("station_m", value=[-5.0, 0.0, 0.0])])
    formation.show_station("rov/leader/beacon")
    lab.until(lambda: times("station", -5.0) > 1, "the station's new place, again")


@pytest.mark.parametrize("name", ["follow", "formation"])
def test_rviz_listens_to_topics_that_the_reference_lists(name):
    folder = files.shared_file("config").parent
    page = (folder / "docs/reference/topics.md").read_text(encoding="utf-8")
    file = yaml.safe_load((folder / f"rviz/{name}.rviz").read_text(encoding="utf-8"))
    displays = file["Visualization Manager"]["Displays"]
    topics = [display["Topic"]["Value"] for display in displays if "Topic" in display]
    assert len(topics) > 4
    for topic in topics:
        assert f"| `{re.sub('^follower_[1-4]/', '', topic)}` |" in page
