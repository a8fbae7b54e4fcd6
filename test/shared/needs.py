"""Marks of tests for what only some machines have.

They skip test by test: to launch_testing a module that skips itself skips its whole folder.
"""

import importlib.util

import pytest

from uuv_optical_array.core.numerics import compilation

# A ROS installation has no rosbags.
rosbags = pytest.mark.skipif(
    importlib.util.find_spec("rosbags") is None, reason="bags need the extra bags"
)
numba = pytest.mark.skipif(not compilation.installed(), reason="Numba is not installed")
