"""One search by spectral angle, by each peer that is installed: compare the rows of each group."""

import numpy as np
import pytest
from peers.exact import nearest_exactly
from peers.libraries import BUILDERS, OURS, missing
from peers.search import signatures

from uuv_optical_array.estimation.signature.spectral_angle import spectral_angle
from uuv_optical_array.forward.scene import load_scene

ROWS = 100_000


@pytest.fixture(scope="module")
def vectors():
    scene, rng = load_scene("reference"), np.random.default_rng(1)
    return signatures(scene, ROWS, rng), signatures(scene, 200, rng)


@pytest.mark.parametrize("name", [name for name in BUILDERS if name not in missing()])
@pytest.mark.parametrize("queries", [1, 200])
def test_search(benchmark, vectors, name, queries):
    benchmark.group = f"{queries} of {ROWS:,} rows"
    rows, asked = vectors
    search = BUILDERS[name](rows)
    rounds = 20 if queries == 1 else 2
    found, _ = benchmark.pedantic(search, (asked[:queries],), rounds=rounds, warmup_rounds=1)
    truth = nearest_exactly(rows, asked[0])
    # Single precision may take a neighbour.
    angles = spectral_angle(rows[[found[0], next(iter(truth))]], asked[0])
    assert angles[0] < angles[1] + 1e-3


def test_build(benchmark, vectors):
    rows, asked = vectors
    search = benchmark.pedantic(BUILDERS[OURS], (rows,), rounds=5, warmup_rounds=1)
    assert int(search(asked[:1])[0][0]) in nearest_exactly(rows, asked[0])
