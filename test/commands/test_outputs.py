"""Where commands write: refused before any work where it cannot be, and whole or not at all."""

import os
import re
import resource
import socket
from pathlib import Path

import numpy as np
import pytest
from command_line import PROGRAM, begun, ended, run

from uuv_optical_array.cli import outputs
from uuv_optical_array.core.storage import files
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.plots import style

# Each command's words, and its options that name a file or a folder, with a file's suffix.
OPTIONS = [
    (("render",), "--output", ".png"),
    (("limits",), "--output", ".pdf"),
    (("study", "accuracy"), "--known", ".svg"),
    (("study", "robustness"), "--output", ".png"),
    (("study", "approach"), "--output", ".png"),
    (("study", "paper"), "--output", ".png"),
    (("follow",), "--output", ".png"),
    (("study", "design"), "--output", ".png"),
    (("calibrate", "no_bag"), "--output", ".yaml"),
    (("calibrate", "no_bag"), "--picture", ".png"),
    (("commission",), "--output", ".yml"),
    (("table",), "--output", ""),
    (("study", "tradeoff"), "--output", ""),
    (("estimate", "no_bag"), "--output", ""),
    (("follow",), "--record", ""),
]
BYTES = 2000  # a file that the full disk still takes


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """A folder of its own, where work that begins is an error of another kind."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def no_work(monkeypatch):
    def begun(*arguments, **settings):
        raise AssertionError("the work began")

    def aligned_only(self, poses, *arguments, **settings):  # what a scene is checked by
        return linearised(self, poses, *arguments, **settings) if np.ndim(poses) == 1 else begun()

    linearised = ForwardModel.linearised
    monkeypatch.setattr(ForwardModel, "linearised", aligned_only)
    for name in ("expected", "expose"):
        monkeypatch.setattr(ForwardModel, name, begun)


@pytest.fixture
def full_disk():
    """No file of this process may grow beyond `BYTES`."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (BYTES, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize(("words", "option", "suffix"), OPTIONS)
def test_what_cannot_be_written_is_refused_before_the_work(
    words, option, suffix, no_work, tmp_path
):
    (tmp_path / f"folder{suffix}").mkdir()
    (tmp_path / "file").touch()
    wrong_folders = {
        "file/deep.zarr": ".*/file is a file; name a folder",
        "/proc/deep/x.zarr": ".*cannot write in /proc",
    }
    wrong_files = {
        f"nowhere/x{suffix}": "no folder nowhere; make it first",
        f"folder{suffix}": "it is a folder; name a file",
        f"file/x{suffix}": "no folder file",
        f"/proc/x{suffix}": "cannot write in /proc",
        "x.gif": f"its name must end in .*{re.escape(suffix)}",
    }
    name = " ".join(words[: 2 if words[0] == "study" else 1])
    for path, why in (wrong_files if suffix else wrong_folders).items():
        error = run(*words, option, path, code=2)
        assert re.match(rf"uuv_array {name}: {option} {path}: {why}", error), error
    assert {path.name for path in tmp_path.iterdir()} == {f"folder{suffix}", "file"}


def test_a_device_is_no_file_to_replace(tmp_path):
    with socket.socket(socket.AF_UNIX) as made:
        made.bind("x.csv")
        with pytest.raises(ValueError, match=r"x\.csv: it is a device"):
            outputs.file_to_write("x.csv", "--csv", (".csv",))


def test_what_can_be_written_leaves_no_trace_of_the_look(tmp_path):
    Path("old.PNG").touch()
    assert outputs.file_to_write("old.PNG", "--output", outputs.PICTURE) == Path("old.PNG")
    assert outputs.folder_to_write("a/b", "--output", new=True) == Path("a/b")
    assert [path.name for path in tmp_path.iterdir()] == ["old.PNG"]


@pytest.mark.usefixtures("sketched")
def test_a_full_disk_gives_the_path_and_leaves_nothing(full_disk, tmp_path):
    error = run("budget", "--output", "sea.png", code=1)
    assert error == f"uuv_array budget: sea.png: {os.strerror(27)}"
    assert not list(tmp_path.iterdir())


def test_a_full_disk_leaves_what_was_there(full_disk, tmp_path):
    page, path = tmp_path / "page.md", tmp_path / "t.npy"
    page.write_text("before")
    with pytest.raises(OSError, match=re.escape(str(page))):
        files.write_text(page, BYTES * "ab")
    assert page.read_text() == "before"
    # NumPy's error has neither number nor name.
    full = pytest.raises(OSError, match=re.escape(str(path)))
    with full as told, files.whole_file(path) as new, new.open("wb") as stream:
        np.save(stream, np.zeros(BYTES))
    assert (told.value.filename, path.exists()) == (str(path), False)
    assert [path.name for path in tmp_path.iterdir()] == ["page.md"]


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    path = tmp_path / "new" / "t"

    def interrupted():
        with files.whole_directory(path) as scratch:
            (scratch / "a").write_text("half")
            assert not path.exists()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not list(path.parent.iterdir())
    with files.whole_directory(path) as scratch:
        (scratch / "a").write_text("whole")
    assert [(file.name, file.read_text()) for file in path.iterdir()] == [("a", "whole")]
    assert list(path.parent.iterdir()) == [path]


def test_an_error_of_another_file_keeps_its_name(tmp_path):
    with pytest.raises(FileNotFoundError) as told, files.whole_file(tmp_path / "x") as scratch:
        np.load(tmp_path / "other.npy")
    assert told.value.filename == str(tmp_path / "other.npy")
    assert not scratch.exists()


def test_an_answer_that_a_full_disk_does_not_take_is_one_line():
    words = [*PROGRAM, "scenes", "effects"]
    with open("/dev/full", "w") as full, begun(words, stdout=full) as process:
        assert ended(process, 1)[1] == (f"uuv_array scenes: standard output: {os.strerror(28)}\n")


@pytest.mark.parametrize("words", [("scenes", "schema"), ("scenes", "effects")], ids=" ".join)
def test_a_reader_that_has_read_enough_is_no_error_to_tell(words):
    read, write = os.pipe()
    os.close(read)
    with open(write, "w") as pipe, begun([*PROGRAM, *words], stdout=pipe) as process:
        assert ended(process, 1)[1] == ""


@pytest.mark.parametrize("there", [True, False])
def test_a_link_stays_one_and_what_it_leads_to_is_written(tmp_path, there):
    (tmp_path / "real").mkdir()
    target, link = tmp_path / "real" / "sea.yaml", tmp_path / "sea.yaml"
    if there:
        target.write_text("old", "utf-8")
    link.symlink_to(Path("real", "sea.yaml"))
    assert outputs.file_to_write(link, "--output", outputs.SCENE) == link
    files.write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text("utf-8") == "new"
    assert [path.name for path in target.parent.iterdir()] == ["sea.yaml"]


def test_a_picture_that_cannot_be_drawn_is_told_before_the_work(no_work, monkeypatch):
    def broken(*size):
        raise RuntimeError("numpy.core.multiarray failed to import")

    monkeypatch.setattr(style, "new_figure", broken)
    assert "no picture can be drawn: RuntimeError numpy.core" in run("render", code=2)
