"""The generator of the reference, which is a script beside the documents."""

import importlib.util
from pathlib import Path

_SPEC = importlib.util.spec_from_file_location(
    "generate_reference", Path(__file__).parents[2] / "docs/generate_reference.py"
)
reference = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(reference)
