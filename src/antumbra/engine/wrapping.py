"""Closed boxes around everything else, such as sky boxes: what lies inside them, and a camera between the two.

A scene is wrapped if its convex hull has few planes, faces cover all of them, and from outside nothing else is seen. It
does not matter which way the faces face, and into how many triangles they are divided.
"""

from typing import NamedTuple

import numpy as np

from ..scene.camera import Camera
from ..scene.framing import VFOV, axes, bounding_sphere, fitted_camera
from ..scene.room import Room, way_out
from ..scene.sampled import MOST, detail, within
from ..scene.triangles import Triangles
from .see import see

_VIEWS, _LENS = 128, 20.0  # pixels across, and degrees, of pictures from outside
_MOST_PLANES, _LAYERS = 32, 4  # of a hull; boxes in boxes that are opened
_ON = 1e-4  # distance from a plane, as a share of the size, up to which a corner lies on it
_COVERED = 0.98  # share of each plane that faces cover, and of the pixels from outside that show these faces
_BACK = 0.9  # of the way to the box: how far away a camera may stand
_CLOSE = 0.05  # share of the distance of a camera outside, below which it is too close
_WIDEST = 75.0  # degrees: with a wider lens, it is a room
_MARGIN = 1.08  # around the content, in a picture


class Wrapping(NamedTuple):
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


def unwrapped(triangles: Triangles, threads: int | None) -> Wrapping | None:
    """The innermost closed box of a scene; None if there is none, or nothing in it."""
    found = None
    for _ in range(_LAYERS):
        layer = _opened(triangles, threads)
        if layer is None:
            break
        found, triangles = layer, layer.content
    return found


def content_room(wrapping: Wrapping, up: str) -> Room | None:
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


def _opened(triangles: Triangles, threads: int | None) -> Wrapping | None:
    """The outermost closed box of a scene."""
    seen = _seen_from_outside(triangles, threads)
    if seen is None:
        return None
    planes = _hull_planes(triangles.vertices[np.unique(seen)].reshape(-1, 3))
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
    if wrap[seen].mean() < _COVERED or np.count_nonzero(~wrap) < len(planes):
        return None
    inside = (array[~wrap] for array in (triangles.vertices, triangles.face_id, triangles.colour))
    vertices, ids, colours = inside
    return Wrapping(Triangles(vertices, triangles.origin, ids, colours), planes[:, :4])


def _seen_from_outside(triangles: Triangles, threads: int | None) -> np.ndarray | None:
    """The faces in the pixels of pictures from the eight corners of a cube around a scene.

    None if one picture shows nothing, or more planes than a hull may have. So most scenes need one picture only.
    """
    solid = triangles._replace(cutouts=None)
    bounds = np.stack([triangles.vertices.min((0, 1)), triangles.vertices.max((0, 1))]).astype(np.float64)
    centre, radius = bounding_sphere(bounds)
    away, found = radius / np.sin(np.radians(_LENS / 2.0)), []
    for corner in np.array(list(np.ndindex(2, 2, 2))) * 2.0 - 1.0:
        place = centre + away / 3.0**0.5 * corner + triangles.origin
        shown = see(solid, Camera(place, centre + triangles.origin, (0, 1, 0), _LENS, _VIEWS, _VIEWS), None, threads)
        found.append(shown.face[shown.face >= 0])
        if not len(found[-1]) or _many_planes(triangles.vertices[np.unique(found[-1])], radius):
            return None
    return np.concatenate(found)


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
