"""A page of results gets what a command prints, beside the command."""

import re

import pytest
from pages import PAGES

from uuv_optical_array.cli import report
from uuv_optical_array.cli.options import OptionError

WORDS = ["uuv_array", "limits", "--scene", "my sea.yaml"]
COMMAND = "uuv_array limits --scene 'my sea.yaml'"
BEGIN = report.BEGIN.format(COMMAND)


@pytest.fixture
def page(tmp_path, monkeypatch):
    path = tmp_path / "page.md"
    monkeypatch.setenv(report.PAGE, str(path))
    return path


def printing(text, code=0):
    def program():
        print(text)
        return code

    return program


def test_a_page_gets_the_command_and_what_it_printed(page, capsys):
    assert report.run(printing("a figure"), WORDS) == 0
    assert capsys.readouterr().out == "a figure\n"
    assert page.read_text(encoding="utf-8") == (
        f"{BEGIN}\n\n```sh\n{COMMAND}\n```\n\n```text\na figure\n```\n\n{report.END}\n"
    )


def test_a_block_takes_the_place_of_that_of_the_same_command_alone(page):
    page.write_text("# Before\n", encoding="utf-8")
    report.run(printing("a figure"), WORDS)
    report.run(printing("a figure"), [*WORDS, "--json"])
    page.write_text(page.read_text(encoding="utf-8") + "\nAfter.\n", encoding="utf-8")
    before = page.read_text(encoding="utf-8")
    report.run(printing("another figure"), WORDS)
    assert page.read_text(encoding="utf-8") == before.replace("a figure", "another figure", 1)
    assert before.startswith("# Before\n\n")
    assert before.endswith("After.\n")


def test_a_command_that_fails_leaves_the_page(page):
    page.write_text(f"{BEGIN}\nold\n{report.END}", encoding="utf-8")
    assert report.run(printing("half", code=130), WORDS) == 130
    assert page.read_text(encoding="utf-8") == f"{BEGIN}\nold\n{report.END}"


@pytest.mark.parametrize("text", [BEGIN, f"{BEGIN}\n{BEGIN.replace('my', 'a')}\n{report.END}"])
def test_a_page_that_cannot_be_filled_is_refused_before_the_work(page, capsys, text):
    page.write_text(text, encoding="utf-8")
    with pytest.raises(OptionError, match=f"{report.PAGE} .*: no line {report.END} after"):
        report.run(printing("a figure"), WORDS)
    assert capsys.readouterr().out == ""
    assert page.read_text(encoding="utf-8") == text


def test_blocks_of_the_pages_are_as_their_commands_write_them():
    wrote = re.compile(r"<!-- printed by: (.*) -->(?s:.*?)```text\n((?s:.*?))\n```\n\n<!-- end -->")
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    blocks = [(text, *found) for text in texts for found in wrote.findall(text)]
    assert len(blocks) == sum(text.count("<!-- printed by: ") for text in texts) > 0
    for text, command, printed in blocks:
        assert report.filled(text, command, printed) == text, command
