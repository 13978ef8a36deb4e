"""Real files, if they exist: counts, and animation against the format's definitions.

This module implements the definitions independently, on arrays that `struct` and `json` read from the files.
"""

import base64
import json
import struct
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from antumbra.engine.scene_loading import load
from formats.gltf.test_gltf_nodes_animation import hermite, linear, step
from gltf_files import assert_at, moved, trs, world
from scenes import scene_folder, scene_path

WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
CODE = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}


def opened(path):
    """The JSON of a file, and a function that reads an accessor of it."""
    data = path.read_bytes()
    if data[:4] == b"glTF":
        size = struct.unpack_from("<I", data, 12)[0]
        document, buffers = json.loads(data[20 : 20 + size]), [data[28 + size :]]
    else:
        document = json.loads(data)
        buffers = [base64.b64decode(b["uri"].split(",")[1]) for b in document["buffers"]]

    def read(index):
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        width, dtype = WIDTH[accessor["type"]], np.dtype(CODE[accessor["componentType"]])
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        stride = view.get("byteStride", width * dtype.itemsize)
        rows = [
            np.frombuffer(buffers[view["buffer"]], dtype, width, start + i * stride) for i in range(accessor["count"])
        ]
        return np.array(rows)

    return document, read


def keyed(document, read, animation, t):
    """(node, path, value) of each channel at a time."""
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        path, node = channel["target"]["path"], document["nodes"][channel["target"]["node"]]
        times, values = read(sampler["input"])[:, 0].astype(float), read(sampler["output"]).astype(float)
        how = sampler.get("interpolation", "LINEAR")
        clamped = min(max(t, times[0]), times[-1])
        if path == "weights":
            values = values.reshape(len(times), -1)
        if how == "CUBICSPLINE":
            value = hermite(times, values.reshape(len(times), 3, -1), t)
            value = value / np.linalg.norm(value) if path == "rotation" else value
        elif how == "STEP":
            value = step(times, values, t)
        elif path == "rotation":
            value = Slerp(times, Rotation.from_quat(values))(clamped).as_quat()
        else:
            value = linear(times, values, clamped)
        yield node, path, value


def posed(document, read, t, animations):
    """World matrices of all nodes at a time, and animated weights by node index."""
    state = [dict(node) for node in document["nodes"]]
    number = {id(node): i for i, node in enumerate(document["nodes"])}
    weights = {}
    for animation in animations:
        for node, path, value in keyed(document, read, animation, t):
            state[number[id(node)]][path] = value
            if path == "weights":
                weights[number[id(node)]] = value

    def local(node):
        if "matrix" in node:
            return np.array(node["matrix"], float).reshape(4, 4).T
        return trs(
            *(node.get(k, d) for k, d in (("translation", (0, 0, 0)), ("rotation", (0, 0, 0, 1)), ("scale", (1, 1, 1))))
        )

    worlds = {}

    def visit(i, above):
        worlds[i] = above @ local(state[i])
        for child in state[i].get("children", []):
            visit(child, worlds[i])

    children = {c for node in state for c in node.get("children", [])}
    for i in range(len(state)):
        if i not in children:
            visit(i, np.eye(4))
    return worlds, weights


def expected(path, t):
    """(n, 3, 3): the triangles of a file in world space, by the definitions.

    Of competing animations, the first counts.
    """
    document, read = opened(path)
    animations = document.get("animations", [])
    animations = animations if path.stem == "InterpolationTest" else animations[:1]
    worlds, weights = posed(document, read, t, animations)
    triangles = []
    for i, node in enumerate(document["nodes"]):
        if "mesh" not in node:
            continue
        for primitive in document["meshes"][node["mesh"]]["primitives"]:
            names = primitive["attributes"]
            points = read(names["POSITION"]).astype(float)
            at = weights.get(i, document["meshes"][node["mesh"]].get("weights", []))
            for weight, target in zip(at, primitive.get("targets", [])):
                points = points + weight * read(target["POSITION"]).astype(float)
            if "skin" in node:
                points = skinned(document["skins"][node["skin"]], worlds, read, names, points)
            else:
                points = moved(worlds[i], points)
            corners = read(primitive["indices"])[:, 0] if "indices" in primitive else np.arange(len(points))
            triangles.append(points[corners.reshape(-1, 3)])
    return np.concatenate(triangles)


