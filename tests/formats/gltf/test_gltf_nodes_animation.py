"""Animation at a time: keyframes, skins and morph targets against an independent implementation of the format."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from antumbra.base.errors import InputError
from antumbra.engine.scene_loading import load
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, TRIANGLE, Gltf, assert_at, moved, trs, world
from strength import examples

TIMES = [0.5, 1.0, 3.0, 3.25]
PROBES = [0.0, 0.5, 0.6, 0.999, 1.0, 2.0, 2.9, 3.0, 3.1, 3.25]


def hermite(times, keys, t):
    """The spline of the glTF 2.0 specification, appendix C.5: (k, 3, c) in-tangent, value, out-tangent."""
    t = min(max(t, times[0]), times[-1])
    i = min(np.searchsorted(times, t, side="right") - 1, len(times) - 2)
    d = times[i + 1] - times[i]
    u = (t - times[i]) / d
    basis = [2 * u**3 - 3 * u**2 + 1, d * (u**3 - 2 * u**2 + u), -2 * u**3 + 3 * u**2, d * (u**3 - u**2)]
    points = [keys[i][1], keys[i][2], keys[i + 1][1], keys[i + 1][0]]
    return sum(b * np.asarray(p, float) for b, p in zip(basis, points))


def step(times, keys, t):
    return np.asarray(keys, float)[max(np.searchsorted(times, t, side="right") - 1, 0)]


def linear(times, keys, t):
    keys = np.asarray(keys, float)
    return np.array([np.interp(t, times, keys[:, c]) for c in range(keys.shape[1])])


def keys_for(path, interpolation, seed=5):
    """Float32 keys as float64; quaternions have unit length."""
    rng = np.random.default_rng(seed)
    width = {"rotation": 4, "weights": 2}.get(path, 3)
    shape = (len(TIMES), 3, width) if interpolation == "CUBICSPLINE" else (len(TIMES), width)
    keys = rng.normal(size=shape)
    if path == "rotation":
        values = keys[:, 1] if keys.ndim == 3 else keys
        values /= np.linalg.norm(values, axis=-1, keepdims=True)
    return keys.astype(np.float32).astype(np.float64)


def expected_value(path, interpolation, keys, t):
    if interpolation == "STEP":
        value = step(TIMES, keys, t)
    elif interpolation == "CUBICSPLINE":
        value = hermite(TIMES, keys, t)
    elif path == "rotation":
        value = Slerp(TIMES, Rotation.from_quat(keys))(min(max(t, TIMES[0]), TIMES[-1])).as_quat()
    else:
        value = linear(TIMES, keys, t)
    return value


@pytest.mark.parametrize("interpolation", ["STEP", "LINEAR", "CUBICSPLINE"])
@pytest.mark.parametrize("path", ["translation", "rotation", "scale"])
def test_keyframes(tmp_path, path, interpolation):
    keys = keys_for(path, interpolation)
    made = Gltf()
    rest = {"translation": [1, 2, 3], "rotation": [0, 0.6, 0, 0.8], "scale": [2, 1, 1]}
    node = made.node(mesh=made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES)), **rest)
    made.animate(node, path, TIMES, keys, interpolation)
    scene = load(made.write(tmp_path))
    assert scene.duration == 3.25 and scene.animated
    for t in PROBES:
        pose = {**rest, path: expected_value(path, interpolation, keys, t)}
        assert_at(scene, moved(trs(**pose), TETRAHEDRON[TETRAHEDRON_FACES]), t)


@given(st.integers(0, 2**32 - 1), st.floats(0.5, 3.25))
@examples(60)
def test_slerp_goes_the_short_way_round(tmp_path_factory, seed, t):
    keys = keys_for("rotation", "LINEAR", seed)
    if seed % 3 == 0:
        keys[1] = -keys[0]  # the same rotation, so nothing may move between the keys
    made = Gltf()
    made.animate(made.node(mesh=made.mesh()), "rotation", TIMES, keys)
    scene = load(made.write(tmp_path_factory.mktemp("slerp")))
    assert_at(scene, moved(trs(rotation=expected_value("rotation", "LINEAR", keys, t)), TRIANGLE)[None], t)


@pytest.mark.parametrize("interpolation", ["STEP", "LINEAR", "CUBICSPLINE"])
def test_morph_weights(tmp_path, interpolation):
    keys = keys_for("weights", interpolation)
    rng = np.random.default_rng(8)
    targets = rng.normal(size=(2, 4, 3)).astype(np.float32)
    made = Gltf()
    primitive = made.primitive(
        TETRAHEDRON, TETRAHEDRON_FACES, targets=[{"POSITION": made.accessor(t)} for t in targets]
    )
    node = made.node(mesh=made.mesh(primitive), translation=[0, 0, 5])
    made.animate(node, "weights", TIMES, keys, interpolation)
    scene = load(made.write(tmp_path))
    for t in PROBES:
        w = expected_value("weights", interpolation, keys, t)
        points = TETRAHEDRON + w[0] * targets[0].astype(float) + w[1] * targets[1].astype(float)
        assert_at(scene, points[TETRAHEDRON_FACES] + (0, 0, 5.0), t)


def test_morph_weights_at_rest_come_from_node_then_mesh(tmp_path):
    made = Gltf()
    target = {"POSITION": made.accessor(np.ones((3, 3), np.float32))}
    mesh = made.mesh(made.primitive(targets=[target, {}]), weights=[0.25, 9.0])
    made.node(mesh=mesh)
    made.node(mesh=mesh, weights=[2.0, 0.0])
    assert_at(load(made.write(tmp_path)), np.stack([TRIANGLE + 0.25, TRIANGLE + 2.0]))


def test_parents_carry_their_children(tmp_path):
    made = Gltf()
    child = made.node(root=False, mesh=made.mesh(), translation=[1, 0, 0])
    parent = made.node(children=[child])
    made.animate(parent, "rotation", [0, 2], [[0, 0, 0, 1], [0, 0, 1, 0]])  # half a turn about z
    made.animate(child, "scale", [0, 2], [[1, 1, 1], [3, 3, 3]])
    scene = load(made.write(tmp_path))
    quarter = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]
    assert_at(scene, moved(trs(rotation=quarter) @ trs((1, 0, 0), scale=(2, 2, 2)), TRIANGLE)[None], 1.0)


def test_time_is_clamped_and_frame_and_ids_stay(tmp_path):
    made = Gltf()
    made.animate(made.node(mesh=made.mesh()), "translation", [0, 2], [[0, 0, 0], [8, 0, 0]])
    scene = load(made.write(tmp_path))
    for wanted, shown in [(-5.0, 0.0), (99.0, 2.0), (np.inf, 2.0), (np.float32(1), 1.0)]:
        a, b = scene.triangles(wanted), scene.triangles(shown)
        np.testing.assert_array_equal(a.vertices, b.vertices)
        np.testing.assert_array_equal(a.origin, scene.triangles(0.0).origin)
        np.testing.assert_array_equal(a.face_id, b.face_id)
    for bad in (np.nan, "soon", None):
        with pytest.raises(InputError, match=r"time .*must be a number"):
            scene.triangles(bad)


def test_the_first_of_rival_animations_counts_and_the_rest_play_together(tmp_path):
    made = Gltf()
    a, b = made.node(mesh=made.mesh()), made.node(mesh=0)
    made.animate(a, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]], animation=0)
    made.animate(b, "translation", [0, 2], [[0, 0, 0], [0, 2, 0]], animation=1)
    made.animate(a, "translation", [0, 9], [[5, 5, 5], [6, 6, 6]], animation=2)
    made.json["animations"][2]["name"] = "rival"
    with pytest.warns(UserWarning, match="rival"):
        scene = load(made.write(tmp_path))
    assert scene.duration == 2.0
    assert_at(scene, TRIANGLE + np.array([[[1.0, 0, 0]], [[0, 2.0, 0]]]), 2.0)


def skin_file(seed=0, sets=1, inverse=True, joints=3):
    """(file, points, joints, weights, bind matrices) of a strip that is skinned to a chain of joints."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(12, 3)).astype(np.float32)
    index = rng.integers(0, joints, (12, 4 * sets)).astype(np.uint8)
    weight = rng.uniform(0.1, 1, (12, 4 * sets))
    weight = (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32)
    bind = rng.normal(size=(joints, 4, 4)).astype(np.float32)
    bind[:, 3] = 0, 0, 0, 1
    made = Gltf()
    chain = []
    for k in range(joints):
        chain.append(made.node(root=k == 0, translation=rng.normal(size=3).tolist()))
        if k:
            made.json["nodes"][chain[-2]]["children"] = [chain[-1]]
    attributes = {}
    for s in range(sets):
        part = slice(4 * s, 4 * s + 4)
        attributes[f"JOINTS_{s}"] = made.accessor(index[:, part])
        attributes[f"WEIGHTS_{s}"] = made.accessor(weight[:, part])
    skin = {"joints": chain}
    if inverse:
        skin["inverseBindMatrices"] = made.accessor(bind.transpose(0, 2, 1).reshape(joints, 16))
    mesh = made.mesh(made.primitive(points, attributes=attributes))
    # the transform of the skinned mesh's node has no effect
    made.node(mesh=mesh, skin=made.add("skins", **skin), translation=[100, 100, 100])
    made.animate(chain[1], "rotation", [0, 1], [[0, 0, 0, 1], [0.6, 0, 0, 0.8]])
    return made, points, index, weight, bind if inverse else np.tile(np.eye(4), (joints, 1, 1))


