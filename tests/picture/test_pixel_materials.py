"""Maps of glTF materials in pixels: metalness, roughness, occlusion, emission, and normals bent by normal maps."""

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.frame import FrameState, with_appearance
from antumbra.picture.frame_passes import evaluate, find_and_trace
from gltf_files import Gltf
from gltf_materials import DIRECT, QUARTER, SQUARE, SQUARE_FACES, SQUARE_UV, brdf, seen_points, square, texture

CAMERA = at.Camera((0, 0, 3), (0, 0, 0), vfov=40, width=32, height=32)
LAMP = at.PointLight((0.8, 0.5, 1.5), intensity=3.0)
FLAT = np.full((4, 4, 3), (128, 128, 255), np.uint8)


def slanted(x, y, z):
    """A normal map of one value."""
    return np.tile(np.rint(np.array([x, y, z]) * 127.5 + 127.5).astype(np.uint8), (4, 4, 1))


def materials_in(scene, camera=CAMERA):
    """The surfaces of a picture, with their materials."""
    renderer = at.Renderer(scene)
    state = FrameState(renderer.engine, renderer.request(camera, [LAMP], at.RenderOptions(spp=1)))
    evaluate(state)
    return with_appearance(state, find_and_trace(state)[0])


def bumped(folder, pixels, node=None, tangent=None, scale=1.0, **fields):
    made = Gltf()
    bump = texture(made, pixels) | {"scale": scale}
    return square(folder, made, node=node, tangent=tangent, normalTexture=bump, **fields)


def lit(scene, **options):
    return at.render(scene, CAMERA, [LAMP], **DIRECT | options)


# --- Normal maps ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fields", [{}, {"metallic": 1.0, "roughness": 0.4}], ids=["diffuse", "metal"])
@pytest.mark.parametrize("node", [None, QUARTER], ids=["straight", "turned"])
def test_a_flat_normal_map_changes_no_bit(tmp_path, node, fields):
    (tmp_path / "plain").mkdir()
    mapped = bumped(tmp_path, FLAT, node, **fields)
    plain = square(tmp_path / "plain", node=node, **fields)
    assert mapped.appearance.tangents is not None
    assert (lit(mapped).image == lit(plain).image).all()


@pytest.mark.parametrize("tangent", [None, (1, 0, 0, 1)], ids=["derived", "given"])
def test_normals_lean_right_and_up_in_the_texture(tmp_path, tangent):
    bump = np.array([0.3, 0.5, np.sqrt(1 - 0.34)])
    surfaces = materials_in(bumped(tmp_path, slanted(*bump), tangent=tangent))
    on = surfaces.ids >= 0
    assert on.sum() > 300
    np.testing.assert_allclose(surfaces.shading.normal[on], np.broadcast_to(bump, (on.sum(), 3)), atol=6e-3)
    assert (surfaces.gbuffer.normal[on] == (0, 0, 1)).all()  # visibility stays that of the geometric surface


def test_given_tangents_take_precedence(tmp_path):
    bump = np.array([0.3, 0.5, np.sqrt(1 - 0.34)])
    surfaces = materials_in(bumped(tmp_path, slanted(*bump), tangent=(0, 1, 0, -1)))
    on = surfaces.ids >= 0
    np.testing.assert_allclose(surfaces.shading.normal[on].mean(0), (bump[1], bump[0], bump[2]), atol=6e-3)


def test_normal_maps_turn_with_the_surface(tmp_path):
    bump = np.array([0.3, 0.5, np.sqrt(1 - 0.34)])
    surfaces = materials_in(bumped(tmp_path, slanted(*bump), QUARTER))
    on = surfaces.ids >= 0
    np.testing.assert_allclose(surfaces.shading.normal[on].mean(0), (-bump[1], bump[0], bump[2]), atol=6e-3)


def test_normal_maps_are_mirrored_with_the_surface(tmp_path):
    bump = np.array([0.3, 0.5, np.sqrt(1 - 0.34)])
    surfaces = materials_in(bumped(tmp_path, slanted(*bump), {"scale": [-1, 1, 1]}))
    on = surfaces.ids >= 0
    np.testing.assert_allclose(surfaces.shading.normal[on].mean(0), (-bump[0], bump[1], bump[2]), atol=6e-3)


def test_seen_from_behind_a_normal_is_turned_as_a_whole(tmp_path):
    bump = np.array([0.3, 0.5, np.sqrt(1 - 0.34)])
    behind = at.Camera((0, 0, -3), (0, 0, 0), vfov=40, width=32, height=32)
    surfaces = materials_in(bumped(tmp_path, slanted(*bump)), behind)
    on = surfaces.ids >= 0
    np.testing.assert_allclose(surfaces.shading.normal[on].mean(0), -bump, atol=6e-3)


