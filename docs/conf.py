"""Sphinx: ``sphinx-build -W docs docs/_build``."""

import sys
from pathlib import Path

import antumbra

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent / "scripts")]

project = "Antumbra"
author = "the Antumbra authors"
copyright = author
version = release = antumbra.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "myst_parser",
    "sphinxcontrib.bibtex",
    "fields",
    "help",
    "labels",
    "live",
    "paper_code",
    "pictures",
    "raised",
    "registries",
    "whole",
    "shown",
]
exclude_patterns = ["_build", "papers/ideas"]
nitpick_ignore_regex = [("py:.*", ".*")]

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings say shapes and types
napoleon_google_docstring = False
napoleon_use_ivar = True

myst_enable_extensions = ["deflist"]
myst_heading_anchors = 3

bibtex_bibfiles = ["REFERENCES.bib"]
bibtex_default_style = "author-year"

html_theme = "furo"
html_title = f"Antumbra {release}"
html_static_path = ["_static"]
html_css_files = ["antumbra.css"]
html_extra_path = ["llms.txt"]  # it links to sources of pages, which html_copy_source publishes
