"""The room that a scene encloses, and a camera inside it, for scenes that look like a box from outside.

A scene is looked at from outside, and in all directions from a few points inside. It is a room if the surfaces around
such a point face it, and show more triangles than the view from outside does. What a closed box encloses, such as a sky
box, is always looked at from inside the box. All views are small rasterised pictures, so no BVH is built.
"""

from typing import NamedTuple

import numpy as np

from ..scene.camera import Camera
from ..scene.framing import axes
from ..scene.lights import tangents
from ..scene.memory import MemoryData
from ..scene.room import Room
from ..scene.sampled import MOST, detail, moving_faces
from ..scene.triangles import Triangles
from ..scene.view import view_of_box
from .see import see
from .wrapping import Wrapping, content_room, unwrapped

_OUTSIDE, _SIDE = 128, 48  # pixels across of the view from outside, and of a view from inside
_RICH = 1500  # triangles that a view from outside shows; with more, it is the better view
_CLOSED, _FACING, _MORE = 0.85, 0.6, 3.0  # of a room: share of directions, of them to front sides; ratio of triangles
_LEVELS = 0.3, 0.45, 0.6  # heights of the points that are tried, as shares of the scene's height
_STEPS = 36  # horizontal directions
_AHEAD = 0.85  # cosine of the angle in which triangles count as being ahead
_FREE = 0.85  # how far back the camera moves towards the wall behind it
_SKY = 0.1  # share of the view straight up that is open, in a room that daylight enters
_VFOV = 60.0


class _Around(NamedTuple):
    """What is seen from a point, in all directions."""

    directions: np.ndarray  # (m, 3) float64, unit length
    distances: np.ndarray  # (m,) float64; inf if nothing is met
    faces: np.ndarray  # (m,) int32; -1 if nothing is met
    facing: np.ndarray  # (m,) bool: a front side is met


def room_of(scene: MemoryData, outside: Camera, box: np.ndarray, threads: int | None = None) -> Room | None:
    """The room that a scene encloses at time 0; None if the scene is better seen from outside.

    outside : a camera that shows the scene's detail; box : (2, 3) float64, the extent of this detail
    """
    triangles = scene.triangles(0.0, threads)
    wrapping = unwrapped(triangles, threads)
    if wrapping is not None and scene.animated and not wrapping.holds(_moving(scene)):
        wrapping = None
    room = None if wrapping is None else content_room(wrapping, scene.up)
    if room is not None:
        return room
    cameras = outside, view_of_box(scene.bounds, scene.up).camera(1, 1)
    shown = max(_fronts(triangles, camera, threads) for camera in cameras)
    if wrapping is None and shown >= _RICH:
        return None
    up = axes(scene.up)[1]
    if wrapping is not None:
        box = detail(wrapping.sample) + scene.origin
    points = _tried(triangles if wrapping is None else wrapping.content, box, up)
    places = [(point, _look_around(triangles, point, scene.up, threads)) for point in points]
    rooms = [place for place in places if _encloses(place[1], shown)]
    if wrapping is not None:
        rooms = [(point, _content(around, triangles, wrapping)) for point, around in rooms or places]
    if not rooms:
        return None
    room = _room(*max(rooms, key=lambda place: _n_faces(place[1])), up)
    return room if wrapping is None else room._replace(planes=wrapping.planes_in_world)


def _content(around: _Around, triangles: Triangles, wrapping: Wrapping) -> _Around:
    """What is seen from a point, whose faces count only if they are inside a box."""
    inside = np.zeros(len(triangles.vertices) + 1, bool)
    inside[np.searchsorted(triangles.face_id, wrapping.content.face_id)] = True
    return around._replace(facing=around.facing & inside[around.faces])


def _moving(scene: MemoryData) -> np.ndarray:
    """(k, 3) float64, recentred: corners of a sample of faces, at several moments."""
    return moving_faces(scene.source, scene.n_triangles).reshape(-1, 3) - scene.origin


