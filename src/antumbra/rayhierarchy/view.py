"""Projection of points by a beam: onto the six faces of a cube around the apex, or parallel for distant lights."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined
from ..kernels.predicate.filters import dot
from ..kernels.simd import fma
from ..kernels.vec import Vec, times
from .beams import PERSPECTIVE

FACES = 6  # of the cube around an apex: +x, -x, +y, -y, +z, -z


class BeamView(NamedTuple):
    """A `Beam` in kernels; all scalars except `kind` are float64."""

    kind: int
    unit: float  # scale factor from the scene to the beam's frame
    x: float  # the apex
    y: float
    z: float
    u: tuple  # three axes of the beam's frame; unused by PERSPECTIVE
    v: tuple
    w: tuple
    radius: float  # as in `Beam`
    scale: float  # largest absolute coordinate of a receiver in the beam's frame; unused by PERSPECTIVE
    lowest: float  # lowest last coordinate of a receiver


@inlined
def view_of(beam):
    """The `BeamView` of a `Beam`."""
    p, a = beam.apex, beam.axes
    u, v, w = (a[0, 0], a[0, 1], a[0, 2]), (a[1, 0], a[1, 1], a[1, 2]), (a[2, 0], a[2, 1], a[2, 2])
    return BeamView(beam.kind, beam.unit, p[0], p[1], p[2], u, v, w, beam.radius, beam.scale, beam.lower[2])


@inlined
def relative(view, p):
    """A float64 point in the beam's frame: relative to the apex, or along the axes."""
    s = view.unit
    if view.kind == PERSPECTIVE:
        return (p[0] - view.x) * s, (p[1] - view.y) * s, (p[2] - view.z) * s
    return dot(view.u, p) * s, dot(view.v, p) * s, dot(view.w, p) * s


@inlined
def turned(d, face):
    """(u, v, depth) of a direction, with depth along the face's axis. The map is linear and also applies to normals."""
    if face < 2:
        return d[1], d[2], (d[0] if face == 0 else -d[0])
    if face < 4:
        return d[2], d[0], (d[1] if face == 2 else -d[1])
    return d[0], d[1], (d[2] if face == 4 else -d[2])


@inlined
def relative16(view, o):
    """16 points in the beam's frame, a `Vec` of f32x16. Apexes are float32, so a difference is rounded only once."""
    s = np.float32(view.unit)
    if view.kind == PERSPECTIVE:
        return times(Vec(o.x - np.float32(view.x), o.y - np.float32(view.y), o.z - np.float32(view.z)), s)
    o = times(o, s)
    return Vec(_along(o, view.u), _along(o, view.v), _along(o, view.w))


@inlined
def _along(o, axis):
    f = np.float32
    return fma(o.x, f(axis[0]), fma(o.y, f(axis[1]), o.z * f(axis[2])))


@inlined
def projected16(view, o, face):
    """(u, v, q) of 16 points; planes are linear in these coordinates.

    PERSPECTIVE: u and v are divided by the depth, and q = 1 / depth. Otherwise: coordinates along the frame's axes.
    """
    d = relative16(view, o)
    if view.kind == PERSPECTIVE:
        u, v, depth = turned((d.x, d.y, d.z), face)
        q = np.float32(1.0) / depth
        return u * q, v * q, q
    return d.x, d.y, d.z
