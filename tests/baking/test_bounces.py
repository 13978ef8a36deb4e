"""Bounced light in bakes, against closed forms: the furnace, two parallel plates, the integrating sphere."""

import numpy as np
import pytest

import antumbra as at
from antumbra.baking.bounces import _entries
from baked_files import Glb, box, grid, primitive
from gltf_files import Gltf, png

FAR_LAMP = at.PointLight((0.0, 0.0, 500.0), intensity=0.0)
TURNS = [np.eye(3), np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])]
"""As it is, and turned by a quarter around +Y."""


def emissive_file(folder, *parts, turn=TURNS[0]):
    """A file with one node for each part, (corners (f, 3, 3), albedo, exitance); it has flat normals."""
    made = Gltf()
    for corners, albedo, exitance in parts:
        points = np.asarray(corners @ turn.T, np.float32)
        normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
        normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).repeat(3, 0).astype(np.float32)
        look = made.add(
            "materials",
            pbrMetallicRoughness={"baseColorFactor": [*np.broadcast_to(albedo, 3).tolist(), 1.0]},
            emissiveFactor=[min(exitance, 1.0)] * 3,
            extensions={"KHR_materials_emissive_strength": {"emissiveStrength": max(exitance, 1.0) / np.pi}},
        )
        faces = np.arange(3 * len(points), dtype=np.uint32)
        made.node(mesh=made.mesh({**primitive(made, points.reshape(-1, 3), faces, NORMAL=normals), "material": look}))
    made.json["extensionsUsed"] = ["KHR_materials_emissive_strength"]
    return made.write(folder)


def light_at_vertices(path, out, node=0, **options):
    """(v, 3): the light at the vertices of a node's part."""
    at.bake(path, out, "light", lights=options.pop("lights", FAR_LAMP), attribute="_LIGHT", keep_hidden=True, **options)
    return Glb(out).attribute("_LIGHT", node)


@pytest.mark.parametrize("turn", TURNS, ids=["as it is", "quarter turn"])
def test_each_bounce_in_a_furnace_is_a_term_of_its_series(tmp_path, turn):
    """A closed room with albedo r whose walls emit M: the irradiance is M (1 + r + r^2 + ...), everywhere."""
    openexr = pytest.importorskip("OpenEXR")
    pytest.importorskip("xatlas")
    points, faces = box((0, 0, 0), (4, 2.5, 3))
    albedo, exitance = np.array([0.25, 0.5, 0.75]), 2.0
    path = emissive_file(tmp_path, (points[faces[:, ::-1]].astype(float), albedo, exitance), turn=turn)
    for bounces in (1, 2, 5):
        report = at.bake(
            path, tmp_path / "out.glb", "light", lights=FAR_LAMP, bounces=bounces, texture=32, spp=16, exr=True
        )
        with openexr.File(str(report.images[0])) as file:
            image = file.channels()["RGB"].pixels
        series = exitance * sum(albedo**k for k in range(bounces + 1))
        np.testing.assert_allclose(image, np.broadcast_to(series, image.shape), rtol=1e-6)
        assert report.hidden == 0 and report.rays == report.receivers * (1 + 16 * (2 * bounces + 1))


def plate(y, facing):
    """A square of side 2 at height y, (f, 3, 3); facing: 1 up, -1 down."""
    points, faces = grid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5), y)
    return points[faces[:, ::facing]].astype(float)


def form_factor_of_squares(ratio):
    """The form factor between two equal, parallel squares; ratio: side over distance."""
    s = np.sqrt(1.0 + ratio**2)
    logarithm = np.log((1.0 + ratio**2) ** 2 / (1.0 + 2.0 * ratio**2)) / 2.0
    return 2.0 / (np.pi * ratio**2) * (logarithm + 2.0 * ratio * (s * np.arctan(ratio / s) - np.arctan(ratio)))


