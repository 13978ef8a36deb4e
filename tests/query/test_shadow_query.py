"""Light patches, receivers and horizons: the segments of a query."""

import numpy as np
import pytest

import antumbra as at
import oracle
from antumbra.query.shadow_query import count_occluded, fraction_lit, segments
from asking import query_of

CENTRE = np.array([0.3, 5.0, -0.2])


def _scene():
    rng = np.random.default_rng(2)
    return at.Scene.from_arrays(rng.normal(size=(400, 1, 3)) + rng.normal(size=(400, 3, 3)) * 0.4)


def _ends(light, spp=256):
    triangles, query = query_of(_scene(), at.Camera((0, 1, 7), (0, 0, 0), width=16, height=12), light, spp)
    ends, above = segments(query)
    seen = query.sides != 0
    assert seen.any()
    return query.origins[seen].astype(float), ends[seen].astype(float), above[seen], triangles, query


def test_quad_samples_lie_on_the_quad_and_fill_it():
    light = at.QuadLight(CENTRE, (2, 0, 0), (0, 1, 1))
    _, ends, _, triangles, _ = _ends(light)
    local = ends + triangles.origin - light.corner
    a, b = local @ light.u / 4, local @ light.v / 2
    np.testing.assert_allclose(a[..., None] * light.u + b[..., None] * light.v, local, atol=1e-5)
    for c in (a, b):
        assert c.min() > -1e-5 and c.max() < 1 + 1e-5 and abs(c.mean() - 0.5) < 0.01


def test_disk_samples_lie_on_the_disk():
    light = at.DiskLight(CENTRE, (1, 2, 3), 1.5)
    _, ends, _, triangles, _ = _ends(light)
    local = ends + triangles.origin - light.center
    np.testing.assert_allclose(local @ light.normal, 0, atol=1e-5)
    r = np.linalg.norm(local, axis=-1)
    assert 1.4 < r.max() <= 1.5 + 1e-5 and abs((r < 0.75).mean() - 0.25) < 0.01


def test_sphere_samples_fill_exactly_the_cone_in_which_the_sphere_is_seen():
    light = at.SphereLight(CENTRE, 1.2)
    origins, ends, _, triangles, _ = _ends(light)
    to_centre = light.center - triangles.origin - origins
    distance = np.linalg.norm(to_centre, axis=-1)
    d = ends - origins[:, None]
    cosine = (d * to_centre[:, None]).sum(-1) / np.linalg.norm(d, axis=-1) / distance[:, None]
    widest = np.arccos(cosine.min(1))
    assert (distance > 1.2).all()
    limit = np.arcsin(1.2 / distance)
    assert (widest <= limit + 1e-4).all() and (widest > 0.9 * limit).all()
    assert (np.linalg.norm(ends + triangles.origin - light.center, axis=-1) <= 1.2 + 1e-4).all()


@pytest.mark.parametrize("diameter", [0.0, 0.53, 40.0])
def test_sun_samples_are_directions_beyond_the_scene(diameter):
    light = at.DirectionalLight((0.2, -2, 0.3), diameter)
    origins, ends, _, triangles, _ = _ends(light)
    d = ends - origins[:, None]
    length = np.linalg.norm(d, axis=-1)
    assert length.min() > np.linalg.norm(np.ptp(triangles.vertices.reshape(-1, 3), axis=0))
    angle = np.degrees(np.arccos(np.clip(-(d @ light.direction) / length, -1, 1)))
    assert angle.max() <= diameter / 2 + 0.05 and angle.max() >= 0.9 * diameter / 2


def test_point_samples_are_the_point():
    _, ends, _, triangles, _ = _ends(at.PointLight(CENTRE), 3)
    np.testing.assert_allclose(ends + triangles.origin, np.broadcast_to(CENTRE, ends.shape), atol=1e-6)


