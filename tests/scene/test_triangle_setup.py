"""Triangles without area: what is found is what rational arithmetic finds, and no tree holds them."""

from fractions import Fraction

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.plan import covering_plans
from antumbra.scene.triangle_setup import face_rows, rows_with_area, solid_vertices, survey
from antumbra.scene.triangles import Triangles
from devices import device_plans

RNG = np.random.default_rng(36)


def has_area(triangle) -> bool:
    a, b, c = ([Fraction(float(x)) for x in corner] for corner in triangle)
    p, q = [x - y for x, y in zip(b, a)], [x - y for x, y in zip(c, a)]
    return any(p[i] * q[j] != p[j] * q[i] for i, j in ((0, 1), (1, 2), (2, 0)))


def on_lines(n, steps=64):
    """Three points of a line each, exact in float32."""
    return RNG.integers(-9, 10, (n, 1, 3)) + RNG.integers(-steps, steps, (n, 3, 1)) * RNG.integers(-3, 4, (n, 1, 3)) / 8


@pytest.mark.parametrize("n", [0, 1, 5, 3 * 8192, 3 * 8193 + 2, 80_000])
@pytest.mark.parametrize("threads", [1, 2])
def test_rows_of_a_table_are_those_of_faces_and_the_first_one_of_none(n, threads):
    table, face = RNG.random((50, 3), np.float32), RNG.integers(-1, 49, n).astype(np.int32)
    np.testing.assert_array_equal(face_rows(table, face, threads), table[face + 1])


def shaken(soup):
    """With a last bit of a coordinate changed."""
    soup = soup.astype(np.float32)
    corner, axis = RNG.integers(0, 3, (2, len(soup)))
    rows = np.arange(len(soup)), corner, axis
    soup[rows] = np.nextafter(soup[rows], np.float32(np.inf))
    return soup


SOUPS = {
    "ordinary": RNG.normal(size=(200, 3, 3)),
    "on lines": on_lines(200),
    "nearly on lines": shaken(on_lines(400)),
    "powers of two": 2.0 ** RNG.integers(-30, 30, (300, 3, 1)) * RNG.integers(-1, 2, (300, 3, 3)),
    "of all magnitudes": 2.0 ** RNG.integers(-120, 60, (300, 3, 3)) * RNG.integers(-1, 2, (300, 3, 3)),
    "denormal": RNG.integers(-2, 3, (300, 3, 3)) * 2.0**-149,
    "two corners": RNG.normal(size=(50, 3, 3))[:, [0, 1, 0]],
    "points": np.full((50, 3, 3), 0.1),
}


@pytest.mark.parametrize("name", SOUPS)
def test_what_has_an_area(name):
    soup = SOUPS[name].astype(np.float32)
    truth = np.flatnonzero([has_area(triangle) for triangle in soup])
    found = rows_with_area(soup, 2)
    assert (found is None) == (len(truth) == len(soup))
    if found is not None:
        np.testing.assert_array_equal(found, truth)
        assert found.dtype == np.int32
    assert 0 < len(truth) < len(soup) or name in ("ordinary", "on lines", "two corners", "points")


@pytest.mark.parametrize("n", [1, 7, 8, 9, 8191, 8193, 20_000])
@pytest.mark.parametrize("threads", [1, 3])
def test_survey_finds_areas_and_bounds(n, threads):
    soup = np.concatenate(list(SOUPS.values())).astype(np.float32)
    soup = np.resize(soup[RNG.permutation(len(soup))], (n, 3, 3))
    with_area, bounds = survey(soup, threads)
    found = rows_with_area(soup, 1)
    np.testing.assert_array_equal(bounds, [soup.min((0, 1)), soup.max((0, 1))])
    assert (with_area is None) == (found is None)
    np.testing.assert_array_equal(
        np.arange(n) if with_area is None else with_area, np.arange(n) if found is None else found
    )
    assert n < 8000 or 0 < len(with_area) < n


def junk_among(soup):
    """(triangles, flags of those without area)."""
    junk = on_lines(len(soup)) / 4
    flags = np.arange(2 * len(soup)) % 2 == 1
    return np.stack([soup, junk], 1).reshape(-1, 3, 3), flags


@pytest.fixture(scope="module")
def mixed():
    soup, flags = junk_among(RNG.integers(-64, 64, (150, 3, 3)) / 16)
    # equal corners at the ends of the bounds: the frame's zero is that of the world, so that no corner is rounded
    return at.Scene.from_arrays(np.concatenate([soup, [np.full((3, 3), k) for k in (-32.0, 32.0)]])), flags