@pytest.mark.parametrize("turn", TURNS, ids=["as it is", "quarter turn"])
def test_light_between_two_parallel_plates_follows_their_form_factors(tmp_path, turn):
    """Two squares of side 2 at distance 1, of which the lower one emits M; Gauss' quadrature gives each term."""
    albedo, exitance = 0.6, 3.0
    nodes, weights = np.polynomial.legendre.leggauss(32)
    x, z = (each.ravel() for each in np.meshgrid(nodes, nodes))
    weight = np.outer(weights, weights).ravel()
    factors = lambda u, v: weight / (np.pi * ((u[:, None] - x) ** 2 + (v[:, None] - z) ** 2 + 1.0) ** 2)
    between = factors(x, z)
    emitted = exitance * between.sum(1)  # on the upper square
    assert weight @ emitted / 4.0 == pytest.approx(exitance * form_factor_of_squares(2.0), rel=1e-9)
    path = emissive_file(tmp_path, (plate(0.0, 1), albedo, exitance), (plate(1.0, -1), albedo, 0.0), turn=turn)

    def inside(node, bounces):
        """The mean over the vertices inside a plate and over two samplers, and the vertices' form factors."""
        out, options = tmp_path / "out.glb", {"bounces": bounces, "spp": 256}
        values = [light_at_vertices(path, out, node, sampler=name, **options) for name in ("hammersley", "halton:0")]
        places = Glb(out).attribute("POSITION", node).astype(float)
        rows = np.abs(places[:, [0, 2]]).max(1) < 0.99
        return np.mean(values, 0)[rows].mean(), factors(places[rows, 0], places[rows, 2])

    direct, to_upper = inside(1, 1)
    assert direct == pytest.approx(exitance * to_upper.sum(1).mean(), rel=5e-3)
    once, to_lower = inside(0, 1)
    assert once == pytest.approx(albedo * (to_lower @ emitted).mean(), rel=1e-2)
    twice = inside(1, 2)[0] - direct
    assert twice == pytest.approx(albedo**2 * (to_upper @ (between @ emitted)).mean(), rel=5e-2)  # 8 % of the paths


def test_the_mean_over_seeds_converges_at_each_bounce(tmp_path):
    """Inside two facing squares, with 16 paths each: each term of the series, by Gauss' quadrature."""
    albedo, exitance, seeds = 0.6, 3.0, 48
    nodes, weights = np.polynomial.legendre.leggauss(24)
    x, z = (each.ravel() for each in np.meshgrid(nodes, nodes))
    weight = np.outer(weights, weights).ravel()
    factors = lambda u, v: weight / (np.pi * ((u[:, None] - x) ** 2 + (v[:, None] - z) ** 2 + 1.0) ** 2)
    path = emissive_file(tmp_path, (plate(0.0, 1), albedo, exitance), (plate(1.0, -1), albedo, 0.0))
    found = []
    for seed in range(1, seeds + 1):
        lower = light_at_vertices(path, tmp_path / "out.glb", 0, bounces=2, spp=16, seed=seed)
        made = Glb(tmp_path / "out.glb")
        places = [made.attribute("POSITION", node)[:, [0, 2]].astype(float) for node in (0, 1)]
        inner = [np.abs(place).max(1) < 0.99 for place in places]
        found.append([lower[inner[0]].mean(), made.attribute("_LIGHT", 1)[inner[1]].mean()])
    once, twice = np.array(found, float).T / exitance
    from_lower = factors(x, z).sum(1)  # the share of the lower square's exitance that arrives on the upper one
    to_lower, to_upper = (factors(*place[rows].T) for place, rows in zip(places, inner))
    terms = [
        (once, (to_lower @ (albedo * from_lower)).mean()),
        (twice - to_upper.sum(1).mean(), (to_upper @ (albedo**2 * (factors(x, z) @ from_lower))).mean()),
    ]
    for values, truth in terms:
        print(f"{values.mean():.5f}, exactly {truth:.5f}, error of the mean {values.std() / np.sqrt(seeds):.5f}")
        assert abs(values.mean() - truth) < 4 * values.std() / np.sqrt(seeds) < 0.3 * truth