@pytest.mark.parametrize("radius", [0.7, None, np.inf])
def test_ambient_samples_fill_the_hemisphere_around_the_normal_by_the_cosine(radius):
    triangles, query = query_of(
        _scene(), at.Camera((0, 1, 7), (0, 0, 0), width=16, height=12), at.AmbientOcclusion(radius), 256
    )
    ends, above = segments(query)
    seen = query.sides != 0
    d = (ends - query.origins[:, :, None].astype(float))[seen]
    length = np.linalg.norm(d, axis=-1)
    corners = triangles.vertices[query.faces[seen]].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal *= (query.sides[seen] / np.linalg.norm(normal, axis=-1))[:, None]
    cosine = (d * normal[:, None]).sum(-1) / length
    if radius == 0.7:
        np.testing.assert_allclose(length, 0.7, rtol=1e-5)
    else:
        assert length.min() > np.linalg.norm(np.ptp(triangles.vertices.reshape(-1, 3), axis=0))
    assert cosine.min() > -1e-6 and above[seen].mean() > 0.999
    for c in (0.3, 0.6, 0.9):
        assert np.abs((cosine < c).mean(1) - c * c).max() < 0.05 and abs((cosine < c).mean() - c * c) < 0.005
    np.testing.assert_allclose(d.mean(1) / length.mean(), normal * 2 / 3, atol=0.01)  # no direction is preferred


def _fan(radius, height, n=256):
    """A horizontal disk of triangles around the y axis."""
    angle = 2 * np.pi * np.arange(n + 1) / n
    rim = np.stack([radius * np.cos(angle), np.full(n + 1, height), radius * np.sin(angle)], 1)
    return np.stack([np.broadcast_to((0.0, height, 0.0), (n, 3)), rim[:-1], rim[1:]], 1)


def test_ambient_occlusion_by_a_disk_is_its_form_factor():
    """A disk of radius R at height h over a point covers R^2 / (R^2 + h^2) of its cosine-weighted hemisphere."""
    for height in (0.3, 1.0, 2.5):
        scene = at.Scene.from_arrays(_fan(1.0, height))
        ask = lambda light, normal=(0, 3, 0), scene=scene: at.visibility(scene, (0, 0, 0), light, normal, spp=1024)
        assert ask(at.AmbientOcclusion()).fraction == pytest.approx(1 - 1 / (1 + height**2), abs=0.005)
        assert ask(at.AmbientOcclusion(height * 0.99)).fraction == 1
        assert ask(at.AmbientOcclusion(), (0, -1, 0)).fraction == 1
        near = at.AmbientOcclusion(height * 1.25)  # the cone of half-angle acos(0.8), if the disk fills it
        assert ask(near).fraction == pytest.approx(1 - min(0.36, 1 / (1 + height**2)), abs=0.005)
        assert ask(at.AmbientOcclusion(spp=65)).bits.shape == (2,)


def test_ambient_occlusion_needs_normals():
    with pytest.raises(at.InputError, match="normals"):
        at.visibility(_scene(), np.zeros((2, 3)), at.AmbientOcclusion())


def test_list_samples_are_its_lights():
    positions = np.random.default_rng(1).normal(size=(37, 3)) * 3 + CENTRE
    for lights in (at.PointLights(positions), at.PointLights(positions, interleave=True)):
        triangles, query = query_of(_scene(), at.Camera((0, 1, 7), (0, 0, 0), width=16, height=12), lights, 1)
        ends = segments(query)[0]
        y, x = np.mgrid[:12, :16]
        wanted = (positions - triangles.origin).astype(np.float32)[lights.sets[x % 4 + 4 * (y % 4)]]
        np.testing.assert_array_equal(ends, wanted)


