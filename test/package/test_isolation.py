"""Test runs at the same time, and the processes of one, do not hear each other."""

import json
import os
from pathlib import Path

from command_line import python

OWN = ("ROS_DOMAIN_ID", "ROS_LOG_DIR", "XDG_CACHE_HOME")
ANOTHER = f"import conftest, json, os; print(json.dumps([os.environ[name] for name in {OWN}]))"


def test_another_run_has_a_domain_a_log_and_a_cache_of_its_own():
    done = python(ANOTHER, cwd=Path(__file__).parents[1])
    ours = [os.environ[name] for name in OWN]
    for name, own, other in zip(OWN, ours, json.loads(done.stdout), strict=True):
        assert own != other, name
    assert 1 <= int(ours[0]) <= 101
