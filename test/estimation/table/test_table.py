"""The signature table: every row computed a second time, and the folder whole or not at all."""

import itertools
import logging
import math
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
import second_forward
import yaml
from second_features import slow_key_parameters

from uuv_optical_array.core.numerics import compilation
from uuv_optical_array.core.storage import files, manifest
from uuv_optical_array.estimation.table import disk, signature_table
from uuv_optical_array.estimation.table.disk import cached_table, load_table, save_table
from uuv_optical_array.estimation.table.signature_table import build_table, grid_axes, signatures
from uuv_optical_array.forward.model import ForwardModel
from uuv_optical_array.forward.scene import load_scene, scene_from_settings

pytestmark = pytest.mark.filterwarnings("error")

SPANS = {
    "x_m": [-8.0, -4.0, 3],
    "y_m": [-0.6, 0.6, 4],
    "z_m": [-0.3, 0.5, 3],
    "pitch_deg": [-20.0, 20.0, 3],
    "yaw_deg": [5.0, 5.0, 1],
}


def scene_with(group=None, **values):
    """Return the reference scene on a small grid, with one group of settings changed."""
    settings = load_scene("reference").settings()
    settings["table"] = dict(SPANS)
    if group is not None:
        settings[group].update(values)
    return scene_from_settings(settings, "small")


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """Keep the user's cache out of the tests."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    return folder / "uuv_optical_array"


@pytest.fixture
def count_builds(monkeypatch):
    """List the scenes of the tables that `cached_table` builds."""
    built = []
    build = disk.build_table

    def counted(scene, **options):
        built.append(scene)
        return build(scene, **options)

    monkeypatch.setattr(disk, "build_table", counted)
    return built


def assert_equal_tables(one, other):
    np.testing.assert_array_equal(one.poses, other.poses)
    np.testing.assert_array_equal(one.parameters, other.parameters)


def rows_by_hand(scene, min_peak_counts):
    """Poses and parameters of the scene's grid, one pose at a time; also how many are dark."""
    model = ForwardModel(scene)
    spans = scene.settings()["table"]
    poses, parameters, dark = [], [], 0
    for cell in itertools.product(*(range(spans[axis][2]) for axis in SPANS)):
        pose = []
        for axis, i in zip(SPANS, cell, strict=True):
            start, stop, number = spans[axis]
            value = start + (stop - start) * i / max(number - 1, 1)
            pose.append(math.radians(value) if axis.endswith("_deg") else value)
        image = model.expected(pose)
        if image.max() < min_peak_counts:
            dark += 1
            continue
        poses.append(pose)
        parameters.append(slow_key_parameters(image, scene.full_scale_counts, scene.signature.peak))
    return np.array(poses), np.array(parameters), dark


@pytest.mark.parametrize("peak", ["detector", "subdetector"])
def test_every_row_is_the_signature_of_its_pose(peak):
    scene = scene_with("signature", peak=peak)
    table = build_table(scene)
    poses, parameters, dark = rows_by_hand(scene, 1.0)
    assert dark == 0
    np.testing.assert_allclose(table.poses, poses, atol=1e-14)
    np.testing.assert_allclose(table.parameters, parameters, atol=1e-9)


def test_the_axes_are_evenly_spaced_in_metres_and_radians():
    axes = grid_axes(scene_with().table)
    for axis, (name, span) in zip(axes, SPANS.items(), strict=True):
        unit = math.pi / 180 if name.endswith("_deg") else 1.0
        np.testing.assert_allclose(axis, np.linspace(*span) * unit, atol=1e-15)


def test_a_grid_reaching_ahead_of_the_lamp_leaves_the_dark_poses_out():
    scene = scene_with("table", x_m=[-5.0, 5.0, 5], y_m=[-3.0, 3.0, 5])
    poses, parameters, dark = rows_by_hand(scene, 20.0)
    table = build_table(scene, min_peak_counts=20.0)
    assert dark > 50
    assert len(poses) > 20
    np.testing.assert_allclose(table.poses, poses, atol=1e-14)
    np.testing.assert_allclose(table.parameters, parameters, atol=1e-9)
    assert (table.parameters[:, 0] * scene.full_scale_counts >= 20.0).all()


def test_the_size_of_a_block_does_not_change_the_table(monkeypatch):
    scene = scene_with()
    whole = build_table(scene)
    monkeypatch.setattr(signature_table, "BLOCK_POSES", 7)
    seen = []
    blocks = build_table(scene, progress=lambda starts: (seen.append(i) or i for i in starts))
    np.testing.assert_array_equal(blocks.poses, whole.poses)
    np.testing.assert_allclose(blocks.parameters, whole.parameters, atol=1e-12)
    assert seen == list(range(0, len(whole.poses), 7))


