"""The shadow queries of a picture, at the surfaces that its pixels see."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..scene.lights import AMBIENT
from ..scene.triangles import Triangles
from .bounds import bounds, reach_of
from .gbuffer import GBuffer
from .placing import place
from .receivers import surface_receivers
from .shadow import ShadowQuery


class ShadingNormals(NamedTuple):
    """Normals for shading alone: shadows stay on the geometric surface."""

    normal: np.ndarray  # (H, W, 3) float32, unit length, towards the camera
    bend: np.ndarray  # (H, W) float32: sine of the height above their horizon where light ends


class Surfaces(NamedTuple):
    """The surfaces that a picture's rays meet, and their triangles."""

    gbuffer: GBuffer  # its faces index `triangles`
    triangles: Triangles  # all triangles of the scene, or only the visible ones
    ids: np.ndarray  # (H, W) int32: index of the face in the scene; -1: background
    box: np.ndarray | None = None  # (2, 3) float32: bounds of the whole scene; None: use the bounds of `triangles`
    albedo: np.ndarray | None = None  # (H, W, 3) float32: linear base colours; None: those of the faces
    shading: ShadingNormals | None = None  # None: the geometric normals shade


def surfaces_of(gbuffer: GBuffer, triangles: Triangles) -> Surfaces:
    """`Surfaces` of a G-buffer whose faces index all triangles of the scene."""
    return Surfaces(gbuffer, triangles, gbuffer.face)


def stacked(bands: Sequence[Surfaces]) -> Surfaces:
    """The surfaces of bands of a picture, which follow one another from top to bottom. Each triangle is kept once."""
    seen = [band.triangles for band in bands if (band.ids >= 0).any()] or [bands[0].triangles]
    ids, first = np.unique(np.concatenate([triangles.face_id for triangles in seen]), return_index=True)
    vertices, colour = (np.concatenate([getattr(t, name) for t in seen])[first] for name in ("vertices", "colour"))
    faces = [np.where(b.ids >= 0, np.searchsorted(ids, b.ids), -1).astype(np.int32) for b in bands]
    names = "position", "normal", "depth", "side"
    of_all = {name: np.concatenate([getattr(b.gbuffer, name) for b in bands]) for name in names}
    gbuffer = bands[0].gbuffer._replace(**of_all, face=np.concatenate(faces))
    triangles = Triangles(vertices, seen[0].origin, ids, colour)
    return Surfaces(gbuffer, triangles, np.concatenate([band.ids for band in bands]), bands[0].box)


def shadow_queries(triangles, gbuffer, lights, samples, cull_faces=0, threads=None) -> list[ShadowQuery]:
    """One query per light at the surfaces in a G-buffer; ``samples``: per light, from `light_samples`."""
    return surface_queries(surfaces_of(gbuffer, triangles), lights, samples, cull_faces, threads)


def surface_queries(surfaces: Surfaces, lights, samples, cull_faces=0, threads=None) -> list[ShadowQuery]:
    """As `shadow_queries`, for `Surfaces`."""
    gbuffer, triangles, ids, box = surfaces[:4]
    shape = gbuffer.face.shape
    corners = triangles.vertices.reshape(-1, 9)
    flat = (
        gbuffer.position.reshape(-1, 3),
        gbuffer.normal.reshape(-1, 3),
        gbuffer.face.reshape(-1),
        gbuffer.side.reshape(-1),
    )
    origins = surface_receivers(*flat, corners, threads).reshape(*shape, 3)
    if box is None and triangles.vertices.size:
        box = np.stack(bounds(triangles.vertices, threads))
    far = reach_of(box) if box is not None and triangles.vertices.size else 1.0
    patches = [place(light, triangles.origin, box, far) for light in lights]
    ambient = any(p.kind == AMBIENT for p in patches)
    normals = gbuffer.normal.astype(np.float64) if ambient else np.empty((0, 0, 3))
    return [
        ShadowQuery(origins, gbuffer.face, gbuffer.side, normals, corners, patch, sets, cull_faces, ids)
        for patch, sets in zip(patches, samples)
    ]
