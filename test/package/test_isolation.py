"""Test runs at the same time, and the processes of one, do not hear each other."""

import json
import os
import subprocess
import sys
from pathlib import Path

from command_line import begun, python

OWN = ("ROS_DOMAIN_ID", "ROS_LOG_DIR", "XDG_CACHE_HOME")
ANOTHER = f"import conftest, json, os; print(json.dumps([os.environ[name] for name in {OWN}]))"


def another():
    """Return what another run, which has ended, had of `OWN`."""
    done = python(ANOTHER, cwd=Path(__file__).parents[1])
    return json.loads(done.stdout)


def test_another_run_has_a_domain_a_log_and_a_cache_of_its_own():
    ours = [os.environ[name] for name in OWN]
    for name, own, other in zip(OWN, ours, another(), strict=True):
        assert own != other, name
    assert 1 <= int(ours[0]) <= 101


def test_no_run_has_the_domain_of_a_node_that_another_left_behind():
    domain, *_ = another()
    left = {**os.environ, "ROS_DOMAIN_ID": domain}
    program = [sys.executable, "-c", "input()"]
    with begun(program, env=left, stdin=subprocess.PIPE):
        assert another()[0] != domain
