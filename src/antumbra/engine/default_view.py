"""Default views: a whole scene from outside, or the room that it encloses from inside.

Enclosing boxes, such as sky boxes. A scene is enclosed if its convex hull has few planes, faces cover all of them, and
nothing else is visible from outside. The orientation of the faces and their triangulation do not matter.

Rooms. A scene is viewed from outside, and in all directions from a few points inside. It is a room if most surfaces
around such a point are front-facing, and if they show more triangles than the view from outside. The content of an
enclosing box is always viewed from inside the box. All views are small images: rasterised, so no BVH is built, or by
rays through a store.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.elementary import atan, cos, sin
from ..kernels.parallel import thread_count
from ..kernels.small_matrices import dot, product
from ..kernels.small_matrices import length as length_of
from ..query.shadow_query import Surfaces
from ..scene.camera import VFOV, Camera, axes, bounding_sphere, fitted_camera
from ..scene.default_picture import DefaultView, Room, exit_distance, view_of_bounds
from ..scene.lights import tangents
from ..scene.scene_bounds import Detail, bounds_of_points, corners_within, detail_box, every_face
from ..scene.scene_data import SceneData
from ..scene.triangle_setup import rows_with_area
from ..scene.triangles import Triangles
from .scene_views import SceneViews, ViewsInMemory, corners_seen

# --- Enclosing boxes --------------------------------------------------------------------------------------------------


_HULL_SIZE, _HULL_VFOV = 128, 20.0  # pixels and field of view in degrees of images from outside
_MAX_PLANES, _MAX_LAYERS = 32, 4  # planes of a hull; nested boxes to open
_MOST_TRIED = 16 * _MAX_PLANES  # planes of visible faces, most of them inside
_ON_PLANE = 1e-4  # distance from a plane, as a share of the scene's size, up to which a corner lies on it
_MIN_COVER = 0.98  # minimum share of each plane that faces cover, and of the pixels that show these faces from outside
_MAX_BACK = 0.9  # maximum distance of the camera, as a share of the distance to the box
_MIN_BACK = 0.05  # minimum distance of the camera, as a share of that of a camera outside
_MAX_VFOV = 75.0  # degrees: if a wider field of view is needed, the content is shown as a room
_MARGIN = 1.08  # around the content, in an image


class EnclosingBox(NamedTuple):
    """A closed box and its content."""

    content: Triangles
    planes: NDArray[np.float64]  # (m, 4), recentred: n x + d <= 0 inside, n unit

    @property
    def sample(self) -> NDArray[np.float64]:
        """(k, 3, 3) float64, recentred: a sample of the faces inside."""
        return self._sampled.astype(np.float64)

    @property
    def detail(self) -> Detail:
        """The detail of the content."""
        origin = self.content.origin
        return Detail.of(detail_box(self.sample) + origin, self._sampled[:, 0], origin)

    @property
    def _sampled(self) -> NDArray[np.float32]:
        return self.content.vertices[:: every_face(len(self.content.vertices))]

    def contains(self, points: np.ndarray) -> bool:
        """Whether all points, (k, 3) recentred, are inside the box."""
        slack = _ON_PLANE * max(float(np.abs(points).max()), 1e-300)
        return all(dot(points, plane[:3]).max() + plane[3] <= slack for plane in self.planes)

    def exit_along(self, start: np.ndarray, along: np.ndarray) -> float:
        """The parameter t at which ``start + t * along`` leaves the box; `start`: a recentred point inside."""
        return exit_distance(self.planes, start, along)

    @property
    def planes_in_world(self) -> NDArray[np.float64]:
        """(m, 4) float64: the planes in world coordinates."""
        normals, offsets = self.planes[:, :3], self.planes[:, 3]
        return np.column_stack([normals, offsets - dot(normals, self.content.origin)])


def innermost_box(views: SceneViews, threads: int | None = None) -> EnclosingBox | None:
    """The innermost nonempty enclosing box of a scene; None if there is none, or if its faces do not fit in memory."""
    innermost = None
    for _ in range(_MAX_LAYERS):
        layer = _outermost_box(views, threads)
        if layer is None:
            break
        innermost, views = layer, ViewsInMemory(layer.content, threads)
    return innermost


def content_room(enclosing: EnclosingBox, up: str) -> Room | None:
    """A viewpoint inside the box that shows its whole content; None if the box is too tight."""
    origin, faces = enclosing.content.origin, enclosing.sample
    points = corners_within(faces, detail_box(faces))
    camera = fitted_camera(points, up, 1, 1)
    back = camera.position - camera.target
    share = min(1.0, _MAX_BACK * enclosing.exit_along(camera.target, back))
    eye = camera.target + share * back
    if not share > _MIN_BACK:
        return None
    vfov = VFOV if share == 1.0 else _vfov_of(points, Camera(eye, camera.target, axes(up)[1], width=1, height=1))
    if not vfov <= _MAX_VFOV:
        return None
    upward = axes(up)[1]
    middle = camera.target + max(dot(points, upward).max() - dot(camera.target, upward), 0.0) * upward
    middle += 0.1 * min(enclosing.exit_along(middle, upward), float(length_of(back))) * upward
    above = enclosing.exit_along((middle + eye) / 2.0, upward)
    middle, eye, target = middle + origin, eye + origin, camera.target + origin
    return Room(middle, eye, target, vfov, False, above, points + origin, enclosing.planes_in_world)


def _outermost_box(views: SceneViews, threads: int | None) -> EnclosingBox | None:
    """The outermost enclosing box of a scene; None if there is none."""
    images = _images_from_outside(views)
    planes = None if images is None else _hull_planes(corners_seen(images))
    triangles = None if planes is None else views.triangles()
    if images is None or planes is None or triangles is None:
        return None
    triangles = _with_area(triangles, threads)
    size = float(np.ptp(bounds_of_points(triangles.vertices), axis=0).max())
    corners = triangles.vertices.reshape(-1, 3).astype(np.float64)
    wrap = np.zeros(len(triangles.vertices), bool)
    for x, y, z, offset, area in planes:
        on = (np.abs(dot(corners, (x, y, z)) + offset) <= _ON_PLANE * size).reshape(-1, 3).all(1)
        if _area(triangles.vertices[on]) < _MIN_COVER * area:
            return None
        wrap |= on
    seen = np.concatenate([image.ids[image.ids >= 0] for image in images])
    if wrap[np.searchsorted(triangles.face_id, seen)].mean() < _MIN_COVER or np.count_nonzero(~wrap) < len(planes):
        return None
    return EnclosingBox(_some(triangles, ~wrap), planes[:, :4])


def _with_area(triangles: Triangles, threads: int | None) -> Triangles:
    """The triangles that have an area, which alone are in a store."""
    rows = rows_with_area(triangles.vertices, thread_count(threads))
    return triangles if rows is None else _some(triangles, rows)


def _some(triangles: Triangles, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Triangles:
    """Some rows of triangles, all of which are solid."""
    return Triangles(triangles.vertices[rows], triangles.origin, triangles.face_id[rows], triangles.colour[rows])


def _images_from_outside(views: SceneViews) -> list[Surfaces] | None:
    """Images from the eight corners of a cube around a scene.

    None if an image is empty or shows more planes than a hull may have, so most scenes need only one image.
    """
    box, origin, images = views.box, views.origin, list[Surfaces]()
    centre, radius = bounding_sphere(box.astype(np.float64))
    away = radius / sin(np.radians(_HULL_VFOV / 2.0))
    for corner in np.array(list(np.ndindex(2, 2, 2))) * 2.0 - 1.0:
        place = centre + away / 3.0**0.5 * corner + origin
        image = views.see_solid(Camera(place, centre + origin, (0, 1, 0), _HULL_VFOV, _HULL_SIZE, _HULL_SIZE))
        if not (image.ids >= 0).any() or _many_planes(corners_seen([image]), radius):
            return None
        images.append(image)
    return images


def _many_planes(corners: np.ndarray, radius: float) -> bool:
    """Whether triangles span clearly more planes than a hull may have."""
    normals = np.cross(*_edges(corners.astype(np.float64)))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    sound = length[:, 0] > 0.0
    normals = normals[sound] / length[sound]
    normals *= np.where(dot(normals, (0.41, 0.67, 0.62)) < 0.0, -1.0, 1.0)[:, None]
    heights = (normals * corners[sound, 0]).sum(1, keepdims=True) / radius
    return len(np.unique(np.c_[normals, heights].round(2), axis=0)) > 2 * _MAX_PLANES


def _hull_planes(faces: NDArray[np.floating]) -> NDArray[np.float64] | None:
    """(m, 5) float64: the planes (n, d) that bound faces from outside, and areas; None if there are too many.

    These are the planes of faces behind which all faces lie. They bound a polytope, whose facets have these areas. If
    faces cover all facets, it is the convex hull; if the hull has a hole, facets beside the hole reach beyond it.
    """
    faces = faces.astype(np.float64)
    normals = np.cross(*_edges(faces))
    twice_area = np.linalg.norm(normals, axis=1)
    faces, normals = faces[twice_area > 0.0], normals[twice_area > 0.0]
    if not len(faces):
        return None
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = np.unique(faces.reshape(-1, 3), axis=0)
    slack = _ON_PLANE * float(np.ptp(points, axis=0).max(initial=0.0))
    rest = np.argsort(-twice_area[twice_area > 0.0], kind="stable")  # the largest face of a plane is the most precise
    planes: list[NDArray[np.float64]] = []
    for _ in range(_MOST_TRIED):
        if not len(rest) or len(planes) > _MAX_PLANES:
            break
        plane = np.append(normals[rest[0]], -normals[rest[0]] @ faces[rest[0], 0])
        heights = points @ plane[:3] + plane[3]
        if heights.max() <= slack:
            planes.append(plane)
        elif heights.min() >= -slack:
            planes.append(-plane)
        rest = rest[(np.abs(faces[rest] @ plane[:3] + plane[3]) > slack).any(1)]
    if len(rest) or not 0 < len(planes) <= _MAX_PLANES:
        return None
    return np.array([np.append(plane, _facet_area(plane, planes, points)) for plane in planes])


def _facet_area(plane: NDArray[np.float64], planes: list[NDArray[np.float64]], points: NDArray[np.float64]) -> float:
    """The area of a plane behind all other planes, within a square much larger than the extent of the points."""
    u, v = tangents(plane[:3])
    centre = points.mean(0)
    centre -= (centre @ plane[:3] + plane[3]) * plane[:3]
    reach = 4.0 * float(np.ptp(points, axis=0).max())
    polygon = centre + reach * np.array([-u - v, u - v, u + v, v - u])
    for other in planes:
        if other is not plane:
            polygon = _clipped(polygon, other)
    fan = polygon - polygon[:1]
    return float(np.linalg.norm(np.cross(fan[:-1], fan[1:]).sum(0)) / 2.0)


def _clipped(polygon: NDArray[np.float64], plane: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, 3): the part of a convex polygon behind a plane."""
    heights = polygon @ plane[:3] + plane[3]
    following, behind = np.roll(heights, -1), heights <= 0.0
    with np.errstate(invalid="ignore", divide="ignore"):
        crossings = polygon + (heights / (heights - following))[:, None] * (np.roll(polygon, -1, axis=0) - polygon)
    used = np.stack([behind, behind != np.roll(behind, -1)], 1)
    return np.asarray(np.stack([polygon, crossings], 1)[used])


