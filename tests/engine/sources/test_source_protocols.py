"""Sources implement narrow protocols, and code asks for what a scene offers instead of what type it has."""

import ast
import sys
from pathlib import Path

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.sources.source_protocols import PointQuery, box_of, moment_of, points_memory
from antumbra.query.light_samples import light_samples
from stores import built

SOURCES = Path(at.__file__).parent
MODULES = "in_memory_source", "instanced_source", "paged_source", "terrain_shadows", "point_shadows", "frame_tracer"

KINDS = {
    *("SceneData", "MemoryData", "InstanceData", "StoreData", "AnyScene", "Scene", "PagedScene", "StreamedScene"),
    *("InMemory", "Instanced", "Paged", "TerrainShadows", "RayLists", "RenderSource", "SceneTrees"),
    *("SharedMemory", "SharedInstances", "SharedStore", "TerrainSurfaces", "StreamedTerrain", "StreamedCity"),
}
"""Kinds of scenes, of their data, and of sources."""

ARGUMENTS_OF_USERS = {  # a scene, as opposed to the path of one, or to a mesh of another library
    ("engine/scene_loading.py", "scene_of"),
    ("engine/scene_reading.py", "data_of"),
    ("engine/store_building.py", "_scene_data_of_all"),
    ("engine/store_building.py", "_scene_data"),
    ("baking/bake_input.py", "bake_source"),
    ("city/changes/scene_changes.py", "_in_memory"),
    ("city/skyline/skyline.py", "_trees"),
}


def functions_of(tree):
    """All functions of a module, but those of protocols, which have no bodies."""
    protocols = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef) and _is_protocol(node)]
    without = {id(each) for protocol in protocols for each in ast.walk(protocol)}
    return [each for each in ast.walk(tree) if isinstance(each, ast.FunctionDef) and id(each) not in without]


def _is_protocol(node):
    return any(isinstance(base, ast.Name) and base.id == "Protocol" for base in node.bases)


@pytest.mark.parametrize("module", MODULES)
def test_sources_use_all_of_their_parameters(module):
    functions = functions_of(ast.parse(next((SOURCES / "engine").rglob(f"{module}.py")).read_text()))
    for function in functions:
        if isinstance(function.body[-1], ast.Raise) and len(function.body) == 1:
            continue  # it refuses
        arguments = function.args
        names = {each.arg for each in [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]}
        used = {each.id for part in function.body for each in ast.walk(part) if isinstance(each, ast.Name)}
        assert names - {"self", "cls"} <= used, function.name
    assert len(functions) > 5


def test_only_arguments_of_users_are_told_apart_by_type():
    found = set()
    for path in SOURCES.rglob("*.py"):
        for function in [each for each in ast.walk(ast.parse(path.read_text())) if isinstance(each, ast.FunctionDef)]:
            for call in ast.walk(function):
                if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "isinstance":
                    names = {each.id for each in ast.walk(call.args[1]) if isinstance(each, ast.Name)}
                    names |= {each.attr for each in ast.walk(call.args[1]) if isinstance(each, ast.Attribute)}
                    if names & KINDS and "trimesh" not in names:
                        found.add((path.relative_to(SOURCES).as_posix(), function.name))
    assert found == ARGUMENTS_OF_USERS


def calls_to_kernels(function):
    """The calls from a function to each kernel on this thread, or to the helper that runs it, as (module, name)."""
    chains = []

    def profile(frame, event, _):
        if event == "call" and frame.f_code.co_qualname in ("kernel.__call__", "kernel.of_words", "run"):
            chain = []
            while frame is not None:
                chain.append((frame.f_code.co_filename.rpartition("antumbra/")[2], frame.f_code.co_qualname))
                frame = frame.f_back
            chains.append(chain[::-1])

    sys.setprofile(profile)
    try:
        function()
    finally:
        sys.setprofile(None)
    return [chain[1 + [name for _, name in chain].index("calls_to_kernels") + 1 :] for chain in chains]


def test_a_query_of_rays_reaches_its_kernel_in_five_calls():
    scene = at.procedural("atrium", triangles=2000)
    ray = [0.0, 1.0, 0.0], [0.3, 0.2, 0.1]
    scene.occluded(*ray)
    (chain,) = calls_to_kernels(lambda: scene.occluded(*ray))
    assert [name for _, name in chain] == [
        "RayQueries.occluded",
        "Engine._any_hit",
        "RayLists.trace_rays",
        "RayTracer.trace",
        "kernel.of_words",
    ]


