"""Sphinx: ``sphinx-build -W docs docs/_build``."""

import inspect
import sys
from importlib import import_module
from pathlib import Path

import antumbra

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent / "scripts")]

SOURCE = "https://github.com/antumbra/antumbra"
project = "Antumbra"
author = "the Antumbra authors"
copyright = author
version = release = antumbra.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx.ext.linkcode",
    "sphinx.ext.napoleon",
    "myst_parser",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinxcontrib.bibtex",
    "sphinxext.opengraph",
    "api_links",
    "api_summary",
    "charts",
    "code_tabs",
    "comments",
    "examples_first",
    "fields",
    "folds",
    "formulas",
    "help",
    "labels",
    "live",
    "long_commands",
    "notebooks",
    "paper_code",
    "pictures",
    "raised",
    "registries",
    "search_results",
    "search_words",
    "shared_keywords",
    "sidebar",
    "signatures",
    "whole",
    "shown",
]
exclude_patterns = ["_build", "_ext", "_templates", "conf.py", "papers/ideas"]
nitpick_ignore_regex = [("py:.*", ".*")]

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # _ext/signatures.py adds those that are short; docstrings say shapes and dtypes
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
napoleon_google_docstring = False
napoleon_use_ivar = True

default_role = "py:obj"  # names in backticks of docstrings become links
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
smartquotes_action = "qe"  # quotes and ellipses; two hyphens begin an option

bibtex_bibfiles = ["REFERENCES.bib"]
bibtex_default_style = "author-year"

SITES = {
    "python": "https://docs.python.org/3/",
    "numpy": "https://numpy.org/doc/stable/",
    "scipy": "https://docs.scipy.org/doc/scipy/",
    "pandas": "https://pandas.pydata.org/docs/",
    "geopandas": "https://geopandas.org/en/stable/",
    "trimesh": "https://trimesh.org/",
    "pyvista": "https://docs.pyvista.org/",
}
intersphinx_mapping = {name: (site, f"_inventories/{name}.txt") for name, site in SITES.items()}  # builds work offline
intersphinx_disabled_reftypes = ["std:*"]

html_theme = "furo"
html_math_renderer = "mathml"
templates_path = ["_templates"]
html_title = f"Antumbra {release}"
html_static_path = ["_static"]
html_css_files = ["antumbra.css"]
html_js_files = ["tables.js"]
html_logo = html_favicon = "_static/logo.svg"
html_search_scorer = str(HERE / "_static" / "scorer.js")
html_baseurl = ogp_site_url = "https://antumbra.github.io/antumbra/"
ogp_image = "_images/soft_shadows.webp"
ogp_social_cards = {"enable": False}  # they need Matplotlib, and show text
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
copybutton_selector = "div:not(.highlight-text) > div.highlight pre"  # what is printed is not copied
html_theme_options = {
    "source_repository": SOURCE,
    "source_branch": "main",
    "source_directory": "docs/",
}
html_extra_path = ["llms.txt"]  # it links to sources of pages, which html_copy_source publishes


def linkcode_resolve(domain: str, info: dict[str, str]) -> str | None:
    """The address of the source of a documented name."""
    thing = import_module(info["module"]) if domain == "py" and info["module"] else None
    for part in info["fullname"].split("."):
        thing = getattr(thing, part, None)
    thing = inspect.unwrap(getattr(thing, "fget", thing) or thing) if thing is not None else None
    try:
        file, (lines, first) = Path(inspect.getsourcefile(thing) or ""), inspect.getsourcelines(thing)
    except TypeError:  # neither a function nor a class
        return None
    if antumbra.__name__ not in file.parts:
        return None
    inside = file.relative_to(Path(antumbra.__file__).parents[1]).as_posix()
    return f"{SOURCE}/blob/main/src/{inside}#L{first}-L{first + len(lines) - 1}"
