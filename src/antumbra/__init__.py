"""Antumbra: which points see which lights, exactly and fast.

>>> import antumbra as at
>>> scene = at.procedural("atrium", triangles=5_000)
>>> frame = at.render(scene, scene.cameras[0].resized(64, 64), scene.lights, spp=16)
>>> frame.visibility[0].shape
(64, 64)
"""

from .version import VERSION as _VERSION

TYPE_CHECKING = False  # as type checkers know it: importing typing would delay the handling of Ctrl-C

if TYPE_CHECKING:
    from . import cluster, examples
    from .baking.bake import Baked, bake
    from .base.errors import InputError, UnavailableError
    from .city.changes.before_and_after import before_and_after
    from .city.changes.scene_changes import SceneChange, changed_scene, scene_change, scene_variant
    from .city.cityjson.attribute_writer import write_attributes
    from .city.gis.gis_scenes import from_footprints, from_raster
    from .city.pv.module_shading import ModuleShading, module_shading
    from .city.pv.modules import PvModule
    from .city.sensors.ground_areas import area_sensors
    from .city.sensors.sensor_files import sensors_of
    from .city.sensors.sensors import Sensors, face_sensors, point_sensors, raster_sensors, vertex_sensors
    from .city.sensors.surface_grid import grid_sensors
    from .city.shadow.shadow import shadow
    from .city.shadow.shadow_polygons import Shadow
    from .city.sheets.sheet_options import Sheet
    from .city.sight.line_points import LinePoints, points_along
    from .city.sight.sightlines import Sightlines, line_of_sight
    from .city.sight.targets import polygon_points, surface_points, visible_share
    from .city.sight.turbines import Turbine
    from .city.sight.viewshed import Viewshed, viewshed
    from .city.sight.visibility_matrix import VisibilityMatrix, visibility_matrix
    from .city.skyline.skyline import Skyline, skyline
    from .city.sun.route_shade import RouteShade, route_shade
    from .city.sun.sun_calendar import SunCalendar, sun_calendar
    from .city.sun.sun_hours import sky_view, sun_hours
    from .city.tables.result_table import Column, Table
    from .city.vegetation.vegetation_scenes import from_trees
    from .city.view_factors.view_factor_matrix import ViewFactors
    from .city.view_factors.view_factors import view_factors
    from .datasets.dataset import Dataset, dataset
    from .engine.engine import Engine
    from .engine.paged_scene import PagedScene
    from .engine.plan import Plan
    from .engine.point_visibility import visibility
    from .engine.scene import Scene, procedural
    from .engine.scene_loading import load
    from .engine.store_building import build_store
    from .engine.visibility import Visibility
    from .integrations.pvlib import pvlib_shading
    from .integrations.trimesh import trimesh_nearest, trimesh_ray, use_in_trimesh
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
    from .scene.raster import Raster
    from .scene.scene_data import CityModel
    from .scene.sky import Sky
    from .scene.triangles import AllHits, ClosestPoints, Hit, Triangles
    from .scene.units import LengthUnit
    from .store.store_build import BuildReport
    from .sun.location import Place, place_of
    from .sun.sun_positions import Suns, suns_of, times_of
    from .techniques.srdh.representative_rays import SrdhRays
    from .viewer.viewer_page import Viewer, view

__version__ = _VERSION

__all__ = [
    "AllHits",
    "AmbientOcclusion",
    "Baked",
    "BuildReport",
    "Camera",
    "CityModel",
    "ClosestPoints",
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
    "LengthUnit",
    "Light",
    "LinePoints",
    "MeshInfo",
    "ModuleShading",
    "ObjectInfo",
    "PagedScene",
    "Place",
    "Plan",
    "PointLight",
    "PointLights",
    "PvModule",
    "QuadLight",
    "Raster",
    "Receivers",
    "RenderOptions",
    "Renderer",
    "RouteShade",
    "Scene",
    "SceneChange",
    "Sensors",
    "Shadow",
    "Sheet",
    "Sightlines",
    "Sky",
    "Skyline",
    "SphereLight",
    "SrdhRays",
    "SunCalendar",
    "Suns",
    "Table",
    "Triangles",
    "Turbine",
    "UnavailableError",
    "ViewFactors",
    "Viewer",
    "Viewshed",
    "Visibility",
    "VisibilityMatrix",
    "area_sensors",
    "bake",
    "before_and_after",
    "build_store",
    "changed_scene",
    "cluster",
    "dataset",
    "examples",
    "face_sensors",
    "from_footprints",
    "from_raster",
    "from_trees",
    "grid_sensors",
    "line_of_sight",
    "load",
    "module_shading",
    "place_of",
    "point_sensors",
    "points_along",
    "polygon_points",
    "procedural",
    "pvlib_shading",
    "raster_sensors",
    "render",
    "route_shade",
    "scene_change",
    "scene_variant",
    "sensors_of",
    "shadow",
    "sky_view",
    "skyline",
    "sun_calendar",
    "sun_hours",
    "suns_of",
    "surface_points",
    "times_of",
    "trimesh_nearest",
    "trimesh_ray",
    "use_in_trimesh",
    "vertex_sensors",
    "view",
    "view_factors",
    "viewshed",
    "virtual_point_lights",
    "visibility",
    "visibility_matrix",
    "visible_share",
    "write_attributes",
]

