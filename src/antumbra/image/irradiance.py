"""Unshadowed irradiance from a light at the surfaces that pixels see, in closed form."""
# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

from typing import NamedTuple, TypeAlias

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.predicate.filters import dot
from ..kernels.simd import get, ptr, put
from ..query.light_samples import tangent_disk
from ..query.receivers import NOTHING
from ..query.shadow_query import three_at
from ..scene.lights import DIRECTIONAL, SPHERE, LightPatch
from .emitters import disk_irradiance, quad_irradiance

Vector3: TypeAlias = tuple[float, float, float]

POINT, QUAD, DISK = 0, 1, 2
_FORMS = {"point": POINT, "square": QUAD, "disk": DISK}


class Emitter(NamedTuple):
    """A light of intensity 1, recentred frame, for kernels; vectors are tuples of three float64."""

    kind: int  # FIXED, DIRECTIONAL or SPHERE
    form: int  # POINT, QUAD or DISK
    base: Vector3  # as in `LightPatch`
    u: Vector3
    v: Vector3
    axis: Vector3  # unit normal of a flat light; 0 of points and spheres
    size: float  # area of a QUAD, radius of a DISK, 0 of a POINT
    scale: float  # of a distant disk: its radiance over that of a disk of intensity 1


def emitter_of(patch: LightPatch, domain: str) -> Emitter:
    """The emitter of a light's patch, which is neither a list nor ambient light; `domain`: the light's."""
    across = np.cross(patch.u, patch.v)
    area, form = float(np.linalg.norm(across)), _FORMS[domain]
    if patch.kind == SPHERE:
        size, axis = patch.radius, np.zeros(3)
    elif area > 0.0:
        size, axis = (area if form == QUAD else float(np.sqrt(area))), across / area
    else:
        form, size, axis = POINT, 0.0, np.zeros(3)
    scale = float(patch.base @ patch.base) + size * size if patch.kind == DIRECTIONAL else 1.0
    vectors = _three(patch.base), _three(patch.u), _three(patch.v), _three(axis)
    return Emitter(patch.kind, form, *vectors, float(size), scale)


def _three(vector: np.ndarray) -> Vector3:
    x, y, z = vector.tolist()
    return x, y, z


@inlined
def _from_point(c, n, distant):
    """Irradiance from a point at c; of a distant one, c is any point on the way to it."""
    r2, height = dot(c, c), dot(n, c)
    if not (height > 0.0 and r2 > 0.0):
        return 0.0
    return height / np.sqrt(r2) if distant else height / (r2 * np.sqrt(r2))


@inlined
def _from_sphere(centre, radius, n):
    """Irradiance from a sphere: that of the disk where the tangent cone touches it, with the sphere's radiance."""
    disk = tangent_disk(centre[0], centre[1], centre[2], radius, 0.0, 0.0, 0.0)
    r = np.sqrt(disk.ux * disk.ux + disk.uy * disk.uy + disk.uz * disk.uz)
    if not r > 0.0:
        return 0.0
    distance = np.sqrt(dot(centre, centre))
    axis = (0.0, 0.0, 1.0)
    if distance > 0.0:
        axis = centre[0] / distance, centre[1] / distance, centre[2] / distance
    share = r / radius
    return share * share * disk_irradiance((disk.bx, disk.by, disk.bz), axis, r, n)


@inlined
def emitted(light, p, n):
    """Unshadowed irradiance at the point p with the unit normal n from an `Emitter`."""
    c = light.base
    if light.kind != DIRECTIONAL:
        c = c[0] - p[0], c[1] - p[1], c[2] - p[2]
    if light.kind == SPHERE:
        return _from_sphere(c, light.size, n)
    if light.form == QUAD:
        return quad_irradiance(c, light.u, light.v, light.size, n)
    if light.form == DISK:
        return light.scale * disk_irradiance(c, light.axis, light.size, n)
    return _from_point(c, n, light.kind == DIRECTIONAL)


@kernel
def _irradiance_kernel(ticket, position, normal, side, light, out):
    positions, normals, sides, found = ptr(position), ptr(normal), ptr(side), ptr(out)
    for i in items(ticket):
        e = 0.0
        if get(sides, i) != NOTHING:
            e = emitted(light, three_at(positions, i), three_at(normals, i))
        put(found, i, np.float32(e))


def irradiance(gbuffer, patch: LightPatch, domain: str, shading=None, threads=None) -> np.ndarray:
    """(H, W) float32: irradiance of each pixel's surface from a light of intensity 1 without shadows; else 0.

    The light is clipped at the horizon of the normal. A receiver inside a sphere gets the light of the disk that it
    samples.

    patch : LightPatch, neither a list nor ambient light; domain : domain of the light
    shading : ShadingNormals; None: the geometric normals
    """
    out = np.empty(gbuffer.face.shape, np.float32)
    normal = gbuffer.normal if shading is None else shading.normal
    ticket = new_ticket(out.size, 4096)
    run(
        _irradiance_kernel, thread_count(threads), ticket, gbuffer.position, normal, gbuffer.side,
        emitter_of(patch, domain), out,
    )  # fmt: skip
    return out
