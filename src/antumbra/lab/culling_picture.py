"""Draw the triangles that pre-BVH culling keeps: from the camera, and as X-ray views from above and from the side."""

from collections.abc import Sequence
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.method_registry import CULLERS
from ..engine.plan_records import precompile_plan
from ..engine.scene import AnyScene
from ..kernels.elementary import exp
from ..picture.renderer import Renderer
from ..query.gbuffer import GBuffer
from ..query.light_samples import light_samples
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadowQuery, shadow_queries
from ..scene.camera import Camera
from ..scene.lights import FIXED, LIST, SPHERE, Light, check_lights
from ..techniques.culling.culling_grid import sample_points

KEPT, DROPPED = np.array([1.0, 0.33, 0.03], np.float32), np.array([0.04, 0.16, 0.6], np.float32)
RECEIVER, LIGHT = np.array([1.0, 1.0, 1.0], np.float32), np.array([1.0, 0.9, 0.1], np.float32)
_POINTS = 4  # surface points per pixel in an X-ray view


class CullingPicture(NamedTuple):
    """A culling picture with its statistics."""

    image: NDArray[np.float32]  # (H, 3 W, 3) float32, linear
    kept: int  # triangles that survive culling
    cells: int  # grid cells; 0: no rays
    marked: int  # grid cells that rays may pass through
    sources: int  # receiver boxes
    targets: int  # light boxes
    seconds: float  # culling time


def culling_picture(
    scene: AnyScene,
    camera: Camera,
    lights: Sequence[Light] | Light,
    culler: str = "grid32",
    *,
    spp: int = 16,
    time: float = 0.0,
    threads: int | None = None,
) -> CullingPicture:
    """Draw the triangles that a culler keeps and drops.

    `culler` is a name in `CULLERS`; the other arguments are those of `antumbra.render`.
    """
    lights, renderer = check_lights(lights, scene.up), Renderer(scene, f"{culler}+bsah+single", threads)
    precompile_plan(renderer.plan, renderer.source.gbuffer)
    triangles = scene.triangles(time, threads)
    gbuffer = renderer.see(triangles, camera)
    samples = [light_samples(light, spp) for light in lights]
    queries = shadow_queries(triangles, gbuffer, lights, samples, threads=renderer.threads)
    start = perf_counter()
    culled = CULLERS[culler].cull(triangles, queries, renderer.threads)
    seconds = perf_counter() - start
    # one extra entry for background pixels (face -1)
    kept_mask = np.zeros(len(triangles.vertices) + 1, np.bool_)
    kept_mask[culled.kept] = True
    receivers = gbuffer.position[gbuffer.side != NOTHING]
    emitters = np.concatenate([np.empty((0, 3)), *(_emitter(query) for query in queries)])
    shape, up = gbuffer.face.shape, 2 if scene.up == "z" else 1
    panels = [_camera_view(gbuffer, camera, kept_mask)]
    panels += [_xray_view(triangles.vertices, kept_mask[:-1], receivers, emitters, shape, axis) for axis in (up, 0)]
    cells, marked = (0, 0) if culled.marked is None else (culled.marked.size, int(culled.marked.sum()))
    image = np.concatenate(panels, axis=1)
    return CullingPicture(image, len(culled.kept), cells, marked, culled.sources, culled.targets, seconds)


def _emitter(query: ShadowQuery) -> NDArray[np.float64]:
    """(k, 3) points on a light; (0, 3) for a light without a position."""
    light = query.light
    if light.kind not in (FIXED, LIST, SPHERE):
        return np.empty((0, 3))
    if light.kind == SPHERE:
        return light.base + light.radius * np.concatenate([np.eye(3), -np.eye(3)])
    return sample_points(query)


def _camera_view(gbuffer: GBuffer, camera: Camera, kept_mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W, 3) float32: the camera's view with a headlight."""
    ahead = np.asarray(camera.target, np.float64) - camera.position
    facing = np.abs(gbuffer.normal @ (ahead / np.linalg.norm(ahead)).astype(np.float32))
    colour = np.where(kept_mask[gbuffer.face][..., None], KEPT, DROPPED)
    return np.where((gbuffer.side != NOTHING)[..., None], colour * (0.15 + 0.85 * facing[..., None]), np.float32(0.0))


def _xray_view(
    vertices: NDArray[np.float32],
    kept_mask: NDArray[np.bool_],
    receivers: NDArray[np.float32],
    emitters: NDArray[np.float64],
    shape: tuple[int, ...],
    axis: int,
) -> NDArray[np.float32]:
    """(H, W, 3) float32: X-ray view along an axis.

    Points on all surfaces add their colours. Receivers and lights are drawn on top.
    """
    h, w = shape
    u, v = [(2, 1), (0, 2), (0, 1)][axis]  # across and down
    corners = vertices.reshape(-1, 3)
    lower, upper = (corners.min(0), corners.max(0)) if len(corners) else np.zeros((2, 3))
    scale = 0.94 * min(w / max(upper[u] - lower[u], 1e-30), h / max(upper[v] - lower[v], 1e-30))
    sign = 1.0 if axis == 1 else -1.0  # in the view from above, z points down in the picture

    def pixels(points: NDArray[np.floating]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Flat indices of the pixels of the points inside the picture, and the mask of these points."""
        x = w / 2 + scale * (points[:, u] - (lower[u] + upper[u]) / 2)
        y = h / 2 + sign * scale * (points[:, v] - (lower[v] + upper[v]) / 2)
        inside = (x >= 0) & (x < w) & (y >= 0) & (y < h)
        return y[inside].astype(np.int64) * w + x[inside].astype(np.int64), inside

    face, points = _surface_points(vertices, _POINTS * h * w)
    where, inside = pixels(points)
    image = np.zeros((h * w, 3), np.float32)
    for mask, colour in ((kept_mask, KEPT), (~kept_mask, DROPPED)):
        count = np.bincount(where[mask[face[inside]]], minlength=h * w)
        image += (1.0 - exp(-count[:, None] / (0.5 * _POINTS))).astype(np.float32) * colour
    image[pixels(receivers[:: max(1, len(receivers) // 20000)])[0]] = RECEIVER
    image[pixels(emitters)[0]] = LIGHT
    return image.reshape(h, w, 3)


def _surface_points(vertices: NDArray[np.float32], n: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Spread n points evenly over all surfaces: (n,) triangle indices and (n, 3) positions."""
    edges = vertices[:, 1:] - vertices[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0].astype(np.float64), edges[:, 1]), axis=1)
    if not area.sum() > 0.0:
        return np.empty(0, np.int64), np.empty((0, 3))
    total, rng = np.cumsum(area), np.random.default_rng(0)
    face = np.searchsorted(total, (np.arange(n) + rng.random(n)) / n * total[-1]).clip(max=len(area) - 1)
    a, b = rng.random((2, n))
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
    return face, vertices[face, 0] + a[:, None] * edges[face, 0] + b[:, None] * edges[face, 1]
