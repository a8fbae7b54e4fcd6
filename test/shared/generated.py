"""The generator of the reference, which is a script beside the documents."""

import importlib.util
import sys
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"
sys.path.append(str(DOCS))  # of what it imports
_SPEC = importlib.util.spec_from_file_location("generate_reference", DOCS / "generate_reference.py")
reference = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(reference)
