"""Textures, colours of vertices and smooth normals in pictures, against formulas in numpy."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.sources.in_memory_source import primary_visibility
from antumbra.picture.irradiance import irradiance, pixel_normals
from antumbra.picture.light_visibility import irradiance_shares
from antumbra.picture.pixel_appearance import albedo, eye_of, shading_normals, surface_points
from antumbra.query.light_samples import light_samples
from antumbra.query.shadow_query import new_bits, surface_queries, surfaces_of
from antumbra.scene.materials import CLAMP, MIRROR, REPEAT
from antumbra.trace.transmission import TracedQuery
from gltf_files import Gltf, png

CAMERA = at.Camera((0, 0, 4), (0, 0, 0), vfov=30, width=48, height=48)
QUAD = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float64)
SUN = at.DirectionalLight(direction=(0, 0, -1))
WRAPS = {REPEAT: 10497, CLAMP: 33071, MIRROR: 33648}


def linear(b):
    b = np.asarray(b, np.float64) / 255.0
    return np.where(b <= 0.04045, b / 12.92, ((b + 0.055) / 1.055) ** 2.4)


def seen_in(scene, camera=CAMERA):
    triangles = scene.triangles(0.0, 1)
    surfaces = surfaces_of(primary_visibility(triangles, camera, None, 1), triangles)
    return surfaces, surface_points(surfaces), eye_of(camera.rays(scene.origin), 1)


def colours_in(scene, camera=CAMERA):
    surfaces, places, eye = seen_in(scene, camera)
    shown = albedo(places, surfaces.triangles.colour, scene.appearance, eye, 1)
    return surfaces, shown


def quad(pixels, uv, wrap=REPEAT, mag=9729, tmp=None):
    made = Gltf()
    picture = made.add("images", bufferView=made.view(png(pixels)), mimeType="image/png")
    sampler = made.add("samplers", wrapS=WRAPS[wrap], wrapT=WRAPS[wrap], magFilter=mag)
    texture = made.add("textures", source=picture, sampler=sampler)
    look = made.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": texture}})
    attributes = {"TEXCOORD_0": made.accessor(uv.astype(np.float32))}
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.uint16)
    made.node(mesh=made.mesh(made.primitive(QUAD.astype(np.float32), faces, attributes=attributes, material=look)))
    return at.load(made.write(tmp))


def place(i, n, wrap):
    if wrap == CLAMP:
        return np.clip(i, 0, n - 1)
    period = i % (2 * n)
    return np.where(period < n, period, 2 * n - 1 - period) if wrap == MIRROR else i % n


@pytest.mark.parametrize("wrap", [REPEAT, CLAMP, MIRROR])
@pytest.mark.parametrize("nearest", [False, True])
def test_magnified_textures_are_interpolated_in_linear_light(tmp_path, wrap, nearest):
    pixels = np.random.default_rng(1).integers(0, 256, (3, 4, 3)).astype(np.uint8)
    uv = np.array([[-0.7, 1.8], [1.6, 1.8], [1.6, -0.6], [-0.7, -0.6]])  # row 0 of the picture is above
    scene = quad(pixels, uv, wrap, 9728 if nearest else 9729, tmp_path)
    surfaces, shown = colours_in(scene)
    on = surfaces.ids >= 0
    x, y = (surfaces.gbuffer.position[on] + surfaces.gbuffer.origin)[:, :2].astype(np.float64).T
    u, v = -0.7 + 2.3 * (x + 1) / 2, 1.8 - 2.4 * (y + 1) / 2
    across, down = u * 4, v * 3
    if nearest:
        i, j = np.floor(across).astype(int), np.floor(down).astype(int)
        expected = linear(pixels)[place(j, 3, wrap), place(i, 4, wrap)]
        sure = (np.abs(across - np.rint(across)) > 1e-3) & (np.abs(down - np.rint(down)) > 1e-3)
    else:
        across, down = across - 0.5, down - 0.5
        i, j = np.floor(across).astype(int), np.floor(down).astype(int)
        fx, fy = (across - i)[:, None], (down - j)[:, None]
        texel = lambda di, dj: linear(pixels)[place(j + dj, 3, wrap), place(i + di, 4, wrap)]
        expected = (1 - fy) * ((1 - fx) * texel(0, 0) + fx * texel(1, 0))
        expected += fy * ((1 - fx) * texel(0, 1) + fx * texel(1, 1))
        sure = np.ones(len(x), bool)
    assert sure.sum() > 400 and (~on).sum() > 100
    np.testing.assert_allclose(shown[on][sure], expected[sure], atol=1e-4)
    assert (shown[~on] == 0).all()


def test_minified_textures_are_means_and_do_not_sparkle():
    board = np.kron(np.indices((64, 64)).sum(0) % 2, np.ones((1, 1)))[..., None].repeat(3, -1)
    board = (255 * board).astype(np.uint8)
    uv = 4.0 * QUAD[:, :2]
    scene = at.Scene.from_arrays(QUAD, np.array([[0, 1, 2], [0, 2, 3]]), uv=uv, texture=board)
    for camera in (CAMERA, at.Camera((0, -3, 0.4), (0, 0, 0), up=(0, 0, 1), vfov=30, width=48, height=48)):
        surfaces, shown = colours_in(scene, camera)
        on = surfaces.ids >= 0
        assert on.sum() > 200
        np.testing.assert_allclose(shown[on], 0.5, atol=0.02)


def test_a_floor_at_a_grazing_angle_keeps_its_stripes_along_the_view():
    stripes = np.zeros((64, 64, 3), np.uint8)
    stripes[:, ::2] = 255
    uv = 0.25 * QUAD[:, :2]
    scene = at.Scene.from_arrays(QUAD, np.array([[0, 1, 2], [0, 2, 3]]), uv=uv, texture=stripes)
    camera = at.Camera((0, -3, 0.5), (0, 0, 0), up=(0, 0, 1), vfov=30, width=96, height=96)
    surfaces, shown = colours_in(scene, camera)
    middle = shown[48, surfaces.ids[48] >= 0, 0]
    assert middle.max() - middle.min() > 0.4  # a single level for the longer side would give 0.5 everywhere


def test_colours_of_vertices_are_interpolated():
    colours = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], float)
    scene = at.Scene.from_arrays(QUAD, np.array([[0, 1, 2], [0, 2, 3]]), vertex_colours=colours)
    surfaces, shown = colours_in(scene)
    on = surfaces.ids >= 0
    x, y = (surfaces.gbuffer.position[on] + surfaces.gbuffer.origin)[:, :2].T
    s, t = (x + 1) / 2, (y + 1) / 2
    lower = np.stack([1 - s, s - t, t], 1) @ colours[:3]
    upper = np.stack([1 - t, s, t - s], 1) @ colours[[0, 2, 3]]
    np.testing.assert_allclose(shown[on], np.where((t > s)[:, None], upper, lower), atol=1e-5)
    frame = at.render(scene, CAMERA, SUN, layers=True)
    np.testing.assert_array_equal(frame.layers.albedo, shown)


def ball(n=12, squash=1.0):
    """A sphere of 2 n x n patches with exact normals."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, 2 * n + 1), indexing="ij")
    points = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1).reshape(-1, 3)
    a = (np.arange(n)[:, None] * (2 * n + 1) + np.arange(2 * n)).ravel()
    b = a + 2 * n + 1
    faces = np.concatenate([np.stack([a, a + 1, b], 1), np.stack([a + 1, b + 1, b], 1)])
    area = np.linalg.norm(
        np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]), axis=1
    )
    return points * (1, squash, 1), faces[area > 1e-9], points / (1, squash, 1)