def test_a_block_of_dark_poses_is_left_out_as_a_whole(monkeypatch):
    scene = scene_with("table", x_m=[-4.0, 4.0, 3])
    whole = build_table(scene)
    monkeypatch.setattr(signature_table, "BLOCK_POSES", 4)
    blocks = build_table(scene)
    np.testing.assert_array_equal(blocks.poses, whole.poses)
    # Few images are worked out one by one, and compiled where the fit is.
    np.testing.assert_allclose(blocks.parameters, whole.parameters, rtol=1e-12, atol=1e-14)


numba = pytest.mark.skipif(not compilation.usable(), reason="Numba is not installed")
both = pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=numba)], ids=str)
WATER = {
    "attenuation": {"k_per_m": 0.2},
    "ambient": {"level_counts": 30.0},
    "forward_scatter": {"window_m": 0.25},
    "responsivity": {"spread": 0.1, "seed": 3},
    "saturation": {"level_counts": 300.0},
    "adc": {"bits": 10},
}


@both
@pytest.mark.parametrize("effects", [{"attenuation": {"k_per_m": 0.1}}, WATER], ids=len)
def test_poses_count_from_the_threshold_of_light_on(compiled, effects):
    settings = load_scene("reference").settings()
    scene = scene_from_settings({**settings, "effects": effects}, "test")
    model, rng = ForwardModel(scene), np.random.default_rng(6)
    # More than fill whole tiles of the compiled loop.
    poses = rng.uniform([-9, -1, -1, -0.5, -0.5], [-4, 1, 1, 0.5, 0.5], (333, 5))
    plain, power = scene.settings(), second_forward.power_of(scene.settings())
    light = np.array([second_forward.light(plain, pose, power=power) for pose in poses])
    images = np.minimum(light, effects.get("saturation", {}).get("level_counts", np.inf))
    peaks = images.max(axis=(1, 2))
    middle = np.sort(peaks)[150:152].mean()
    assert ((middle / 1.5 < peaks) & (peaks < middle)).sum() > 5
    lit, found = signatures(model, poses, middle, compiled)
    np.testing.assert_array_equal(lit, peaks > middle)
    expected = [
        slow_key_parameters(image, scene.full_scale_counts, "subdetector") for image in images[lit]
    ]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_pose_at_the_threshold_counts_and_the_threshold_is_a_count_unless_given():
    scene = scene_with("lamp", reference_counts=3.0)
    model = ForwardModel(scene)
    poses = build_table(scene, min_peak_counts=1e-9).poses
    peaks = model.expected(poses).max(axis=(1, 2))
    assert ((peaks > 0.5) & (peaks < 1)).sum() > 5
    assert ((peaks > 1) & (peaks < 2)).sum() > 5
    np.testing.assert_array_equal(build_table(scene).poses, poses[peaks >= 1])
    lit, _ = signatures(model, poses, peaks[7])
    np.testing.assert_array_equal(lit, peaks >= peaks[7])


def test_a_grid_without_any_light_is_refused():
    with pytest.raises(ValueError, match=r"scene small: no pose of the table has 1 count"):
        build_table(scene_with("table", x_m=[2.0, 4.0, 2]))


def test_a_saved_table_loads_equal_and_memory_mapped(tmp_path):
    table = build_table(scene_with())
    save_table(table, tmp_path / "some" / "where")
    loaded = load_table(str(tmp_path / "some" / "where"), scene_with())
    assert_equal_tables(loaded, table)
    assert loaded.scene == table.scene
    assert isinstance(loaded.poses, np.memmap)
    assert isinstance(loaded.parameters, np.memmap)
    assert os.listdir(tmp_path / "some") == ["where"]


def test_saving_over_a_table_replaces_it(tmp_path):
    save_table(build_table(scene_with()), tmp_path / "t")
    other = build_table(scene_with("lamp", beam_sigma_deg=9.0))
    save_table(other, tmp_path / "t")
    assert_equal_tables(load_table(tmp_path / "t", other.scene), other)
    assert os.listdir(tmp_path) == ["t"]


