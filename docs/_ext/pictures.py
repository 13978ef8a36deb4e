"""Programs with the pictures that they made, see `scripts/gallery.py`.

Each program of docs/gallery/ is the source of a page. gallery.md shows their thumbnails in tables, which read well on
GitHub too; here they become a grid that fits the screen, and a table of contents. ``{examples}`` has a section for each
program of examples/, with what it drew and printed.
"""

import re
from pathlib import Path

import gallery
from docutils import nodes
from myst_parser.parsers.sphinx_ import MystParser
from sphinx import addnodes
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

SUFFIXES = {".py": "python", ".sh": "sh"}
FOLDER = "gallery"  # of the programs, in docs/


class ProgramParser(MystParser):
    """Reads a program of the gallery as a page: its picture, what it shows, its code, and its scene."""

    supported = ("program",)

    def parse(self, inputstring, document):
        env = document.settings.env
        super().parse(page_of(gallery.program_of(Path(env.doc2path(env.docname)))), document)


def page_of(program) -> str:
    """The page of a program, as Markdown."""
    picture = f"../{program.picture.relative_to(gallery.ROOT / 'docs').as_posix()}"
    code = f"```{SUFFIXES[program.path.suffix]}\n{program.code}```"
    parts = [f"# {program.title}", f"![{program.title}]({picture})", program.caption, code, scene_line(program)]
    return "\n\n".join([*parts, f"{{download}}`{program.path.name}`"]) + "\n"


def scene_line(program) -> str:
    """Where the scene of a program is from."""
    if program.scenes:
        return " ".join(
            f"{gallery.CREDITS[name]} The program loads `{name}.glb` from the current folder. {gallery.CURES[name]}"
            for name in program.scenes
        )
    names = " and ".join(f"`{name}`" for name in gallery.packaged_scenes(program))
    comes = f"{names} [comes with the package](../examples.md)" if names else "made by the program"
    return f"Scene: {comes}."


def add_contents(app, page: str, source: list[str]) -> None:
    """Give the page of the gallery a hidden table of contents."""
    if page == FOLDER:
        names = re.findall(rf"\]\(({FOLDER}/\w+)\.\w+\)", source[0])
        known = {f"{FOLDER}/{program.name}" for program in gallery.programs()}
        if wrong := known ^ set(names):
            raise ExtensionError(f"docs/gallery.md and docs/gallery/ differ in {', '.join(sorted(wrong))}")
        source[0] += "\n```{toctree}\n:hidden:\n\n" + "\n".join(names) + "\n```\n"


def lay_out(app, doctree, page: str) -> None:
    """Turn the tables of the gallery into grids of thumbnails with their titles."""
    if page == FOLDER:
        for table in list(doctree.findall(nodes.table)):
            thumbnails = [_thumbnail(image) for image in table.findall(nodes.image)]
            table.replace_self(nodes.container("", *thumbnails, classes=["thumbnails"]))


def _thumbnail(image: nodes.image) -> nodes.paragraph:
    parent = image.parent
    while not isinstance(parent, nodes.reference):  # within it, text that a page is named by
        parent = parent.parent
    link = parent.deepcopy()
    next(link.findall(nodes.image))["loading"] = "lazy"
    link += nodes.inline("", image["alt"])
    return nodes.paragraph("", "", link)


class Examples(SphinxDirective):
    """The programs of examples/."""

    def run(self):
        return [self._shown(program) for program in gallery.examples()]

    def _shown(self, program) -> nodes.section:
        self.env.note_dependency(str(program.path))
        section = nodes.section(ids=[program.name.replace("_", "-")], names=[program.title.lower()])
        section += nodes.title("", "", *self._inline(program.title))
        if program.caption:
            section += self._words(program.caption)
        if program.picture.is_file():
            uri = "/" + program.picture.relative_to(gallery.ROOT / "docs").as_posix()
            section += nodes.image(uri=uri, alt=program.title, loading="lazy")
        section += self._code(program.code, "python")
        if program.printed.is_file():
            section += [self._words("It prints:"), self._code(program.printed.read_text(encoding="utf-8"), "text")]
        link = addnodes.download_reference(reftarget=f"/../{program.place}", refdoc=self.env.docname)
        link += nodes.literal("", program.path.name)
        section += nodes.paragraph("", "", link)
        return section

    def _inline(self, text: str) -> list[nodes.Node]:
        return self.state.inline_text(text, self.lineno)[0]

    def _words(self, text: str) -> nodes.paragraph:
        return nodes.paragraph("", "", *self._inline(text))

    def _code(self, text: str, language: str) -> nodes.literal_block:
        return nodes.literal_block(text, text, language=language)


def setup(app):
    app.connect("source-read", add_contents)
    app.connect("doctree-resolved", lay_out, priority=400)  # before charts
    app.add_directive("examples", Examples)
    for suffix in SUFFIXES:
        app.add_source_suffix(suffix, ProgramParser.supported[0])
    app.add_source_parser(ProgramParser)
    return {"parallel_read_safe": True}
