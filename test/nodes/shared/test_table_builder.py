"""The first start: a coarse table answers until that of the scene is built beside the node."""

import itertools
import threading

import numpy as np
import pytest
from asker import Asker, assert_is
from conftest import PATIENCE_S, write_scene
from diagnostic_msgs.msg import DiagnosticStatus

from uuv_optical_array.core.storage import files
from uuv_optical_array.estimation.estimator import Estimator
from uuv_optical_array.estimation.signature.features import key_parameters
from uuv_optical_array.estimation.table.disk import cached_table, load_table, save_table
from uuv_optical_array.estimation.table.signature_table import build_table, coarse_scene
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings
from uuv_optical_array.nodes.shared import table_builder
from uuv_optical_array.nodes.shared.table_builder import TableBuilder

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
X_M = [-8.0, -4.0]


def scene_file_with(folder, name, x_points):
    return str(write_scene(folder, name, [("table", "x_m", [*X_M, x_points])]))


@pytest.fixture(scope="module")
def fine_file(tmp_path_factory):
    return scene_file_with(tmp_path_factory.mktemp("scene"), "fine", 9)


@pytest.fixture(scope="module")
def tables(fine_file, tmp_path_factory):
    """The coarse table, of at most seven points an axis, and that of the scene."""
    coarse_file = scene_file_with(tmp_path_factory.mktemp("scene"), "coarse", 7)
    return [build_table(load_scene(file)) for file in (coarse_file, fine_file)]


@pytest.fixture(scope="module")
def signatures(tables):
    scene, rng = tables[1].scene, np.random.default_rng(8)
    poses = rng.uniform([-7.5, -0.4, -0.4, -0.2, -0.2], [-4.5, 0.4, 0.4, 0.2, 0.2], (6, 5))
    images = ForwardModel(scene).expose(poses, rng)
    return key_parameters(images, scene.full_scale_counts, scene.signature.peak)


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def gate(monkeypatch):
    """An event until which the table is under way."""
    opened = threading.Event()

    def held(scene, progress):
        opened.wait(PATIENCE_S)
        return cached_table(scene, progress)

    monkeypatch.setattr(table_builder, "cached_table", held)
    yield opened
    opened.set()


def answer(table, signature):
    return Estimator(table, "sam").estimate(parameters=signature)


def test_every_frame_is_answered_before_and_after_the_table_takes_over(
    gate, lab, fine_file, tables, signatures
):
    coarse, fine = tables
    asker = Asker(lab, fine_file)
    for seconds in (1, 2):
        signature = signatures[seconds]
        assert_is(asker.ask(signature, seconds), answer(coarse, signature))
    lab.report(asker.node, WARN, "building the signature table", "a coarse one answers")
    gate.set()
    lab.until(lambda: len(asker.node.table.poses) == len(fine.poses), "the table")
    lab.statuses.clear()
    assert_is(asker.ask(signatures[3], 3), answer(fine, signatures[3]))
    lab.report(asker.node, OK)
    assert asker.seconds_answered() == [1, 2, 3]


def test_a_coarse_table_takes_an_angle_wider_by_its_cells(gate, lab, fine_file, tables, signatures):
    asker = Asker(lab, fine_file)
    nearest = answer(tables[0], signatures[0]).angle_rad
    wider = 8 / 6  # nine points of the scene's grid along x, seven of the coarse one
    assert lab.set(asker.node, "max_angle_rad", 1.01 * nearest / wider).successful
    assert_is(asker.ask(signatures[0], 1), answer(tables[0], signatures[0]))
    assert lab.set(asker.node, "max_angle_rad", 0.99 * nearest / wider).successful
    asker.clouds.publish(asker.message(signatures[0], 2))
    lab.report(asker.node, WARN, "no match", "the nearest signature")


def test_a_table_in_the_cache_answers_from_the_first_frame_on(
    lab, fine_file, tables, signatures, monkeypatch
):
    cached_table(tables[1].scene)
    monkeypatch.setattr(table_builder, "build_table", None)  # nothing is built
    asker = Asker(lab, fine_file)
    assert_is(asker.ask(signatures[0], 1), answer(tables[1], signatures[0]))
    lab.report(asker.node, OK)


