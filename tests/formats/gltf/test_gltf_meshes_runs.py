"""Small primitives that are placed as one: nothing but the time to read them may differ."""

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.engine.scene_loading import load
from antumbra.formats.gltf import gltf_meshes
from antumbra.formats.gltf.gltf_meshes import MAX_RUN_VERTICES
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, Gltf, everything, png


def mixed(n=40, nodes=5, seed=0):
    """A mesh of primitives of all kinds, at several nodes; some have a skin, some copies."""
    rng, made = np.random.default_rng(seed), Gltf()
    image = made.add("images", bufferView=made.view(png(rng.integers(0, 255, (4, 4, 4)))), mimeType="image/png")
    texture = {"index": made.add("textures", source=image)}
    for i in range(4):
        colour = {"baseColorFactor": rng.random(4).tolist(), **({"baseColorTexture": texture} if i % 2 else {})}
        made.add("materials", name=f"m{i}", alphaMode=("OPAQUE", "MASK")[i // 3], pbrMetallicRoughness=colour)
    bones = {
        "JOINTS_0": made.accessor(np.tile(np.array([0, 1, 0, 0], np.uint8), (4, 1))),
        "WEIGHTS_0": made.accessor(np.tile(np.array([0.25, 0.75, 0, 0], np.float32), (4, 1))),
    }
    joint = made.node(translation=[0, 1, 0])
    bind = made.accessor(np.tile(np.eye(4, dtype=np.float32).reshape(1, 16), (2, 1)))
    skin = made.add("skins", joints=[joint, joint], inverseBindMatrices=bind)
    made.animate(joint, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 0.6, 0.8]])
    primitive = lambda own={}: _primitive(made, rng, own)
    plain = made.mesh(*(primitive() for _ in range(n)), name="plain")
    moving = made.mesh(*(primitive(bones if k % 3 else {}) for k in range(n)), name="moving")
    bent = lambda: {"POSITION": made.accessor((TETRAHEDRON * rng.random()).astype(np.float32))}
    morphed = made.mesh(*({**primitive(), "targets": [bent(), bent()]} for _ in range(n)), weights=[0.5, 0.25])
    for k in range(nodes):
        made.node(mesh=plain, translation=[3.0 * k, 0, 0], scale=[1, 2, -1])
        made.node(mesh=moving, skin=skin)
        made.node(mesh=morphed, translation=[0, 9.0 * k, 0])
    rows = made.accessor(np.array([[0, 0, 9], [2, 0, 9], [4, 0, 9]], np.float32))
    made.node(mesh=plain, extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": rows}}})
    return made


def _primitive(made, rng, own):
    attributes, v = dict(own), (TETRAHEDRON + rng.random((4, 3))).astype(np.float32)
    if rng.random() < 0.5:
        attributes["NORMAL"] = made.accessor(rng.normal(size=(4, 3)).astype(np.float32))
    if rng.random() < 0.5:
        attributes["TEXCOORD_0"] = made.accessor(rng.random((4, 2)).astype(np.float32))
    if rng.random() < 0.3:
        attributes["COLOR_0"] = made.accessor(rng.random((4, 4)).astype(np.float32))
    fields = {} if rng.random() < 0.2 else {"material": int(rng.integers(4))}
    if rng.random() < 0.3:
        return made.primitive(v, mode=int(rng.integers(5, 7)), attributes=attributes, **fields)
    return made.primitive(v, TETRAHEDRON_FACES[: rng.integers(1, 5)], attributes=attributes, **fields)


def told(path):
    """All that a file shows, at two moments."""
    scene = load(path)
    found = {"pieces": len(list(scene.source.pieces(0.0)))}
    found |= {"colours": scene.colours, "objects": scene.object_of_face, "bounds": scene.bounds, "meshes": scene.meshes}
    for time in 0.0, 0.75:
        found[f"triangles at {time}"] = scene.triangles(time).vertices
    look = scene.appearance
    for name in "uv", "colours", "normals", "bends", "textured":
        found[f"look {name}"] = getattr(look, name)
    found["materials"] = [look.materials[i].name if i >= 0 else "" for i in look.material_of_face]
    cut = scene.cutouts
    return found | ({} if cut is None else {f"cutouts {k}": v for k, v in enumerate(cut)})


@pytest.mark.parametrize("made", [mixed, everything], ids=["mixed", "everything"])
def test_runs_change_nothing(tmp_path, monkeypatch, made):
    path = made().write(tmp_path)
    joined = told(path)
    monkeypatch.setattr(gltf_meshes, "MAX_RUN_VERTICES", 0)
    apart = told(path)
    fewer = joined.pop("pieces") < apart.pop("pieces")
    assert joined.keys() == apart.keys() and len(joined["colours"]) > 10 and fewer == (made is mixed)
    for name in joined:
        np.testing.assert_equal(joined[name], apart[name], name)


def test_a_mesh_of_many_primitives_is_placed_at_once(tmp_path):
    """5,000 primitives at 500 nodes were 2,500,000 pieces."""
    made = Gltf()
    shown = made.mesh(*(made.primitive(made.accessor(TETRAHEDRON[:3] + np.float32(i))) for i in range(300)))
    for k in range(100):
        made.node(mesh=shown, translation=[0, 2.0 * k, 0])
    scene = load(made.write(tmp_path))
    pieces = list(scene.source.pieces(0.0))
    assert scene.n_triangles == 30_000 and len(pieces) == 100 and len(scene.objects) == 100
    assert len(list(scene.source.placed(0.0))) == 30_000  # bakes need each primitive
    assert (np.bincount(scene.object_of_face) == 300).all()


def test_large_primitives_stay_alone(tmp_path):
    made = Gltf()
    large = np.random.default_rng(1).random((3 * (MAX_RUN_VERTICES // 3), 3)).astype(np.float32)
    parts = [made.primitive(large), made.primitive(), made.primitive(), made.primitive(large), made.primitive()]
    made.node(mesh=made.mesh(*parts))
    pieces = list(load(made.write(tmp_path)).source.pieces(0.0))
    assert [piece.vertices.shape[1] for piece in pieces] == [len(large), 6, len(large), 3]
    assert pieces[1].where.endswith("primitives[1] to primitives[2]")


def test_a_vertex_at_infinity_is_named(tmp_path):
    made = Gltf()
    made.node(mesh=made.mesh(made.primitive(), made.primitive(), made.primitive(np.full((3, 3), np.inf, np.float32))))
    with pytest.raises(InputError, match=r"primitives\[2\]: vertex 0"):
        load(made.write(tmp_path))
