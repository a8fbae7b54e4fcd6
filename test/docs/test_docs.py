"""What the documents point to is there: files, sections, commands, options, make's targets."""

import re

import pytest
from pages import FENCED, PACKAGE, PAGES, ROOT, without_blocks
from reference_pages.commands import command_parsers

from uuv_optical_array.commands import build_parser

each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


def code(page):
    """Return the pieces of code of a page: each line of a block, and each span in the prose."""
    text = page.read_text(encoding="utf-8")
    blocks = "\n".join(block for _, block in FENCED.findall(text)).replace("\\\n", " ").splitlines()
    spans = re.findall(r"`([^`]+)`", without_blocks(text))
    return [line.partition(" #")[0] for line in blocks] + [" ".join(s.split()) for s in spans]


def anchors(page):
    """Return the anchors that GitHub gives to the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", without_blocks(page.read_text("utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def options_of_commands():
    """Return the options of each command of ``uuv_array``, by its name."""
    return {
        parser.prog.removeprefix("uuv_array "): set(parser._option_string_actions)
        for parser in command_parsers(build_parser())
    }


@each_page
def test_every_link_leads_to_a_file_and_a_section_that_are_there(page):
    text = without_blocks(page.read_text(encoding="utf-8"))
    links = re.findall(r"(?<=\]\()[^)\s]+(?=\))|(?<=src=\")[^\"]+", text)
    for link in links:
        if re.match(r"https?://", link):
            continue
        name, _, section = link.partition("#")
        target = page.parent / name if name else page
        assert target.is_file(), link
        assert not section or section in anchors(target), link


@each_page
def test_every_path_in_code_is_there(page):
    folders = {path.name for path in (*ROOT.iterdir(), *PACKAGE.iterdir()) if path.is_dir()}
    placeholder = re.compile(r"[<>*=]|[A-Z]{3}")
    for word in " ".join(code(page)).split():
        path = word.partition("::")[0].strip(",.:;'")
        folder, slash, _ = path.partition("/")
        if slash and folder in folders and not placeholder.search(path):
            assert (ROOT / path).exists() or (PACKAGE / path).exists(), path


@each_page
def test_every_command_and_each_of_its_options_is_there(page):
    known = options_of_commands()
    every = set.union(*known.values())
    for piece in code(page):
        for command, rest in re.findall(r"uuv_array ((?:study )?[a-z]+)(.*)", piece):
            assert command in known, piece
            used = set(re.findall(r"(?<=[ \[])--?[a-z][a-z-]*", rest))
            assert used <= known[command], piece
        if piece.startswith("--"):
            assert piece.split()[0] in every, piece


@each_page
def test_every_target_of_make_is_there(page):
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z]+):", makefile, re.MULTILINE))
    for piece in code(page):
        assert set(re.findall(r"^make ([a-z]+)", piece)) <= targets, piece


@each_page
def test_no_line_break_in_code_makes_a_list(page):
    spans = re.findall(r"`[^`]+`", without_blocks(page.read_text(encoding="utf-8")))
    assert [span for span in spans if re.search(r"\n *([-+*]|\d+[.)]) ", span)] == []


def test_the_readme_has_less_than_a_thousand_words():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) < 1000


def test_what_the_limits_quote_stands_on_the_pages_that_they_name():
    page = ROOT / "docs" / "explanation" / "limits.md"
    rows = re.findall(r"\| `([^`]+)` \| \[\w+\]\(([^)#]+)", page.read_text(encoding="utf-8"))
    assert len(rows) > 10
    for quoted, link in rows:
        assert quoted in " ".join((page.parent / link).read_text(encoding="utf-8").split())


def test_the_page_on_stacks_quotes_the_printed_envelopes():
    page, envelope = (
        (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
        for name in ("how_to/stack", "results/envelope")
    )
    own, drawn = envelope.partition("## BlueROV2")[0].split("## Drawn seas")

    def off_m(kind, printed):
        return float(re.search(rf"^{kind} +\d+ +\d+ +\d+ +(\S+)", printed, re.MULTILINE)[1])

    told, untold = off_m("told_dark_20", own), off_m("dark_20_path", own)
    quoted = (
        f"it strayed {told:.1f} m from its station, and {untold:.1f} m without messages",
        f"{off_m('formation_4', own):.2f} m in the scene's own sea, or "
        f"{off_m('formation_4', drawn):.2f} m in drawn seas",
    )
    for text in quoted:
        assert text in " ".join(page.split())


def test_what_shows_a_physical_cause_and_what_tries_it_are_there():
    page = (ROOT / "docs" / "how_to" / "physical_causes.md").read_text(encoding="utf-8")
    texts = {
        name: (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
        for name in ("reference/diagnostics", "reference/mismatches", "glossary")
    }
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith("| ")]
    rows = [row for row in rows if len(row) == 4 and "cause" not in row[0]]
    assert len(rows) > 20
    for _, shows, tried, _ in rows:
        for word in re.findall(r"`([^`]+)`", shows):
            assert word in texts["reference/diagnostics"] + texts["glossary"], word
        for word in re.findall(r"`([^`]+)`", tried):
            assert f"`{word}`" in texts["reference/mismatches"], word


def test_readme_and_site_have_one_order_of_pages():
    site = re.findall(
        r"^   ((?:\w+/)?\w+)$", (ROOT / "docs/index.rst").read_text("utf-8"), re.MULTILINE
    )
    pages = {
        str(page.relative_to(ROOT / "docs").with_suffix(""))
        for page in PAGES
        if page.parent != ROOT
    }
    assert sorted(site) == sorted(pages)
    _, _, rows = (ROOT / "README.md").read_text("utf-8").partition("## Read on")
    read = re.findall(r"\]\(docs/([\w/]+)\.md\)", rows)
    assert read == [page for page in site if page in read]
