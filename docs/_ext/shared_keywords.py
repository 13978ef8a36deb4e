"""Parameters that a class or method shares with a function are described once in the reference, at the function.

The others say where. Docstrings in Python keep them all.
"""

import inspect
import re
from importlib import import_module

DESCRIBED = {
    "antumbra.RenderOptions": "antumbra.render",
    "antumbra.Renderer.render": "antumbra.render",
    "antumbra.Engine.occluded": "antumbra.Scene.occluded",
}
"""Name -> the name that describes its parameters too."""

TITLE = "Parameters"
_ENTRY = re.compile(r"[*\w]+(?:, [*\w]+)* :")


def parameters(lines: list[str]) -> dict[str, slice]:
    """Names, as the section Parameters of a docstring writes them -> the lines of their description."""
    if TITLE not in lines:
        return {}
    begin = lines.index(TITLE) + 2
    ruled = (n - 1 for n in range(begin + 1, len(lines)) if re.fullmatch(r"-{3,}", lines[n]))
    end = next(ruled, len(lines))  # at the title of the next section
    while end > begin and not lines[end - 1]:
        end -= 1
    starts = [n for n in range(begin, end) if _ENTRY.match(lines[n])]
    return {lines[a].partition(" :")[0]: slice(a, b) for a, b in zip(starts, [*starts[1:], end])}


def docstring_of(name: str) -> list[str]:
    """The lines of the docstring of a public name."""
    thing = import_module("antumbra")
    for part in name.split(".")[1:]:
        thing = getattr(thing, part)
    return (inspect.getdoc(thing) or "").splitlines()


def refer(app, what, name, obj, options, lines):
    """Replace the parameters of a docstring that another one describes by a sentence with a link."""
    other = DESCRIBED.get(name)
    if other is None:
        return
    whole = docstring_of(other)
    own, known = parameters(lines), {names: whole[part] for names, part in parameters(whole).items()}
    text_of = lambda part: [line for line in part if line]
    shared = {names: part for names, part in own.items() if text_of(lines[part]) == text_of(known.get(names, []))}
    if not shared:
        return
    for part in reversed(shared.values()):
        del lines[part]
    *first, last = [f"*{name}*" for names in shared for name in names.split(", ")]
    text = f"{', '.join(first)} and {last} are" if first else f"{last} is"
    title = lines.index(TITLE)
    if len(shared) == len(own):
        del lines[title : title + 2]
    lines[title:title] = [f"{text} described at `{other}`.", ""]


def setup(app):
    app.connect("autodoc-process-docstring", refer, priority=100)  # before napoleon
    return {"parallel_read_safe": True}