@pytest.mark.parametrize("interleave", [False, True])
def test_points_see_of_a_list_what_they_see_of_each_light(interleave):
    rng = np.random.default_rng(4)
    positions, points = rng.uniform(-4, 4, (70, 3)), rng.uniform(-4, 4, (9, 3))
    together = at.visibility(_scene(), points, at.PointLights(positions, interleave=interleave), spp=3)
    alone = [at.visibility(_scene(), points, at.PointLight(p), spp=1).bits[:, 0] for p in positions]
    assert together.bits.shape == (9, 2)
    for s, bits in enumerate(alone):
        np.testing.assert_array_equal(together.bits[:, s // 64] >> np.uint64(s % 64) & np.uint64(1), bits)
    assert 0 < together.fraction.mean() < 1


def test_receivers_are_on_the_seen_side_of_their_own_plane_and_close_to_it():
    scene = _scene()
    camera = at.Camera((0, 1, 7), (0, 0, 0), width=64, height=48)
    triangles, query = query_of(scene, camera, at.PointLight(CENTRE), 1)
    gbuffer = at.render(scene, camera, at.PointLight(CENTRE), spp=1).gbuffer
    eye = (camera.position - triangles.origin).astype(np.float32)
    y, x = np.nonzero(query.sides)
    assert len(y) > 300
    for i in range(0, len(y), 7):
        here = y[i], x[i]
        own = triangles.vertices[query.faces[here]]
        assert oracle.plane_side(query.origins[here], own) == query.sides[here] == oracle.plane_side(eye, own)
    moved = np.abs(query.origins[y, x] - gbuffer.position[y, x]).max(1)
    assert moved.max() <= 2.0**-19 * np.abs(triangles.vertices).max()


def test_the_horizon_is_the_exact_plane():
    light = at.QuadLight((-4, -1, -4), (8, 2, 0), (0, 0.5, 8))
    _, ends, above, triangles, query = _ends(light, 4)
    faces, sides = query.faces[query.sides != 0], query.sides[query.sides != 0]
    truth = [
        [oracle.plane_side(e.astype(np.float32), triangles.vertices[f]) == s for e in row]
        for row, f, s in zip(ends, faces, sides)
    ]
    np.testing.assert_array_equal(above, truth)
    assert above.any() and not above.all()


def test_points_with_normals_are_occluded_below_their_horizon_and_free_points_are_not():
    scene = at.Scene.from_arrays(np.array([[-50.0, -50, -50], [-49, -50, -50], [-50, -49, -50]]), np.array([[0, 1, 2]]))
    light = at.PointLight((0, 5, 0))
    points = np.zeros((2, 3, 3))
    assert (at.visibility(scene, points, light).fraction == 1).all()
    assert (at.visibility(scene, points, light, normals=(0, 2, 0)).fraction == 1).all()
    assert (at.visibility(scene, points, light, normals=(0, -1, 0)).fraction == 0).all()
    assert at.visibility(scene, points, light, spp=65).bits.shape == (2, 3, 2)


def test_points_on_a_surface_do_not_shadow_themselves_at_map_coordinates():
    rng = np.random.default_rng(3)
    normal = np.array([0.3, 1.0, 0.2]) / np.linalg.norm([0.3, 1.0, 0.2])
    u, v = np.cross(normal, (1, 0, 0)), np.cross(normal, (0, 0, 1))
    offset = np.array([5e6, 30.0, 4.5e5])
    quad = offset + np.array([-u - v, u - v, u + v, -u + v]) * 50
    scene = at.Scene.from_arrays(quad, np.array([[0, 1, 2], [0, 2, 3]]))
    points = offset + rng.uniform(-30, 30, (5000, 1)) * u + rng.uniform(-30, 30, (5000, 1)) * v
    light = at.DirectionalLight(-normal, 10.0)
    assert (at.visibility(scene, points, light, normals=normal).fraction == 1).all()


@pytest.mark.parametrize(
    "change, says",
    [
        (dict(points=np.zeros((4, 2))), "shape"),
        (dict(points=np.full((4, 3), np.nan)), "NaN"),
        (dict(normals=np.zeros(3)), "normals"),
        (dict(normals=np.ones((5, 3))), "broadcast"),
        (dict(light="lamp"), "light"),
        (dict(spp=0), "spp"),
        (dict(plan="bsah+teleport"), "single"),
    ],
)
def test_bad_arguments(change, says):
    args = dict(points=np.zeros((4, 3)), light=at.PointLight((0, 5, 0))) | change
    with pytest.raises(at.InputError, match=says):
        at.visibility(_scene(), **args)


def test_fraction_lit():
    bits = np.array([[0], [0b1011], [2**64 - 1]], np.uint64)
    np.testing.assert_allclose(fraction_lit(bits, 64), [1, 61 / 64, 0])


def test_count_occluded():
    bits = np.random.default_rng(4).integers(0, 2**63, (5, 7, 3)).astype(np.uint64)
    bits[2, 3], bits[0, 0] = 0, np.uint64(2**64 - 1)
    counts = count_occluded(bits, 2)
    np.testing.assert_array_equal(
        counts, [[sum(int(word).bit_count() for word in pixel) for pixel in row] for row in bits]
    )
    assert counts.dtype == np.int32 and counts[2, 3] == 0 and counts[0, 0] == 192
