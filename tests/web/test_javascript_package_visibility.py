"""Visibility of lights in the package for JavaScript, in node: it has the bits of Python's."""

import numpy as np
import pytest

import antumbra as at
from scene_in_node import MESHES, Asked, grid, without_node

pytestmark = without_node


def lights_of(vertices):
    """Name -> (light in Python, light in JavaScript), in and around a mesh."""
    lower, upper = vertices.min(0).astype(float), vertices.max(0).astype(float)
    size, middle = float((upper - lower).max()), (lower + upper) / 2.0
    above, u, v = middle + [0.1 * size, 0.7 * size, 0.05 * size], [0.2 * size, 0.0, 0.0], [0.0, 0.03 * size, 0.1 * size]
    generator = np.random.default_rng(4)
    positions = above + generator.normal(size=(21, 3)) * size / 4
    ways = generator.normal(size=(70, 3)) - [0, 1, 0]
    wide = {"corner": (middle - size).tolist(), "u": [2 * size, 0, 0], "v": [0, 2 * size, size]}
    lights = {
        "point": (at.PointLight(above), {"position": above.tolist()}),
        "quad": (at.QuadLight(above, u, v), {"corner": above.tolist(), "u": u, "v": v}),
        "quad as large as the scene": (at.QuadLight(**wide), wide),
        "disk": (
            at.DiskLight(above, [1, -2, 0.5], 0.1 * size),
            {"center": above.tolist(), "normal": [1, -2, 0.5], "radius": 0.1 * size},
        ),
        "disk at a vertex": (
            at.DiskLight(vertices[0], [0, 0, -3], 0.2 * size),
            {"center": vertices[0].tolist(), "normal": [0, 0, -3], "radius": 0.2 * size},
        ),
        "sphere": (at.SphereLight(above, 0.2 * size), {"center": above.tolist(), "radius": 0.2 * size}),
        "sun": (at.DirectionalLight([0.3, -1, 0.2]), {"direction": [0.3, -1, 0.2]}),
        "sun of 20 degrees": (
            at.DirectionalLight([0.3, -1, 0.2], 20.0),
            {"direction": [0.3, -1, 0.2], "angularDiameter": 20},
        ),
        "sun without a diameter": (
            at.DirectionalLight([0, -1, 0], 0.0),
            {"direction": [0, -1, 0], "angularDiameter": 0},
        ),
        "ambient": (at.AmbientOcclusion(), {}),
        "ambient nearby": (at.AmbientOcclusion(0.3 * size), {"radius": 0.3 * size}),
        "points": (at.PointLights(positions), {"positions": positions.ravel().tolist()}),
        "suns": (at.DirectionalLights(ways), {"directions": ways.ravel().tolist()}),
    }
    return {name: (light, {"kind": name.split()[0], **fields}) for name, (light, fields) in lights.items()}


LIGHTS = list(lights_of(MESHES["grid"][0]))


def points_of(vertices, n=500):
    """(points, normals) float64: on vertices, between them, and around."""
    generator = np.random.default_rng(7)
    pick = vertices[generator.integers(0, len(vertices), (n, 3))].astype(float)
    weights = generator.dirichlet((1, 1, 1), n)
    weights[::3] = [1, 0, 0]
    points = (weights[:, :, None] * pick).sum(1)
    points[::5] += generator.normal(size=points[::5].shape) * np.ptp(vertices, axis=0).max() / 3
    normals = generator.normal(size=(n, 3))
    normals[::2] = [0, 1, 0]
    return points, normals


@pytest.mark.parametrize("mesh", MESHES)
def test_lights_have_the_bits_of_python(package, tmp_path, mesh):
    vertices, faces = MESHES[mesh]
    scene = at.Scene.from_arrays(vertices if faces is not None else vertices.reshape(-1, 3, 3), faces)
    asked, wanted, names = Asked(package, tmp_path, vertices, faces), [], []
    points, normals = points_of(vertices)
    of_faces = [(points.astype(np.float32), normals.astype(np.float32), 16), (points, normals, 33), (points, None, 7)]
    for name, (light, same) in lights_of(vertices).items():
        for places, ways, samples in of_faces:
            if ways is None and isinstance(light, at.AmbientOcclusion):
                continue
            asked.ask("visibility", places, ways, same, samples=samples)
            wanted.append(at.visibility(scene, places, light, ways, spp=samples))
            names.append(f"{name}, {samples} samples")
    for found, want, name in zip(asked.answers(), wanted, names, strict=True):
        assert isinstance(found, dict), (name, found)
        np.testing.assert_array_equal(found["bits"], want.bits.ravel(), err_msg=name)
        np.testing.assert_array_equal(found["fraction"], want.fraction, err_msg=name)
        np.testing.assert_array_equal(found["seenSamples"], want.seen_samples.ravel(), err_msg=name)
    seen = np.concatenate([want.fraction for want in wanted])
    assert (seen > 0).any()
    assert (seen < 1).any()


