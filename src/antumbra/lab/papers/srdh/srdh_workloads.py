"""The scenes and lights of the SRDH paper's measurements [Feltman et al. 2012, Sec. 4, Fig. 1].

Each scene is measured with a light of its own: a square lamp, or the sun through blinds. The paper's MADSCI and BEDROOM
have several lights, and the two lights of ARCADE send "fields of rays going in opposite directions" (Sec. 4.3). Other
lightings of a scene therefore have two opposed lights, or four lamps. Ambient occlusion and a sky, whose rays leave in
all directions, have no counterpart in the paper.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from ....base.errors import InputError
from ....scene.lights import AmbientOcclusion, Light, QuadLight, check_lights, tangents
from ....scene.sky import Sky
from ..benchmark_views import BenchmarkScenes, BenchmarkView, diagonal_of, square
from .srdh_published import Lighting

SCENES = BenchmarkScenes(
    ("sponza_crytek", "zdm2", "godot_room", "bart_robots", "sanmiguel_lite"),
    ("blinds",),
    ("blinds", "cellar", "atrium"),
    square(10),
)
"""Real scenes with area lights, and procedural ones with much occlusion."""


NAMES = {
    Lighting.own: "",
    Lighting.opposed: ", two opposed lights",
    Lighting.lamps: ", four lamps",
    Lighting.ambient: ", ambient occlusion",
    Lighting.sky: ", sky",
}
"""Lighting -> what it adds to the name of a scene."""

RELIT = {
    "sponza_crytek": tuple(Lighting),
    "godot_room": (Lighting.own, Lighting.lamps),
    "atrium": tuple(Lighting),
}
"""Scene -> its lightings, unless the user chooses some. Other scenes keep their own lights. ARCADE has the triangles of
SPONZA; the atrium stands for both where no real scenes are."""

_AMBIENT_RADIUS = 1 / 10  # of the scene's diagonal
_FARTHEST = 1 / 3  # of the diagonal: distance of a lamp where nothing is in the way
_SKY_LIGHTS = 64  # distant lights; each receiver tests a sixteenth of them


def workloads(views: Iterable[BenchmarkView], lightings: Sequence[Lighting] | None) -> list[BenchmarkView]:
    """The views under these lightings, or under the default ones of each scene. Their names include the lighting.

    Raises
    ------
    InputError
        If two views would have the same name.
    """
    lit = [lit_view(view, each) for view in views for each in lightings or RELIT.get(view.name, (Lighting.own,))]
    names = [view.name for view in lit]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError(f"{twice} would be measured twice; name each scene and lighting once")
    return lit


def lit_view(view: BenchmarkView, lighting: Lighting) -> BenchmarkView:
    """A view under another lighting, with its name."""
    lights = _LIGHTS[lighting](view)
    return view._replace(name=view.name + NAMES[lighting], lights=check_lights(lights, view.scene.up))


def _opposed(view: BenchmarkView) -> list[Light]:
    """Two distant squares, to the left and to the right of the camera's view and half-way up the sky."""
    right, up = view.camera.axes[0], _up(view)
    middle, reach = view.scene.bounds.mean(0), diagonal_of(view.name, view.scene.bounds)
    ways = [(side * right + up) / np.sqrt(2.0) for side in (-1, 1)]
    return [_square_lamp(view, middle + reach * way, *tangents(way), 1 / 10) for way in ways]


def _lamps(view: BenchmarkView) -> list[Light]:
    """Four level squares, which together are as large as the usual lamp.

    Each hangs above what the camera sees in the middle of a quarter of the picture, at four fifths of the height to
    what is above.
    """
    camera, up, lamps = view.camera, _up(view), list[Light]()
    right, down, ahead = camera.axes
    half = np.tan(np.radians(camera.vfov) / 2)
    across = np.cross(up, right)
    for a, b in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
        way = ahead + half / 2 * (a * camera.width / camera.height * right + b * down)
        seen = camera.position + 0.98 * _free_distances(view, camera.position, [way])[0] * way
        height = _free_distances(view, seen, [up])[0]
        lamps.append(_square_lamp(view, seen + 0.8 * height * up, right, across, 1 / 20))
    return lamps


def _ambient(view: BenchmarkView) -> list[Light]:
    return [AmbientOcclusion(_AMBIENT_RADIUS * diagonal_of(view.name, view.scene.bounds))]


_LIGHTS: dict[Lighting, Callable[[BenchmarkView], list[Light]]] = {
    Lighting.own: lambda view: view.lights,
    Lighting.opposed: _opposed,
    Lighting.lamps: _lamps,
    Lighting.ambient: _ambient,
    Lighting.sky: lambda view: [Sky(count=_SKY_LIGHTS)],
}


def _up(view: BenchmarkView) -> np.ndarray:
    axes: np.ndarray = np.eye(3)
    up: np.ndarray = axes[2 if view.scene.up == "z" else 1]
    return up


def _free_distances(view: BenchmarkView, origin: np.ndarray, ways: Sequence[np.ndarray]) -> np.ndarray:
    """The distance to the nearest surface in each direction, in lengths of the direction; at most `_FARTHEST`."""
    most = _FARTHEST * diagonal_of(view.name, view.scene.bounds)
    distances: np.ndarray = np.minimum(view.scene.closest_hit(origin, np.asarray(ways)).t, most)
    return distances


def _square_lamp(view: BenchmarkView, middle: np.ndarray, u: np.ndarray, v: np.ndarray, share: float) -> QuadLight:
    """A square whose edge is a share of the scene's diagonal, along the unit vectors u and v."""
    edge = share * diagonal_of(view.name, view.scene.bounds)
    return QuadLight(middle - edge * (u + v) / 2, edge * u, edge * v)
