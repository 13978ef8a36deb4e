"""The program of the page as one text: its ES modules, each in a function of its own, in the order of their imports.

The modules remain those of the repository. A page opened from a folder may import no file, so its program is inline.
"""

import re
from pathlib import Path

PAGE = Path(__file__).parent / "page"
ENTRY = PAGE / "main.mjs"

_IMPORT = re.compile(r'^import \{([^}]*)\} from "(\.[^"]+)";\n', re.M)
_REEXPORT = re.compile(r"^export \{[^}]*\} from .*\n", re.M)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:class|function|const|let) (\w+))", re.M)
_DOC = re.compile(r"^ *(?:/\*\*(?:[^*]|\*(?!/))*\*/|//.*)\n", re.M)  # comments that fill their lines


def page_program(entry: Path = ENTRY) -> str:
    """The modules that a module needs, and itself, as one script without imports, for the page and its workers.

    Workers of pages that are opened from a folder take classic scripts only, so the text is one.

    Raises
    ------
    RuntimeError
        If modules import each other in a circle, or use other forms of imports than ``import { A } from "./b.mjs";``.
    """
    done: dict[Path, str] = {}
    _collect(entry.resolve(), done, ())
    return '"use strict";\n' + "".join(done.values()).replace("import.meta.url", "globalThis.location.href")


def _collect(path: Path, done: dict[Path, str], open_modules: tuple[Path, ...]) -> None:
    if path in open_modules:
        raise RuntimeError(f"{path.name} imports itself through {open_modules[-1].name}")
    if path in done:
        return
    source = _DOC.sub("", path.read_text(encoding="utf-8"))
    for _, target in _IMPORT.findall(source):
        _collect((path.parent / target).resolve(), done, (*open_modules, path))
    exported = ", ".join(match[1] for match in _EXPORT.finditer(source))
    body = _EXPORT.sub("", _IMPORT.sub(lambda match: _binding(match[1], path.parent / match[2]), source))
    if _REEXPORT.search(source) or re.search(r"^(import|export)\b", body, re.M):
        raise RuntimeError(f"{path.name} has an import or export that a page cannot inline")
    done[path] = f"const {_name(path)} = (() => {{\n{body}return {{ {exported} }};\n}})();\n"


def _binding(names: str, target: Path) -> str:
    """What takes the place of an import."""
    return f"const {{{names.replace(' as ', ': ')}}} = {_name(target)};\n"


def _name(path: Path) -> str:
    """The variable with what a module exports."""
    path = path.resolve()
    return re.sub(r"\W", "_", f"{path.parent.name}_{path.stem}")
