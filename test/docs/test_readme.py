"""The README is short."""

from pathlib import Path

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")


def test_it_has_less_than_a_thousand_words():
    assert len(README.split()) < 1000