@pytest.mark.parametrize("plan, most", [("bsah+multifrusta", 12), ("bsah+wide", 12), ("auto", 13)])
def test_a_picture_reaches_the_kernel_of_its_shadow_rays_in_twelve_calls_and_one_that_chooses(plan, most):
    scene = at.procedural("atrium", triangles=2000)
    camera, lights = scene.cameras[0].resized(64, 64), scene.lights
    at.render(scene, camera, lights, spp=16, plan=plan)
    chains = calls_to_kernels(lambda: at.render(scene, camera, lights, spp=16, plan=plan))
    names = [[name for _, name in chain] for chain in chains]
    traced = [chain for chain in names if "Accelerator.answer_all" in chain and chain[-1] == "run"]
    assert 0 < min(map(len, traced)) <= most


COPIES = [np.eye(4), np.eye(4) + np.eye(4, k=3) * 3.0]
PLACE = 2.0, 0.0, 84000.0, 0.0, -2.0, 446000.0


def kinds(folder):
    """A scene of each kind."""
    random, atrium = np.random.default_rng(0), at.procedural("atrium", triangles=2000)
    return {
        "memory": atrium,
        "instances": at.Scene.from_instances([random.random((20, 3, 3))], [COPIES], instances=True),
        "store": at.load(built(folder, atrium).path),
        "terrain": at.from_raster((random.integers(0, 40, (9, 12)) / 4.0, PLACE)),
    }


def test_data_and_engines_say_what_they_offer(tmp_path):
    for kind, scene in kinds(tmp_path).items():
        data, source = scene.data, scene.engine.source
        assert data.resident == (kind != "store") and data.instanced == (kind == "instances")
        assert (data.terrain is not None) == (data.cell_tops() is not None) == (kind == "terrain")
        assert (scene.engine.terrain is not None) == scene.engine.prefers_rows == (kind == "terrain")
        assert (source.geometry is not None) == (source.fixed is None) == (kind in ("memory", "terrain"))
        assert (source.memory is not None) == (data.sampled_faces() is None) == (kind == "store")
        if kind == "store":
            with pytest.raises(
                at.InputError, match="a store cannot be used for this; use the file that it was built from"
            ):
                data.check_resident()
        else:
            data.check_resident()
            np.testing.assert_array_equal(data.every(3, 0.0), data.triangles().vertices[::3])


def test_contents_differ_where_scenes_do(tmp_path):
    scenes = kinds(tmp_path)
    contents = {kind: b"".join(map(bytes, scene.data.content(0.0))) for kind, scene in scenes.items()}
    assert len(set(contents.values())) == 4 and all(contents.values())
    for kind, scene in scenes.items():
        assert b"".join(map(bytes, scene.data.content(0.0, 1))) == contents[kind]
    moved = scenes["terrain"]
    moved.update(transform=np.diag([1.0, 1.0, 2.0, 1.0]))
    assert moved.data.terrain is None and not moved.engine.prefers_rows
    assert b"".join(map(bytes, moved.data.content(0.0))) != contents["terrain"]


def test_points_and_what_they_need_of_memory(tmp_path):
    scene = at.procedural("atrium", triangles=2000)
    paged = at.load(built(tmp_path, scene).path)
    lights = [at.PointLight((0.0, 3.0, 0.0)), at.AmbientOcclusion(3.0)]
    receivers = at.Receivers.in_space(np.zeros((7, 3)), scene.origin)
    points = PointQuery(receivers, lights, [light_samples(light, 16) for light in lights])
    assert points.rays == 7 * (1 + 16)  # the samples of a point light are equal
    memory = points_memory(points)
    assert memory.fixed == 2 * 104 * 7 and memory.passes == 0
    assert memory.cells == 4 * 7 * (1 + points.samples[1].shape[1])
    for each in scene, paged:
        triangles, tree = moment_of(each.engine.source, 0.0)
        assert (tree is None) == (each is scene)
        box = box_of(each.engine.source, triangles) + each.origin
        np.testing.assert_allclose(box, scene.bounds, atol=1e-5)