def test_scale_stretches_x_and_y(tmp_path):
    bump = np.array([0.3, 0.5, np.sqrt(1 - 0.34)])
    surfaces = materials_in(bumped(tmp_path, slanted(*bump), scale=0.5))
    expected = bump * (0.5, 0.5, 1.0)
    on = surfaces.ids >= 0
    np.testing.assert_allclose(surfaces.shading.normal[on].mean(0), expected / np.linalg.norm(expected), atol=6e-3)


def test_normal_maps_change_no_bit_of_visibility(tmp_path):
    made = Gltf()
    made.node(mesh=made.mesh(made.primitive(0.4 * SQUARE + np.float32([0.2, 0.2, 0.5]), SQUARE_FACES)))
    scene = square(tmp_path, made, normalTexture=texture(made, slanted(0.6, 0.0, 0.8)))
    bumpy, flat = (lit(scene, materials=each) for each in ("pbr", "diffuse"))
    assert (bumpy.bits[0] == flat.bits[0]).all() and bumpy.bits[0].any()
    assert (bumpy.gbuffer.normal == flat.gbuffer.normal).all()
    assert (bumpy.image != flat.image).any()


# --- Metalness, roughness, occlusion and emission ---------------------------------------------------------------------


def test_blue_is_metalness_and_green_roughness(tmp_path):
    made = Gltf()
    pixels = np.full((2, 2, 3), (7, 102, 204), np.uint8)
    model = {"metallicRoughnessTexture": texture(made, pixels)}
    found = materials_in(square(tmp_path, made, metallic=0.5, roughness=1.0, model=model))
    on = found.ids >= 0
    np.testing.assert_allclose(found.materials.metallic[on], 0.5 * 204 / 255, rtol=1e-6)
    np.testing.assert_allclose(found.materials.roughness[on], 102 / 255, rtol=1e-6)
    assert (found.materials.lobe == on).all()


def test_data_are_averaged_as_numbers(tmp_path):
    """A checkerboard of 0 and 255 seen from afar is 0.5, not the mean of sRGB colours."""
    made = Gltf()
    pixels = np.where((np.indices((64, 64)).sum(0) % 2)[..., None], 255, 0).repeat(3, -1)
    scene = square(tmp_path, made, roughness=1.0, model={"metallicRoughnessTexture": texture(made, pixels)})
    far = at.Camera((0, 0, 40), (0, 0, 0), vfov=4, width=12, height=12)
    found = materials_in(scene, far)
    inner = found.materials.roughness[3:9, 3:9]
    np.testing.assert_allclose(inner, 0.5, atol=0.02)


def test_emission_is_added_with_its_strength_and_map(tmp_path):
    made = Gltf()
    pixels = np.full((2, 2, 3), (255, 188, 0), np.uint8)
    extensions = {"KHR_materials_emissive_strength": {"emissiveStrength": 4.0}}
    fields = {"emissiveFactor": [0.5, 1.0, 1.0], "emissiveTexture": texture(made, pixels), "extensions": extensions}
    scene = square(tmp_path, made, base=(0.2, 0.3, 0.4), **fields)
    with_light, without = (lit(scene, materials=each) for each in ("pbr", "diffuse"))
    linear = ((188 / 255 + 0.055) / 1.055) ** 2.4
    added = (with_light.image - without.image)[with_light.mask]
    np.testing.assert_allclose(added, np.broadcast_to([2.0, 4.0 * linear, 0.0], added.shape), rtol=1e-5, atol=1e-6)
    assert (with_light.image[~with_light.mask] == 0.0).all()


def test_occlusion_maps_dim_ambient_light_alone(tmp_path):
    made = Gltf()
    shade = texture(made, np.full((2, 2, 3), (51, 0, 0), np.uint8)) | {"strength": 0.5}
    scene = square(tmp_path, made, base=(0.5, 0.5, 0.5), occlusionTexture=shade)
    (tmp_path / "plain").mkdir()
    plain = square(tmp_path / "plain", base=(0.5, 0.5, 0.5), roughness=0.999999)
    images = {
        (each, ambient): lit(one, ambient=ambient).image[16, 16]
        for each, one in (("map", scene), ("plain", plain))
        for ambient in (True, False)
    }
    np.testing.assert_allclose(images["map", False], images["plain", False], rtol=1e-4)
    dimmed, full = (images[each, True] - images[each, False] for each in ("map", "plain"))
    np.testing.assert_allclose(dimmed, full * (1 - 0.5 * (1 - 51 / 255)), rtol=1e-3)


def test_a_map_has_a_transform_of_its_own(tmp_path):
    made = Gltf()
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0, 1] = 255
    base = texture(made, np.full((2, 2, 3), 255))
    moved = {"KHR_texture_transform": {"offset": [0.75, 0.25], "scale": [0.0, 0.0]}}
    fields = {"emissiveFactor": [1.0, 1.0, 1.0], "emissiveTexture": texture(made, pixels) | {"extensions": moved}}
    scene = square(tmp_path, made, base=(0, 0, 0), model={"baseColorTexture": base}, **fields)
    frame = lit(scene)
    np.testing.assert_allclose(frame.image[frame.mask], 1.0, rtol=1e-5)  # all of it is the white texel


