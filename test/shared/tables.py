"""Signature tables on disk, as ``uuv_array table`` writes them."""

import numpy as np
import pytest

from uuv_optical_array.estimation.large_table import build_large_table
from uuv_optical_array.estimation.signature_table import grid_axes, grid_poses


def write_table(path, table):
    """Write a table that has all rows of its scene's grid or some of them."""
    zarr = pytest.importorskip("zarr", reason="a table on disk needs the extra cluster")
    build_large_table(path, table.scene, threads=1)
    array = zarr.open_array(str(path), mode="r+")
    rows = {tuple(pose) for pose in table.poses}
    poses = grid_poses(grid_axes(table.scene.table), np.arange(len(array)))
    array[:] = np.where([[tuple(pose) in rows] for pose in poses], array[:], np.nan)
    return str(path)