def _edges(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]


def _area(corners: np.ndarray) -> float:
    return float(np.linalg.norm(np.cross(*_edges(corners.astype(np.float64))), axis=1).sum() / 2.0)


def _vfov_of(points: np.ndarray, camera: Camera) -> float:
    """The field of view in degrees that shows all points; 180 if some are behind the camera."""
    right, down, ahead = product(points - camera.position, camera.axes.T).T
    if ahead.min() <= 0.0:
        return 180.0
    across = float((np.maximum(np.abs(right), np.abs(down)) / ahead).max())
    return max(VFOV, 2.0 * float(np.degrees(atan(_MARGIN * across))))


# --- Rooms ------------------------------------------------------------------------------------------------------------


_OUTSIDE_SIZE, _INSIDE_SIZE = 128, 48  # pixels across of the view from outside, and of each view from inside
_RICH = 1500  # number of visible triangles above which the view from outside is the better one
_CLOSED, _FACING, _MORE = 0.85, 0.6, 3.0  # minima of a room: share of hits, share of front faces; ratio of triangles
_LEVELS = 0.3, 0.45, 0.6  # heights of candidate points, as shares of the scene's height
_STEPS = 36  # horizontal directions
_AHEAD = 0.85  # cosine of the angle within which triangles count as ahead
_BACK_SHARE = 0.85  # how far the camera moves back, as a share of the distance to the wall behind it
_OPEN_SKY = 0.1  # minimum share of sky in the view straight up, in a room lit by daylight
_VFOV = 60.0


