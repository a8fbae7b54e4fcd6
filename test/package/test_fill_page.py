"""A page of results gets what a command prints, beside the command."""

import re
import sys

import command_line
import fill_page
import pytest
from pages import PAGES

WORDS = ["uuv_array", "scenes", "plume"]
BEGIN = fill_page.BEGIN.format("uuv_array scenes plume")


@pytest.fixture
def page(tmp_path):
    return tmp_path / "page.md"


def test_a_page_gets_the_command_and_what_it_printed(page, capsys):
    assert fill_page.main(str(page), *WORDS) == 0
    told = capsys.readouterr().out
    assert told == command_line.text_of(command_line.run, *WORDS[1:])
    printed = "\n".join(map(str.rstrip, told.strip().splitlines()))
    shown = f"```sh\nuuv_array scenes plume\n```\n\n```text\n{printed}\n```"
    assert page.read_text(encoding="utf-8") == f"<!-- printed -->\n\n{shown}\n\n<!-- end -->\n"


def test_a_command_line_can_be_pasted_into_a_shell(page):
    fill_page.main(str(page), sys.executable, "-c", "print(6 * 7)")
    text = page.read_text(encoding="utf-8")
    assert f"```sh\n{sys.executable} -c 'print(6 * 7)'\n```\n\n```text\n42\n```" in text


def test_a_block_takes_the_place_of_that_of_the_same_command_alone():
    page = fill_page.filled("# Before\n", "uuv_array scenes", "a figure")
    page = fill_page.filled(page, "uuv_array scenes plume", "a figure") + "\nAfter.\n"
    assert fill_page.filled(page, "uuv_array scenes", "another figure\n") == page.replace(
        "a figure", "another figure", 1
    )
    assert page.startswith("# Before\n\n")
    assert page.endswith("After.\n")


def test_a_command_that_fails_leaves_the_page(page):
    page.write_text(f"{BEGIN}\nold\n{fill_page.END}", encoding="utf-8")
    assert fill_page.main(str(page), sys.executable, "-c", "exit(2)") == 2
    assert page.read_text(encoding="utf-8") == f"{BEGIN}\nold\n{fill_page.END}"


@pytest.mark.parametrize("text", [BEGIN, f"{BEGIN}\n{BEGIN.replace('scenes', 'a')}\n<!-- end -->"])
def test_a_page_that_cannot_be_filled_is_refused_before_the_work(page, capsys, text):
    page.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=f"no line {fill_page.END} after"):
        fill_page.main(str(page), *WORDS)
    assert capsys.readouterr().out == ""
    assert page.read_text(encoding="utf-8") == text


def test_blocks_of_the_pages_are_as_their_commands_write_them():
    wrote = re.compile(
        r"<!-- printed -->\n\n```sh\n(.*)\n```\n\n```text\n((?s:.*?))\n```\n\n<!-- end -->"
    )
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    blocks = [(text, *found) for text in texts for found in wrote.findall(text)]
    assert len(blocks) == sum(text.count("<!-- printed -->") for text in texts) > 0
    for text, command, printed in blocks:
        assert fill_page.filled(text, command, printed) == text, command


def test_a_page_alone_has_its_commands_run_again(page):
    printing = [sys.executable, "-c", "print(6 * 7)"]
    fill_page.main(str(page), *printing)
    whole = page.read_text(encoding="utf-8")
    failing = f"{fill_page.BEGIN.format(f'{sys.executable} -c exit(2)')}\nold\n{fill_page.END}\n"
    page.write_text(failing + whole.replace("42", "41"), encoding="utf-8")
    assert fill_page.main(str(page)) == 2
    assert page.read_text(encoding="utf-8") == failing + whole
