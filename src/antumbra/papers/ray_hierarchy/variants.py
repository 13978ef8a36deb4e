"""The tracers ``cones:...``: the report's variants, and any other combination of the options."""

from ...errors import InputError
from ...methods import Tracer, by_cones
from ...techniques.tracer_options import RayHierarchyOptions
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


def with_words(*words: str) -> RayHierarchyOptions:
    """The options that the words name.

    Without "boxes", nodes are the report's cones. Without "spheres", they are tested precisely (Sec. 3.2).
    """
    flags = {word.replace("-", "_"): True for word in words if word not in ("boxes", "precise")}
    return RayHierarchyOptions(nodes=None if "boxes" in words else Cones, **flags)


_TABLE_1_WORDS = {
    "Precise": ("precise",),
    "PreciseSorted": ("precise", "sorted"),
    "Spheres": ("spheres",),
    "SpheresSorted": ("spheres", "sorted"),
    "PreciseSEA": ("precise", "sorted", "early-accept"),
    "PreciseEATP": ("precise", "early-accept", "two-pass"),
    "PreciseSEATP": ("precise", "sorted", "early-accept", "two-pass"),
}

TABLE_1 = {name: with_words(*words) for name, words in _TABLE_1_WORDS.items()}
"""The variants that the report evaluates, by the report's names."""


def with_culling(name: str) -> str:
    """The plan of a variant of Table 1 that drops culled faces before the traversal, as the report does (Sec. 3.6)."""
    return ":".join(("cones", *_TABLE_1_WORDS[name], "backface"))


CONES: dict[str, tuple[RayHierarchyOptions, str]] = {
    **{f"cones:{word}": (with_words(word), text) for word, text in _WORDS.items()},
    **{f"cones:{name}": (options, f"the report's variant {name}") for name, options in TABLE_1.items()},
}
"""Name -> (options, description)."""


def combination(name: str) -> RayHierarchyOptions | None:
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
