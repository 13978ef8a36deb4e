"""Antumbra: which points see which lights, exactly and fast.

>>> import antumbra as at
>>> scene = at.procedural("atrium", triangles=5_000)
>>> frame = at.render(scene, scene.cameras[0].resized(64, 64), scene.lights, spp=16)
>>> frame.visibility[0].shape
(64, 64)
"""

import importlib
import typing

from .field_docs import describe as _describe
from .version import VERSION as _VERSION

if typing.TYPE_CHECKING:
    from . import cluster
    from .engine.engine import Engine, Visibility
    from .engine.paged_scene import PagedScene
    from .engine.plan import Plan
    from .engine.point_visibility import visibility
    from .engine.scene import Scene, procedural
    from .engine.scene_loading import load
    from .engine.store_building import build_store
    from .errors import InputError
    from .formats.cityjson.attribute_writer import write_attributes
    from .jobs.bake import Baked, bake
    from .jobs.dataset.dataset_job import Dataset, dataset
    from .jobs.ground_areas import area_sensors
    from .jobs.line_of_sight.sightlines import Sightlines, line_of_sight
    from .jobs.line_of_sight.viewshed import Viewshed, viewshed
    from .jobs.line_of_sight.visibility_matrix import VisibilityMatrix, visibility_matrix
    from .jobs.raster_grid import Raster
    from .jobs.result_table import Column, Table
    from .jobs.sensor_files import sensors_of
    from .jobs.sensors import Sensors, face_sensors, grid_sensors, point_sensors, raster_sensors, vertex_sensors
    from .jobs.sun.location import Place, place_of
    from .jobs.sun.sun_hours import sky_view, sun_hours
    from .jobs.sun.sun_positions import Suns, suns_of, times_of
    from .picture.frame import Frame
    from .picture.render_options import RenderOptions
    from .picture.renderer import Renderer, render
    from .picture.virtual_point_lights import virtual_point_lights
    from .query.gbuffer import GBuffer
    from .query.receivers import Receivers
    from .scene.camera import Camera
    from .scene.light_lists import DirectionalLights, PointLights
    from .scene.lights import AmbientOcclusion, DirectionalLight, DiskLight, Light, PointLight, QuadLight, SphereLight
    from .scene.mesh import MeshInfo, ObjectInfo
    from .scene.scene_data import CityModel
    from .scene.sky import Sky
    from .scene.triangles import Hit, Triangles
    from .store.store_build import BuildReport
    from .techniques.srdh.representative_rays import SrdhRays
    from .viewer.viewer_page import Viewer, view

__version__ = _VERSION

__all__ = [
    "AmbientOcclusion",
    "Baked",
    "BuildReport",
    "Camera",
    "CityModel",
    "Column",
    "Dataset",
    "DirectionalLight",
    "DirectionalLights",
    "DiskLight",
    "Engine",
    "Frame",
    "GBuffer",
    "Hit",
    "InputError",
    "Light",
    "MeshInfo",
    "ObjectInfo",
    "PagedScene",
    "Place",
    "Plan",
    "PointLight",
    "PointLights",
    "QuadLight",
    "Raster",
    "Receivers",
    "RenderOptions",
    "Renderer",
    "Scene",
    "Sensors",
    "Sightlines",
    "Sky",
    "SphereLight",
    "SrdhRays",
    "Suns",
    "Table",
    "Triangles",
    "Viewer",
    "Viewshed",
    "Visibility",
    "VisibilityMatrix",
    "area_sensors",
    "bake",
    "build_store",
    "cluster",
    "dataset",
    "face_sensors",
    "grid_sensors",
    "line_of_sight",
    "load",
    "place_of",
    "point_sensors",
    "procedural",
    "raster_sensors",
    "render",
    "sensors_of",
    "sky_view",
    "sun_hours",
    "suns_of",
    "times_of",
    "vertex_sensors",
    "view",
    "viewshed",
    "virtual_point_lights",
    "visibility",
    "visibility_matrix",
    "write_attributes",
]

# Names are imported on first use: `antumbra --help` must start faster than Numba can be imported.
_HOMES = {
    "techniques.srdh.representative_rays": ["SrdhRays"],
    "engine.engine": ["Engine", "Visibility"],
    "engine.paged_scene": ["PagedScene"],
    "engine.point_visibility": ["visibility"],
    "engine.scene": ["Scene", "procedural"],
    "engine.scene_loading": ["load"],
    "engine.store_building": ["build_store"],
    "errors": ["InputError"],
    "jobs.ground_areas": ["area_sensors"],
    "jobs.bake": ["Baked", "bake"],
    "jobs.dataset.dataset_job": ["Dataset", "dataset"],
    "jobs.raster_grid": ["Raster"],
    "jobs.sensor_files": ["sensors_of"],
    "jobs.sensors": ["Sensors", "face_sensors", "grid_sensors", "point_sensors", "raster_sensors", "vertex_sensors"],
    "jobs.line_of_sight.visibility_matrix": ["VisibilityMatrix", "visibility_matrix"],
    "jobs.line_of_sight.sightlines": ["Sightlines", "line_of_sight"],
    "jobs.line_of_sight.viewshed": ["Viewshed", "viewshed"],
    "jobs.sun.location": ["Place", "place_of"],
    "jobs.sun.sun_positions": ["Suns", "suns_of"],
    "jobs.sun.sun_hours": ["sky_view"],
    "jobs.sun.sun_hours": ["sun_hours"],
    "jobs.sun.sun_positions": ["times_of"],
    "jobs.result_table": ["Column", "Table"],
    "plan": ["Plan"],
    "query.gbuffer": ["GBuffer"],
    "query.receivers": ["Receivers"],
    "picture.frame": ["Frame"],
    "picture.render_options": ["RenderOptions"],
    "picture.renderer": ["Renderer", "render"],
    "picture.virtual_point_lights": ["virtual_point_lights"],
    "scene.camera": ["Camera"],
    "scene.scene_data": ["CityModel"],
    "formats.cityjson.attribute_writer": ["write_attributes"],
    "scene.light_lists": ["DirectionalLights"],
    "scene.triangles": ["Hit"],
    "scene.lights": [
        "AmbientOcclusion",
        "DirectionalLight",
        "DiskLight",
        "Light",
        "PointLight",
        "QuadLight",
        "SphereLight",
    ],
    "scene.mesh": ["MeshInfo", "ObjectInfo"],
    "scene.light_lists": ["PointLights"],
    "scene.sky": ["Sky"],
    "scene.triangles": ["Triangles"],
    "store.store_build": ["BuildReport"],
    "viewer.viewer_page": ["Viewer", "view"],
}
_MODULES = ("cluster",)  # parts of the public face that are modules
_HOME = {name: home for home, names in _HOMES.items() for name in names}

if not typing.TYPE_CHECKING:  # hidden from type checkers, so that unknown names are errors

    def __getattr__(name):
        if name in _MODULES:
            return importlib.import_module(f"{__name__}.{name}")
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
        if hasattr(value, "_fields"):
            _describe(value)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
