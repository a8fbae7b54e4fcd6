"""The README is short, and its topics are those of the nodes."""

import re
from pathlib import Path

from generated import reference

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")


def test_it_has_less_than_a_thousand_words():
    assert len(README.split()) < 1000


def test_every_topic_stands_in_the_row_of_its_node():
    rows = dict(re.findall(r"^\| `(\w+_node)`[^|]*\|(.*)\|$", README, re.MULTILINE))
    for node, published, name, _ in reference.all_topics():
        subscribes, publishes = rows[node].split("|")
        # A name in brackets follows from parameters.
        assert "<" in name or f"`{name}`" in (publishes if published else subscribes), (node, name)