class _Panorama(NamedTuple):
    """The view from a point in all directions."""

    directions: NDArray[np.float64]  # (m, 3), unit length
    distances: NDArray[np.float64]  # (m,); inf on a miss
    faces: NDArray[np.integer]  # (m,), of the scene; -1 on a miss
    facing: NDArray[np.bool_]  # (m,): whether the front side is hit


def room_of(
    scene: SceneData, views: SceneViews, outside: Camera, detail: Detail, threads: int | None = None
) -> Room | None:
    """The room that a scene encloses at time 0; None if the view from outside is better.

    outside : a camera that shows the scene's detail
    """
    enclosing = innermost_box(views, threads)
    if enclosing is not None and scene.animated and not enclosing.contains(_moving_corners(scene)):
        enclosing = None
    room = None if enclosing is None else content_room(enclosing, scene.up)
    if room is not None:
        return room
    n_outside = 0
    for camera in outside, view_of_bounds(scene.bounds, scene.up).camera(1, 1):
        n_outside = max(n_outside, _n_front_faces(views, camera))
        if enclosing is None and n_outside >= _RICH:
            return None
    up = axes(scene.up)[1]
    points = _candidate_points(detail if enclosing is None else enclosing.detail, up)
    places = [(point, _panorama(views, point, scene.up)) for point in points]
    rooms = [place for place in places if _encloses(place[1], n_outside)]
    if enclosing is not None:
        rooms = [(point, _content_only(view, enclosing)) for point, view in rooms or places]
    if not rooms:
        return None
    room = _room(*max(rooms, key=lambda place: _n_faces(place[1])), up)
    return room if enclosing is None else room._replace(planes=enclosing.planes_in_world)


