"""Pictures of glTF materials: mirrored skies, layers, refined edges, and the reference of diffuse surfaces."""

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.row_bands import band_array_names, bits_of_bands
from gltf_files import Gltf
from gltf_materials import DIRECT, SQUARE, SQUARE_FACES, ball, square, texture

CAMERA = at.Camera((0.0, -2.0, 2.0), (0, 0, 0), up=(0, 0, 1), vfov=40, width=32, height=24)
LAMP = at.PointLight((0.3, 0.5, 1.5), intensity=3.0)
COLUMNS = np.linspace(0.2, 1.0, 32)[None, :, None] * np.ones((16, 1, 3))
"""A sky whose radiance depends on the azimuth."""


def room_of_balls(folder):
    """A matt, a rough and a smooth ball over a floor."""
    made, (points, uv, faces) = Gltf(), ball(16)
    attributes = {"NORMAL": made.accessor(points), "TEXCOORD_0": made.accessor(uv)}
    models = ((0.0, 1.0), (0.0, 0.5), (1.0, 0.1), (1.0, 0.6))
    for k, (metal, rough) in enumerate(models):
        model = {"metallicFactor": metal, "roughnessFactor": rough, "baseColorFactor": [0.8, 0.6, 0.3, 1]}
        fields = {"emissiveFactor": [0.1, 0.0, 0.2]} if k == 1 else {}
        material = made.add("materials", pbrMetallicRoughness=model, **fields)
        mesh = made.mesh(made.primitive(points, faces, attributes=attributes, material=material))
        made.node(mesh=mesh, translation=[2.2 * k, 1.0, 0.0])
    floor = made.add("materials", pbrMetallicRoughness={"metallicFactor": 0})
    corners = (10 * SQUARE)[:, [0, 2, 1]] * np.float32([1, 1, -1])
    made.node(mesh=made.mesh(made.primitive(corners, SQUARE_FACES, material=floor)))
    scene = at.load(made.write(folder), up="y")
    return scene, at.Camera((3.3, 4.0, 9.0), (3.3, 0.8, 0.0), vfov=45, width=64, height=40)


LIGHTS = [at.DirectionalLight((-0.5, -1.0, -0.4), 1.5, intensity=3.0), at.Sky(intensity=0.8)]


def test_a_smooth_metal_mirrors_the_sky(tmp_path):
    scene, sky = square(tmp_path, metallic=1.0, roughness=0.0), at.Sky(COLUMNS, up="z")
    frame = at.render(scene, CAMERA, [sky], **DIRECT)
    points = frame.gbuffer.position[frame.mask] + frame.gbuffer.origin
    mirrored = (points - CAMERA.position) * (1, 1, -1)
    np.testing.assert_allclose(frame.image[frame.mask], sky.radiance(mirrored), rtol=0.02)


@pytest.mark.parametrize("roughness", [0.1, 0.4, 0.8])
def test_under_a_uniform_sky_no_surface_reflects_more_than_arrives(tmp_path, roughness):
    for metallic in (0.0, 1.0):
        scene = square(tmp_path, metallic=metallic, roughness=roughness)
        image = at.render(scene, CAMERA, [at.Sky((1.0, 1.0, 1.0))], **DIRECT).image
        shown = image[image.any(-1)]
        assert len(shown) and shown.max() <= 1.06  # the sky is a list of lights
        assert shown.min() > (0.85 if roughness < 0.5 else 0.5)


def test_a_wall_hides_the_mirrored_sky(tmp_path):
    made = Gltf()
    wall = (SQUARE[:, [0, 2, 1]] * np.float32([4, 1, 4]) + np.float32([0, 1.2, 2])).astype(np.float32)
    made.node(mesh=made.mesh(made.primitive(wall, SQUARE_FACES)))
    scene = square(tmp_path, made, metallic=1.0, roughness=0.0)
    frame = at.render(scene, CAMERA, [at.Sky((1.0, 1.0, 1.0))], **DIRECT)
    normals, points = frame.gbuffer.normal, frame.gbuffer.position + frame.gbuffer.origin
    floor = frame.mask & (np.abs(normals[..., 2]) > 0.9)
    mirrored = (points - CAMERA.position) * (1, 1, -1)
    height = points[..., 2] + mirrored[..., 2] / mirrored[..., 1] * (1.2 - points[..., 1])
    hidden = floor & (height < 5.9)
    assert hidden.sum() > 50
    assert (frame.image[hidden] == 0.0).all()


