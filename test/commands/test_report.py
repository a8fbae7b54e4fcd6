"""``--report`` keeps what a command prints in a page, beside the command."""

import re

import pytest
from command_line import run
from pages import PAGES

from uuv_optical_array.cli import report
from uuv_optical_array.commands.studies import paper

BEGIN = report.BEGIN.format("uuv_array study paper --seed 2")


@pytest.fixture
def printing(monkeypatch):
    """Let ``uuv_array study paper`` print these lines and end with this code, and nothing else."""
    told = {"text": "a figure", "code": 0}

    def run_paper(options):
        print(told["text"])
        return told["code"]

    monkeypatch.setattr(paper, "run", run_paper)
    return told


def test_a_page_gets_the_command_and_what_it_printed(printing, tmp_path, capsys):
    page = tmp_path / "page.md"
    run("study", "paper", "--seed", 2, "--report", page)
    assert capsys.readouterr().out == "a figure\n"
    assert page.read_text(encoding="utf-8") == (
        f"{BEGIN}\n\n```sh\nuuv_array study paper --seed 2\n```\n\n```text\na figure\n```\n\n"
        f"{report.END}\n"
    )


def test_a_block_takes_the_place_of_that_of_the_same_command_alone(printing, tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# Before\n", encoding="utf-8")
    run("study", "paper", "--seed", 2, "--report", page)
    run("study", "paper", f"--repo={page}", "--seed", 3)  # as argparse takes it
    page.write_text(page.read_text(encoding="utf-8") + "\nAfter.\n", encoding="utf-8")
    old = page.read_text(encoding="utf-8")
    printing["text"] = "another figure"
    run("study", "paper", "--report", page, "--seed", 2)
    first, second = old.split("a figure")[0], old.split("a figure", 1)[1]
    assert page.read_text(encoding="utf-8") == f"{first}another figure{second}"
    assert "\nuuv_array study paper --seed 3\n" in second
    assert old.startswith("# Before\n\n")
    assert old.endswith("After.\n")


def test_the_line_of_a_program_leaves_the_page_out():
    words = ["--sides", "5", "--report=page.md", "--methods", "a method"]
    line = report.command_of(words, ["python", "latency.py"])
    assert line == "python latency.py --sides 5 --methods 'a method'"


def test_a_command_that_fails_leaves_the_page(printing, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"{BEGIN}\nold\n{report.END}", encoding="utf-8")
    printing["code"] = 130
    run("study", "paper", "--seed", 2, "--report", page, code=130)
    assert page.read_text(encoding="utf-8") == f"{BEGIN}\nold\n{report.END}"


@pytest.mark.parametrize("text", [BEGIN, f"{BEGIN}\n{BEGIN.replace('2', '3')}\n{report.END}"])
def test_a_page_that_cannot_be_filled_is_refused_before_the_work(printing, tmp_path, capsys, text):
    page = tmp_path / "page.md"
    page.write_text(text, encoding="utf-8")
    error = run("study", "paper", "--seed", 2, "--report", page, code=1)
    assert (
        error
        == f"uuv_array study paper: --report {page}: no line {report.END} after {BEGIN}; add it"
    )
    assert "make it first" in run("study", "paper", "--report", tmp_path / "no" / "page.md", code=1)
    assert "leave --json out" in run("study", "paper", "--json", "--report", page, code=1)
    assert capsys.readouterr().out == ""
    assert page.read_text(encoding="utf-8") == text


def test_blocks_of_the_pages_are_as_their_commands_write_them():
    wrote = re.compile(r"<!-- printed by: (.*) -->(?s:.*?)```text\n((?s:.*?))\n```\n\n<!-- end -->")
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    blocks = [(text, *found) for text in texts for found in wrote.findall(text)]
    assert len(blocks) == sum(text.count("<!-- printed by: ") for text in texts) > 0
    for text, command, printed in blocks:
        assert report.filled(text, command, printed) == text, command
