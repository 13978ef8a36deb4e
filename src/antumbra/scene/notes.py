"""Notes of a loader, put together by kind: a scene with 62 missing textures has one thing to say, not 62."""

import re
from collections.abc import Iterable

_QUOTED = re.compile(r"""'[^']*'|"[^"]*\"""")


def by_kind(notes: Iterable[str], where: str = "Scene.notes has all") -> list[str]:
    """The first note of each kind, with the number of further ones. Notes of a kind differ by names and numbers.

    where : says how to see all notes
    """
    kinds: dict[tuple[str, ...], list[str]] = {}
    for note in notes:
        kinds.setdefault(_kind(note), []).append(note)
    more = lambda found: f" (and {len(found) - 1} more of this kind; {where})" if len(found) > 1 else ""
    return [found[0] + more(found) for found in kinds.values()]


def _kind(note: str) -> tuple[str, ...]:
    """The plain words of a note, without names, numbers and files."""
    words = (word.strip("(),;:") for word in _QUOTED.sub("", note).split())
    return tuple(word for word in words if word.isalpha())