def test_an_integrating_sphere_spreads_the_light_of_a_lamp_evenly(tmp_path):
    """In a sphere of radius R with a lamp I anywhere inside, each bounce k adds r^k I / R^2, on average exactly."""
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.icosphere(4, 2.0)
    albedo, lamp = 0.5, at.PointLight((0.3, 0.6, -0.2), intensity=8.0)
    path = emissive_file(tmp_path, (np.array(mesh.triangles)[:, ::-1], albedo, 0.0))
    area = mesh.area / (16.0 * np.pi)  # of the facets, over that of the sphere
    before = light_at_vertices(path, tmp_path / "out.glb", lights=lamp, spp=16)
    for bounces in (1, 2):
        after = light_at_vertices(path, tmp_path / "out.glb", lights=lamp, bounces=bounces, spp=16)
        assert (after - before).mean() == pytest.approx(albedo**bounces * 8.0 / 4.0 / area, rel=5e-3)
        before = after


def test_walls_bleed_the_mean_colour_of_their_texture(tmp_path):
    """A floor beside a wall with a checkered texture: the bounced light has the colour of its mean texel."""
    made = Gltf()
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0, 0], pixels[1, 1] = (255, 0, 0), (255, 255, 0)
    made.add("images", bufferView=made.view(png(pixels)), mimeType="image/png")
    made.add("textures", source=0)
    look = made.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    wall = np.array([[0, 0, -9], [0, 0, 9], [0, 9, -9], [0, 9, 9]], np.float32)
    uv = np.array([[0, 0], [8, 0], [0, 4], [8, 4]], np.float32)
    faces = np.array([[0, 2, 1], [1, 2, 3]], np.uint32)
    made.node(mesh=made.mesh({**primitive(made, wall, faces, TEXCOORD_0=uv), "material": look}))
    made.node(mesh=made.mesh(primitive(made, *grid([1.0, 2.0], [-0.5, 0.5]))))
    sun = at.DirectionalLight((-1.0, -1e-3, 0.0), intensity=1.0)
    path = made.write(tmp_path)
    light = [light_at_vertices(path, tmp_path / "out.glb", 1, lights=sun, bounces=b, spp=256) for b in (0, 1)]
    red, green, blue = (light[1] - light[0]).mean(0)
    assert red > 0.05 and green == pytest.approx(red / 2.0, rel=1e-5) and blue == 0.0


@pytest.mark.parametrize("options", [{"plan": "bsah+single"}, {"plan": "lbvh+multifrusta"}, {"threads": 1}])
def test_every_plan_and_number_of_threads_bakes_the_same_bounces(tmp_path, options):
    points, faces = box((-2, 0, -2), (2, 3, 2))
    path = emissive_file(tmp_path, (points[faces[:, ::-1]].astype(float), 0.7, 0.4), (plate(1.0, -1), 0.2, 0.0))
    lights = [at.SphereLight((0.5, 2.0, 0.5), 0.2, intensity=3.0), at.AmbientOcclusion(intensity=2.0)]
    for name, more in (("plain.glb", {}), ("other.glb", options)):
        at.bake(path, tmp_path / name, "light", lights=lights, bounces=3, spp=16, **more)
    assert (tmp_path / "plain.glb").read_bytes() == (tmp_path / "other.glb").read_bytes()