@pytest.mark.parametrize("squash", [1.0, 0.5])
def test_normals_are_interpolated(squash):
    points, faces, normals = ball(24, squash)
    scene = at.Scene.from_arrays(points, faces, normals=normals)
    surfaces, places, _ = seen_in(scene)
    found = shading_normals(places, scene.appearance, 1).normal
    on = surfaces.ids >= 0
    position = surfaces.gbuffer.position[on] + surfaces.gbuffer.origin
    expected = position / (1, squash**2, 1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    error = lambda n: np.degrees(np.arccos(np.clip((n[on] * expected).sum(1), -1, 1)))
    assert on.sum() > 300 and error(found).max() < 1.5 < error(surfaces.gbuffer.normal).max()
    np.testing.assert_array_equal(found[~on], 0.0)


def test_normals_move_with_an_animation(tmp_path):
    points, faces, normals = ball(24)
    made = Gltf()
    attributes = {"NORMAL": made.accessor(normals.astype(np.float32))}
    mesh = made.mesh(made.primitive(points.astype(np.float32), faces.astype(np.uint16), attributes=attributes))
    node = made.node(mesh=mesh, scale=[1.0, 0.5, 1.0])
    made.animate(made.node(children=[node]), "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, np.sqrt(0.5), np.sqrt(0.5)]])
    made.json["scenes"][0]["nodes"].remove(node)
    scene = at.load(made.write(tmp_path))
    for time, axes in ((0.0, (1.0, 0.25, 1.0)), (1.0, (0.25, 1.0, 1.0))):  # a quarter turn swaps x and y
        triangles = scene.triangles(time, 1)
        surfaces = surfaces_of(primary_visibility(triangles, CAMERA, None, 1), triangles)
        found = shading_normals(surface_points(surfaces), scene.appearance, 1).normal[surfaces.ids >= 0]
        expected = (surfaces.gbuffer.position[surfaces.ids >= 0] + surfaces.gbuffer.origin) / axes
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        assert len(found) > 200 and (found * expected).sum(1).min() > np.cos(np.radians(2.0))


def test_bits_and_visibility_do_not_depend_on_shading():
    points, faces, normals = ball()
    white = np.random.default_rng(3).integers(0, 256, (8, 8, 3)).astype(np.uint8)
    scene = at.Scene.from_arrays(points, faces, uv=points[:, :2], texture=white, normals=normals)
    lights = [at.SphereLight((3, 3, 3), 0.5, intensity=20), at.AmbientOcclusion(1.0)]
    dressed = at.render(scene, CAMERA, lights, adaptive=32)
    plain = at.render(scene, CAMERA, lights, adaptive=32, textures=False, smooth_normals=False)
    for name in ("bits", "visibility"):
        for a, b in zip(getattr(dressed, name), getattr(plain, name)):
            np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(dressed.gbuffer.normal, plain.gbuffer.normal)
    for other in (plain, at.render(scene, CAMERA, lights, adaptive=32, textures=False)):
        assert np.abs(dressed.image - other.image).max() > 0.01
    assert sum(int(b.any()) for b in dressed.bits) > 0


def test_the_terminator_is_smooth_and_nothing_leaks():
    points, faces, normals = ball(8)
    scene = at.Scene.from_arrays(points, faces, normals=normals)
    camera = at.Camera((0, 0, 4), (0, 0, 0), vfov=30, width=96, height=96)
    light = at.DirectionalLight(direction=(-1, -0.3, -0.2))
    surfaces, places, _ = seen_in(scene, camera)
    shading = shading_normals(places, scene.appearance, 1)
    (query,) = surface_queries(surfaces, [light], [light_samples(light, 16)])

    def lit(shading):
        found = irradiance(surfaces.gbuffer, query.light, light.domain, shading, threads=1)
        facing, unshadowed = pixel_normals(surfaces.gbuffer, shading), TracedQuery(query, new_bits(query))
        return found * irradiance_shares(facing, unshadowed, threads=1)

    flat, smooth = lit(None), lit(shading)
    assert (flat[smooth > 0] > 0).all() and (smooth > 0).sum() > 1000
    assert (smooth[surfaces.ids >= 0] == 0).any()
    inside = (surfaces.ids >= 0)[:, 1:] & (surfaces.ids >= 0)[:, :-1]
    steps = lambda e: np.abs(np.diff(e, axis=1))[inside].max()
    assert steps(smooth) < 0.1 < 0.15 < steps(flat)  # of 1; a light of a staircase would end in steps as of `flat`
    toward = -np.array([-1, -0.3, -0.2]) / np.linalg.norm([-1, -0.3, -0.2])
    high = (shading.normal @ toward) > 0.6
    np.testing.assert_allclose(smooth[high], (shading.normal @ toward)[high], atol=1e-5)


def test_a_textured_surface_is_no_edge():
    n = 9
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n))
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n], 1), np.stack([a + 1, a + n + 1, a + n], 1)])
    points = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    pixels = np.random.default_rng(4).integers(0, 256, (8, 8, 3)).astype(np.uint8)
    scene = at.Scene.from_arrays(points, faces, uv=0.5 * points[:, :2] + 0.5, texture=pixels)
    assert scene.colours.std(0).min() > 0.1
    near = at.Camera((0, 0, 1), (0, 0, 0), vfov=40, width=32, height=32)
    assert not at.render(scene, near, SUN, adaptive=16).refined.any()
    assert at.render(scene, near, SUN, adaptive=16, textures=False).refined.any()