def test_points_that_are_not_finite_fail_alone(package, tmp_path):
    vertices, faces = MESHES["grid"]
    points, normals = points_of(vertices, 40)
    points[[0, 7]], normals[9], normals[11] = np.nan, 0.0, np.inf
    light, same = lights_of(vertices)["quad"]
    asked = Asked(package, tmp_path, vertices, faces)
    asked.ask("visibility", points, normals, same, samples=70)
    (found,) = asked.answers()
    wanted = at.visibility(at.Scene.from_arrays(vertices, faces), points, light, normals, spp=70)
    assert np.isnan(found["fraction"]).sum() == 4
    np.testing.assert_array_equal(found["fraction"], wanted.fraction)
    np.testing.assert_array_equal(found["bits"], wanted.bits.ravel())


@pytest.mark.parametrize("side", ["front", "back"])
def test_light_passes_faces_that_are_culled(package, tmp_path, side):
    vertices, faces = MESHES["soup"]
    scene = at.Scene.from_arrays(vertices.reshape(-1, 3, 3))
    points, normals = points_of(vertices)
    asked, wanted = Asked(package, tmp_path, vertices, faces), []
    for name in "disk", "ambient":  # by shafts, and by segments
        light, same = lights_of(vertices)[name]
        asked.ask("visibility", points, normals, same, cullFaces=side)
        wanted.append(at.visibility(scene, points, light, normals, cull_faces=side))
    for found, want in zip(asked.answers(), wanted, strict=True):
        np.testing.assert_array_equal(found["bits"], want.bits.ravel())


@pytest.mark.parametrize("samples", [1, 2, 5, 64, 100, 1024])
def test_samples_of_any_number_are_those_of_python(package, tmp_path, samples):
    vertices, faces = MESHES["grid"]
    scene, (points, normals) = at.Scene.from_arrays(vertices, faces), points_of(vertices, 30)
    asked, wanted = Asked(package, tmp_path, vertices, faces), []
    for name in "quad", "sun of 20 degrees", "ambient":
        light, same = lights_of(vertices)[name]
        asked.ask("visibility", points, normals, same, samples=samples)
        wanted.append(at.visibility(scene, points, light, normals, spp=samples))
    for found, want in zip(asked.answers(), wanted, strict=True):
        np.testing.assert_array_equal(found["bits"], want.bits.ravel())


QUAD = {"kind": "quad", "corner": [0, 3, 0], "u": [1, 0, 0], "v": [0, 0, 1]}
FAULTS = {
    "the light is of kind lamp; give one of point, quad, disk, sphere, sun, ambient, points, suns": {"kind": "lamp"},
    "the quad has no area (u and v are parallel or zero)": {**QUAD, "v": [2, 0, 0]},
    "corner is 0,3; it must be three finite numbers": {**QUAD, "corner": [0, 3]},
    "radius is -1; it must be positive and finite": {"kind": "sphere", "center": [0, 3, 0], "radius": -1},
    "direction is zero; give it a direction": {"kind": "sun", "direction": [0, 0, 0]},
    "angularDiameter is 180; it must be from 0 to below 180 degrees": {
        "kind": "sun", "direction": [0, -1, 0], "angularDiameter": 180,
    },
    "the light has 1025 suns; give 1 to 1024 a call": {"kind": "suns", "directions": [0, -1, 0] * 1025},
    "directions must have three numbers a light": {"kind": "suns", "directions": [0, -1]},
}  # fmt: skip


def test_invalid_lights_are_errors_with_a_cure(package, tmp_path):
    asked, points = Asked(package, tmp_path, *grid()), np.ones((2, 3))
    for light in FAULTS.values():
        asked.ask("visibility", points, None, light)
    asked.ask("visibility", points, None, QUAD, samples=2000)
    asked.ask("visibility", points, None, {"kind": "ambient"})
    asked.ask("visibility", points, points[:1], QUAD)
    asked.ask("visibility", points * np.nan, None, QUAD)
    asked.ask("visibility", points, None, QUAD, cullFaces="both")
    assert asked.answers() == [
        *FAULTS,
        "samples is 2000; it must be a whole number from 1 to 1024",
        "ambient light needs the normals of the points",
        "normals has 3 numbers, and the points have 6",
        "no point is left: points or normals hold NaN or infinity, or normals are zero",
        'cullFaces is both; it must be "front" or "back"',
    ]
