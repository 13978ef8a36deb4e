"""``{live} NAME``: a page with exact shadows of `scripts/live_pages.py`, which is made when the site is built.

Its option `alt` says what is to be seen; `play` plays the day once; its content is the caption. Its still is shown
until the page has come.
"""

import base64
import re
from html import escape
from pathlib import Path

import live_pages
from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.util.docutils import SphinxDirective

FOLDER = "_static/live"
_STILL = re.compile(r'id="still" alt="" src="data:image/webp;base64,([^"]+)"')


class LivePage(SphinxDirective):
    """A figure with a page in a frame, which is loaded when it comes into view."""

    required_arguments = 1
    has_content = True
    option_spec = {"alt": directives.unchanged_required, "play": directives.flag}  # noqa: RUF012

    def run(self):
        (name,) = self.arguments
        if name not in live_pages.PAGES:
            raise self.error(f"no live page {name!r}; there are {', '.join(live_pages.PAGES)}")
        self.env.note_dependency(live_pages.__file__)
        place = f"{'../' * self.env.docname.count('/')}{FOLDER}/{name}"
        source = f"{place}.html{'?play' if 'play' in self.options else ''}"
        still = f'style="background-image: url({place}.webp)"'
        frame = f'<iframe src="{source}" title="{escape(self.options["alt"])}" loading="lazy" {still}></iframe>'
        caption = nodes.paragraph("", "", *self.state.inline_text(" ".join(self.content), self.lineno)[0])
        start, end = (nodes.raw("", text, format="html") for text in (f'<figure class="live">{frame}', "</figure>"))
        return [start, caption, end]


def write_pages(app, exception) -> None:
    """Make the pages once the site is built."""
    if exception is None and app.builder.format == "html":
        for name in live_pages.PAGES:
            path = Path(app.outdir, FOLDER, f"{name}.html")
            live_pages.write(name, path)
            still = _STILL.search(path.read_text(encoding="utf-8"))
            if still is not None:
                path.with_suffix(".webp").write_bytes(base64.b64decode(still[1]))


def setup(app):
    app.add_directive("live", LivePage)
    app.connect("build-finished", write_pages)
    return {"parallel_read_safe": True}
