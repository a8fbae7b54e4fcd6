"""The README is short, its topics are those of the nodes, and what it shows in Python runs."""

import dataclasses
import re
from pathlib import Path

import numpy as np
from generated import reference

from uuv_optical_array import build_table
from uuv_optical_array.core import compilation
from uuv_optical_array.core.settings import Span
from uuv_optical_array.estimation.table import disk

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def test_it_has_less_than_a_thousand_words():
    assert len(README.split()) < 1000


def test_every_topic_stands_in_the_row_of_its_node():
    rows = dict(re.findall(r"^\| `(\w+_node)`[^|]*\|(.*)\|$", README, re.MULTILINE))
    for node, published, name, _ in reference.all_topics():
        subscribes, publishes = rows[node].split("|")
        assert f"`{name}`" in (publishes if published else subscribes), (node, name)


def test_what_it_shows_in_python_finds_the_pose_of_the_image(monkeypatch):
    def coarse(scene):
        spans = dataclasses.asdict(scene.table)
        fewer = {key: Span(start, stop, 5) for key, (start, stop, _) in spans.items()}
        table = dataclasses.replace(scene.table, **fewer)
        return build_table(dataclasses.replace(scene, table=table))

    monkeypatch.setattr(disk, "cached_table", coarse)
    monkeypatch.setattr(compilation, "usable", lambda: False)  # one image is not worth it
    [block] = re.findall(r"^```python\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
    names = {}
    exec(block, names)
    error = np.abs(names["estimate"].pose - names["pose"])
    assert np.all(error < 6 * np.sqrt(names["estimate"].covariance.diagonal()))
