"""Placeholder: the names of the tracer `cones`, until its kernels are there."""

from typing import NamedTuple

from ..errors import InputError


class Cones(NamedTuple):
    """What a ray hierarchy does."""

    spheres: bool = False
    precise: bool = False
    sorted: bool = False
    early_accept: bool = False
    two_pass: bool = False
    backface: bool = False
    clustered: bool = False


CONES: dict[str, tuple[Cones, str]] = {
    "cones": (Cones(), "no hierarchy over the scene, but cones around shadow rays"),
    "cones:spheres": (Cones(spheres=True), "the same, cones tested against bounding spheres of triangles"),
    "cones:precise": (Cones(precise=True), "the same, cones tested against triangles"),
    "cones:sorted": (Cones(sorted=True), "the same, rays sorted by direction"),
    "cones:early-accept": (Cones(early_accept=True), "the same, cones that a triangle covers are done"),
    "cones:two-pass": (Cones(two_pass=True), "the same, large triangles first"),
    "cones:backface": (Cones(backface=True), "the same, triangles that face away are culled"),
    "cones:clustered": (Cones(clustered=True), "the same, triangles in clusters"),
    "cones:Precise": (Cones(precise=True), "Table 1, Precise"),
    "cones:PreciseSorted": (Cones(precise=True, sorted=True), "Table 1, PreciseSorted"),
    "cones:Spheres": (Cones(spheres=True), "Table 1, Spheres"),
    "cones:SpheresSorted": (Cones(spheres=True, sorted=True), "Table 1, SpheresSorted"),
    "cones:PreciseSEA": (Cones(precise=True, sorted=True, early_accept=True), "Table 1, PreciseSEA"),
    "cones:PreciseEATP": (Cones(precise=True, early_accept=True, two_pass=True), "Table 1, PreciseEATP"),
    "cones:PreciseSEATP": (
        Cones(precise=True, sorted=True, early_accept=True, two_pass=True),
        "Table 1, PreciseSEATP",
    ),
}
"""Name -> (options, description)."""


def combination(name: str) -> Cones | None:
    """The options of a name such as ``cones:spheres:sorted``, each once, in any order; None: it is no such name."""
    family, *words = name.split(":")
    fields = [word.replace("-", "_") for word in words]
    if family != "cones" or not words or len(set(words)) < len(words) or not set(fields) <= set(Cones._fields):
        return None
    if "spheres" in words and "precise" in words:
        raise InputError(f"tracer {name!r}: 'spheres' and 'precise' exclude each other; leave one of them out")
    return Cones(**dict.fromkeys(fields, True))
