"""The sidebar: one group of pages open, that of the page shown; the others are folded, and open with a click.

The pictures of the gallery stay folded even on its pages, as their names would fill the sidebar.
"""

import re

_GROUP = re.compile(
    r'<p class="caption"[^>]*>(?P<caption>.*?)</p>\s*(?P<pages><ul.*?)(?=<p class="caption"|\Z)', re.DOTALL
)

_PICTURES = re.compile(r'(>Gallery</a><input[^>]*?) checked=""')


def folded(tree: str) -> str:
    """The navigation of a page, whose groups are `details`; the first is open where none has the page."""
    start = re.compile(r' class="current"').search(tree) is None

    def group(match: re.Match) -> str:
        nonlocal start
        is_open, start = start or 'class="current"' in match["pages"], False
        summary = f'<summary class="caption">{match["caption"]}</summary>'
        return f"<details{' open' * is_open}>{summary}{match['pages']}</details>"

    return _GROUP.sub(group, _PICTURES.sub(r"\1", tree))


def fold(app, page, template, context, doctree):
    """Fold the groups of the sidebar of a page, after Furo has made it."""
    if tree := context.get("furo_navigation_tree"):
        context["furo_navigation_tree"] = folded(tree)


def setup(app):
    app.connect("html-page-context", fold, priority=900)
    return {"parallel_read_safe": True}
