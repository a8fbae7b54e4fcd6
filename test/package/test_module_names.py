"""No two test modules have one name: launch_testing imports each by its name alone."""

from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_each_module_of_tests_and_benchmarks_has_a_name_of_its_own():
    names = [
        path.stem for folder in ("test", "benchmarks") for path in (ROOT / folder).rglob("*.py")
    ]
    twice = {name for name, count in Counter(names).items() if count > 1}
    assert twice <= {"__init__"}