def test_a_damaged_table_in_the_cache_is_told_and_built_again(
    gate, lab, fine_file, tables, signatures
):
    coarse, fine = tables
    cached_table(fine.scene)
    (folder,) = files.cache_dir().iterdir()
    with (folder / "poses.npy").open("r+b") as file:
        file.seek(5000)
        file.write(b"~")
    asker = Asker(lab, fine_file)
    lab.report(asker.node, WARN, str(folder), "poses.npy is damaged", "building it again now")
    assert_is(asker.ask(signatures[0], 1), answer(coarse, signatures[0]))
    gate.set()
    lab.until(lambda: len(asker.node.table.poses) == len(fine.poses), "the table")
    lab.statuses.clear()
    assert_is(asker.ask(signatures[0], 2), answer(fine, signatures[0]))
    lab.report(asker.node, OK)
    np.testing.assert_array_equal(load_table(folder, fine.scene).poses, fine.poses)


def test_a_table_set_while_another_is_built_stays(
    gate, lab, fine_file, tables, signatures, tmp_path
):
    fine = tables[1]
    keep = (fine.poses != answer(fine, signatures[0]).pose).any(axis=1)
    thinner = type(fine)(fine.scene, fine.poses[keep], fine.parameters[keep])
    save_table(thinner, tmp_path / "thinner")
    asker = Asker(lab, fine_file)
    assert lab.set(asker.node, "table", str(tmp_path / "thinner")).successful
    built = asker.node.builder._thread
    gate.set()
    lab.until(lambda: not built.is_alive(), "the table")
    assert_is(asker.ask(signatures[0], 1), answer(thinner, signatures[0]))
    lab.report(asker.node, OK)
    # Asked for, the table of the cache is there at once.
    assert lab.set(asker.node, "table", "").successful
    assert_is(asker.ask(signatures[0], 2), answer(fine, signatures[0]))


def test_a_table_that_cannot_be_built_is_told_and_tried_again_on_request(
    lab, fine_file, tables, signatures, monkeypatch
):
    coarse, fine = tables

    def fail(scene, progress):
        raise ValueError("too little memory")

    with monkeypatch.context() as patch:
        patch.setattr(table_builder, "cached_table", fail)
        asker = Asker(lab, fine_file)
        lab.report(asker.node, WARN, "a coarse table answers", "too little memory")
        assert_is(asker.ask(signatures[0], 1), answer(coarse, signatures[0]))
    assert lab.set(asker.node, "table", "").successful
    lab.until(lambda: len(asker.node.table.poses) == len(fine.poses), "the table")
    assert_is(asker.ask(signatures[0], 2), answer(fine, signatures[0]))


def test_the_covariance_counts_the_cells_of_the_coarse_grid(tables, signatures):
    scene = load_scene("follow")
    estimator = Estimator(build_table(coarse_scene(scene)), "sam_interpolated")
    cell = [
        ((np.radians(span[1] - span[0]) if key.endswith("deg") else span[1] - span[0]) / 6) ** 2
        for key, span in scene.settings()["table"].items()
    ]
    for signature in signatures:
        covariance = estimator.estimate(parameters=signature).covariance
        spread = np.linalg.eigvalsh(covariance - np.diag(cell) / 12)
        assert spread.min() > -1e-12


def test_where_only_the_finer_grid_meets_the_light_it_is_built_at_once(tables):
    settings = tables[1].scene.settings()
    settings["table"]["y_m"] = [-300.0, 500.0, 9]  # of whose points only 0 is in the beam
    scene = scene_from_settings(settings, "offset")
    with pytest.raises(ValueError, match="no pose of the table"):
        build_table(coarse_scene(scene))
    table = TableBuilder(scene, lambda: None).table()
    np.testing.assert_array_equal(table.poses, build_table(scene).poses)


def test_a_build_ends_with_the_node(tables, monkeypatch):
    started, told = threading.Event(), []

    def endless(scene, progress):
        for _ in progress(itertools.repeat(0)):
            started.set()

    monkeypatch.setattr(table_builder, "cached_table", endless)
    builder = TableBuilder(tables[1].scene, lambda: told.append(1))
    builder.table()
    thread = builder._thread
    assert started.wait(PATIENCE_S)
    builder.stop()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()
    assert told == []