@pytest.mark.parametrize("sets, inverse", [(1, True), (2, True), (1, False)])
def test_skins(tmp_path, sets, inverse):
    made, points, index, weight, bind = skin_file(4, sets, inverse)
    scene = load(made.write(tmp_path))
    for t in (0.0, 0.4, 1.0):
        turn = Slerp([0, 1], Rotation.from_quat([[0, 0, 0, 1], [0.6, 0, 0, 0.8]]))(t).as_quat()
        globals_, matrix = [], np.eye(4)
        for k, node in enumerate(made.json["nodes"][: len(bind)]):
            matrix = matrix @ trs(node["translation"], turn if k == 1 else (0, 0, 0, 1))
            globals_.append(matrix)
        expected = np.zeros((12, 3))
        for v in range(12):
            for j, w in zip(index[v], weight[v].astype(float)):
                expected[v] += w / weight[v].sum(dtype=float) * moved(globals_[j] @ bind[j], points[v])
        assert_at(scene, expected.reshape(-1, 3, 3), t)


def test_skin_and_morph_together(tmp_path):
    made, *_ = skin_file(7)
    plain = load(made.write(tmp_path, "plain.glb"))
    primitive = made.json["meshes"][0]["primitives"][0]
    shift = np.tile(np.array([0.5, 0, -1], np.float32), (12, 1))
    primitive["targets"] = [{"POSITION": made.accessor(shift)}]
    made.json["meshes"][0]["weights"] = [0.0]
    np.testing.assert_array_equal(world(load(made.write(tmp_path)), 0.5), world(plain, 0.5))
    made.json["meshes"][0]["weights"] = [2.0]
    assert np.abs(world(load(made.write(tmp_path)), 0.5) - world(plain, 0.5)).max() > 0.1


