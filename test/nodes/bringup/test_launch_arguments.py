"""Arguments of the launch files: those that a command line gives and no file has are named."""

import re

import pytest

from uuv_optical_array.nodes.bringup.launch_arguments import FOLLOW, FORMATION, parsed, unknown

FILE = "/share/uuv_optical_array/launch/follow.launch.py"
WORDS = "ros2", "launch", "uuv_optical_array", "follow.launch.py"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("scene:=reference", "sigterm_timeout:=60"), []),
        (("stations:=[-5,0,0]",), ["stations: .*did you mean station"]),
        (("scene:=a:=b", "method:=sam"), ["method: .*params_file"]),
    ],
)
def test_an_argument_that_no_file_has_is_named(given, said):
    texts = unknown(FILE, FOLLOW, [*WORDS, *given])
    assert len(texts) == len(said)
    for text, words in zip(texts, said, strict=True):
        assert re.search(words, text)


def test_arguments_of_a_users_own_launch_file_are_its_own():
    assert unknown(FILE, FOLLOW, ["ros2", "launch", "boat.launch.py", "rudder:=2"]) == []
    assert unknown(FILE, FOLLOW, ["ros2", "launch", "p", "formation.launch.py", "chain:=1"]) == []
    assert unknown("formation.launch.py", FORMATION, ["x/formation.launch.py", "chain:=1"]) == []


def test_a_value_that_is_no_yaml_is_refused_by_the_name_of_its_argument():
    with pytest.raises(ValueError, match="station: not YAML: line 1: "):
        parsed("station", "[-4.5, 0, 0")
    assert parsed("station", "[-4.5, 0, 0]") == [-4.5, 0, 0]