def _content_only(panorama: _Panorama, enclosing: EnclosingBox) -> _Panorama:
    """The panorama with front faces only where the content of a box is hit."""
    return panorama._replace(facing=panorama.facing & np.isin(panorama.faces, enclosing.content.face_id))


def _moving_corners(scene: SceneData) -> NDArray[np.float64]:
    """(k, 3) float64, recentred: corners of a sample of faces, at several times."""
    faces = scene.sampled_faces()
    assert faces is not None
    corners: NDArray[np.float64] = faces.reshape(-1, 3) - scene.origin
    return corners


def _n_front_faces(views: SceneViews, outside: Camera) -> int:
    """The number of triangles whose front side is visible to a camera."""
    image = views.see(outside.resized(_OUTSIDE_SIZE, _OUTSIDE_SIZE))
    return len(np.unique(image.ids[image.gbuffer.side > 0]))


def _candidate_points(detail: Detail, up: np.ndarray) -> list[np.ndarray]:
    """Points inside a scene at several heights, above the middle of its extent and where most triangles are."""
    box, dense = detail
    height = dot(np.ptp(box, axis=0), np.abs(up))
    places = box.mean(0), dense + dot(box.mean(0) - dense, up) * up
    return [place + (level - 0.5) * height * up for place in places for level in _LEVELS]


def _panorama(views: SceneViews, point: np.ndarray, up: str) -> _Panorama:
    """The view from a point through the six faces of a cube."""
    right, upward, towards = axes(up)
    parts = []
    for ahead, above in ((right, upward), (towards, upward), (upward, right)):
        for axis in ahead, -ahead:
            camera = Camera(point, point + axis, above, 90.0, _INSIDE_SIZE, _INSIDE_SIZE)
            image, rays = views.see(camera), camera.rays(views.origin)
            y, x = np.mgrid[:_INSIDE_SIZE, :_INSIDE_SIZE][..., None] + 0.5
            directions = (rays.corner + x * rays.dx + y * rays.dy).reshape(-1, 3)
            length = np.linalg.norm(directions, axis=1)
            parts.append(
                (
                    directions / length[:, None],
                    image.gbuffer.depth.ravel() * length,
                    image.ids.ravel(),
                    image.gbuffer.side.ravel() > 0,
                )
            )
    return _Panorama(*(np.concatenate(arrays) for arrays in zip(*parts)))


