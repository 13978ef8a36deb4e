"""Textures: coverage, charts, seams, and the values that viewers interpolate."""

import json

import numpy as np
import OpenEXR
import pytest
import trimesh

import antumbra as at
from antumbra.baking import baked_values, texture_atlas
from antumbra.baking.gltf_primitives import NodePrimitive, accessors_of, read_primitives
from antumbra.baking.surface_meter import Meter, MeterSettings
from antumbra.baking.texture_atlas import cover
from antumbra.formats.gltf.gltf_asset import open_asset
from antumbra.work.executors import LocalExecutor
from baked_files import Glb, box, grid, primitive, scene_file
from gltf_files import Gltf, png

pytest.importorskip("xatlas")


def part_of(mesh):
    """A part of a mesh from trimesh, with its smooth normals."""
    positions, normals = np.array(mesh.vertices), np.array(mesh.vertex_normals)
    rows = np.arange(len(positions))
    return NodePrimitive(
        0, 0, "part", {}, rows, len(rows), positions, normals, np.array(mesh.faces, np.int32), False, np.eye(3), 1.0
    )


def clipped_area(triangle, x, y):
    """The area of a triangle within the texel (x, y), by Sutherland and Hodgman's clipping."""
    polygon = [tuple(p) for p in triangle]
    for axis, limit, sign in ((0, x, 1), (0, x + 1, -1), (1, y, 1), (1, y + 1, -1)):
        out = []
        for a, b in zip(polygon, polygon[1:] + polygon[:1]):
            if sign * (a[axis] - limit) >= 0:
                out.append(a)
            if (sign * (a[axis] - limit) >= 0) != (sign * (b[axis] - limit) >= 0):
                t = (limit - a[axis]) / (b[axis] - a[axis])
                out.append(tuple(a[k] + t * (b[k] - a[k]) for k in (0, 1)))
        polygon = out
        if not polygon:
            return 0.0
    p = np.array(polygon)
    q = np.roll(p, -1, 0)
    return abs((p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]).sum()) / 2


