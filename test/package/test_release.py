"""What a release needs is there, as the tools that make one read it."""

import ast
import itertools
import re
from xml.etree import ElementTree

from pages import ROOT

from uuv_optical_array.core.storage import yaml_text

# As catkin_pkg reads the title of a section of a changelog; one without a date is no section to it.
SECTION = re.compile(r"^(\d+\.\d+\.\d+) \((\d{4}-\d\d-\d\d)\)\n-+$", re.MULTILINE)


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def of_setup():
    """Return the version in setup.py, which catkin_prepare_release wants as a literal."""
    calls = [node for node in ast.walk(ast.parse(text("setup.py"))) if isinstance(node, ast.Call)]
    (setup,) = (call for call in calls if getattr(call.func, "id", "") == "setup")
    return next(ast.literal_eval(key.value) for key in setup.keywords if key.arg == "version")


def test_one_version_stands_in_package_setup_and_changelog():
    package = ElementTree.fromstring(text("package.xml")).findtext("version")
    sections = SECTION.findall(text("CHANGELOG.rst"))
    assert package == of_setup() == sections[0][0]
    assert len(re.findall(r"^\d+\.\d+\.\d+\b", text("CHANGELOG.rst"), re.MULTILINE)) == len(
        sections
    )
    for (newer, late), (older, early) in itertools.pairwise(sections):
        assert [*map(int, newer.split("."))] > [*map(int, older.split("."))]
        assert late >= early


def test_workflows_name_targets_of_make_and_the_container_runs_the_commands_of_the_readme():
    targets = set(re.findall(r"^([a-z]+):", text("Makefile"), re.MULTILINE))
    workflows = [*(ROOT / ".github" / "workflows").iterdir()]
    assert len(workflows) == 2
    for file in workflows:
        jobs = yaml_text.read(file)["jobs"]
        lines = [step.get("run", "") for job in jobs.values() for step in job["steps"]]
        assert {word for line in lines for word in re.findall(r"\bmake ([a-z]+)", line)} <= targets
    first, second = re.findall(r"^make (\w+)", text("README.md"), re.MULTILINE)[:2]
    container = text("Containerfile")
    assert f"\nRUN make {first} ARGS='--seed 3'\n" in container
    assert f'\nCMD ["make", "{second}"' in container


def test_the_workflow_builds_on_the_distributions_that_the_page_names():
    matrix = yaml_text.read(ROOT / ".github" / "workflows" / "ci.yml")["jobs"]["workspace"]
    page = text("docs/how_to/install.md")
    (named,) = re.findall(r"ci\.yml` builds and tests on ([\w,\s]+), on both architectures", page)
    assert matrix["strategy"]["matrix"]["distribution"] == re.findall(
        "[a-z]+", named.lower().replace(" and ", " ")
    )


def test_the_citation_names_license_and_doi_of_the_package():
    citation = yaml_text.read(ROOT / "CITATION.cff")
    package = ElementTree.fromstring(text("package.xml"))
    assert citation["title"] == package.findtext("name")
    assert citation["license"] == package.findtext("license")
    assert [author["name"] for author in citation["authors"]] == [package.findtext("author")]
    assert package.findtext("url") == f"https://doi.org/{citation['references'][0]['doi']}"