@pytest.mark.parametrize("n", [16, 64, 256])
def test_all_paths_together_test_each_light_of_a_sky_with_its_power(n):
    sky = at.Sky(intensity=2.0, colour=(1.0, 0.5, 0.25), count=100)
    tested = _entries(sky, n, (1, 2))
    directions = np.concatenate([light.directions for light in tested])
    powers = np.concatenate([light.intensities[:, None] * light.colours for light in tested]) / n
    of_sky = {
        tuple(d.round(9)): p for d, p in zip(-sky.points, 2.0 * sky.intensities[:, None] * sky.colours * sky.colour)
    }
    sums = {}
    for d, power in zip(directions, powers):
        sums[tuple(d.round(9))] = sums.get(tuple(d.round(9)), 0.0) + power
    assert sums.keys() == of_sky.keys() and max(map(len, (light.points for light in tested))) == -(-100 // n)
    np.testing.assert_allclose([sums[d] for d in of_sky], list(of_sky.values()), rtol=1e-12)


def test_emissive_textures_count_by_their_mean_on_each_face(tmp_path):
    """A plate whose left half glows in a texture: its left faces emit, and its right ones do not."""
    made = Gltf()
    pixels = np.zeros((16, 16, 3), np.uint8)
    pixels[:, :8] = 255
    made.add("images", bufferView=made.view(png(pixels)), mimeType="image/png")
    made.add("textures", source=0)
    look = made.add("materials", emissiveFactor=[1.0, 0.5, 0.0], emissiveTexture={"index": 0})
    points, faces = grid([-1.0, 0.0, 1.0], [-1.0, 1.0])
    uv = np.stack([0.5 + 0.5 * points[:, 0], 0.5 + 0.5 * points[:, 2]], 1).astype(np.float32)
    made.node(mesh=made.mesh({**primitive(made, points, faces, TEXCOORD_0=uv), "material": look}))
    near = [grid([x, x + 0.01], [0.0, 0.01], 0.02) for x in (-0.5, 0.5)]
    for positions, triangles in near:
        made.node(mesh=made.mesh(primitive(made, positions, triangles[:, ::-1].copy())))
    path = made.write(tmp_path)
    left, right = (light_at_vertices(path, tmp_path / "out.glb", node, bounces=1, spp=64).mean(0) for node in (1, 2))
    np.testing.assert_allclose(left, np.pi * np.array([1.0, 0.5, 0.0]), rtol=0.03)
    assert right[0] < 0.03 * left[0]
    with pytest.warns(UserWarning, match="its materials emit light, which bounces gathers"):
        at.bake(path, tmp_path / "out.glb", "light", lights=FAR_LAMP, spp=4)


def test_an_emissive_texture_that_cannot_be_read_is_noted(tmp_path):
    made = Gltf()
    made.add("images", bufferView=made.view(b"not an image"), mimeType="image/png")
    made.add("textures", source=0)
    look = made.add("materials", emissiveFactor=[1.0, 1.0, 1.0], emissiveTexture={"index": 0})
    uv = np.zeros((4, 2), np.float32)
    made.node(mesh=made.mesh({**primitive(made, *grid([0, 1], [0, 1]), TEXCOORD_0=uv), "material": look}))
    with pytest.warns(UserWarning, match="its emissive texture cannot be read; it emits evenly"):
        at.bake(made.write(tmp_path), tmp_path / "out.glb", "light", lights=FAR_LAMP, bounces=1, spp=4)


def test_an_interrupted_bake_of_bounces_resumes_with_its_own_parts_only(tmp_path):
    path = emissive_file(tmp_path, (plate(0.0, 1), 0.5, 1.0), (plate(1.0, -1), 0.5, 0.0))
    for bounces in (0, 1, 2, 1):
        keep = tmp_path / "parts"
        values = light_at_vertices(path, tmp_path / "kept.glb", 1, bounces=bounces, spp=16, keep=keep)
        np.testing.assert_array_equal(values, light_at_vertices(path, tmp_path / "a.glb", 1, bounces=bounces, spp=16))


def test_bounces_are_for_light(tmp_path):
    path = emissive_file(tmp_path, (plate(0.0, 1), 0.5, 1.0))
    for what in ("ao", "shadow", "sun", "bent-normal"):
        with pytest.raises(at.InputError, match=f"bounces is for light, not for {what}"):
            at.bake(path, tmp_path / "out.glb", what, bounces=1)
    with pytest.raises(at.InputError, match="bounces"):
        at.bake(path, tmp_path / "out.glb", "light", bounces=-1)
    assert not (tmp_path / "out.glb").exists()
