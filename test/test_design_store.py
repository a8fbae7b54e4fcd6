"""A study on disk: the same bytes however it is filled, and no other study in its place."""

import dataclasses

import numpy as np
import pytest
from conftest import dask_workers, filled_while_a_worker_dies
from designs import SMALL, study_of

from uuv_optical_array.core.cluster import on_threads
from uuv_optical_array.forward.scene import load_scene
from uuv_optical_array.studies.design.store import DesignStore


def fill(path, study, threads=1):
    store = DesignStore.create(path, study)
    assert on_threads(store.fill, store.chunks, threads, lambda: None) == [3] * 6 + [2]
    return store


def contents(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def test_the_same_bytes_by_one_thread_two_threads_and_any_order(tmp_path, small_chunks):
    study = study_of()
    one, two = (fill(tmp_path / f"{n}.zarr", study, n) for n in (1, 2))
    back = DesignStore.create(tmp_path / "back.zarr", study)
    for chunk in reversed(back.chunks):
        back.fill(chunk)
    assert contents(one.path) == contents(two.path) == contents(back.path)
    assert len(contents(one.path)) == 7 + 2
    # A design's score is its own, whatever else is swept.
    alone = dataclasses.replace(SMALL, shape=("curved",), width_m=(0.4,), beam_sigma_deg=(6.0,))
    rows = dict(one.rows())
    for design, values in zip(
        alone.designs(), study_of(sweep=alone).scored(alone.designs()), strict=True
    ):
        np.testing.assert_array_equal(dataclasses.astuple(rows[design]), values)


def test_two_workers_one_killed_half_way_write_the_same_bytes(tmp_path, small_chunks):
    whole = contents(fill(tmp_path / "whole.zarr", study_of()).path)
    small = "import uuv_optical_array.studies.design.store as s; s.CHUNK_DESIGNS = 3\n"
    with dask_workers(tmp_path, small) as (address, workers):
        store = DesignStore.create(tmp_path / "t.zarr", study_of())
        counts = filled_while_a_worker_dies(store, address, workers, 0.1)
    assert counts == [3] * 6 + [2]
    assert contents(store.path) == whole


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"poses": 41}, "poses is 40 there and 41 here"),
        ({"seed": 2}, "seed is 1 there and 2 here"),
        ({"power": "counts"}, "power is flux there and counts here"),
        ({"mount": "centre"}, "mount is front there"),
        ({"scene": load_scene("coastal")}, "attenuation.k_per_m is 0.1 there"),
        (
            {"sweep": dataclasses.replace(SMALL, width_m=(0.2, 0.3))},
            "width_m is 0.2 0.4 there and 0.2 0.3 here",
        ),
    ],
)
def test_the_store_of_another_study_is_refused_by_what_differs(
    tmp_path, small_chunks, changes, error
):
    store = DesignStore.create(tmp_path / "t.zarr", study_of())
    before = contents(store.path)
    assert DesignStore.create(tmp_path / "t.zarr", study_of()) == store
    with pytest.raises(ValueError, match=f"another study: .*{error}.*name another --output"):
        DesignStore.create(tmp_path / "t.zarr", study_of(**changes))
    assert contents(store.path) == before


def test_a_store_that_is_none_or_damaged_is_refused(tmp_path, small_chunks):
    with pytest.raises(ValueError, match=r"name it \*.zarr"):
        DesignStore.create(tmp_path / "t.designs", study_of())
    (tmp_path / "t.zarr").mkdir()
    with pytest.raises(ValueError, match="exists and is no design study"):
        DesignStore.create(tmp_path / "t.zarr", study_of())
    store = fill(tmp_path / "u.zarr", study_of())
    whole = contents(store.path)
    (store.path / "1.0").write_bytes(whole["1.0"][:-3])
    with pytest.raises(ValueError, match=r"chunk 1.0 is damaged.*uuv_array design again to mend"):
        store.rows()
    assert contents(fill(store.path, study_of()).path) == whole
