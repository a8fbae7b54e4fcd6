"""One search by spectral angle, by each peer that is installed: compare the rows of each group."""

import numpy as np
import pytest

from uuv_optical_array import peers
from uuv_optical_array.forward.scene import load_scene

ROWS = 100_000


@pytest.fixture(scope="module")
def vectors():
    scene, rng = load_scene("reference"), np.random.default_rng(1)
    return peers.signatures(scene, ROWS, rng), peers.signatures(scene, 200, rng)


@pytest.mark.parametrize("name", [name for name in peers.BUILDERS if name not in peers.missing()])
@pytest.mark.parametrize("queries", [1, 200])
def test_search(benchmark, vectors, name, queries):
    benchmark.group = f"{queries} of {ROWS:,} rows"
    rows, asked = vectors
    search = peers.BUILDERS[name](rows)
    rounds = 20 if queries == 1 else 2
    found, _ = benchmark.pedantic(search, (asked[:queries],), rounds=rounds, warmup_rounds=1)
    truth = peers.nearest_exactly(rows, asked[0])
    # Single precision may take a neighbour.
    angles = peers.spectral_angle(rows[[found[0], next(iter(truth))]], asked[0])
    assert angles[0] < angles[1] + 1e-3


def test_build(benchmark, vectors):
    rows, asked = vectors
    search = benchmark.pedantic(peers.BUILDERS[peers.OURS], (rows,), rounds=5, warmup_rounds=1)
    assert int(search(asked[:1])[0][0]) in peers.nearest_exactly(rows, asked[0])