def test_weights_count_by_their_share_of_the_sum(tmp_path):
    made = Gltf()
    attributes = {
        "JOINTS_0": made.accessor(np.array([[0, 1, 0, 0]] * 3, np.uint8)),
        "WEIGHTS_0": made.accessor(np.array([[0.3, 0.1, 0, 0]] * 3, np.float32)),
    }
    joints = [made.node(translation=[8, 0, 0]), made.node(translation=[0, 4, 0])]
    made.node(mesh=made.mesh(made.primitive(attributes=attributes)), skin=made.add("skins", joints=joints))
    share = 0.3 / 0.4
    assert_at(load(made.write(tmp_path)), TRIANGLE[None] + np.array([8 * share, 4 * (1 - share), 0]))


def test_vertices_without_weights_follow_their_first_joint(tmp_path):
    made = Gltf()
    attributes = {
        "JOINTS_0": made.accessor(np.array([[1, 0, 0, 0]] * 3, np.uint8)),
        "WEIGHTS_0": made.accessor(np.zeros((3, 4), np.float32)),
    }
    joints = [made.node(translation=[9, 0, 0]), made.node(translation=[0, 4, 0])]
    mesh = made.mesh(made.primitive(attributes=attributes))
    made.node(mesh=mesh, skin=made.add("skins", joints=joints))
    # joint numbers with zero weights have no meaning, so the vertices follow the first joint of the skin
    assert_at(load(made.write(tmp_path)), TRIANGLE[None] + (9.0, 0, 0))