@pytest.mark.parametrize("moved", [False, True], ids=["as they are", "transformed"])
def test_maps_may_have_the_second_texture_coordinates(tmp_path, moved):
    made = Gltf()
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0, 1] = 255
    info = texture(made, pixels) | {"texCoord": 1}
    second, shift = np.full((4, 2), (0.75, 0.25)), {"KHR_texture_transform": {"offset": [0.5, 0.0]}}
    if moved:
        second, info = second - (0.5, 0.0), info | {"extensions": shift}
    fields = {"emissiveFactor": [1.0, 1.0, 1.0], "emissiveTexture": info, "occlusionTexture": info}
    base = {"baseColorTexture": texture(made, np.full((2, 2, 3), 255))}
    scene = square(tmp_path, made, base=(0, 0, 0), model=base, second=second, **fields)
    assert not scene.notes
    frame = lit(scene, ambient=True)
    assert (frame.image[frame.mask] >= 1.0 - 1e-5).all()  # all of it is the white texel
    scene.update(transform=np.eye(4))
    np.testing.assert_array_equal(lit(scene, ambient=True).image, frame.image)


def test_maps_without_their_texture_coordinates_are_not_shown(tmp_path):
    made = Gltf()
    info = texture(made, np.full((2, 2, 3), 255)) | {"texCoord": 1}
    base = {"baseColorTexture": texture(made, np.full((2, 2, 3), 255))}
    fields = {"occlusionTexture": info, "emissiveFactor": [0.5, 0.5, 0.5]}
    scene = square(tmp_path, made, model=base, **fields)
    assert scene.appearance.second_uv is None and lit(scene, ambient=True).mask.any()


def test_unusable_maps_are_left_out_with_a_note(tmp_path):
    made = Gltf()
    broken = made.add("images", bufferView=made.view(b"not an image"), mimeType="image/png")
    own = texture(made, FLAT) | {"texCoord": 1}
    fields = {
        "occlusionTexture": {"index": made.add("textures", source=broken)},
        "normalTexture": own,
    }
    base = texture(made, np.full((2, 2, 3), 255))
    with pytest.warns(UserWarning, match="left out"):
        scene = square(tmp_path, made, model={"baseColorTexture": base}, **fields)
    notes = " ".join(scene.notes)
    assert "occlusionTexture cannot be used" in notes and "coordinates of its own, TEXCOORD_1" in notes
    assert lit(scene).mask.any()


def test_a_map_that_cannot_be_decoded_names_the_remedy(tmp_path):
    made = Gltf()
    shade = texture(made, np.random.default_rng(1).integers(0, 255, (32, 32, 3)))
    view = made.json["bufferViews"][made.json["images"][0]["bufferView"]]
    start = view["byteOffset"] + 60
    made.data[start : start + 200] = bytes(200)  # the header stays
    scene = square(tmp_path, made, occlusionTexture=shade)
    with pytest.raises(at.InputError, match=r'cannot be decoded .*materials="diffuse"'):
        lit(scene)
    assert lit(scene, materials="diffuse").mask.any()


def test_vertices_of_merged_primitives_keep_their_materials(tmp_path):
    """Small primitives are merged when they are read; their maps and tangents stay apart."""
    made = Gltf()
    parts = []
    for k, shift in enumerate((-1.0, 1.0)):
        fields = {"normalTexture": texture(made, slanted(0.6, 0.0, 0.8))} if k else {}
        model = {"metallicFactor": float(k), "roughnessFactor": 0.3}
        material = made.add("materials", pbrMetallicRoughness=model, **fields)
        attributes = {"TEXCOORD_0": made.accessor(SQUARE_UV)} if k else {}
        corners = SQUARE * np.float32(0.9) + np.float32([shift, 0, 0])
        parts.append(made.primitive(corners, SQUARE_FACES, attributes=attributes, material=material))
    made.node(mesh=made.mesh(*parts))
    scene = at.load(made.write(tmp_path))
    camera = at.Camera((0, 0, 6), (0, 0, 0), vfov=40, width=48, height=24)
    frame = at.render(scene, camera, [LAMP], **DIRECT)
    mask, points, view = seen_points(scene, camera, frame)
    right = points[:, 0] > 0.0
    way = LAMP.position - points
    r2 = (way**2).sum(1)[:, None]
    for half, metallic, normal in ((~right, 0.0, (0, 0, 1)), (right, 1.0, (0.6, 0, 0.8))):
        n = np.broadcast_to(np.array(normal, float), points[half].shape)
        l = way[half] / np.sqrt(r2[half])
        arriving = 3.0 * np.maximum((l * n).sum(1), 0.0)[:, None] / r2[half]
        reflected = arriving * brdf(n, view[half], l, (1, 1, 1), metallic, 0.3)
        np.testing.assert_allclose(frame.image[mask][half], reflected, rtol=0.05, atol=1e-3)
