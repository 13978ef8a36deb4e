"""Seeds of light samples: the mean over seeds converges to closed forms, and equal seeds give equal bits everywhere."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.plan import Plan, covering_plans
from antumbra.engine.primary_visibility import primary_visibility
from antumbra.query.light_samples import ROTATIONS, SAMPLERS, domain_sets, light_samples, sample_sets
from antumbra.query.shadow_query import shadow_queries
from asking import answer, true_occlusion
from devices import device_plans
from truths import LIGHTS, soup_scene

NETS = [sampler for sampler in SAMPLERS if sampler not in ROTATIONS]
SEEDS = 256
FLOOR = [[(-1, 0, -1), (-1, 0, 1), (1, 0, 0)]]


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("spp", [1, 5, 16, 100, 1024])
def test_seeds_draw_other_samples_of_the_same_kind(sampler, spp):
    sets = sample_sets(spp, sampler, 7)
    assert sets.shape == (16, spp, 2) and (sets > 0).all() and (sets < 1).all()
    np.testing.assert_array_equal(sets, sample_sets(spp, sampler, 7))
    for other in (0, 8):  # single coordinates may coincide by chance
        assert np.isin(sets, sample_sets(spp, sampler, other)).mean() < 1e-3


@pytest.mark.parametrize("sampler", NETS)
@pytest.mark.parametrize("spp", [4, 16, 64, 256])
def test_a_seed_keeps_one_sample_of_each_set_in_each_cell(sampler, spp):
    side = int(spp**0.5)
    for points in sample_sets(spp, sampler, 2**62 + 1):
        assert len(np.unique((points * side).astype(int) @ (1, side))) == spp


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_directions_and_light_samples_are_drawn_apart(sampler):
    """Bounced light pairs them: a common shift would leave their difference the same for all seeds."""
    square, disk = domain_sets(16, sampler, "square", 3)[..., :2], domain_sets(16, sampler, "disk", 3)
    hemisphere = domain_sets(16, sampler, "hemisphere", 3)
    assert not np.isin(hemisphere[..., :2], disk[..., :2]).any() and not np.isin(square, hemisphere[..., :2]).any()


def half_plane(a, b):
    """Two triangles in the plane y = 1 that cover the side left of the line from a to b, out to a great distance."""
    a, b = (np.array([x, 1.0, z]) for x, z in (a, b))
    along = (b - a) / np.linalg.norm(b - a)
    across = np.cross(along, (0, 1, 0))
    ends = [a - 1e3 * along, a + 1e3 * along]
    corners = [*ends, ends[1] + 1e3 * across, ends[0] + 1e3 * across]
    return [[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]]


def segment(distance):
    """The share of a unit disk beyond a chord at a distance from its centre."""
    return (np.arccos(distance) - distance * np.sqrt(1 - distance**2)) / np.pi


WALL = [[(0.5, -1, -1e4), (0.5, -1, 1e4), (0.5, 0.4, 1e4)], [(0.5, -1, -1e4), (0.5, 0.4, 1e4), (0.5, 0.4, -1e4)]]
CASES = {
    # light, blocker, share of the light that the origin sees, in closed form
    "quad": (at.QuadLight((-0.5, 2, -0.5), (1, 0, 0), (0, 0, 1)), half_plane((-0.25, 0.25), (0.25, -0.10)), 0.65),
    "disk": (at.DiskLight((0, 2, 0), (0, -1, 0), 0.5), half_plane((0.06, 0), (0.06, 1)), segment(0.24)),
    "sun": (
        at.DirectionalLight((0, -1, 0), angular_diameter=20),
        half_plane((0.1 * np.tan(np.radians(10)), 0), (0.1 * np.tan(np.radians(10)), 1)),
        segment(0.1),
    ),
    "ambient": (at.AmbientOcclusion(), WALL, 1 - (1 - np.cos(np.arctan2(0.4, 0.5))) / 2),
}


def shares(name, sampler, seeds, spp=5):
    """The visible shares at the origin for many seeds."""
    light, blocker, _ = CASES[name]
    scene = at.Scene.from_arrays(np.array(blocker, float))
    at_origin = np.zeros((1, 3))
    return np.array(
        [at.visibility(scene, at_origin, light, (0, 1, 0), spp=spp, sampler=sampler, seed=s).fraction[0] for s in seeds]
    ).astype(float)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("sampler", SAMPLERS)
def test_the_mean_over_seeds_converges_to_the_closed_form(name, sampler):
    truth = CASES[name][2]
    found = shares(name, sampler, range(1, SEEDS + 1))
    assert len(np.unique(found)) > 1, "every seed gives the same"
    print(f"{name}, {sampler}: {found.mean():.5f}, exactly {truth:.5f}, spread {found.std():.3f}")
    assert abs(found.mean() - truth) < 4 * found.std() / np.sqrt(SEEDS)
    groups = found.reshape(-1, 16).mean(1)
    assert np.sqrt(np.mean((groups - truth) ** 2)) < 0.4 * np.sqrt(np.mean((found - truth) ** 2))  # 1/4 on average


def test_more_seeds_go_on_where_more_samples_per_ray_end():
    """A frame has 1,024 samples at most; their error stays, and that of the mean of seeds goes to a tenth of it."""
    truth = CASES["quad"][2]
    most = abs(shares("quad", "larcher-pillichshammer", [0], 1024)[0] - truth)
    assert 1e-4 < most < 2e-3
    assert abs(shares("quad", "larcher-pillichshammer", range(1, 129), 1024).mean() - truth) < most / 4


SOUP = soup_scene(5)
CAMERA = at.Camera((0, 2, 9), (0, -0.5, 0), width=12, height=9)
PLANS = [p for p in covering_plans() if p == Plan(trace=p.trace)] + device_plans()


@pytest.mark.parametrize("name", ["quad", "sphere", "ambient nearby", "interleaved list"])
@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_equal_seeds_give_the_bits_of_the_oracle_in_every_plan_and_device(plan, name):
    triangles, light = SOUP.triangles(), LIGHTS[name].drawn(11)
    gbuffer = primary_visibility(triangles, CAMERA, threads=2)
    (query,) = shadow_queries(triangles, gbuffer, [light], [light_samples(light, 5, seed=11)])
    truth, active = true_occlusion(triangles, query)
    assert truth[active].any() and not truth[active].all()
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


def test_seeds_change_bits_and_nothing_but_bits_and_light():
    frames = [at.render(SOUP, CAMERA, LIGHTS["quad"], spp=8, seed=seed) for seed in (0, 1, 1, 2)]
    usual = at.render(SOUP, CAMERA, LIGHTS["quad"], spp=8)
    assert (frames[0].bits[0] == usual.bits[0]).all() and (frames[0].image == usual.image).all()
    assert (frames[1].bits[0] == frames[2].bits[0]).all() and (frames[1].image == frames[2].image).all()
    assert (frames[1].bits[0] != frames[0].bits[0]).any() and (frames[1].bits[0] != frames[3].bits[0]).any()
    assert (frames[1].gbuffer.face == frames[0].gbuffer.face).all()


def on_floor(light, seeds, **options):
    """The mean red of each frame of a white floor, seen from above, for many seeds."""
    scene = at.Scene.from_arrays(np.array(FLOOR, float) * 9, colours=np.ones((1, 3)))
    camera = at.Camera((0, 3, 0), (0, 0, 0), up=(0, 0, 1), vfov=20, width=4, height=4)
    options = {"spp": 1, "ambient": False, "antialias": False, "filter": False, **options}
    return np.array([at.render(scene, camera, light, seed=s, **options).image[..., 0] for s in seeds], float)


def test_pixels_converge_to_the_light_of_a_sky():
    """A sky whose sixteen sets differ: each pixel alone converges to the sum over all texels."""
    rng = np.random.default_rng(4)
    texels = rng.uniform(0.2, 2.0, (6, 8))
    sky = at.Sky(np.repeat(texels[..., None], 3, 2), up="y", count=64)
    edges = np.sin(np.pi / 2 - np.pi * np.arange(7) / 6)  # sine of the elevation at the edges of rows
    above = (np.maximum(edges[:-1], 0) ** 2 - np.maximum(edges[1:], 0) ** 2) / 2 * (2 * np.pi / 8)
    truth = (texels.mean(1) * 8 * above).sum() / np.pi
    found = on_floor(sky, range(1, SEEDS + 1))
    error = found.mean(0) - truth
    assert (np.abs(error) < 4.5 * found.std(0) / np.sqrt(SEEDS)).all() and found.std(0).min() > 0.01 * truth
    usual = on_floor(sky, [0])[0]
    assert np.abs(usual - truth).max() > 4 * np.abs(error).max(), "one frame is as good as many"


def test_pixels_converge_to_the_sum_of_an_interleaved_list():
    rng = np.random.default_rng(5)
    places = rng.uniform((-2, 1, -2), (2, 2, 2), (37, 3))
    listed = at.PointLights(places, rng.uniform(0.5, 2, 37), interleave=True)
    whole = at.PointLights(places, listed.intensities)
    found, truth = on_floor(listed, range(1, SEEDS + 1)), on_floor(whole, [0])[0]
    assert (np.abs(found.mean(0) - truth) < 4.5 * found.std(0) / np.sqrt(SEEDS)).all() and found.std(0).min() > 0


def test_bounced_light_converges_to_one_value_for_all_samplers():
    """Two grey planes that face each other, one of them lit by a small lamp: samplers agree within their errors."""
    plane = np.array([[(-4, 0, -4), (-4, 0, 4), (4, 0, 4)], [(-4, 0, -4), (4, 0, 4), (4, 0, -4)]], float)
    scene = at.Scene.from_arrays(np.concatenate([plane, plane[:, ::-1] + (0, 2, 0)]), colours=np.full((4, 3), 0.5))
    camera, lamp = (
        at.Camera((0, 1, 0), (0, 0, 0), up=(0, 0, 1), vfov=30, width=4, height=4),
        at.QuadLight((0.5, 1, 0.5), (0.8, 0, 0), (0, 0, 0.8)),
    )
    means, errors = [], []
    for sampler in ("larcher-pillichshammer", "sobol", "halton:full"):
        options = {"spp": 1, "bounce": 4, "sampler": sampler, "antialias": False}
        values = [at.render(scene, camera, lamp, seed=s, **options).indirect.mean(dtype=float) for s in range(1, 65)]
        means.append(np.mean(values))
        errors.append(np.std(values) / 8)
    print(means, errors)
    for k in (1, 2):
        assert abs(means[k] - means[0]) < 4 * np.hypot(errors[k], errors[0])
    assert errors[0] < 0.005 * means[0] and errors[1] < 0.01 * means[1]
