"""``{live} NAME``: a 3D view of a model of `scripts/live_models.py`, with a slider of the sun.

Its options are `image`, which is shown without WebGL 2 or JavaScript, and `alt`; its content is the caption. The model
is baked when the site is built.
"""

from pathlib import Path

import live_models
from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.util.docutils import SphinxDirective

FOLDER = "_static/live"


class LiveView(SphinxDirective):
    """A figure that docs/_static/live.js turns into a 3D view."""

    required_arguments = 1
    has_content = True
    option_spec = {"image": directives.unchanged_required, "alt": directives.unchanged_required}  # noqa: RUF012

    def run(self):
        (name,) = self.arguments
        if name not in live_models.SCENES:
            raise self.error(f"no live model {name!r}; there are {', '.join(live_models.SCENES)}")
        self.env.note_dependency(live_models.__file__)
        up = "../" * self.env.docname.count("/")
        start = f'<figure class="live" data-name="{name}" data-model="{up}{FOLDER}/{name}.js">'
        image = nodes.image(uri=self.options["image"], alt=self.options["alt"])
        caption = nodes.paragraph("", "", *self.state.inline_text(" ".join(self.content), self.lineno)[0])
        end = f'</figure><script defer src="{up}_static/live.js"></script>'
        html = (nodes.raw("", text, format="html") for text in (start, end))
        return [next(html), image, caption, next(html)]


def write_models(app, exception) -> None:
    """Bake the models once the site is built."""
    if exception is None and app.builder.format == "html":
        for name in live_models.SCENES:
            live_models.write(name, Path(app.outdir, FOLDER, f"{name}.js"))


def setup(app):
    app.add_directive("live", LiveView)
    app.connect("build-finished", write_models)
    return {"parallel_read_safe": True}
