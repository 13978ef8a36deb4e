"""The page of a bake: its values at the corners of the faces of the scene, also of mirrored and instanced parts."""

import numpy as np
import pytest

import antumbra as at
from antumbra.baking.bake_input import bake_source, open_source
from antumbra.baking.baked_values import faces_of
from antumbra.base.errors import InputError
from antumbra.web import baked_page
from baked_files import Glb, box, primitive
from gltf_files import Gltf
from pages import box_on_floor


@pytest.fixture
def shown(monkeypatch):
    """What pages would show, instead of pages."""
    pages = []
    monkeypatch.setattr(baked_page, "make_page", lambda scene, path, **given: pages.append((scene, given["layer"])))
    return pages


def test_numbers_lie_at_the_corners_of_the_faces_they_were_measured_at(tmp_path, shown):
    at.bake(box_on_floor(), tmp_path / "a.glb", spp=16, attribute="_AO").page()
    ((scene, layer),) = shown
    corners = scene.triangles().vertices + scene.origin
    assert layer.corners.shape == corners.shape[:2] and np.ptp(layer.values) > 0
    baked = Glb(tmp_path / "a.glb")
    stored = set()
    for mesh in baked.json["meshes"]:
        for each in mesh["primitives"]:
            positions, values = (baked.array(each["attributes"][name]).tolist() for name in ("POSITION", "_AO"))
            stored |= set(zip(map(tuple, positions), np.ravel(values).tolist()))
    drawn = zip(map(tuple, corners.reshape(-1, 3).tolist()), layer.values[layer.corners].ravel().tolist())
    assert set(drawn) == stored


@pytest.mark.parametrize("what, column", [("light", None), ("bent-normal", 1)])
def test_light_is_shown_by_its_luminance_and_directions_by_their_height(tmp_path, shown, what, column):
    baked = at.bake(box_on_floor(), tmp_path / "a.glb", what, spp=16)
    baked.page()
    ((_, layer),) = shown
    rows = baked.vertices.values.astype(float)
    expected = rows @ [0.2126, 0.7152, 0.0722] if column is None else rows[:, column]
    assert np.array_equal(layer.values, expected) and np.ptp(expected) > 0


def test_mirrored_parts_have_the_corners_of_the_scene(tmp_path):
    made = Gltf()
    made.node(mesh=made.mesh(primitive(made, *box((0, 0, 0), (1, 2, 3)))), scale=[-1, 1, 1])
    made.write(tmp_path, "scene.glb")
    source = open_source(bake_source(tmp_path / "scene.glb"), 0.0, emits=False)
    triangles = source.scene.triangles()
    positions = np.concatenate([part.positions for part in source.parts])
    assert np.allclose(positions[faces_of(source.parts).faces], triangles.vertices + triangles.origin)
    assert (positions[:, 0] <= 0).all() and [part.sign for part in source.parts] == [-1.0]


def test_a_texture_has_no_page(tmp_path):
    pytest.importorskip("xatlas", reason="no xatlas: textures are NOT checked")
    baked = at.bake(box_on_floor(), tmp_path / "a.glb", spp=4, texture=64)
    with pytest.raises(InputError, match="a page shows values at vertices"):
        baked.page(tmp_path / "a.html")


def test_a_command_writes_the_page_of_a_bake(cli):
    cli("bake", "none.glb", "-o", "a.glb", "--page", "a.html", "--texture", "64").refused(
        "--page", "leave --texture out"
    )
    assert cli("bake", "procedural:atrium?triangles=1000", "-o", "a.glb", "--spp", "4", "--page", "a.html").code == 0