def test_a_scale_that_is_animated_may_be_zero(tmp_path):
    made = Gltf()
    node = made.node(mesh=made.mesh(), scale=[0, 0, 0])
    made.animate(node, "scale", [0, 1], [[0, 0, 0], [1, 1, 1]])
    scene = load(made.write(tmp_path))
    np.testing.assert_array_equal(world(scene, 0.0), np.zeros((1, 3, 3)))
    assert_at(scene, 0.5 * TRIANGLE[None], 0.5)


def test_animation_to_infinity_is_an_error_when_it_is_reached(tmp_path):
    made = Gltf()
    inner = made.node(root=False, mesh=made.mesh())
    outer = made.node(children=[inner])
    for node in (inner, outer):
        made.animate(node, "scale", [0, 1], [[1, 1, 1], [3e38, 3e38, 3e38]])
    scene = load(made.write(tmp_path))
    assert scene.triangles(0.0).vertices.shape == (1, 3, 3)
    with pytest.raises(InputError, match=r"made.glb: meshes.*not finite"):
        scene.triangles(1.0)


# --- One clip of many -------------------------------------------------------------------------------------------------


def clips(names=("walk", None, "run")):
    made = Gltf()
    node = made.node(mesh=made.mesh())
    for k, name in enumerate(names):
        made.animate(node, "translation", [0.0, 1.0 + k], [[k, 0, 0], [k, 5, 0]], animation=k)
        if name is not None:
            made.json["animations"][k]["name"] = name
    return made


@pytest.mark.parametrize("chosen, k", [("walk", 0), ("1", 1), ("run", 2)])
def test_a_chosen_clip_plays_alone(tmp_path, chosen, k):
    scene = load(clips().write(tmp_path), animation=chosen)
    assert scene.duration == 1.0 + k and scene.notes == ()
    assert_at(scene, TRIANGLE[None] + np.float32([k, 0, 0]))


def test_without_a_choice_the_first_clip_wins_with_a_note(tmp_path):
    with pytest.warns(UserWarning, match="choose one with animation=NAME"):
        scene = load(clips().write(tmp_path))
    assert_at(scene, TRIANGLE[None])


def test_an_unknown_clip_is_refused(tmp_path):
    path = clips(("walk", "run")).write(tmp_path)
    with pytest.raises(InputError, match=r"animation 'runn' is unknown; did you mean 'run'\? use walk, run"):
        load(path, animation="runn")
    (tmp_path / "still").mkdir()
    made = Gltf()
    made.node(mesh=made.mesh())
    with pytest.raises(InputError, match="animation 'run' is unknown; the file has none"):
        load(made.write(tmp_path / "still"), animation="run")


def test_other_files_have_no_clips(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="animation chooses a clip of a glTF file"):
        load(tmp_path / "a.obj", animation="run")