@pytest.mark.parametrize("plan", ["bsah+single", "bsah+multifrusta", "lbvh+packet16", "auto"])
def test_every_plan_mirrors_the_same_sky(tmp_path, plan):
    scene, camera = room_of_balls(tmp_path)
    expected = at.render(scene, camera, LIGHTS, plan="bsah+single", spp=4)
    assert (at.render(scene, camera, LIGHTS, plan=plan, spp=4).image == expected.image).all()


def test_threads_do_not_change_a_bit(tmp_path):
    scene, camera = room_of_balls(tmp_path)
    images = [at.render(scene, camera, LIGHTS, spp=4, threads=n).image for n in (1, 2)]
    assert (images[0] == images[1]).all()


def test_layers_ambient_and_emitted_light_add_up(tmp_path):
    scene, camera = room_of_balls(tmp_path)
    options = {"spp": 4, "antialias": False, "background": False, "ambient": False, "layers": True}
    frame = at.render(scene, camera, LIGHTS, **options)
    total = sum(frame.layers.images)
    blue = frame.mask & (frame.layers.object == 1)
    assert blue.any()
    total[blue] += np.float32([0.1, 0.0, 0.2])
    np.testing.assert_allclose(total, frame.image, rtol=1e-4, atol=1e-5)


def test_diffuse_pixels_beside_lobes_keep_their_bits(tmp_path):
    scene, camera = room_of_balls(tmp_path)
    options = {"spp": 4, "antialias": False}
    shown, diffuse = (at.render(scene, camera, LIGHTS, materials=each, **options) for each in ("pbr", "diffuse"))
    matt = shown.mask & np.isin(scene.object_of_face[np.maximum(shown.gbuffer.face, 0)], [0, 4])
    assert matt.sum() > 300 and (shown.mask & ~matt).sum() > 200
    assert (shown.image[matt] == diffuse.image[matt]).all()
    assert (shown.image != diffuse.image).any()
    assert all((a == b).all() for a, b in zip(shown.bits, diffuse.bits))


def test_refined_edges_are_means_of_finer_pictures(tmp_path):
    scene, camera = room_of_balls(tmp_path)
    fine = at.render(scene, camera, LIGHTS, spp=16, adaptive=64, background=False)
    large = at.render(scene, camera.resized(256, 160), LIGHTS, spp=16, antialias=False, background=False)
    means = large.image.reshape(40, 4, 64, 4, 3).mean((1, 3))
    balls = np.isin(scene.object_of_face[np.maximum(fine.gbuffer.face, 0)], [0, 1, 3])  # without narrow highlights
    edges = fine.refined & fine.mask & balls
    assert edges.sum() > 50
    np.testing.assert_allclose(fine.image[edges].mean(0), means[edges].mean(0), rtol=0.03)


def test_bounced_light_is_that_of_diffuse_surfaces(tmp_path):
    scene, camera = room_of_balls(tmp_path)
    frames = [at.render(scene, camera, LIGHTS, spp=4, bounce=4, materials=each) for each in ("pbr", "diffuse")]
    assert (frames[0].indirect == frames[1].indirect).all()


def test_bands_of_rows_make_the_same_picture(tmp_path):
    scene, camera = room_of_balls(tmp_path)
    renderer, options = at.Renderer(scene, "bsah+single"), at.RenderOptions(spp=4)
    request = renderer.request(camera, LIGHTS, options)
    bands = [renderer.rows(request).band(first, first + 20) for first in (0, 20)]
    traced = bits_of_bands({name: np.concatenate([b[name] for b in bands]) for name in band_array_names(request)})
    whole = at.Renderer(scene, "bsah+single").render(camera, LIGHTS, options=options)
    assert (renderer.from_rows(request, traced).image == whole.image).all()


def test_undecoded_maps_cost_diffuse_pictures_nothing(tmp_path):
    made = Gltf()
    scene = square(tmp_path, made, roughness=0.5, occlusionTexture=texture(made, np.full((2, 2, 3), 99)))
    at.render(scene, CAMERA, [LAMP], materials="diffuse")
    (occlusion,) = scene.appearance.pbr[0].maps
    assert "pixels" not in vars(occlusion.texture)
    at.render(scene, CAMERA, [LAMP])
    assert "pixels" in vars(occlusion.texture)