def _encloses(panorama: _Panorama, n_outside: int) -> bool:
    hit = panorama.faces >= 0
    if hit.mean() < _CLOSED or panorama.facing[hit].mean() < _FACING:
        return False
    return _n_faces(panorama) > _MORE * n_outside


def _n_faces(panorama: _Panorama, chosen: np.ndarray | bool = True) -> int:
    """The number of triangles whose front side is visible in chosen directions."""
    return len(np.unique(panorama.faces[panorama.facing & chosen]))


def _room(point: np.ndarray, panorama: _Panorama, up: np.ndarray) -> Room:
    """The room around a point. Its camera looks along the longest free line through the point."""
    east, north = tangents(up)
    ways = 2.0 * np.pi * np.arange(_STEPS) / _STEPS
    horizontal = cos(ways)[:, None] * east + sin(ways)[:, None] * north
    free = np.array([_free_distance(panorama, direction) for direction in horizontal])
    rich = np.array([_n_faces(panorama, dot(panorama.directions, direction) > _AHEAD) for direction in horizontal])
    # The free distance behind the camera counts less than that ahead: it only lets the camera move back.
    best = int(np.argmax((free + 0.8 * np.roll(free, _STEPS // 2)) * np.sqrt(rich + 1.0)))
    eye = point - _BACK_SHARE * free[(best + _STEPS // 2) % _STEPS] * horizontal[best]
    target = point + 0.5 * free[best] * horizontal[best]
    above = dot(panorama.directions, up) > 0.9
    return Room(
        point, eye, target, _VFOV, float((panorama.faces[above] < 0).mean()) > _OPEN_SKY, _ceiling(panorama, up)
    )


def _ceiling(panorama: _Panorama, up: np.ndarray) -> float:
    """Height of the ceiling above the point, ignoring objects that hang from it."""
    heights = dot(panorama.directions, up) * panorama.distances
    above = heights[(dot(panorama.directions, up) > 0.3) & np.isfinite(heights)]
    return float(np.quantile(above, 0.9)) if len(above) else 0.0


def _free_distance(panorama: _Panorama, direction: np.ndarray) -> float:
    """Free distance in a direction, ignoring a few thin objects in between."""
    distances = panorama.distances[dot(panorama.directions, direction) > 0.98]
    distances = distances[np.isfinite(distances)]
    return float(np.quantile(distances, 0.2)) if len(distances) else 0.0


# --- Views ------------------------------------------------------------------------------------------------------------


def view_of(data: SceneData, views: Callable[[], SceneViews]) -> DefaultView:
    """The geometry that a default view of a scene shows; `views`: makes images of it.

    Instances are shown from outside.
    """
    faces = data.sampled_faces()
    if faces is None:
        points, detail = data.framed_points, data.detail
        if points is None:
            return view_of_bounds(data.bounds, data.up)
        view = DefaultView(points, data.up, None, data.bounds)
        return view if detail is None else _with_room(data, views(), view, detail)
    box = detail_box(faces)
    view = DefaultView(corners_within(faces, box), data.up, None, data.bounds)
    if data.instanced:
        return view
    of_scene = views()
    triangles = of_scene.triangles()
    assert triangles is not None
    corners = triangles.vertices[:: every_face(len(triangles.vertices)), 0]
    return _with_room(data, of_scene, view, Detail.of(box, corners, triangles.origin))


def _with_room(data: SceneData, views: SceneViews, view: DefaultView, detail: Detail) -> DefaultView:
    """The view, from inside the room that the scene encloses, if there is one."""
    room = room_of(data, views, view.camera(1, 1), detail)
    views.end()
    return view._replace(room=room, points=view.points if room is None or room.points is None else room.points)


def view_at(data: SceneData, view: DefaultView, time: float) -> DefaultView:
    """The view of an animated scene at one time, given its view over the whole animation."""
    if not data.animated or view.room is not None or (faces := data.sampled_faces(time)) is None:
        return view
    return view._replace(points=corners_within(faces, detail_box(faces)))
