"""A scene on a curved earth: a copy, lowered around its middle, in which straight lines represent refracted ones.

A point at the horizontal distance d from an observer sinks by (1 - k) d^2 / (2 R), as in GIS programs. Copies that are
lowered around two places differ by a function that is linear in x and y, a shear along the up axis, which maps straight
lines to straight lines. So one copy serves all observers: who sees whom is the same in it. Only angles depend on the
place; `Earth.turns` has what they differ by.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...engine.measured_scenes import earth_radius_of
from ...engine.scene import AnyScene, Scene
from ...scene.map_point import on_earth
from ...scene.scene_data import MemoryData
from ...scene.terrain import HeightGrid, TerrainSurfaces
from .sensors import Sensors, corners_of

_REFRACTION = 0.13  # of the atmosphere of the earth
_FACE_BYTES = 600  # of memory, with a copy of the triangles
_SAG = 1e-3  # metres: maximum height of an edge above the curve between its ends


class Earth(NamedTuple):
    """A curved earth.

    drop : float
        (1 - k) / (2 R), per world unit.
    centre : (3,) float64
        World: where nothing is lowered.
    up : int
        The axis that points up.
    sag : float
        Maximum height of an edge above the curve between its ends, world units.
    """

    drop: float
    centre: NDArray[np.float64]
    up: int
    sag: float = _SAG

    @property
    def longest(self) -> float:
        """The longest edge that is not divided; the middle of an edge lies drop * length^2 / 4 off the curve."""
        return float(2.0 * np.sqrt(self.sag / self.drop)) if self.drop > 0.0 else np.inf

    def lowered(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 3) float64: points, lowered."""
        out = points.copy()
        away = np.delete(points - self.centre, self.up, -1)
        out[..., self.up] -= self.drop * (away * away).sum(-1)
        return out

    def lowered_sensors(self, sensors: Sensors) -> Sensors:
        """The sensors of the copy. Those on faces are lifted by the maximum height of a face above the curve."""
        at, normals = self.lowered(sensors.points), sensors.normals
        if normals is not None:
            away = sensors.points - self.centre
            away[:, self.up] = 0.0
            normals = normals + 2.0 * self.drop * normals[:, self.up, None] * away
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            if sensors.faces is not None:
                at[sensors.faces >= 0] += (self.sag * normals)[sensors.faces >= 0]
        return replace(sensors, points=at, normals=normals)

    def turns(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) float64: along the two level axes, what must be added to slopes in the copy, as points see them."""
        return np.asarray(2.0 * self.drop * np.delete(points - self.centre, self.up, -1))


def earth_of(options: Any, scene: AnyScene) -> Earth | None:
    """The earth of a scene, from options with the fields of `CurvatureOptions`; None: it is flat.

    Raises
    ------
    InputError
        If a store has more triangles than fit in memory, or the scene has faces that let light through.
    """
    if not options.curvature:
        return None
    scene.data.check_all(_FACE_BYTES)
    if scene.cutouts is not None:
        raise InputError(
            f"{scene.name} has alpha masks or transmittance, which its copy on a curved earth would lose; "
            "leave curvature out, or make faces solid (cutouts=off)"
        )
    drop = (1.0 - refraction_of(options, scene)) / (2.0 * (options.earth_radius or earth_radius_of(scene)))
    return Earth(drop, scene.bounds.mean(0), "xyz".index(scene.up), scene.unit.of_metres(_SAG))


def refraction_of(options: Any, scene: AnyScene) -> float:
    """The refraction coefficient given, or that of the body on which a scene is."""
    if options.refraction is not None:
        return float(options.refraction)
    return _REFRACTION if scene.crs is None or on_earth(scene.crs) else 0.0


def curvature_record(options: Any, scene: AnyScene) -> dict[str, float]:
    """The refraction and the radius, as metadata of a study; nothing on a flat earth."""
    if not options.curvature:
        return {}
    radius = options.earth_radius or earth_radius_of(scene)
    return {"refraction": refraction_of(options, scene), "earth_radius": radius}


def lowered_scene(scene: AnyScene, earth: Earth, time: float = 0.0) -> Scene:
    """The lowered copy of a scene. Long edges are divided identically in both adjacent faces.

    A raster of heights with short edges stays one, which takes less memory than its triangles.
    """
    terrain = scene.data.terrain
    if terrain is not None and terrain.grid.dx**2 + terrain.grid.dy**2 <= earth.longest**2:
        east = terrain.grid.eastings() - earth.centre[0]
        north = terrain.grid.northings() - earth.centre[1]
        drops = earth.drop * ((north * north)[:, None] + east * east)
        heights = terrain.rows(0, terrain.grid.rows) - drops
        source = TerrainSurfaces([HeightGrid(terrain.name, terrain.grid, terrain.crs, heights)], scene.name)
        return Scene.of_data(MemoryData(source, name=scene.name, up=scene.up))
    corners = earth.lowered(subdivide(corners_of(scene, time), earth.longest))
    return Scene.from_arrays(corners, name=scene.name, up=scene.up)


def subdivide(corners: NDArray[np.float64], longest: float) -> NDArray[np.float64]:
    """(m, 3, 3): triangles with no edge longer than `longest`; longer edges are halved, the longest of a face first.

    Adjacent faces halve a shared edge at the same point, since halving depends only on the edge.
    """
    finished = list[np.ndarray]()
    while len(corners):
        lengths = np.linalg.norm(np.roll(corners, -1, 1) - corners, axis=2)
        k = lengths.argmax(1)
        long = lengths[np.arange(len(k)), k] > longest
        finished.append(corners[~long])
        corners, k = corners[long], k[long]
        row = np.arange(len(k))
        a, b, c = (corners[row, (k + shift) % 3] for shift in range(3))
        middle = (a + b) / 2.0
        corners = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
    return np.concatenate([np.empty((0, 3, 3)), *finished])