@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
@pytest.mark.parametrize("older", [False, True])
def test_an_interrupted_save_leaves_no_trace_and_keeps_the_older_table(
    tmp_path, monkeypatch, error, older
):
    first = build_table(scene_with())
    if older:
        save_table(first, tmp_path / "t")
    calls = []
    save = np.save

    def interrupted(file, array):
        calls.append(file)
        if len(calls) == 2:
            raise error
        save(file, array)

    monkeypatch.setattr(np, "save", interrupted)
    with pytest.raises(type(error)):
        save_table(build_table(scene_with("lamp", beam_sigma_deg=9.0)), tmp_path / "t")
    assert len(calls) == 2
    assert os.listdir(tmp_path) == (["t"] if older else [])
    if older:
        assert_equal_tables(load_table(tmp_path / "t", first.scene), first)


@pytest.mark.parametrize("kind", ["folder", "file", "empty folder"])
def test_what_is_no_table_is_never_overwritten(tmp_path, kind):
    place = tmp_path / "mine"
    if kind == "file":
        place.write_text("mine")
    else:
        place.mkdir()
        if kind == "folder":
            (place / "notes.txt").write_text("mine")
    table = build_table(scene_with())
    with pytest.raises(ValueError, match="is no table"):
        save_table(table, place)
    assert os.listdir(tmp_path) == ["mine"]
    if kind == "file":
        assert place.read_text() == "mine"
    if kind == "folder":
        assert (place / "notes.txt").read_text() == "mine"


def test_a_folder_with_a_strangers_table_yaml_is_never_overwritten(tmp_path):
    (tmp_path / "table.yaml").write_text("legs: 4\n")
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match="is no table"):
        save_table(build_table(scene_with()), tmp_path)
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_table_saved_under_the_home_folder_loads_by_the_same_name(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    table = build_table(scene_with())
    save_table(table, "~/t")
    assert_equal_tables(load_table("~/t", table.scene), table)


def truncate(name, size):
    def harm(folder):
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: int(size * len(data))])

    return harm


def rewrite(**changes):
    def harm(folder):
        about = yaml.safe_load((folder / "table.yaml").read_text())
        about.update(changes)
        (folder / "table.yaml").write_text(yaml.safe_dump(about))

    return harm


def replace(name, content):
    def harm(folder):
        if isinstance(content, np.ndarray):
            np.save(folder / name, content)
        else:
            (folder / name).write_bytes(content)

    return harm


def signed(harm):
    """What is written by another version has checksums that hold."""

    def harm_and_sign(folder):
        harm(folder)
        manifest.write(folder, {file.name for file in folder.iterdir()} - {"SHA256SUMS"})

    return harm_and_sign


DAMAGE = {
    "no folder": (shutil.rmtree, "no table there"),
    "no yaml": (lambda folder: (folder / "table.yaml").unlink(), "table.yaml is missing"),
    "half an npy": (truncate("parameters.npy", 0.5), "parameters.npy is damaged"),
    "other rows": (replace("parameters.npy", np.zeros((107, 5))), "parameters.npy is damaged"),
    "half a yaml": (truncate("table.yaml", 0.05), "table.yaml is damaged"),
    "of before": (lambda folder: (folder / "SHA256SUMS").unlink(), "SHA256SUMS is missing"),
    "a later format": (signed(rewrite(format=3)), "format 3, this version reads 2"),
    "no table": (signed(replace("poses.npy", b"poses")), "delete this one and build it again"),
}