def skinned(skin, worlds, read, names, points):
    bind = read(skin["inverseBindMatrices"]).astype(float).reshape(-1, 4, 4).transpose(0, 2, 1)
    joints, weights = read(names["JOINTS_0"]), read(names["WEIGHTS_0"]).astype(float)
    matrices = np.array([worlds[j] @ b for j, b in zip(skin["joints"], bind)])
    each = np.einsum("vkij,vj->vki", matrices[joints], np.c_[points, np.ones(len(points))])[..., :3]
    return (each * (weights / weights.sum(axis=1, keepdims=True))[..., None]).sum(axis=1)


def quietly(path, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return load(path, **options)


ANIMATED = {
    "AnimatedMorphCube.glb": (12, 4.2),
    "BoxAnimated.glb": (254, 3.708),
    "CesiumMan.glb": (4672, 2.0),
    "CesiumMilkTruck.glb": (3624, 1.25),
    "Fox.glb": (576, 3.417),
    "InterpolationTest.glb": (110, 1.708),
    "RiggedSimple.glb": (188, 2.083),
    "SimpleMorph.gltf": (1, 4.0),
    "SimpleSkin.gltf": (8, 5.5),
    "robot.glb": (3238, 3.333),
}


@pytest.mark.parametrize("name", ANIMATED)
def test_animation_follows_the_definitions(name):
    path = scene_path(f"gltf/{name}")
    scene = quietly(path)
    count, duration = ANIMATED[name]
    assert scene.n_triangles == count and scene.duration == pytest.approx(duration, abs=1e-3)
    moves = []
    for share in (0.0, 0.13, 0.5, 0.77, 1.0):
        time = share * scene.duration
        assert_at(scene, expected(path, time), time)
        moves.append(world(scene, time))
    assert max(np.abs(m - moves[0]).max() for m in moves) > 0.01


def test_instances():
    path = scene_path("gltf/SimpleInstancing.glb")
    document, read = opened(path)
    names = document["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]
    points, corners = read(1).astype(float), read(0)[:, 0].reshape(-1, 3)
    each = [
        moved(trs(t, r, s), points)[corners]
        for t, r, s in zip(read(names["TRANSLATION"]), read(names["ROTATION"]), read(names["SCALE"]))
    ]
    scene = load(path)
    assert_at(scene, np.concatenate(each))
    assert scene.meshes[0].instances == 125


def test_cameras():
    path = scene_path("gltf/Cameras.gltf")
    camera, above = load(path).cameras
    assert (camera.projection, above.projection) == ("perspective", "orthographic")
    np.testing.assert_allclose(camera.position, [0.5, 0.5, 3])
    np.testing.assert_allclose(camera.target - camera.position, [0, 0, -1])
    assert camera.vfov == pytest.approx(np.degrees(0.7))


def scenes_with(file):
    folder = scene_folder()
    found = [] if folder is None else sorted(p.parent.name for p in folder.glob(f"*/{file}"))
    return found or [pytest.param("none", marks=pytest.mark.skip(reason="no real scenes: set ANTUMBRA_SCENES"))]


@pytest.mark.parametrize("name", scenes_with("scene.glb"))
def test_static_scenes(name):
    path = scene_path(f"{name}/scene.glb")
    info = SimpleNamespace(**json.loads((path.parent / "info.json").read_text()))
    scene = load(path, up="yz"[info.up[2]])
    assert scene.n_triangles == info.triangles and scene.notes == ()
    np.testing.assert_allclose(scene.bounds, info.bounds, atol=1e-4)
    triangles = scene.triangles()
    assert np.isfinite(triangles.vertices).all() and len(triangles.face_id) == info.triangles


@pytest.mark.parametrize("name", scenes_with("frames.npy"))
def test_frame_folders(name):
    path = scene_path(name)
    scene = load(path)
    frames, faces = np.load(path / "frames.npy"), np.load(path / "faces.npy")
    assert scene.n_triangles == len(faces) and scene.animated
    last = len(frames) - 1
    for share, points in [
        (0.0, frames[0]),
        (1.0, frames[-1]),
        (1.5 / last, (frames[1] + frames[2].astype(float)) / 2),
    ]:
        assert_at(scene, points.astype(float)[faces], share * scene.duration)


@pytest.mark.slow
def test_memory_of_a_large_scene():
    import tracemalloc

    path = scene_path("sanmiguel_lite/scene.glb")
    tracemalloc.start()
    try:
        scene = load(path)
        kept, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept <= 45 * scene.n_triangles, kept / scene.n_triangles
    assert peak <= 100 * scene.n_triangles, peak / scene.n_triangles
