"""The tracers ``cones:...``: the report's variants, and any other combination of the options."""

from ...errors import InputError
from ...methods import Tracer, by_cones
from ...rayhierarchy.options import Options
from .cones import Cones

_EXCLUDE = ("spheres", "precise"), ("spheres", "boxes"), ("precise", "boxes"), ("spheres", "early-accept")

_WORDS = {
    "spheres": "four-way cones in the order of the screen, tested against bounding spheres of triangles",
    "precise": "four-way cones in the order of the screen, tested against triangles",
    "boxes": "the same, boxes in the light's projection instead of cones",
    "wide": "the same, sixteen children to a node",
    "sorted": "the same, rays sorted by direction",
    "blocks": "the same, blocks of 4 x 4 pixels sorted, sixteen children to a node",
    "early-accept": "the same, cones that a triangle covers are done",
    "two-pass": "the same, good occluders first",
    "backface": "the same, triangles that face culling lets through are dropped at once",
    "shared": "the same, one traversal for all samples of a light",
    "shafts": "the same, shafts instead where a light is as large as what it lights",
    "clustered": "the same, triangles in Morton order",
}


def with_words(*words: str) -> Options:
    """The options that the words name.

    Without "boxes", nodes are the report's cones. Without "spheres", they are tested precisely (Sec. 3.2).
    """
    flags = {word.replace("-", "_"): True for word in words if word not in ("boxes", "precise")}
    return Options(nodes=None if "boxes" in words else Cones, **flags)


TABLE_1 = {
    "Precise": with_words("precise"),
    "PreciseSorted": with_words("precise", "sorted"),
    "Spheres": with_words("spheres"),
    "SpheresSorted": with_words("spheres", "sorted"),
    "PreciseSEA": with_words("precise", "sorted", "early-accept"),
    "PreciseEATP": with_words("precise", "early-accept", "two-pass"),
    "PreciseSEATP": with_words("precise", "sorted", "early-accept", "two-pass"),
}
"""The variants that the report evaluates, by the report's names."""

CONES: dict[str, tuple[Options, str]] = {
    **{f"cones:{word}": (with_words(word), text) for word, text in _WORDS.items()},
    **{f"cones:{name}": (options, f"the report's variant {name}") for name, options in TABLE_1.items()},
}
"""Name -> (options, description)."""


def combination(name: str) -> Options | None:
    """The options of a name such as ``cones:spheres:sorted``; None if it is no such name.

    Each word may occur once, in any order.

    Raises
    ------
    InputError
        If two options exclude each other.
    """
    family, *words = name.split(":")
    if family != "cones" or not words or len(set(words)) < len(words) or not set(words) <= set(_WORDS):
        return None
    for one, other in _EXCLUDE:
        if one in words and other in words:
            raise InputError(f"tracer {name!r}: {one!r} and {other!r} exclude each other; leave one of them out")
    return with_words(*words)


def find_combination(text: str) -> tuple[str, Tracer] | None:
    """(canonical name, tracer) of a combination of options.

    The canonical name has its words in the order of `_WORDS`.
    """
    options = combination(text)
    if options is None:
        return None
    family, *words = text.split(":")
    words.sort(key=list(_WORDS).index)
    return ":".join((family, *words)), by_cones(options, "a combination of options")
