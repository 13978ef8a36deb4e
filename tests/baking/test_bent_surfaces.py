"""Finely tessellated smooth surfaces in an atlas: charts neither crash xatlas nor fold onto themselves."""

import numpy as np
import pytest
import trimesh

import antumbra as at
from antumbra.baking import texture_atlas
from antumbra.baking.bent_surfaces import directions_of_bent
from antumbra.baking.gltf_primitives import NodePrimitive
from baked_files import Glb

pytest.importorskip("xatlas")

QUARTER = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
FINE = {
    "sphere": lambda: trimesh.creation.icosphere(6),
    "pipe": lambda: trimesh.creation.cylinder(1.0, 2.0, sections=900),
    "ring": lambda: trimesh.creation.annulus(0.5, 1.0, 2.0, sections=900),
}


def part_of(mesh, turn):
    positions, rows = np.array(mesh.vertices) @ turn, np.arange(len(mesh.vertices))
    normals, faces = np.array(mesh.vertex_normals) @ turn, np.array(mesh.faces, np.int32)
    return NodePrimitive(0, 0, "part", {}, rows, len(rows), positions, normals, faces, False, np.eye(3), 1.0)


@pytest.mark.parametrize("turn", [np.eye(3), QUARTER], ids=["upright", "turned"])
@pytest.mark.parametrize("shape", FINE)
def test_each_texel_belongs_to_one_face_of_a_smooth_surface(shape, turn):
    part = part_of(FINE[shape](), turn)
    (sheet,) = texture_atlas.atlas([part], 256)
    assert sheet.cover.overlap < 2e-3 and len(sheet.cover.texel) > 256 * 256 // 3
    (one,) = sheet.unwrapped
    np.testing.assert_array_equal(one.source[one.faces], part.faces)


def test_a_sphere_of_81920_triangles_is_fully_lit(tmp_path):
    ball = FINE["sphere"]()
    made = at.bake(at.Scene.from_arrays(ball.vertices, ball.faces), tmp_path / "out.glb", texture=64, spp=16)
    assert (
        made.mean == 1.0 and made.hidden == 0 and made.notes == () and (Glb(tmp_path / "out.glb").image() == 255).all()
    )


def test_flat_faces_and_hard_edges_stay_together():
    box = trimesh.creation.box()
    assert not directions_of_bent(np.array(box.vertices), box.faces).any()
    coarse = trimesh.creation.icosphere(3)
    assert not directions_of_bent(np.array(coarse.vertices), coarse.faces).any()


def test_only_the_bent_part_of_a_mesh_is_split():
    pipe = FINE["pipe"]()
    direction = directions_of_bent(np.array(pipe.vertices), pipe.faces)
    caps = np.abs(pipe.face_normals[:, 2]) > 0.5
    assert not direction[caps].any() and set(direction[~caps]) == {1, 2, 3, 4}