# Names are imported on first use, since `antumbra --help` must start faster than Numba can be imported.
_HOME = {
    "AllHits": "scene.triangles",
    "AmbientOcclusion": "scene.lights",
    "Baked": "baking.bake",
    "BuildReport": "store.store_build",
    "Camera": "scene.camera",
    "CityModel": "scene.scene_data",
    "ClosestPoints": "scene.triangles",
    "Column": "city.tables.result_table",
    "Dataset": "datasets.dataset",
    "DirectionalLight": "scene.lights",
    "DirectionalLights": "scene.light_lists",
    "DiskLight": "scene.lights",
    "Engine": "engine.engine",
    "Frame": "picture.frame",
    "GBuffer": "query.gbuffer",
    "Hit": "scene.triangles",
    "InputError": "base.errors",
    "LengthUnit": "scene.units",
    "Light": "scene.lights",
    "LinePoints": "city.sight.line_points",
    "MeshInfo": "scene.mesh",
    "ModuleShading": "city.pv.module_shading",
    "ObjectInfo": "scene.mesh",
    "PagedScene": "engine.paged_scene",
    "Place": "sun.location",
    "Plan": "engine.plan",
    "PointLight": "scene.lights",
    "PointLights": "scene.light_lists",
    "PvModule": "city.pv.modules",
    "QuadLight": "scene.lights",
    "Raster": "scene.raster",
    "Receivers": "query.receivers",
    "RenderOptions": "picture.render_options",
    "Renderer": "picture.renderer",
    "RouteShade": "city.sun.route_shade",
    "Scene": "engine.scene",
    "SceneChange": "city.changes.scene_changes",
    "Sensors": "city.sensors.sensors",
    "Shadow": "city.shadow.shadow_polygons",
    "Sheet": "city.sheets.sheet_options",
    "Sightlines": "city.sight.sightlines",
    "Sky": "scene.sky",
    "Skyline": "city.skyline.skyline",
    "SphereLight": "scene.lights",
    "SrdhRays": "techniques.srdh.representative_rays",
    "Suns": "sun.sun_positions",
    "SunCalendar": "city.sun.sun_calendar",
    "Table": "city.tables.result_table",
    "Triangles": "scene.triangles",
    "Turbine": "city.sight.turbines",
    "UnavailableError": "base.errors",
    "ViewFactors": "city.view_factors.view_factor_matrix",
    "Viewer": "viewer.viewer_page",
    "Viewshed": "city.sight.viewshed",
    "Visibility": "engine.visibility",
    "VisibilityMatrix": "city.sight.visibility_matrix",
    "area_sensors": "city.sensors.ground_areas",
    "bake": "baking.bake",
    "before_and_after": "city.changes.before_and_after",
    "build_store": "engine.store_building",
    "changed_scene": "city.changes.scene_changes",
    "dataset": "datasets.dataset",
    "face_sensors": "city.sensors.sensors",
    "from_footprints": "city.gis.gis_scenes",
    "from_raster": "city.gis.gis_scenes",
    "from_trees": "city.vegetation.vegetation_scenes",
    "grid_sensors": "city.sensors.surface_grid",
    "line_of_sight": "city.sight.sightlines",
    "load": "engine.scene_loading",
    "place_of": "sun.location",
    "point_sensors": "city.sensors.sensors",
    "module_shading": "city.pv.module_shading",
    "points_along": "city.sight.line_points",
    "polygon_points": "city.sight.targets",
    "procedural": "engine.scene",
    "pvlib_shading": "integrations.pvlib",
    "raster_sensors": "city.sensors.sensors",
    "render": "picture.renderer",
    "route_shade": "city.sun.route_shade",
    "scene_change": "city.changes.scene_changes",
    "scene_variant": "city.changes.scene_changes",
    "sensors_of": "city.sensors.sensor_files",
    "shadow": "city.shadow.shadow",
    "sky_view": "city.sun.sun_hours",
    "skyline": "city.skyline.skyline",
    "sun_calendar": "city.sun.sun_calendar",
    "sun_hours": "city.sun.sun_hours",
    "suns_of": "sun.sun_positions",
    "surface_points": "city.sight.targets",
    "times_of": "sun.sun_positions",
    "trimesh_nearest": "integrations.trimesh",
    "trimesh_ray": "integrations.trimesh",
    "use_in_trimesh": "integrations.trimesh",
    "vertex_sensors": "city.sensors.sensors",
    "view": "viewer.viewer_page",
    "view_factors": "city.view_factors.view_factors",
    "viewshed": "city.sight.viewshed",
    "virtual_point_lights": "picture.virtual_point_lights",
    "visibility": "engine.point_visibility",
    "visibility_matrix": "city.sight.visibility_matrix",
    "visible_share": "city.sight.targets",
    "write_attributes": "city.cityjson.attribute_writer",
}
_MODULES = "cluster", "examples"  # public names that are modules

if not TYPE_CHECKING:  # hidden from type checkers, so that unknown names are errors

    def __getattr__(name):
        from importlib import import_module

        if name in _MODULES:
            return import_module(f"{__name__}.{name}")
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
        if hasattr(value, "_fields"):
            from .base.field_docs import describe

            describe(value)
        globals()[name] = value
        return value


del TYPE_CHECKING


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
