"""Example calls whose kernels are recorded: frames of a small scene, ray lists, updates, stores, instances and terrain.

`engine.precompilation` describes how the records are used. `work.warm_ups` adds the examples of studies.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import cast

import numpy as np

from ..base.files import temporary_folder
from ..bvh.instance_trees import InstanceTrees
from ..engine.accelerator import Accelerator
from ..engine.auto.cost_model import GOOD, QUICK, cost_of, strategies
from ..engine.auto.strategies import TreeForms, answer_query
from ..engine.auto_accelerator import CULLER, best_tree
from ..engine.engine import Engine
from ..engine.method_registry import BUILDERS, CULLERS, UPDATERS
from ..engine.plan import Plan, parse_plan
from ..engine.primary_visibility import primary_visibility
from ..engine.refitted_rays import RayTreeRefit
from ..engine.scene import Scene
from ..engine.scene_loading import load
from ..engine.small_scenes import (
    UP,
    small_instances,
    small_scene,
    small_scene_of_metal,
    small_scene_with_cutouts,
    small_terrain,
    small_view,
)
from ..engine.sources.in_memory_source import RAY_PLANS
from ..engine.sources.paged_source import Paged
from ..engine.sources.source_protocols import CameraView, FrameMemory
from ..engine.sources.terrain_shadows import TerrainPyramid
from ..engine.store_building import build_store
from ..kernels.parallel import new_ticket
from ..query.light_samples import light_samples
from ..query.ray_list import hit_arrays, rays_of
from ..query.ray_passes import rays_through
from ..query.receivers import Receivers
from ..query.shadow_query import shadow_queries
from ..scene.camera import Camera
from ..scene.instance_data import InstanceData
from ..scene.light_lists import DirectionalLights
from ..scene.lights import Light, QuadLight
from ..scene.scene_data import MemoryData
from ..scene.sky import Sky
from ..scene.triangles import HitFilter
from ..techniques.chcrt.occlusion_queries import cells_of_pixels
from ..techniques.chcrt.ray_bundles import bound_rays, pass_rays, shorten_pass
from ..techniques.srdh.representative_rays import SrdhRays
from ..trace.alpha_cutouts import cutout_tree
from ..trace.counters import new_counters
from ..trace.device import device_cutouts, device_instances, nearest_list_tracer, settling
from ..trace.device.device_rays import pack_receivers
from ..trace.rays.local_rays import local_rays
from ..trace.rays.row_tiles import FEWEST
from ..trace.terrain.terrain_ray_lists import trace_rays
from .frame import FrameState
from .frame_passes import render_frame
from .frame_request import TimeSample, request_of
from .render_options import RenderOptions
from .traversal_steps import explain

# --- Queries ----------------------------------------------------------------------------------------------------------


@contextmanager
def _small_store() -> Iterator[Scene]:
    """The small scene in a store of many chunks."""
    with temporary_folder() as folder:
        path = folder / "small.antumbra"
        build_store(Scene.of_data(small_scene()), path, threads=2, chunk=64)
        yield cast(Scene, load(path))


def _trace_rays() -> None:
    scene = Scene.of_data(small_scene())
    scene.occluded([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], threads=1)
    scene.closest_hit([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], threads=1)
    scene.occluded([0.0, 0.0, 0.0], np.ones((FEWEST, 3)), threads=1)  # rows are sought


def _find_all_hits(scene: Scene) -> None:
    origins, direction = np.zeros((128, 3)), [1.0, 1.0, 1.0]
    scene.all_hits(origins, direction, max_hits=1, threads=1)
    scene.count_hits(origins, direction, threads=1)


def _all_hits() -> None:
    for data in small_scene(), small_scene_with_cutouts():
        _find_all_hits(Scene.of_data(data))


def _contains() -> None:
    """Includes the grid of cells, and the columns of caps, which are made after thousands of points."""
    for seed in range(2):
        points = np.random.default_rng(seed).uniform(-1.0, 1.0, (10_000 * seed + 2, 3))
        Scene.of_data(small_scene()).contains(points, threads=1)


def _closest_points() -> None:
    Scene.of_data(small_scene()).signed_distance(np.zeros((2, 3)), threads=1)


def _all_hits_in_a_store() -> None:
    with _small_store() as scene:
        _find_all_hits(scene)


def _update() -> None:
    """Moves the geometry, and refits the tree of ray queries without tracing any."""
    scene, accelerator = Scene.of_data(data := small_scene()), Accelerator(parse_plan(RAY_PLANS[0]), 2)
    built = accelerator.build(scene.triangles(0.0, 2))
    (piece,) = data.source.pieces(0.0)
    scene.update(built.triangles.vertices + scene.origin, threads=2)
    scene.update(piece.vertices[0], threads=2)
    scene.update(transform=np.eye(4), threads=2)  # reads the corners of the faces
    RayTreeRefit(2).refit(accelerator, built, scene.triangles(0.0, 2), 0)


def _query(data: MemoryData | InstanceData, plan: str | None, gbuffer: str = "auto") -> None:
    """The surfaces that a camera sees, and the visibility of lights from a point."""
    engine, (camera, lights) = Engine(Scene.of_data(data), plan, 2, gbuffer=gbuffer), small_view()
    engine.surfaces(camera)
    engine.visibility(Receivers.on_surface(UP, UP, data.origin), lights, spp=1)


def _camera_rays() -> None:
    Engine(Scene.of_data(small_scene()), "lbvh+multifrusta", 2, gbuffer="rays").surfaces(small_view()[0])


def _instances() -> None:
    _query(small_instances(), None)
    scene, origins = Scene.of_data(small_instances()), np.ones((2, 3))
    scene.occluded(origins, -origins)
    scene.closest_hit(origins, -origins)
    scene.all_hits(origins, -origins)


def _surfaces_in_a_store() -> None:
    with _small_store() as scene:
        source, (camera, _) = cast(Paged, Engine(scene, None, 2).source), small_view()
        source.begin(FrameMemory(0, 0, 0))
        source.residency.budget = source.residency.min_budget()  # so that chunks with hits are evicted
        tree = source.accelerated
        view = CameraView(camera, tree.triangles, tree, slice(0, camera.height))
        source.look(view)
        source.subpixels(view, np.ones((camera.height, camera.width), np.bool_))
        scene.closest_hit(np.zeros((2, 3)), [1.0, 1.0, 1.0])


def _count_steps() -> None:
    moment = TimeSample(0.0, *small_view())
    explain(Scene.of_data(small_scene()), [moment], ["bsah+single"], spp=1, threads=2)


def _build_store() -> None:
    with _small_store():
        pass


def _terrain() -> None:
    engine = Engine(Scene.of_data(small_terrain()), threads=1)
    for points in ([[0.7, -1.0, 1.0]], [[0.5, -0.5, 1.0], [1.5, -0.5, 1.0], [2.5, -0.5, 1.0]]):
        receivers = Receivers.in_space(np.array(points), engine.data.origin)
        engine.visibility(receivers, DirectionalLights(np.array([(0.5, 0.3, -1.0)])), spp=1)


def _trace_rays_over_terrain() -> None:
    """A ray, without the tree that a scene builds soon."""
    data = small_terrain()
    rays = rays_of(np.zeros((1, 3)), np.ones(3), HitFilter(), (0.0, 0.0, 0.0), data.n_triangles)
    tree = TerrainPyramid(data).tree
    assert tree is not None  # it is in memory
    trace_rays(tree, None, local_rays(rays.arrays(), 0), hit_arrays(1, True), 1)


def _wide_lights() -> None:
    """Lights too wide for a single apex."""
    light = QuadLight(np.array([-1, 0.5, -1]), np.array([2, 0, 0]), np.array([0, 0, 2]))
    engine = Engine(Scene.of_data(small_scene()), "cones", 2, gbuffer="raster")
    seen = engine.surfaces(Camera((0, 2, 3), (0, 0, 0), width=96, height=96))
    engine.visibility(Receivers.on_surface(seen.position.reshape(-1, 3), UP, engine.data.origin), light, spp=16)


# --- Frames -----------------------------------------------------------------------------------------------------------


PLAIN = RenderOptions(spp=1, sampler="hammersley", filter=False, antialias=False)
"""Options of a frame that calls as few kernels as possible."""

QUALITY = replace(PLAIN, filter=True, adaptive=2)
"""The same, with the kernels of the filter and of refinement."""


def example_frame(
    plan: Plan,
    gbuffer: str = "raster",
    options: RenderOptions = PLAIN,
    *,
    view: tuple[Camera, list[Light]] | None = None,
    textured: bool = False,
    scene: MemoryData | None = None,
) -> None:
    """Render a frame of the small scene or another one.

    view : camera and lights
    textured : whether the small scene has textures and smooth normals
    """
    if plan.tracer.chooses:
        _trace_all_strategies(options.counters)
    scene = scene or small_scene(textured)
    engine = Engine(scene, plan, 2, gbuffer=gbuffer)
    camera, lights = view or small_view(bool(options.filter), sky=options.bounce is None)
    request = request_of(camera, lights, options, None if options.ground is False else options.ground)
    if engine.accelerator.ray_selector is None:  # all triangles: culling leaves too few to reach a builder's kernels
        engine.accelerator.build(scene.triangles(0.0, 2))
    with engine.lock:
        render_frame(FrameState(engine, request))


def _trace_all_strategies(counters: bool) -> None:
    """Cull for the lights of the small scene, and trace them by every strategy of `auto` in each kind of its trees."""
    triangles, (camera, lights) = small_scene().triangles(0.0, 2), small_view()
    gbuffer = primary_visibility(triangles, camera, None, 2)
    queries = shadow_queries(triangles, gbuffer, lights, [light_samples(light, 1) for light in lights])
    CULLERS[CULLER].cull(triangles, queries, 2)
    for build in (BUILDERS[QUICK].build, UPDATERS["refit"].keep(BUILDERS[GOOD].build).update):
        forms = TreeForms(build(triangles.vertices, 2), 2)
        for name, tracer in strategies().items():
            for query in queries:
                if tracer.suits(query, forms.extent.box) and not cost_of(name).load:
                    answer_query(name, forms, query, 2, new_counters() if counters else None)


def _listed_camera() -> None:
    """A camera whose rays are listed."""
    camera, lights = small_view(True)
    above = Camera(camera.position, camera.target, width=8, height=8, projection="orthographic", extent=3.0)
    example_frame(Plan(), view=(above, lights))


def _materials() -> None:
    """Surfaces with lobes below a lamp and a sky."""
    camera, lights = small_view()
    example_frame(_DEFAULT, view=(camera, [lights[0], Sky(up="y")]), scene=small_scene_of_metal())


def _devices() -> None:
    """What the CPU does for devices."""
    triangles, (camera, lights) = small_scene().triangles(0.0, 2), small_view()
    bvh, records = BUILDERS["bsah"].build(triangles.vertices, 2), settling.example_records(2)
    seen = primary_visibility(triangles, camera, None, 2)
    query = shadow_queries(triangles, seen, lights[:1], [light_samples(lights[0], 1)], 0, 2)[0]
    settling.blocked_rays(records, bvh, 0, query, 0, 1)
    settling.below_horizon(np.zeros(1, np.int64), query, 1)
    settling.nearest_slots(records, bvh, 0)
    settling.numbers_of(records, bvh, 1)
    settling.traced_rays(records, bvh, 0, True, 1)
    pack_receivers(new_ticket(1, 1), query.origins, query.faces, query.sides, np.empty((1, 4), np.float32))
    cutouts = cutout_tree(small_scene_with_cutouts().triangles(0.0, 2), 2)
    assert cutouts is not None
    device_cutouts.blocked_by_texels(records, cutouts, 0, 1)
    device_cutouts.depths_along(records, cutouts, 0, 1)
    device_cutouts.first_cutouts(records, cutouts, bvh, 0, 1)
    copies = InstanceTrees(small_instances(), BUILDERS["bsah"].build, 1)
    device_instances.traced_rays(records, copies, 0, False, 1)
    nearest_list_tracer.numbers_of(records, np.zeros((len(records), 9), np.float32), 0, 1)
    (h, w), tiles = seen.face.shape, np.zeros(1, np.int32)
    rays = pass_rays(rays_through(camera.rays(triangles.origin), np.ones((h, w), np.bool_), 1), h, w, 1.0)
    picture, spans = cells_of_pixels(h, w), np.array([[0, 1, 0, 1]], np.int32)
    shorten_pass(bound_rays(picture, rays, 1)[0], spans, tiles, picture, rays, 1)


_DEFAULT = Plan()
_BOUNCE = Plan(build="srdh", trace="single", sample=SrdhRays(bounce=True))

EXAMPLES: dict[str, Callable[[], object]] = {
    "ray queries": _trace_rays,
    "all hits": _all_hits,
    "contains": _contains,
    "closest points": _closest_points,
    "best tree": lambda: best_tree(small_scene().triangles(0.0, 2).vertices, 2),
    "update": _update,
    "camera rays": _camera_rays,
    "filter and refinement": lambda: example_frame(_DEFAULT, options=QUALITY),
    "anti-aliasing": lambda: example_frame(_DEFAULT, options=replace(PLAIN, antialias=True)),
    "textures and normals": lambda: example_frame(_DEFAULT, textured=True),
    "materials": _materials,
    "a ground": lambda: example_frame(_DEFAULT, options=replace(QUALITY, ground=1.95)),  # lights are partly below it
    "orthographic and panoramic cameras": _listed_camera,
    "light that bounces (raster)": lambda: example_frame(_DEFAULT, "raster", replace(PLAIN, bounce=1)),
    "light that bounces (rays)": lambda: example_frame(_DEFAULT, "rays", replace(PLAIN, bounce=1)),
    "building stores": _build_store,
    "scenes in a store": _surfaces_in_a_store,
    "all hits in stores": _all_hits_in_a_store,
    "cut-outs": lambda: _query(small_scene_with_cutouts(), "bsah+single", "raster"),
    "instances": _instances,
    "counted steps": _count_steps,
    "terrain": _terrain,
    "ray lists over terrain": _trace_rays_over_terrain,
    "devices": _devices,
}
"""The examples that are for every plan."""

WIDE_LIGHTS = {"cones, wide lights": _wide_lights}
BOUNCED_RAYS = {"a diffuse bounce": lambda: example_frame(_BOUNCE)}
