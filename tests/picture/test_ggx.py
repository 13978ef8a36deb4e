"""GGX lobes of glTF's model, against closed forms and Mitsuba."""

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.ggx import LobePoints, alpha_of, uniform_lobes
from gltf_files import Gltf
from gltf_materials import DIRECT, QUARTER, ball, brdf, seen_points, square

EYE = np.array([0.4, -2.2, 1.3])
CAMERA = at.Camera(EYE, (0, 0, 0), up=(0, 0, 1), vfov=50, width=24, height=20)
LAMP = at.PointLight((-0.5, 1.5, 0.9), intensity=3.0, colour=(1.0, 0.8, 0.5))
MATERIALS = [((0.9, 0.6, 0.2), 1.0), ((0.7, 0.2, 0.1), 0.0), ((0.5, 0.8, 0.3), 0.4)]


def lit(scene, camera=CAMERA, light=LAMP, **options):
    return at.render(scene, camera, [light], **DIRECT | options)


def expected(points, view, light, base, metallic, roughness):
    way = light.position - points
    r2 = (way**2).sum(1)[:, None]
    l, n = way / np.sqrt(r2), np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    arriving = light.intensity * np.asarray(light.colour) * l[:, 2:] / r2
    return arriving * brdf(n, view, l, base, metallic, roughness)


@pytest.mark.parametrize("node", [None, QUARTER], ids=["straight", "turned"])
@pytest.mark.parametrize("roughness", [0.1, 0.3, 0.6, 1.0])
@pytest.mark.parametrize("base, metallic", MATERIALS)
def test_a_lamp_is_reflected_by_gltfs_formula(tmp_path, base, metallic, roughness, node):
    scene = square(tmp_path, base=base, metallic=metallic, roughness=roughness, node=node)
    frame = lit(scene)
    mask, points, view = seen_points(scene, CAMERA, frame)
    assert mask.sum() > 100
    if metallic == 0.0 and roughness == 1.0:  # Lambertian, see the test below
        assert scene.appearance.pbr is None
        return
    np.testing.assert_allclose(frame.image[mask], expected(points, view, LAMP, base, metallic, roughness), rtol=2e-4)


def test_a_rough_dielectric_without_maps_is_lambertian(tmp_path):
    scene = square(tmp_path, base=(0.7, 0.2, 0.1))
    assert scene.appearance.pbr is None
    assert (lit(scene).image == lit(scene, materials="diffuse").image).all()


@pytest.mark.parametrize("roughness", [0.2, 0.5, 0.8])
def test_metals_are_those_of_mitsuba(tmp_path, roughness):
    """Mitsuba masks and shadows separately, glTF together; with their ratio, they differ by 7e-7 on average."""
    mi = pytest.importorskip("mitsuba", reason="mitsuba is not installed: GGX is not compared with it")
    mi.set_variant("scalar_rgb")
    scene = square(tmp_path, metallic=1.0, roughness=roughness)
    frame = lit(scene, light=at.PointLight(LAMP.position, intensity=3.0))
    mask, points, view = seen_points(scene, CAMERA, frame)
    alpha = roughness**2
    metal = mi.load_dict({"type": "roughconductor", "distribution": "ggx", "alpha": alpha, "material": "none"})
    theirs, context, seen = [], mi.BSDFContext(), mi.SurfaceInteraction3f()
    for p, v in zip(points, view):
        way = LAMP.position - p
        l = way / np.linalg.norm(way)
        seen.wi = mi.Vector3f(*v.tolist())
        value = np.array(metal.eval(context, seen, mi.Vector3f(*l.tolist())))[0]
        sides = [np.sqrt(alpha**2 + (1 - alpha**2) * c**2) for c in (l[2], v[2])]
        apart = np.prod([2 * c / (c + s) for c, s in zip((l[2], v[2]), sides)])
        together = 2 * l[2] * v[2] / (l[2] * sides[1] + v[2] * sides[0])
        theirs.append(3.0 / (way @ way) * value * together / apart)
    ours, theirs = frame.image[mask][:, 0].astype(np.float64), np.array(theirs)
    assert theirs.min() > 0.0
    assert np.mean(np.abs(ours - theirs) / theirs) < 2e-6


@pytest.mark.parametrize("roughness", [0.05, 0.2])
def test_a_highlight_is_where_a_mirror_shows_the_lamp(tmp_path, roughness):
    scene = square(tmp_path, metallic=1.0, roughness=roughness)
    camera = at.Camera(EYE, (0, 0, 0), up=(0, 0, 1), vfov=50, width=160, height=120)
    frame = lit(scene, camera)
    mirrored = LAMP.position * (1, 1, -1)
    place = EYE + (mirrored - EYE) * EYE[2] / (EYE[2] - mirrored[2])
    y, x = np.unravel_index(frame.image[..., 0].argmax(), frame.mask.shape)
    found = frame.gbuffer.position[y, x] + frame.gbuffer.origin
    assert np.abs(found - place).max() < 0.05


