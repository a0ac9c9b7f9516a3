"""How the documentation is built. Everything a page needs is in it: no font, script or picture from elsewhere."""

import gc
import logging
import os
import sys
from pathlib import Path

import haptorb

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "_ext"))
os.environ.setdefault("MPLBACKEND", "Agg")

# Every page stays in memory as a tree to the end: to look through all of them for garbage again and again takes long.
gc.set_threshold(100_000, 50, 50)
# Nor is every event worth a line that nobody reads.
logging.getLogger("sphinx").setLevel(logging.INFO)

project = "haptorb"
author = "The haptorb developers"
copyright = "2026, the haptorb developers"
release = version = haptorb.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinxcontrib.bibtex",
    "sphinx_gallery.gen_gallery",
    "plain_docstrings",
    "quick_references",
    "room_pages",
]
exclude_patterns = [
    "_build",
    "_ext",
    "gallery/*.ipynb",
    "gallery/*.py.md5",
    "sg_execution_times.rst",
]
nitpicky = False
default_role = "code"

myst_enable_extensions = ["deflist", "colon_fence"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_type_aliases = {"Array": "Array", "ArrayLike": "ArrayLike"}
autodoc_typehints_format = "short"
autodoc_use_type_comments = False  # there are none, and looking for them takes seconds
python_maximum_signature_line_length = 100
add_module_names = False
# Every page lists all contents: with every function in them that is half of the build.
toc_object_entries = False

bibtex_bibfiles = ["references.bib"]
bibtex_default_style = "plain"
bibtex_reference_style = "author_year"

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/\d\d_",
    "within_subsection_order": "sphinx_gallery.sorting.FileNameSortKey",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
    "min_reported_time": 1e9,
    "remove_config_comments": True,
}

html_theme = "furo"
html_title = "haptorb"
html_static_path = ["_static"]
html_css_files = ["haptorb.css"]
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False
templates_path: list[str] = []
