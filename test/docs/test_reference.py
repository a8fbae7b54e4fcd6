"""The pages of the reference are what their generator writes, and it sees what is declared."""

import ast
from xml.etree import ElementTree

import generate_reference as reference
import rclpy
from command_line import run, text_of
from reference_pages.markdown import first_sentence, shown, table
from reference_pages.nodes import all_topics, value_of

from uuv_optical_array.nodes.vehicles_node import VehiclesNode


def test_every_page_and_drawing_is_what_the_generator_makes():
    cure = "run docs/generate_reference.py"
    pages = {path.stem for path in reference.FOLDER.glob("*.md")}
    assert pages == set(reference.PAGES), cure
    for name in pages:
        text = (reference.FOLDER / f"{name}.md").read_text(encoding="utf-8")
        assert text == reference.text_of(name), cure
    for name in reference.DRAWINGS:
        text = (reference.PICTURES / name).read_text(encoding="utf-8")
        assert text == reference.drawing(name), cure


def test_an_arrow_goes_from_each_publisher_to_each_subscriber():
    """By the marks in the row of each topic, beside those that the nodes declare."""
    drawn = ElementTree.fromstring(reference.drawing("nodes.svg"))
    space = "{http://www.w3.org/2000/svg}"
    names = {}
    for text in drawn.iter(f"{space}text"):
        names.setdefault(float(text.get("y")), []).append((float(text.get("x")), text.text))
    columns = {x: name for row in names.values() for x, name in row if name.endswith("_node")}
    found = set()
    for mark in drawn.iter(f"{space}circle"):
        y, x = float(mark.get("cy")), float(mark.get("cx"))
        near = min(columns, key=lambda column: abs(column - x))
        if abs(near - x) <= 15:
            found.add((columns[near], mark.get("stroke") is None, names[y][0][1]))
    assert found == {topic[:3] for topic in all_topics()}


def test_the_schema_of_scenes_is_what_the_command_prints():
    printed = text_of(run, "scenes", "schema")
    assert reference.schema_text() == printed, "run docs/generate_reference.py"


def test_topics_of_a_node_are_those_that_ros_knows():
    """Of the node whose topics are named in a loop."""
    rclpy.init()
    try:
        node = VehiclesNode()
        known = {
            (published, topic, kind.replace("/msg/", "/"))
            for published, ask in (
                (True, node.get_publisher_names_and_types_by_node),
                (False, node.get_subscriber_names_and_types_by_node),
            )
            for topic, (kind, *_) in ask("vehicles_node", "/")
            if kind.startswith(("nav_msgs", "geometry_msgs"))
        }
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    read = [topic for topic in all_topics() if topic.node == "vehicles_node"]
    for published, topic, kind in known:
        same = [f"/{one.name}" for one in read if (one.published, one.kind) == (published, kind)]
        assert topic in same or any("<" in name for name in same), topic


def test_a_bar_in_a_cell_and_a_missing_default_stay_in_their_cell():
    assert table(("a", "b"), [("x | y", "")]).splitlines()[-1] == r"| x \| y |  |"
    assert shown(None) == ""
    assert shown(0) == "0"
    assert first_sentence("Law of ``a`` et al. (2016). More.\n\nRest.") == (
        "Law of `a` et al. (2016)"
    )


def test_a_name_that_a_node_works_out_is_shown_as_it_is_written():
    told = [ast.parse(text, mode="eval").body for text in ("topic", "f'{LEADER}/odometry'")]
    assert [value_of(one, {"LEADER": "leader"}) for one in told] == [
        "<topic>",
        "leader/odometry",
    ]