def test_reflection_is_reciprocal(tmp_path):
    scene, rng = square(tmp_path, base=(0.9, 0.5, 0.2), metallic=0.5, roughness=0.4), np.random.default_rng(1)
    for _ in range(3):
        one, other = rng.uniform(-1, 1, (2, 3)) * (1, 1, 0) + (0, 0, 2)
        values = []
        for eye, lamp in ((one, other), (other, one)):
            camera = at.Camera(eye, (0, 0, 0), up=(0, 1, 0), vfov=1, width=1, height=1)
            image = lit(scene, camera, at.PointLight(lamp)).image[0, 0].astype(np.float64)
            values.append(image * ((lamp @ lamp) ** 1.5 / lamp[2]))
        np.testing.assert_allclose(*values, rtol=1e-5)


@pytest.mark.parametrize("roughness", [0.0, 0.1, 0.35, 0.7, 1.0])
def test_a_white_furnace_reflects_no_more_than_arrives(roughness):
    nv = np.linspace(0.05, 1.0, 20)
    view = np.stack([np.sqrt(1 - nv * nv), 0 * nv, nv], 1).astype(np.float32)
    normal = np.tile(np.float32([0, 0, 1]), (20, 1))
    rough = np.full(20, roughness, np.float32)
    lobe, edge, _ = uniform_lobes(LobePoints(np.arange(20), normal, view, alpha_of(rough)), rough).T
    assert (lobe <= 1.0 + 1e-3).all() and (edge >= 0.0).all() and (edge <= lobe + 1e-6).all()
    if roughness <= 0.1:
        assert lobe[nv > 0.2].min() > 0.99  # a mirror loses nothing


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
def test_light_from_all_sides_is_the_integral_of_the_formula(roughness):
    polar, around = np.meshgrid((np.arange(400) + 0.5) / 400 * np.pi / 2, (np.arange(400) + 0.5) / 400 * np.pi)
    l = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1)
    weight = np.sin(polar) * np.cos(polar) * (np.pi / 800) * (2 * np.pi / 400)
    n = np.broadcast_to([0.0, 0.0, 1.0], l.shape)
    for nv in (0.3, 0.7, 1.0):
        v = np.broadcast_to([np.sqrt(1 - nv * nv), 0.0, nv], l.shape)
        white = (brdf(n, v, l, (1, 1, 1), 1.0, roughness)[..., 0] * weight).sum()
        dark = (brdf(n, v, l, (0, 0, 0), 1.0, roughness)[..., 0] * weight).sum()
        diffuse = (
            (brdf(n, v, l, (1, 1, 1), 0.0, roughness) - brdf(n, v, l, (0, 0, 0), 0.0, roughness))[..., 0] * weight
        ).sum()
        points = LobePoints(
            np.zeros(1, np.int64), np.float32([[0, 0, 1]]), v[:1, 0].astype(np.float32), np.ones(1, np.float32)
        )
        lobe, edge, share = uniform_lobes(points, np.float32([roughness]))[0]
        np.testing.assert_allclose((lobe, edge, share * 0.96), (white, dark, diffuse), atol=4e-3)


def test_samples_of_a_wide_light_are_averaged(tmp_path):
    """A square lamp is the mean of point lights at its samples, weighted by what arrives from each."""
    scene = square(tmp_path, metallic=1.0, roughness=0.5)
    lamp = at.QuadLight((-0.7, 1.2, 1.0), (0.5, 0, 0), (0, 0.4, 0), intensity=2.0)
    frame = lit(scene, light=lamp, sampler="hammersley", spp=64, filter=False)
    mask, points, view = seen_points(scene, CAMERA, frame)
    a, b = (each.ravel() for each in np.meshgrid((np.arange(40) + 0.5) / 40, (np.arange(40) + 0.5) / 40))
    n, total = np.broadcast_to([0.0, 0.0, 1.0], points.shape), 0.0
    for x, y in zip(a, b):
        way = np.array([-0.7 + 0.5 * x, 1.2 + 0.4 * y, 1.0]) - points
        r2 = (way**2).sum(1)[:, None]
        l = way / np.sqrt(r2)
        total = total + 2.0 * l[:, 2:] ** 2 / r2 * brdf(n, view, l, (1, 1, 1), 1.0, 0.5) / len(a)
    np.testing.assert_allclose(frame.image[mask].mean(), total.mean(), rtol=0.01)


def test_a_ball_has_its_highlight_between_eye_and_sun(tmp_path):
    points, _, faces = ball(64)
    made = Gltf()
    material = made.add("materials", pbrMetallicRoughness={"roughnessFactor": 0.2})
    mesh = made.mesh(made.primitive(points, faces, attributes={"NORMAL": made.accessor(points)}, material=material))
    made.node(mesh=mesh)
    scene, towards = at.load(made.write(tmp_path)), np.array([0.6, 0.5, np.sqrt(1 - 0.61)])
    camera = at.Camera((0, 0, 50), (0, 0, 0), vfov=2.6, width=128, height=128)
    frame = lit(scene, camera, at.DirectionalLight(-towards))
    y, x = np.unravel_index(frame.image[..., 0].argmax(), frame.mask.shape)
    half = (towards + (0, 0, 1)) / np.linalg.norm(towards + (0, 0, 1))
    assert np.abs(frame.gbuffer.position[y, x] + frame.gbuffer.origin - half).max() < 0.04
