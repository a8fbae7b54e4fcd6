"""Settings of Sphinx, for ``make docs`` and for rosdoc2."""

import importlib.util
from pathlib import Path
from xml.etree import ElementTree

project = "uuv_optical_array"
release = ElementTree.parse(Path(__file__).parents[1] / "package.xml").findtext("version")
author = project_copyright = "uuv_optical_array developers"
html_title = f"{project} {release}"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    # Either reads the docstrings; rosdoc2 brings Sphinx's own alone.
    "numpydoc" if importlib.util.find_spec("numpydoc") else "sphinx.ext.napoleon",
]
exclude_patterns = [
    "_build",
    # What rosdoc2 adds: copies of the README and its like, and a page for every module.
    "__readme_include*",
    "modules*",
    "standard*",
    "uuv_optical_array*",
]
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["style.css"]
myst_heading_anchors = 3  # links to headings, as GitHub has them
autodoc_member_order = "bysource"
numpydoc_show_class_members = False  # autodoc shows them
