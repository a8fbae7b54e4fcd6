"""What the documents show in blocks of code would be taken by what it is shown for."""

import itertools
import re
import shlex

import numpy as np
import pytest
import yaml
from pages import FENCED, PACKAGE, PAGES, ROOT, without_blocks
from reference_pages.nodes import all_topics, launch_arguments, node_modules
from scenes import coarse

from uuv_optical_array import build_table
from uuv_optical_array.commands import build_parser
from uuv_optical_array.estimation import estimator
from uuv_optical_array.forward.scene import load_scene

BLOCKS = [
    pytest.param(language, block, id=f"{page.relative_to(ROOT)}-{number}")
    for page in PAGES
    for number, (language, block) in enumerate(FENCED.findall(page.read_text(encoding="utf-8")))
]
PARAMETERS = {name: getattr(module, "PARAMETERS", {}) for name, module in node_modules()}
PARTS = {"follower_node": ("feature_node", "estimator_node", "formation_node")}
PARAMETERS["follower_node"] = {
    name: parameter
    for node in PARTS["follower_node"]
    for name, parameter in PARAMETERS[node].items()
}
ARGUMENTS = dict(launch_arguments())
TOPICS = all_topics()


def check_run(node, words):
    """Check parameters and remapped names of ``ros2 run``."""
    own = {topic.name for topic in TOPICS if topic.node in PARTS.get(node, (node,))}
    for flag, word in itertools.pairwise(words):
        name, _, value = word.partition(":=")
        if flag == "-p":
            PARAMETERS[node][name].check(name, yaml.safe_load(value))
        elif flag == "-r":
            assert name in own | {"__ns", "__node"}, word


def check_shell(block):
    """Check the package's nodes, launch files and commands; test_docs checks make's targets."""
    for line in block.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        names = [word.rpartition("/")[2] for word in words]
        if "uuv_array" in names[:4]:
            build_parser().parse_args(words[names.index("uuv_array") + 1 :])
        elif words[:3] == ["ros2", "run", PACKAGE.name]:
            check_run(words[3], words)
        elif names and names[0] in PARAMETERS:
            check_run(names[0], words)
        elif words[1:] and re.fullmatch(r"examples/\w+\.py", words[1]):
            script = (ROOT / words[1]).read_text(encoding="utf-8")
            options = {word for word in words if word[:2] == "--"} - {"--ros-args"}
            assert all(f'"{option}"' in script for option in options), line
        elif words[:3] == ["ros2", "launch", PACKAGE.name]:
            given = {word.partition(":=")[0] for word in words[4:]}
            assert given <= ARGUMENTS[words[3]].keys(), line


def check_yaml(block, folder):
    """Check a scene, or parameters of our nodes."""
    values = yaml.safe_load(block)
    if "lamp" in values or "extends" in values:
        (folder / "sea.yaml").write_text(block, encoding="utf-8")
        load_scene(folder / "sea.yaml")
        return
    for name, group in values.items():
        node = name.rpartition("/")[2]
        for key, value in group.get("ros__parameters", {}).items():
            if node in PARAMETERS:
                PARAMETERS[node][key].check(key, value)


def numbers(text):
    """Return the numbers of a text."""
    return [float(number) for number in re.findall(r"-?\d+\.\d*", text)]


def test_the_readme_shows_what_its_snippet_prints(monkeypatch, capsys):
    """Each in the last place that it shows, as the estimate of an image may change by less."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (found,) = re.finditer(r"```python\n(.*?)```\n\n```text\n(.*?)```", text, re.DOTALL)
    monkeypatch.setattr(estimator, "fit_compiler", lambda: None)  # not worth it here
    exec(found[1], {})
    printed = capsys.readouterr().out
    assert len(numbers(printed)) == 15
    np.testing.assert_allclose(numbers(found[2]), numbers(printed), atol=0.0101)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_block_of_code_is_passed_over(page):
    """A block that is indented has no language, by which it could be checked."""
    lines = without_blocks(page.read_text(encoding="utf-8")).splitlines()
    assert [line for line in lines if line.startswith("    ")] == []


@pytest.mark.parametrize(("language", "block"), BLOCKS)
def test_a_block_of_code_holds(language, block, tmp_path, monkeypatch):
    assert language, "say what language it is"
    if language == "sh":
        check_shell(block)
    elif language == "yaml":
        check_yaml(block, tmp_path)
    elif language == "python":
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(estimator, "build_table", lambda scene: build_table(coarse(scene)))
        monkeypatch.setattr(estimator, "fit_compiler", lambda: None)  # not worth it here
        names = {}
        exec(block, names)
        if "pose" in names:
            error = np.abs(names["estimate"].pose - names["pose"])
            assert np.all(error < 6 * np.sqrt(names["estimate"].covariance.diagonal()))