def test_sub_pixels_show_textures_too():
    pixels = np.random.default_rng(5).integers(0, 256, (16, 16, 3)).astype(np.uint8)
    scene = at.Scene.from_arrays(QUAD, np.array([[0, 1, 2], [0, 2, 3]]), uv=0.5 * QUAD[:, :2] + 0.5, texture=pixels)
    once, refined = (at.render(scene, CAMERA, SUN, adaptive=n) for n in (None, 64))
    edge = refined.refined & (once.gbuffer.face >= 0)
    assert edge.any() and np.isfinite(refined.image).all()
    shown = refined.image[edge] / np.maximum(refined.coverage[edge], 0.05)[:, None]
    assert np.corrcoef(shown.ravel(), once.image[edge].ravel())[0, 1] > 0.9


def test_colours_of_faces_and_smooth_normals_go_together():
    colours = np.array([[0.9, 0.1, 0.2], [0.2, 0.8, 0.4]])
    tilted = np.tile([0.6, 0.0, 0.8], (4, 1))
    made = at.Scene.from_arrays(QUAD, np.array([[0, 1, 2], [0, 2, 3]]), colours, normals=tilted)
    flat = at.Scene.from_arrays(QUAD, np.array([[0, 1, 2], [0, 2, 3]]), colours)
    surfaces, shown = colours_in(made)
    seen = surfaces.ids >= 0
    assert seen.any() and (made.colours == flat.colours).all()
    np.testing.assert_array_equal(shown[seen], colours.astype(np.float32)[surfaces.ids[seen]])
    images = [at.render(scene, CAMERA, SUN).image[seen] for scene in (made, flat)]
    ratio = images[0][images[1] > 0.05] / images[1][images[1] > 0.05]
    np.testing.assert_allclose(ratio, 0.8, atol=0.01)  # the cosine of the tilted normal


@pytest.mark.parametrize(
    "given, words",
    [
        ({"uv": np.zeros((3, 2))}, r"uv must be numbers \(4, 2\)"),
        ({"normals": np.zeros((4, 2))}, r"normals must be numbers \(4, 3\)"),
        ({"uv": np.zeros((4, 2)), "texture": np.zeros((4, 4, 3))}, r"texture must be .* uint8, not float64"),
        ({"uv": np.zeros((4, 2)), "colours": np.ones(3)}, "exclude each other"),
    ],
)
def test_bad_looks_of_arrays_are_refused(given, words):
    with pytest.raises(at.InputError, match=words):
        at.Scene.from_arrays(QUAD, np.array([[0, 1, 2], [0, 2, 3]]), **given)
