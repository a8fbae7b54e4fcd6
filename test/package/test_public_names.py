"""What ``import uuv_optical_array`` offers, in the code and in the documentation."""

from pathlib import Path
from xml.etree import ElementTree

import pytest
from command_line import python

import uuv_optical_array

ROOT = Path(__file__).parents[2]
NAMES = [name for name in uuv_optical_array.__all__ if name != "__version__"]


@pytest.mark.parametrize("name", NAMES)
def test_every_public_name_is_there_and_documented(name):
    assert getattr(uuv_optical_array, name).__doc__


def test_the_version_is_that_of_the_package():
    assert uuv_optical_array.__version__ == ElementTree.parse(ROOT / "package.xml").findtext(
        "version"
    )
    assert f'version="{uuv_optical_array.__version__}"' in (ROOT / "setup.py").read_text()


def test_a_name_that_is_not_public_is_refused():
    with pytest.raises(AttributeError, match="nonsense"):
        _ = uuv_optical_array.nonsense


def test_importing_the_package_imports_none_of_its_modules():
    program = (
        "import sys, uuv_optical_array; "
        "print(sum(name.startswith('uuv_optical') for name in sys.modules))"
    )
    assert python(program).stdout.strip() == "1"
