"""The names of the tracer `cones`, and what they stand for."""

from typing import NamedTuple

from ..errors import InputError


class Options(NamedTuple):
    """Parts of a ray hierarchy that can be chosen; the words of a name, in their order there."""

    spheres: bool = False  # cones are tested against spheres around triangles [Roger et al. 2007]
    precise: bool = False  # or against the triangles (Sec. 3.2); without either word too
    boxes: bool = False  # nodes are boxes in the light's projection, see `boxes`
    wide: bool = False  # sixteen children, not four
    sorted: bool = False  # rays are sorted by direction (Sec. 3.5), not in the order of the screen
    blocks: bool = False  # blocks of 4 x 4 pixels are sorted, see `blocks`; they are leaves of 16 rays
    early_accept: bool = False  # nodes that a triangle covers are done (Sec. 3.3)
    two_pass: bool = False  # good occluders first, then all others for the rays that are left (Sec. 3.4)
    backface: bool = False  # triangles that the query's `cull_faces` lets through are dropped at once (Sec. 3.6)
    shared: bool = False  # one traversal for all samples of a light, not one for each
    shafts: bool = False  # where a light is too wide for one apex, leaves of one sample each, see `wide`
    clustered: bool = False  # triangles in Morton order, so that those of a batch meet the same nodes


FASTEST = Options(boxes=True, wide=True, blocks=True, early_accept=True, backface=True, shared=True, shafts=True)
_EXCLUDE = ("spheres", "precise"), ("spheres", "boxes"), ("precise", "boxes"), ("spheres", "early-accept")

TABLE_1 = {
    "Precise": Options(precise=True),
    "PreciseSorted": Options(precise=True, sorted=True),
    "Spheres": Options(spheres=True),
    "SpheresSorted": Options(spheres=True, sorted=True),
    "PreciseSEA": Options(precise=True, sorted=True, early_accept=True),
    "PreciseEATP": Options(precise=True, early_accept=True, two_pass=True),
    "PreciseSEATP": Options(precise=True, sorted=True, early_accept=True, two_pass=True),
}
"""The variants that the paper evaluates, by their names there."""

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

CONES: dict[str, tuple[Options, str]] = {
    "cones": (FASTEST, "no hierarchy over the scene, but one over the shadow rays, by which triangles find them"),
    **{f"cones:{word}": (Options(**{word.replace("-", "_"): True}), text) for word, text in _WORDS.items()},
    **{f"cones:{name}": (options, f"the report's variant {name}") for name, options in TABLE_1.items()},
}
"""Name -> (options, description)."""


def combination(name: str) -> Options | None:
    """The options of a name such as ``cones:spheres:sorted``, each once, in any order; None: it is no such name.

    Raises
    ------
    InputError
        On options that exclude each other.
    """
    family, *words = name.split(":")
    if family != "cones" or not words or len(set(words)) < len(words) or not set(words) <= set(_WORDS):
        return None
    for one, other in _EXCLUDE:
        if one in words and other in words:
            raise InputError(f"tracer {name!r}: {one!r} and {other!r} exclude each other; leave one of them out")
    return Options(**{word.replace("-", "_"): True for word in words})