@pytest.mark.parametrize("seed", range(6))
def test_every_texel_that_meets_a_face_has_its_nearest_point(seed):
    rng, size = np.random.default_rng(seed), 12
    corners = (
        rng.uniform(-1.0, size + 1.0, (3, 3, 2))
        if seed % 2
        else rng.uniform(2, 9, (3, 1, 2)) + rng.normal(0, 0.7, (3, 3, 2))
    )
    found = cover(corners, size)
    areas = np.array([[clipped_area(t, k % size, k // size) for k in range(size * size)] for t in corners])
    covered = np.isin(np.arange(size * size), found.texel)
    assert covered[areas.max(0) > 1e-9].all() and covered.any() and not covered.all()
    assert found.weights.min() >= 0.0
    np.testing.assert_allclose(found.weights.sum(1), 1.0, atol=1e-12)
    points = np.einsum("nk,nki->ni", found.weights, corners[found.face])
    centres = np.stack([found.texel % size, found.texel // size], 1) + 0.5
    a, b = rng.random((2, 4000))
    flip = a + b > 1
    a, b = np.where(flip, 1 - a, a), np.where(flip, 1 - b, b)
    dense = (
        corners[:, :1]
        + a[:, None] * (corners[:, 1:2] - corners[:, :1])
        + b[:, None] * (corners[:, 2:] - corners[:, :1])
    )
    near = np.linalg.norm(centres[:, None] - dense.reshape(1, -1, 2), axis=2).min(1)
    assert (np.linalg.norm(points - centres, axis=1) <= near + 1e-9).all()
    touched = (
        np.abs(points - centres).max(1) <= 0.5 + 1e-9
    )  # the sample itself may lie in the next texel: a corner does
    assert touched.mean() > 0.5


def test_one_large_face_covers_its_texels_in_batches():
    found = cover(np.array([[[0, 0], [2048, 0], [0, 2048]]], float), 2048)
    assert len(found.texel) == 2048 * 2049 // 2 + 2047 and found.overlap == 0.0


def test_bilinear_lookups_meet_no_background():
    """Each chart has a value of its own. Lookups anywhere on a chart give exactly this value, up to its edges."""
    (sheet,) = texture_atlas.atlas(
        [part_of(trimesh.creation.icosphere(3)), part_of(trimesh.creation.box((1, 2, 3)))], 128
    )
    own = texture_atlas.chart_of_faces(sheet.unwrapped)
    assert own.max() > 5
    image = baked_values.image_of(sheet.cover, own[sheet.cover.face].astype(np.float32)[:, None])
    assert np.isfinite(image).all()
    rng = np.random.default_rng(3)
    uv = np.concatenate([one.uv[one.faces] for one in sheet.unwrapped])
    weights = rng.dirichlet((0.3, 0.3, 0.3), (50, len(uv)))  # many near edges and corners
    for w in weights:
        points = np.einsum("nk,nki->ni", w, uv)
        np.testing.assert_array_equal(baked_values.sample_bilinear(image, points)[:, 0], own)


def test_both_sides_of_a_seam_agree(tmp_path):
    """A torus shades itself smoothly, and its charts have seams on smooth surfaces."""
    mesh = trimesh.creation.torus(1.0, 0.45, 48, 24)
    positions, normals = np.array(mesh.vertices, np.float32), np.array(mesh.vertex_normals, np.float32)
    path = scene_file(tmp_path, (positions, np.array(mesh.faces, np.uint32)), NORMAL=normals)
    report = at.bake(path, tmp_path / "out.glb", texture=128, spp=256, exr=True)
    image = exr(tmp_path / "out.exr")
    assert np.ptp(image) > 0.3 and report.hidden == 0
    assert report.seam is not None and report.seam * report.mean < 0.04


def exr(path):
    with OpenEXR.File(str(path)) as file:
        return file.channels()["Y"].pixels


def test_a_texture_of_a_wall_has_the_closed_form_everywhere(tmp_path):
    far = 1e4
    points = np.array([[0, 0, -far], [0, 0, far], [0, 2, far], [0, 2, -far]], np.float32)
    uv = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)
    floor = grid([0.2, 4.2], [-2.0, 2.0])
    path = scene_file(tmp_path, floor, TEXCOORD_0=uv)
    made = at.load(path).triangles()
    world = np.concatenate([made.vertices + made.origin, points[[[0, 2, 1], [0, 3, 2]]]])
    wall = at.Scene.from_arrays(world)  # the receivers' file has no wall, so that its UV set is whole
    at.bake(path, tmp_path / "open.glb", texture=64, uv=0, spp=64, exr=True)
    assert (exr(tmp_path / "open.exr") == 1.0).all()
    asset = open_asset(path)
    parts = read_primitives(at.load(path), asset, 0.0)
    (sheet,) = texture_atlas.uv_set_sheets(parts, accessors_of(asset, "x"), 0, 64)
    meter = Meter(wall, MeterSettings("ao", [at.AmbientOcclusion()], 1024, "hammersley", None, 0.0, None), 4096)
    texels = baked_values.Texels(sheet, meter, True)
    LocalExecutor().finish([texels.parts])
    values, hidden = texels.values(None)
    d = 0.2 + 4.0 * (sheet.cover.texel % 64 + 0.5) / 64
    error = values[:, 0] - 0.5 * (1.0 + d / np.hypot(d, 2.0))
    assert not hidden.any() and np.abs(error).max() < 2.5e-3 and np.sqrt((error**2).mean()) < 1e-3


@pytest.mark.parametrize("bits", [8, 16])
def test_png_and_exr_hold_the_same(tmp_path, bits):
    path = scene_file(tmp_path, grid([-1, 1], [-1, 1]), box((-0.5, 0.2, -0.5), (0.5, 1, 0.5)))
    at.bake(path, tmp_path / "out.glb", texture=64, bit_depth=bits, exr=True, spp=64)
    image, values = Glb(tmp_path / "out.glb").image(), exr(tmp_path / "out.exr")
    assert image.shape == values.shape == (64, 64) and image.dtype.itemsize == bits // 8
    np.testing.assert_array_equal(image, np.round(values.astype(float) * (2**bits - 1)))
    glb = Glb(tmp_path / "out.glb")
    used = [glb.json["materials"][glb.primitive(k)["material"]]["occlusionTexture"] for k in (0, 1)]
    assert used[0] == used[1] == {"index": 0, "texCoord": 0}
    uv = glb.attribute("TEXCOORD_0")
    assert uv.min() >= 0 and uv.max() <= 1


def test_texels_inside_solids_are_pushed_out(tmp_path):
    """The floor around a box is bright up to the box, and not darkened by the floor inside it."""
    uv = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)
    made_floor, made_box = grid([-2, 2], [-2, 2]), box((-0.77, -0.5, -0.77), (0.77, 0.05, 0.77))
    path = scene_file(tmp_path, made_floor, made_box)
    kept = at.bake(path, tmp_path / "kept.glb", texture=64, keep_hidden=True, exr=True, spp=64)
    moved = at.bake(path, tmp_path / "moved.glb", texture=64, exr=True, spp=64)
    before, after = exr(tmp_path / "kept.exr"), exr(tmp_path / "moved.exr")
    assert moved.hidden > 50 and kept.hidden == 0 and moved.receivers == kept.receivers
    assert (before == 0).sum() > 50 and (after == 0).sum() == 0 and len(uv) == 4
    bright = before > 0.0
    np.testing.assert_array_equal(before[bright], after[bright])


def test_denoising_comes_nearer_to_the_truth(tmp_path):
    path = scene_file(tmp_path, grid([-2, 2], [-2, 2]), box((-0.5, 0.4, -0.5), (0.5, 1.0, 0.5)))
    for name, options in {"few": {}, "smooth": {"denoise": True}, "truth": {"spp": 1024}}.items():
        at.bake(path, tmp_path / f"{name}.glb", texture=64, exr=True, **{"spp": 16, **options})
    few, smooth, truth = (exr(tmp_path / f"{n}.exr") for n in ("few", "smooth", "truth"))
    assert np.abs(smooth - truth).mean() < 0.5 * np.abs(few - truth).mean() > 0


def test_unlit_light_keeps_the_base_colour(tmp_path):
    """A sun from above on a floor with a texture: the unlit colour is the texture times the light."""
    made = Gltf()
    pixels = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8).repeat(2, 0).repeat(2, 1)
    made.add("images", bufferView=made.view(png(pixels)), mimeType="image/png")
    made.add("textures", source=0)
    uv = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)
    floor = primitive(made, *grid([0, 1], [0, 1]), TEXCOORD_0=uv)
    made.node(
        mesh=made.mesh(
            {**floor, "material": made.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": 0}})}
        )
    )
    sun = at.DirectionalLight((0, -1, 0), intensity=1.0)
    at.bake(made.write(tmp_path), tmp_path / "out.glb", "light", lights=sun, texture=64, uv=0, exposure=1.0, unlit=True)
    glb = Glb(tmp_path / "out.glb")
    image = glb.image()  # instead of the file's own
    for (y, x), colour in {(16, 16): (255, 0, 0), (16, 48): (0, 255, 0), (48, 16): (0, 0, 255)}.items():
        np.testing.assert_allclose(image[y, x], colour, atol=1)
    assert "KHR_materials_unlit" in json.dumps(glb.json["materials"])


def test_an_own_uv_set(tmp_path):
    uv = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)
    path = scene_file(tmp_path, grid([0, 1], [0, 1]), grid([0, 1], [2, 3]), TEXCOORD_0=uv)
    report = at.bake(path, tmp_path / "two.glb", texture=32, uv=0, spp=16, exr=True)  # both use all of it
    assert len(report.images) == 2 and len(Glb(tmp_path / "two.glb").json["images"]) == 2
    with pytest.raises(at.InputError, match="beyond 0 to 1"):
        at.bake(
            scene_file(tmp_path, grid([0, 1], [0, 1]), TEXCOORD_0=2 * uv - np.float32(0.5)),
            tmp_path / "a.glb",
            texture=32,
            uv=0,
        )
    fold = np.array([[0, 0], [0, 1], [1, 1], [0, 0.2]], np.float32)
    with pytest.raises(at.InputError, match="overlaps itself"):
        at.bake(scene_file(tmp_path, grid([0, 1], [0, 1]), TEXCOORD_0=fold), tmp_path / "a.glb", texture=32, uv=0)
    with pytest.raises(at.InputError, match="has no TEXCOORD_1"):
        at.bake(scene_file(tmp_path, grid([0, 1], [0, 1]), TEXCOORD_0=uv), tmp_path / "a.glb", texture=32, uv=1)
    assert not (tmp_path / "a.glb").exists()


def test_only_other_charts_stop_the_filter():
    """Texels at the edge of a chart beside the background are smoothed; those next to another chart are not."""
    (sheet,) = texture_atlas.atlas([part_of(trimesh.creation.icosphere(2))], 64)
    alone = baked_values._beside_others(sheet, 1)
    assert not alone.any() and texture_atlas.chart_of_faces(sheet.unwrapped).max() > 0
    assert baked_values._beside_others(sheet, texture_atlas.PADDING + 2).any()