@pytest.mark.parametrize(("harm", "why"), DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_table_is_refused_with_its_path_and_the_reason(tmp_path, harm, why):
    table = build_table(scene_with())
    assert len(table.poses) == 108
    save_table(table, tmp_path / "t")
    harm(tmp_path / "t")
    with pytest.raises(ValueError, match=why) as refusal:
        load_table(tmp_path / "t", scene_with())
    assert str(tmp_path / "t") in str(refusal.value)


def test_a_table_whose_own_scene_cannot_be_read_is_refused_with_its_path(tmp_path):
    save_table(build_table(scene_with()), tmp_path / "t")
    signed(rewrite(fingerprint="0", scene={"lamp": {}}))(tmp_path / "t")
    with pytest.raises(ValueError, match="delete this one") as refusal:
        load_table(tmp_path / "t", scene_with())
    assert str(tmp_path / "t") in str(refusal.value)


@pytest.mark.parametrize(
    ("group", "values", "words"),
    [
        ("lamp", {"beam_sigma_deg": 9.0}, ["lamp.beam_sigma_deg", "8.0 there", "9.0 here"]),
        ("effects", {"attenuation": {"k_per_m": 0.25}}, ["attenuation", "0.1", "0.25"]),
        ("effects", {"forward_scatter": {"window_m": 0.3}}, ["forward_scatter", "absent", "0.3"]),
        ("table", {"yaw_deg": [6.0, 6.0, 1]}, ["table.yaw_deg", "[5.0,", "[6.0,"]),
        ("signature", {"lift": 0.0}, ["signature.lift", "1.0 there", "0.0 here"]),
    ],
)
def test_a_table_of_another_scene_is_refused_with_the_key_and_both_values(
    tmp_path, group, values, words
):
    save_table(build_table(scene_with()), tmp_path / "t")
    with pytest.raises(ValueError, match="another scene") as refusal:
        load_table(tmp_path / "t", scene_with(group, **values))
    message = str(refusal.value)
    assert all(word in message for word in words), message
    # Only what differs is named.
    assert "array.width_m" not in message


def test_a_table_of_the_same_scene_under_another_name_is_welcome(tmp_path):
    table = build_table(scene_with())
    save_table(table, tmp_path / "t")
    renamed = scene_from_settings(table.scene.settings(), "renamed")
    assert_equal_tables(load_table(tmp_path / "t", renamed), table)


def test_the_cache_builds_once_for_each_scene(cache, count_builds):
    scene, other = scene_with(), scene_with("lamp", beam_sigma_deg=9.0)
    first = cached_table(scene)
    assert_equal_tables(cached_table(scene), first)
    assert_equal_tables(cached_table(other), cached_table(other))
    assert count_builds == [scene, other]
    assert isinstance(first.poses, np.memmap)
    assert len(os.listdir(cache)) == 2


@pytest.mark.parametrize(
    "harm", [truncate("poses.npy", 0.5), truncate("table.yaml", 0.05), rewrite(fingerprint="0")]
)
def test_a_damaged_cache_heals(cache, count_builds, caplog, harm, monkeypatch):
    # Of the module's own logger, as launch, where it is imported, puts another one at the root.
    logger = logging.getLogger(disk.__name__)
    monkeypatch.setattr(logger, "handlers", [caplog.handler])
    scene = scene_with()
    first = build_table(scene)
    cached_table(scene)
    (entry,) = cache.iterdir()
    harm(entry)
    assert_equal_tables(cached_table(scene), first)
    assert str(entry) in caplog.text
    assert "building it again now" in caplog.text
    assert_equal_tables(cached_table(scene), first)
    assert count_builds == [scene, scene]
    assert list(cache.iterdir()) == [entry]


def test_a_cache_that_cannot_be_written_still_gives_the_table(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(file))
    assert_equal_tables(cached_table(scene_with()), build_table(scene_with()))
    assert file.read_text() == "no folder"


def test_a_file_in_the_place_of_a_cached_table_still_gives_the_table(cache):
    cached_table(scene_with())
    (entry,) = cache.iterdir()
    shutil.rmtree(entry)
    entry.write_text("no folder")
    assert_equal_tables(cached_table(scene_with()), build_table(scene_with()))


def test_the_cache_lies_where_xdg_says_and_else_in_the_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "x"))
    assert files.cache_dir() == tmp_path / "x" / "uuv_optical_array"
    monkeypatch.setenv("HOME", str(tmp_path))
    for unset in (True, False):
        if unset:
            monkeypatch.delenv("XDG_CACHE_HOME")
        else:
            monkeypatch.setenv("XDG_CACHE_HOME", "")
        assert files.cache_dir() == tmp_path / ".cache" / "uuv_optical_array"


def test_a_folder_that_cannot_be_moved_into_place_keeps_the_older_one(tmp_path, monkeypatch):
    place = tmp_path / "t"
    place.mkdir()
    (place / "old").write_text("old")
    rename = type(place).rename

    def refuse_new(self, target):
        if os.fspath(target) == os.fspath(place) and (self / "new").exists():
            raise OSError("no")
        return rename(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(type(place), "rename", refuse_new)
        with pytest.raises(OSError, match="no"), files.whole_directory(place) as scratch:
            (scratch / "new").write_text("new")
    assert (place / "old").read_text() == "old"
    assert list(tmp_path.iterdir()) == [place]


FRESH_PAGES = """import resource
from uuv_optical_array.estimation.table.signature_table import build_table
from uuv_optical_array.forward.scene import load_scene
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
rows = len(build_table(load_scene("follow")).poses)
print(rows, resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)"""


def test_each_block_of_a_table_is_built_in_the_memory_of_the_one_before_it():
    # In a process of its own, whose allocator has seen no large array yet.
    run = subprocess.run([sys.executable, "-c", FRESH_PAGES], capture_output=True, check=True)
    rows, fresh_pages = map(int, run.stdout.split())
    assert fresh_pages < rows / 10
