"""Default views: a whole scene from outside, or the room that it encloses from inside.

Enclosing boxes. A scene is wrapped if its convex hull has few planes, faces cover all of them, and from outside nothing
else is seen. It does not matter which way the faces face, and into how many triangles they are divided.

Rooms. A scene is looked at from outside, and in all directions from a few points inside. It is a room if the surfaces
around such a point face it, and show more triangles than the view from outside does. What a closed box encloses, such
as a sky box, is always looked at from inside the box. All views are small rasterised pictures, so no BVH is built.
"""

from typing import NamedTuple

import numpy as np

from ..scene.camera import Camera
from ..scene.data import SceneData
from ..scene.framing import VFOV, axes, bounding_sphere, fitted_camera
from ..scene.lights import tangents
from ..scene.memory import MemoryData
from ..scene.room import Room, way_out
from ..scene.sampled import MOST, detail, moving_faces, sampled_faces, within
from ..scene.triangles import Triangles
from ..scene.view import View, view_of_box
from .primary_visibility import primary_visibility

# --- Closed boxes around everything else, such as sky boxes: what lies inside them, and a camera between the two ------
#
# A scene is wrapped if its convex hull has few planes, faces cover all of them, and from outside nothing else is seen.
# It does not matter which way the faces face, and into how many triangles they are divided.


_VIEWS, _LENS = 128, 20.0  # pixels across, and degrees, of pictures from outside
_MOST_PLANES, _LAYERS = 32, 4  # of a hull; boxes in boxes that are opened
_ON = 1e-4  # distance from a plane, as a share of the size, up to which a corner lies on it
_COVERED = 0.98  # share of each plane that faces cover, and of the pixels from outside that show these faces
_BACK = 0.9  # of the way to the box: how far away a camera may stand
_CLOSE = 0.05  # share of the distance of a camera outside, below which it is too close
_WIDEST = 75.0  # degrees: with a wider lens, it is a room
_MARGIN = 1.08  # around the content, in a picture