def without_junk(scene, flags):
    """The scene without its triangles on lines. The last two keep its bounds."""
    return at.Scene.from_arrays(scene.triangles().vertices[np.append(~flags, [True, True])])


def test_solid_triangles_keep_their_numbers(mixed):
    scene, flags = mixed
    triangles = scene.triangles()
    assert not scene.origin.any() and len(triangles.vertices) == scene.n_triangles == 302
    np.testing.assert_array_equal(triangles.solid, np.flatnonzero(~flags))
    np.testing.assert_array_equal(solid_vertices(triangles, 2), triangles.vertices[:300][~flags])
    whole = Triangles(*triangles[:4])
    assert solid_vertices(whole, 1) is whole.vertices


@pytest.mark.parametrize("plan", [*covering_plans(), *device_plans()], ids=str)
def test_no_bit_depends_on_triangles_without_area(mixed, plan):
    scene, flags = mixed
    points, light = np.random.default_rng(1).normal(size=(40, 3)) * 4, at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2))
    bits = [at.visibility(each, points, light, spp=8, plan=plan).bits for each in (scene, without_junk(scene, flags))]
    np.testing.assert_array_equal(*bits)
    assert 0 < np.bitwise_count(bits[0]).sum() < 40 * 8


@pytest.mark.parametrize("plan", [*covering_plans(), *device_plans()], ids=str)
def test_scenes_in_which_no_triangle_has_an_area(plan):
    scene, light = at.Scene.from_arrays(np.full((280, 3, 3), 0.1)), at.PointLight((0, 2, 0))
    assert len(scene.triangles().solid) == 0
    assert (at.visibility(scene, [[0.1, -1, 0.1], [0.1, 0.1, 0.1]], light, plan=plan).fraction == 1).all()
    frame = at.render(scene, at.Camera((1, 1, 1), (0, 0, 0), width=8, height=6), light, plan=plan, spp=1)
    assert not frame.mask.any() and not frame.bits[0].any()


def test_rays_pass_what_has_no_area(mixed):
    scene, flags = mixed
    origins, directions = RNG.normal(size=(2, 400, 3)) * 8
    hit = scene.closest_hit(origins, directions)
    met = hit.face[hit.face >= 0]
    assert len(met) > 20 and not flags[met].any()
    np.testing.assert_array_equal(scene.occluded(origins, directions), hit.face >= 0)


@pytest.mark.parametrize("gbuffer", ["raster", "rays"])
def test_pictures_show_the_face_that_is_there(mixed, gbuffer):
    scene, flags = mixed
    camera = at.Camera((0, 3, 14), (0, 0, 0), width=40, height=30)
    asked = camera, at.PointLight((5, 9, 5))
    frame, other = (
        at.render(each, *asked, spp=1, gbuffer=gbuffer, plan="bsah+single")
        for each in (scene, without_junk(scene, flags))
    )
    numbers = np.append(np.flatnonzero(np.append(~flags, [True, True])), -1)  # of face -1, the last
    assert frame.mask.any()
    np.testing.assert_array_equal(frame.gbuffer.face, numbers[other.gbuffer.face])
    np.testing.assert_array_equal(frame.bits[0], other.bits[0])


@pytest.fixture
def collapsing(tmp_path):
    """A soup of which every other triangle is a point at the beginning, and others are at the end."""
    first, last = RNG.normal(size=(2, 60, 3, 3)).astype(np.float32)
    first[::2], last[1::3] = first[::2, :1], last[1::3, :1]
    np.save(tmp_path / "frames.npy", np.stack([first.reshape(-1, 3), last.reshape(-1, 3)]))
    np.save(tmp_path / "faces.npy", np.arange(180, dtype=np.int32).reshape(60, 3))
    return at.load(tmp_path)


@pytest.mark.parametrize(
    "plan", ["auto", "bsah+refit+single", "grid32+bsah+refit+single", "bsah+refit+chcrt", "cones", "srdh+refit+single"]
)
def test_moving_scenes_whose_triangles_collapse(collapsing, plan):
    light, camera = at.SphereLight((0, 4, 0), 0.5), at.Camera((0, 1, 5), (0, 0, 0), width=24, height=16)
    plain, other = at.Renderer(collapsing, "bsah+single"), at.Renderer(collapsing, plan)
    sizes = set()
    for time in (0.0, collapsing.duration / 2, collapsing.duration, 0.0):
        solid = collapsing.triangles(time).solid
        sizes.add(60 if solid is None else len(solid))
        frames = [one.render(camera, light, spp=4, time=time) for one in (plain, other)]
        np.testing.assert_array_equal(frames[0].bits[0], frames[1].bits[0])
        assert frames[0].bits[0].any()
    assert sizes == {30, 40, 50}