def _fronts(triangles: Triangles, outside: Camera, threads: int | None) -> int:
    """The number of triangles whose front sides a camera sees."""
    seen = see(triangles, outside.resized(_OUTSIDE, _OUTSIDE), None, threads)
    return len(np.unique(seen.face[seen.side > 0]))


def _tried(triangles: Triangles, box: np.ndarray, up: np.ndarray) -> list[np.ndarray]:
    """Points inside a scene, at several heights: above the middle of its extent, and where most triangles are."""
    height = np.ptp(box, axis=0) @ np.abs(up)
    step = -(-len(triangles.vertices) // MOST)
    dense = np.median(triangles.vertices[::step, 0], axis=0) + triangles.origin
    places = box.mean(0), dense + ((box.mean(0) - dense) @ up) * up
    return [place + (level - 0.5) * height * up for place in places for level in _LEVELS]


def _look_around(triangles: Triangles, point: np.ndarray, up: str, threads: int | None) -> _Around:
    """Look from a point into the six faces of a cube."""
    right, upward, towards = axes(up)
    parts = []
    for ahead, above in ((right, upward), (towards, upward), (upward, right)):
        for way in ahead, -ahead:
            camera = Camera(point, point + way, above, 90.0, _SIDE, _SIDE)
            seen, rays = see(triangles, camera, None, threads), camera.rays(triangles.origin)
            y, x = np.mgrid[:_SIDE, :_SIDE][..., None] + 0.5
            directions = (rays.corner + x * rays.dx + y * rays.dy).reshape(-1, 3)
            length = np.linalg.norm(directions, axis=1)
            parts.append(
                (directions / length[:, None], seen.depth.ravel() * length, seen.face.ravel(), seen.side.ravel() > 0)
            )
    return _Around(*(np.concatenate(arrays) for arrays in zip(*parts)))


def _encloses(around: _Around, shown: int) -> bool:
    met = around.faces >= 0
    if met.mean() < _CLOSED or around.facing[met].mean() < _FACING:
        return False
    return _n_faces(around) > _MORE * shown


def _n_faces(around: _Around, chosen: np.ndarray | bool = True) -> int:
    """The number of triangles whose front sides are seen, in chosen directions."""
    return len(np.unique(around.faces[around.facing & chosen]))


def _room(point: np.ndarray, around: _Around, up: np.ndarray) -> Room:
    """The room around a point: its camera looks along the longest free way through the point."""
    east, north = tangents(up)
    ways = 2.0 * np.pi * np.arange(_STEPS) / _STEPS
    horizontal = np.cos(ways)[:, None] * east + np.sin(ways)[:, None] * north
    free = np.array([_free_way(around, way) for way in horizontal])
    rich = np.array([_n_faces(around, around.directions @ way > _AHEAD) for way in horizontal])
    # The way behind the camera counts less than the way ahead: it is only there to stand back.
    best = int(np.argmax((free + 0.8 * np.roll(free, _STEPS // 2)) * np.sqrt(rich + 1.0)))
    eye = point - _FREE * free[(best + _STEPS // 2) % _STEPS] * horizontal[best]
    target = point + 0.5 * free[best] * horizontal[best]
    above = around.directions @ up > 0.9
    return Room(point, eye, target, _VFOV, float((around.faces[above] < 0).mean()) > _SKY, _ceiling(around, up))


def _ceiling(around: _Around, up: np.ndarray) -> float:
    """How far above the point the ceiling is. Things that hang below it do not count."""
    heights = around.directions @ up * around.distances
    above = heights[(around.directions @ up > 0.3) & np.isfinite(heights)]
    return float(np.quantile(above, 0.9)) if len(above) else 0.0


def _free_way(around: _Around, way: np.ndarray) -> float:
    """How far nothing is met about a direction. A few thin things in the way do not count."""
    near = around.distances[around.directions @ way > 0.98]
    near = near[np.isfinite(near)]
    return float(np.quantile(near, 0.2)) if len(near) else 0.0