class EnclosingBox(NamedTuple):
    """A closed box, and what is inside."""

    content: Triangles
    planes: np.ndarray  # (m, 4) float64, recentred: n x + d <= 0 inside, n unit

    @property
    def sample(self) -> np.ndarray:
        """(k, 3, 3) float64, recentred: some of the faces inside."""
        return self.content.vertices[:: -(-len(self.content.vertices) // MOST)].astype(np.float64)

    def holds(self, points: np.ndarray) -> bool:
        """Whether the box has all points ((k, 3), recentred) inside."""
        slack = _ON * max(float(np.abs(points).max()), 1e-300)
        return all((points @ plane[:3]).max() + plane[3] <= slack for plane in self.planes)

    def way(self, start: np.ndarray, along: np.ndarray) -> float:
        """How many times `along` leads from a point inside, in the recentred frame, to the box."""
        return way_out(self.planes, start, along)

    @property
    def planes_in_world(self) -> np.ndarray:
        """(m, 4) float64: the planes in world coordinates."""
        normals, offsets = self.planes[:, :3], self.planes[:, 3]
        return np.c_[normals, offsets - normals @ self.content.origin]


def innermost_box(triangles: Triangles, threads: int | None) -> EnclosingBox | None:
    """The innermost closed box of a scene; None if there is none, or nothing in it."""
    innermost = None
    for _ in range(_LAYERS):
        layer = _opened(triangles, threads)
        if layer is None:
            break
        innermost, triangles = layer, layer.content
    return innermost


def content_room(wrapping: EnclosingBox, up: str) -> Room | None:
    """A place in the box that shows its content as from outside; None if the box is too tight."""
    origin, faces = wrapping.content.origin, wrapping.sample
    points = within(faces, detail(faces))
    camera = fitted_camera(points, up, 1, 1)
    back = camera.position - camera.target
    share = min(1.0, _BACK * wrapping.way(camera.target, back))
    eye = camera.target + share * back
    if not share > _CLOSE:
        return None
    vfov = VFOV if share == 1.0 else _lens(points, Camera(eye, camera.target, axes(up)[1], width=1, height=1))
    if not vfov <= _WIDEST:
        return None
    upward = axes(up)[1]
    middle = camera.target + max((points @ upward).max() - camera.target @ upward, 0.0) * upward
    middle += 0.1 * min(wrapping.way(middle, upward), float(np.linalg.norm(back))) * upward
    above = wrapping.way((middle + eye) / 2.0, upward)
    middle, eye, target = middle + origin, eye + origin, camera.target + origin
    return Room(middle, eye, target, vfov, False, above, points + origin, wrapping.planes_in_world)


def _opened(triangles: Triangles, threads: int | None) -> EnclosingBox | None:
    """The outermost closed box of a scene."""
    visible = _seen_from_outside(triangles, threads)
    if visible is None:
        return None
    planes = _hull_planes(triangles.vertices[np.unique(visible)].reshape(-1, 3))
    if planes is None:
        return None
    size = float(np.ptp(triangles.vertices, axis=(0, 1)).max())
    corners = triangles.vertices.reshape(-1, 3).astype(np.float64)
    wrap = np.zeros(len(triangles.vertices), bool)
    for x, y, z, offset, area in planes:
        on = (np.abs(corners @ (x, y, z) + offset) <= _ON * size).reshape(-1, 3).all(1)
        if _area(triangles.vertices[on]) < _COVERED * area:
            return None
        wrap |= on
    if wrap[visible].mean() < _COVERED or np.count_nonzero(~wrap) < len(planes):
        return None
    inside = (array[~wrap] for array in (triangles.vertices, triangles.face_id, triangles.colour))
    vertices, ids, colours = inside
    return EnclosingBox(Triangles(vertices, triangles.origin, ids, colours), planes[:, :4])


def _seen_from_outside(triangles: Triangles, threads: int | None) -> np.ndarray | None:
    """The faces in the pixels of pictures from the eight corners of a cube around a scene.

    None if one picture shows nothing, or more planes than a hull may have. So most scenes need one picture only.
    """
    solid = triangles._replace(cutouts=None)
    bounds = np.stack([triangles.vertices.min((0, 1)), triangles.vertices.max((0, 1))]).astype(np.float64)
    centre, radius = bounding_sphere(bounds)
    away, faces = radius / np.sin(np.radians(_LENS / 2.0)), []
    for corner in np.array(list(np.ndindex(2, 2, 2))) * 2.0 - 1.0:
        place = centre + away / 3.0**0.5 * corner + triangles.origin
        gbuffer = primary_visibility(
            solid, Camera(place, centre + triangles.origin, (0, 1, 0), _LENS, _VIEWS, _VIEWS), None, threads
        )
        faces.append(gbuffer.face[gbuffer.face >= 0])
        if not len(faces[-1]) or _many_planes(triangles.vertices[np.unique(faces[-1])], radius):
            return None
    return np.concatenate(faces)


def _many_planes(corners: np.ndarray, radius: float) -> bool:
    """Whether triangles lie in clearly more planes than a hull may have."""
    normals = np.cross(*_edges(corners.astype(np.float64)))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    sound = length[:, 0] > 0.0
    normals = normals[sound] / length[sound]
    normals *= np.where(normals @ (0.41, 0.67, 0.62) < 0.0, -1.0, 1.0)[:, None]
    heights = (normals * corners[sound, 0]).sum(1, keepdims=True) / radius
    return len(np.unique(np.c_[normals, heights].round(2), axis=0)) > 2 * _MOST_PLANES


def _hull_planes(points: np.ndarray) -> np.ndarray | None:
    """(m, 5) float64: the planes of the convex hull (n, d), and their areas; None if they are many, or it is flat."""
    from scipy.spatial import ConvexHull, QhullError

    points = points.astype(np.float64)
    scale = max(float(np.abs(points).max()), 1e-300)
    try:
        hull = ConvexHull(points / scale)
    except (QhullError, ValueError):  # all in one plane
        return None
    planes, which = np.unique(hull.equations.round(5), axis=0, return_inverse=True)
    if len(planes) > _MOST_PLANES:
        return None
    corners = points[hull.simplices]
    areas = np.bincount(which.reshape(-1), np.linalg.norm(np.cross(*_edges(corners)), axis=1) / 2.0)
    planes[:, 3] *= scale
    return np.c_[planes, areas]


def _edges(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]


def _area(corners: np.ndarray) -> float:
    return float(np.linalg.norm(np.cross(*_edges(corners.astype(np.float64))), axis=1).sum() / 2.0)


def _lens(points: np.ndarray, camera: Camera) -> float:
    """The field of view, degrees, in which a camera sees all points; 180 if some are behind it."""
    right, down, ahead = camera.axes @ (points - camera.position).T
    if ahead.min() <= 0.0:
        return 180.0
    across = float((np.maximum(np.abs(right), np.abs(down)) / ahead).max())
    return max(VFOV, 2.0 * float(np.degrees(np.arctan(_MARGIN * across))))


# --- The room that a scene encloses, and a camera inside it, for scenes that look like a box from outside -------------
#
# A scene is looked at from outside, and in all directions from a few points inside. It is a room if the surfaces
# around such a point face it, and show more triangles than the view from outside does. What a closed box encloses,
# such as a sky box, is always looked at from inside the box. All views are small rasterised pictures, so no BVH is
# built.


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
    wrapping = innermost_box(triangles, threads)
    if wrapping is not None and scene.animated and not wrapping.holds(_moving(scene)):
        wrapping = None
    room = None if wrapping is None else content_room(wrapping, scene.up)
    if room is not None:
        return room
    cameras = outside, view_of_box(scene.bounds, scene.up).camera(1, 1)
    n_outside = max(_fronts(triangles, camera, threads) for camera in cameras)
    if wrapping is None and n_outside >= _RICH:
        return None
    up = axes(scene.up)[1]
    if wrapping is not None:
        box = detail(wrapping.sample) + scene.origin
    points = _tried(triangles if wrapping is None else wrapping.content, box, up)
    places = [(point, _look_around(triangles, point, scene.up, threads)) for point in points]
    rooms = [place for place in places if _encloses(place[1], n_outside)]
    if wrapping is not None:
        rooms = [(point, _content(around, triangles, wrapping)) for point, around in rooms or places]
    if not rooms:
        return None
    room = _room(*max(rooms, key=lambda place: _n_faces(place[1])), up)
    return room if wrapping is None else room._replace(planes=wrapping.planes_in_world)


def _content(around: _Around, triangles: Triangles, wrapping: EnclosingBox) -> _Around:
    """What is seen from a point, whose faces count only if they are inside a box."""
    inside = np.zeros(len(triangles.vertices) + 1, bool)
    inside[np.searchsorted(triangles.face_id, wrapping.content.face_id)] = True
    return around._replace(facing=around.facing & inside[around.faces])


def _moving(scene: MemoryData) -> np.ndarray:
    """(k, 3) float64, recentred: corners of a sample of faces, at several moments."""
    return moving_faces(scene.source, scene.n_triangles).reshape(-1, 3) - scene.origin


def _fronts(triangles: Triangles, outside: Camera, threads: int | None) -> int:
    """The number of triangles whose front sides a camera sees."""
    gbuffer = primary_visibility(triangles, outside.resized(_OUTSIDE, _OUTSIDE), None, threads)
    return len(np.unique(gbuffer.face[gbuffer.side > 0]))


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
        for axis in ahead, -ahead:
            camera = Camera(point, point + axis, above, 90.0, _SIDE, _SIDE)
            gbuffer, rays = primary_visibility(triangles, camera, None, threads), camera.rays(triangles.origin)
            y, x = np.mgrid[:_SIDE, :_SIDE][..., None] + 0.5
            directions = (rays.corner + x * rays.dx + y * rays.dy).reshape(-1, 3)
            length = np.linalg.norm(directions, axis=1)
            parts.append(
                (directions / length[:, None], gbuffer.depth.ravel() * length, gbuffer.face.ravel(), gbuffer.side.ravel() > 0)
            )
    return _Around(*(np.concatenate(arrays) for arrays in zip(*parts)))


def _encloses(around: _Around, n_outside: int) -> bool:
    met = around.faces >= 0
    if met.mean() < _CLOSED or around.facing[met].mean() < _FACING:
        return False
    return _n_faces(around) > _MORE * n_outside


def _n_faces(around: _Around, chosen: np.ndarray | bool = True) -> int:
    """The number of triangles whose front sides are seen, in chosen directions."""
    return len(np.unique(around.faces[around.facing & chosen]))


def _room(point: np.ndarray, around: _Around, up: np.ndarray) -> Room:
    """The room around a point: its camera looks along the longest free way through the point."""
    east, north = tangents(up)
    ways = 2.0 * np.pi * np.arange(_STEPS) / _STEPS
    horizontal = np.cos(ways)[:, None] * east + np.sin(ways)[:, None] * north
    free = np.array([_free_way(around, direction) for direction in horizontal])
    rich = np.array([_n_faces(around, around.directions @ direction > _AHEAD) for direction in horizontal])
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


def _free_way(around: _Around, direction: np.ndarray) -> float:
    """How far nothing is met about a direction. A few thin things in the way do not count."""
    distances = around.distances[around.directions @ direction > 0.98]
    distances = distances[np.isfinite(distances)]
    return float(np.quantile(distances, 0.2)) if len(distances) else 0.0


# ---------------------------------------------------------------------------------------------------------------------
# What the default pictures of scenes show: all of a scene from outside, or the room that it encloses from inside.


def view_of(data: SceneData) -> View:
    """The geometry that a default picture of a scene shows; of a scene in a store only the bounds are known."""
    if not isinstance(data, MemoryData):
        return view_of_box(data.bounds, data.up)
    faces = moving_faces(data.source, data.n_triangles)
    box = detail(faces)
    view = View(within(faces, box), data.up, None)
    room = room_of(data, view.camera(1, 1), box)
    return view._replace(room=room, points=view.points if room is None or room.points is None else room.points)


def view_at(data: SceneData, view: View, time: float) -> View:
    """The view of a moment of a scene whose view is known."""
    if not isinstance(data, MemoryData) or not data.animated or view.room is not None:
        return view
    faces = sampled_faces(data.source, data.n_triangles, time)
    return view._replace(points=within(faces, detail(faces)))
