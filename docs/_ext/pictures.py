"""Directives that show programs with the pictures that they made, see `scripts/gallery.py`.

``{gallery}`` has lines "Group: NAME ...": thumbnails in groups, then a section for each picture. ``{examples}`` has a
section for each program of examples/, with what it drew and printed.
"""

import gallery
from docutils import nodes
from sphinx import addnodes
from sphinx.util.docutils import SphinxDirective

LANGUAGES = {".py": "python", ".sh": "bash"}


class _Programs(SphinxDirective):
    def _code(self, text: str, language: str) -> nodes.literal_block:
        return nodes.literal_block(text, text, language=language)

    def _words(self, text: str, *classes: str) -> nodes.paragraph:
        return nodes.paragraph("", "", *self.state.inline_text(text, self.lineno)[0], classes=list(classes))

    def _link(self, program) -> nodes.paragraph:
        """A link that saves the program."""
        link = addnodes.download_reference(reftarget=f"/../{program.place}", refdoc=self.env.docname)
        link += nodes.literal("", program.path.name)
        return nodes.paragraph("", "", link, classes=["download-program"])

    def _image(self, program, picture) -> nodes.image:
        uri = "/" + picture.relative_to(gallery.ROOT / "docs").as_posix()
        return nodes.image(uri=uri, alt=program.title, loading="lazy")

    def _section(self, program, *parts: nodes.Node) -> nodes.section:
        self.env.note_dependency(str(program.path))
        section = nodes.section(ids=[_anchor(program)], names=[program.title.lower()])
        section += nodes.title("", "", *self.state.inline_text(program.title, self.lineno)[0])
        section += [*parts, self._link(program)]
        return section


class Gallery(_Programs):
    """Pictures of docs/gallery/."""

    has_content = True

    def run(self):
        known = {program.name: program for program in gallery.programs()}
        thumbnails, sections, shown = [], [], []
        for line in self.content:
            group, _, names = line.partition(": ")
            if unknown := set(names.split()) - set(known):
                raise self.error(f"docs/gallery has no {', '.join(sorted(unknown))}")
            chosen = [known[name] for name in names.split()]
            grid = nodes.container("", *map(self._thumbnail, chosen), classes=["thumbnails"])
            thumbnails += [nodes.rubric("", group), grid]
            sections += map(self._shown, chosen)
            shown += names.split()
        if left := set(known) - set(shown):
            raise self.error(f"not in the gallery: {', '.join(sorted(left))}")
        return [*thumbnails, *sections]

    def _thumbnail(self, program) -> nodes.paragraph:
        link = nodes.reference("", "", internal=True, refid=_anchor(program))
        link += [self._image(program, program.thumbnail), nodes.inline("", program.title)]
        return nodes.paragraph("", "", link)

    def _shown(self, program) -> nodes.section:
        parts = [self._image(program, program.picture), self._words(program.caption)]
        credits = [gallery.CREDITS[name] for name in program.scenes]
        if program.scenes:
            credits.append(_stand_in(program.scenes))
        if credits:
            parts.append(self._words(" ".join(credits), "credit"))
        return self._section(program, *parts, self._code(program.code, LANGUAGES[program.path.suffix]))


class Examples(_Programs):
    """The programs of examples/."""

    def run(self):
        return [self._shown(program) for program in gallery.examples()]

    def _shown(self, program) -> nodes.section:
        parts = [self._words(program.caption)] if program.caption else []
        if program.picture.is_file():
            parts.append(self._image(program, program.picture))
        parts.append(self._code(program.code, "python"))
        if program.printed.is_file():
            parts += [self._words("It prints:"), self._code(program.printed.read_text(encoding="utf-8"), "text")]
        return self._section(program, *parts)


def _stand_in(scenes: list[str]) -> str:
    """How to run a program without its real scenes."""
    files = " and ".join(f"`{name}.glb`" for name in scenes)
    cure = f"`antumbra scenes atrium -o {scenes[0]}.glb`"
    return f"The program loads {files} from the current folder: put a model of yours there, or run {cure}."


def _anchor(program) -> str:
    return program.name.replace("_", "-")


def setup(app):
    app.add_directive("gallery", Gallery)
    app.add_directive("examples", Examples)
    return {"parallel_read_safe": True}
