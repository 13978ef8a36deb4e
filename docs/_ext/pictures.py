"""Programs with the pictures that they made, see `scripts/gallery.py`.

Each program of docs/gallery/ is the source of a page. ``{gallery}`` has lines "Group: NAME ...", and shows a thumbnail
of each, linked to its page. ``{examples}`` has a section for each program of examples/, with what it drew and printed.
"""

from pathlib import Path

import gallery
from docutils import nodes
from myst_parser.parsers.sphinx_ import MystParser
from sphinx import addnodes
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
        files = " and ".join(f"`{name}.glb`" for name in program.scenes)
        cure = f"put a model of yours there, or run `antumbra scenes atrium -o {program.scenes[0]}.glb`."
        credits = " ".join(gallery.CREDITS[name] for name in program.scenes)
        return f"{credits} The program loads {files} from the current folder: {cure}"
    names = " and ".join(f"`{name}`" for name in gallery.packaged_scenes(program))
    comes = f"{names} [comes with the package](../examples.md)" if names else "made by the program"
    return f"Scene: {comes}."


class _Programs(SphinxDirective):
    def _image(self, program, picture) -> nodes.image:
        uri = "/" + picture.relative_to(gallery.ROOT / "docs").as_posix()
        return nodes.image(uri=uri, alt=program.title, loading="lazy")


class Gallery(_Programs):
    """Thumbnails of the pictures of docs/gallery/, and a table of contents of their pages."""

    has_content = True

    def run(self):
        known = {program.name: program for program in gallery.programs()}
        sections, shown = list[nodes.Node](), list[str]()
        for line in self.content:
            group, _, names = line.partition(": ")
            if unknown := set(names.split()) - set(known):
                raise self.error(f"docs/gallery has no {', '.join(sorted(unknown))}")
            section = nodes.section(ids=[nodes.make_id(group)], names=[group.lower()])
            thumbnails = [self._thumbnail(known[name]) for name in names.split()]
            section += [nodes.title("", group), nodes.container("", *thumbnails, classes=["thumbnails"])]
            sections.append(section)
            shown += names.split()
        if left := set(known) - set(shown):
            raise self.error(f"not in the gallery: {', '.join(sorted(left))}")
        return [*sections, self._contents([f"{FOLDER}/{name}" for name in shown])]

    def _thumbnail(self, program) -> nodes.paragraph:
        self.env.note_dependency(str(program.path))
        address = self.env.app.builder.get_relative_uri(self.env.docname, f"{FOLDER}/{program.name}")
        link = nodes.reference("", "", internal=True, refuri=address)
        link += [self._image(program, program.thumbnail), nodes.inline("", program.title)]
        return nodes.paragraph("", "", link)

    def _contents(self, pages: list[str]) -> nodes.Node:
        tree = addnodes.toctree(parent=self.env.docname, includefiles=pages, entries=[(None, page) for page in pages])
        shown = dict(hidden=True, glob=False, caption=None, includehidden=False, titlesonly=True, maxdepth=1)
        tree.attributes.update(shown)
        return tree


class Examples(_Programs):
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
            section += self._image(program, program.picture)
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
    app.add_directive("gallery", Gallery)
    app.add_directive("examples", Examples)
    for suffix in SUFFIXES:
        app.add_source_suffix(suffix, ProgramParser.supported[0])
    app.add_source_parser(ProgramParser)
    return {"parallel_read_safe": True}
