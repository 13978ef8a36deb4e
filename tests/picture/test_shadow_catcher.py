"""The ground that catches shadows: exact, the same for every plan, and without effect on other pixels."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
from antumbra.engine.method_registry import CULLERS, TRACERS
from antumbra.picture.renderer import Renderer
from antumbra.picture.row_bands import band_array_names, bits_of_bands
from cutout_scenes import scene_with_cutouts
from devices import device_plans
from strength import examples

SIZE = 48, 36
LIGHTS = [
    at.SphereLight((1.5, 4, 1), 0.4, intensity=30.0),
    at.DirectionalLight((0.3, -1, -0.4), 4.0, intensity=2.0),
    at.QuadLight((-3, -2, 0), (0, 3, 0), (0, 0, 1), intensity=9.0),  # in part below the ground
    at.Sky(count=64),
    at.AmbientOcclusion(1.0),
]
PLANS = [f"bsah+{name}" if tracer.builds else name for name, tracer in TRACERS.items() if ":" not in name]
PLANS += [f"{name}+tl-lbvh+multifrusta" for name in CULLERS if ":" not in name] + ["auto"]


def soup(up="y", at_=(0.0, 0.0, 0.0)):
    """Triangles that float one unit above their lowest corner."""
    rng = np.random.default_rng(3)
    corners = rng.normal(size=(60, 1, 3)) * 0.5 + 0.3 * rng.normal(size=(60, 3, 3))
    corners[0] = [[-0.2, -2.0, 0], [0.2, -2.0, 0], [0, -1.0, 0.2]]
    if up == "z":
        corners = corners[..., [0, 2, 1]] * (1, -1, 1)
    return at.Scene.from_arrays(corners + np.array(at_), colours=rng.random((60, 3)), up=up)


def camera(kind="perspective"):
    if kind == "orthographic":
        return at.Camera((4, 3, 5), (0, -1, 0), width=48, height=36, projection=kind, extent=6.0)
    return at.Camera((4, 3, 5), (0, -1, 0), (0, 1, 0), 50.0, *SIZE)


@pytest.fixture(scope="module")
def scene():
    return soup()


def asked(scene, frame, light):
    """`visibility` at the points of the ground. Its points use the sets of the first of four rows of pixels."""
    ground = frame.ground
    points = ground.position.astype(np.float64) + frame.gbuffer.origin
    points[~ground.mask] = points[ground.mask][0]
    normal = np.eye(3)["xyz".index(scene.up)]
    found = at.visibility(scene, points.reshape(-1, 3), light, normal, spp=16).bits
    return found.reshape(*ground.mask.shape, -1)


@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
def test_the_bits_of_the_ground_are_those_of_its_points(scene, kind):
    frame = at.render(scene, camera(kind), LIGHTS, ground=True)
    rows = np.arange(SIZE[1])[:, None] % 4 == 0
    here = frame.ground.mask & rows
    for k, light in enumerate(LIGHTS):
        bits = frame.ground.bits[k]
        assert not bits[~frame.ground.mask].any()
        if isinstance(light, at.Sky):  # a pixel asks every 16th light, and a point all of them
            continue
        np.testing.assert_array_equal(bits[here], asked(scene, frame, light)[here], err_msg=str(light))
        assert bits[here].any() and not bits[here].all()
    assert 0.2 < frame.ground.mask.mean() < 0.95


def test_a_pixel_asks_the_lights_of_its_set(scene):
    frame = at.render(scene, camera(), LIGHTS[3], ground=True)
    here, sky = frame.ground.mask, LIGHTS[3]
    words = asked(scene, frame, sky)
    seen = (words[..., None] >> np.arange(64, dtype=np.uint64) & np.uint64(1)).reshape(*here.shape, -1)[..., :64]
    y, x = np.nonzero(here)
    sets = (x % 4) + 4 * (y % 4)
    expected = seen[y[:, None], x[:, None], sky.sets[sets]]
    own = frame.ground.bits[0][here]
    np.testing.assert_array_equal(own >> np.arange(4, dtype=np.uint64) & np.uint64(1), expected)
    assert expected.any() and not expected.all()


@pytest.fixture(scope="module")
def usual(scene):
    return at.render(scene, camera(), LIGHTS, spp=4, adaptive=16, plan="bsah+single", ground=True)


@pytest.mark.parametrize("plan", [*PLANS, *device_plans(text=True)])
def test_no_plan_changes_the_ground_and_the_ground_no_surface(scene, usual, plan):
    alone = at.render(scene, camera(), LIGHTS, spp=4, adaptive=16, plan=plan)
    frame = at.render(scene, camera(), LIGHTS, spp=4, adaptive=16, plan=plan, ground=True)
    for k in range(len(LIGHTS)):
        np.testing.assert_array_equal(frame.ground.bits[k], usual.ground.bits[k])
        np.testing.assert_array_equal(frame.bits[k], alone.bits[k])
        np.testing.assert_array_equal(frame.visibility[k], alone.visibility[k])
    np.testing.assert_array_equal(frame.ground.share, usual.ground.share)
    inside = frame.coverage == 1.0
    np.testing.assert_array_equal(frame.image[inside], alone.image[inside])
    np.testing.assert_array_equal(frame.coverage, alone.coverage)
    assert frame.rays > alone.rays and not (frame.ground.mask & frame.mask).any()
    assert inside.any() and (frame.image[~inside] < alone.image[~inside]).any()


@pytest.mark.parametrize("gbuffer", ["raster", "rays"])
def test_cutouts_cast_their_shadows(gbuffer):
    scene = scene_with_cutouts()
    frame = at.render(scene, None, LIGHTS[1], gbuffer=gbuffer, ground=True)
    rows = np.arange(frame.mask.shape[0])[:, None] % 4 == 0
    here = frame.ground.mask & rows
    np.testing.assert_array_equal(frame.ground.bits[0][here], asked(scene, frame, LIGHTS[1])[here])
    assert frame.ground.bits[0][here].any()


@examples(12)
@given(st.tuples(*[st.floats(-3, 3)] * 3), st.floats(-4, -1), st.sampled_from("yz"), st.sampled_from([0.0, 1.0, 5e6]))
def test_any_light_over_any_ground_agrees_with_its_points(place, height, up, away):
    scene = soup(up, (away, away, away))
    axis = "xyz".index(up)
    light = at.PointLight(np.array(place) + away, intensity=5.0)
    eye = np.array((4.0, 3, 5) if up == "y" else (4.0, -5, 3)) + away
    view = at.Camera(eye, np.full(3, away), np.eye(3)[axis], 50.0, 32, 16)
    frame = at.render(scene, view, light, spp=1, ground=height + away)
    here = frame.ground.mask & (np.arange(16)[:, None] % 4 == 0)
    np.testing.assert_array_equal(frame.ground.bits[0][here], asked(scene, frame, light)[here, :1] & np.uint64(1))
    world = frame.ground.position[here].astype(np.float64) + frame.gbuffer.origin
    np.testing.assert_allclose(world[:, axis], height + away, atol=1e-5 * max(1.0, away * 1e-6))
    assert here.any() and ((frame.ground.share >= 0) & (frame.ground.share <= 1)).all()


def test_the_picture_shows_what_is_behind_times_the_light_that_arrives(scene):
    lights = [LIGHTS[1], at.Sky()]
    bare, frame = (at.render(scene, camera(), lights, ground=g, antialias=False) for g in (False, True))
    share = frame.ground.share
    np.testing.assert_array_equal(frame.image[frame.mask], bare.image[frame.mask])
    np.testing.assert_allclose(frame.image[~frame.mask], (bare.image * share)[~frame.mask], rtol=1e-6)
    umbra = frame.ground.mask & (frame.ground.visibility[0] == 0.0)
    open_ = frame.ground.mask & (frame.ground.visibility[0] == 1.0) & (share.min(-1) > 0.98)
    assert umbra.any() and open_.any()
    assert (share[umbra] < 0.75).all() and (share[frame.mask] == 1.0).all()
    red, _, blue = share[umbra].mean(0)
    assert red < blue  # the sky lights the sun's shadow
    np.testing.assert_allclose(frame.ground.lost[~frame.ground.mask], 0.0, atol=1e-6)


def test_a_single_light_in_front_of_a_backdrop(scene):
    bare, frame = (at.render(scene, camera(), LIGHTS[0], filter=True, ground=ground) for ground in (False, True))
    np.testing.assert_allclose(frame.backdrop, bare.backdrop * frame.ground.share, rtol=1e-6)
    umbra = frame.ground.mask & (frame.ground.visibility[0] == 0.0)
    assert umbra.any() and (frame.ground.share[umbra] > 0.0).all()  # ambient light
    assert (frame.ground.share[umbra] < 0.7).all()


def test_light_that_bounces_leaves_no_black_shadow(scene):
    lights = [LIGHTS[0], at.virtual_point_lights(scene, LIGHTS[0], 4096)]
    vpl = at.render(scene, camera(), lights, ground=True)
    bounced = at.render(scene, camera(), LIGHTS[0], bounce=2, ground=True)
    plain = at.render(scene, camera(), LIGHTS[0], ground=True)
    assert len(vpl.ground.bits) == 1
    for frame in vpl, bounced:
        np.testing.assert_allclose(frame.ground.share, plain.ground.share, rtol=1e-4)


def test_ambient_occlusion_alone_darkens_the_ground_below_things(scene):
    ground = at.render(scene, camera(), at.AmbientOcclusion(3.0), filter=True, ground=True).ground
    np.testing.assert_allclose(
        ground.share[ground.mask], ground.visibility[0][ground.mask, None].repeat(3, 1), rtol=1e-5
    )
    assert ground.share.min() < 0.9


def test_a_light_below_the_ground_casts_no_shadow_on_it(scene):
    ground = at.render(scene, camera(), at.PointLight((0, -9, 0)), ground=True).ground
    assert (ground.share == 1.0).all() and ground.mask.any()


def test_half_a_light_below_the_ground_dims_nothing():
    scene = at.Scene.from_arrays(np.array([[[0, -3.0, 0], [1, -3, 0], [0, -3, 1]]]))
    light = at.QuadLight((-3, -3, 0), (0, 2, 0), (0, 0, 1), intensity=9.0)
    frame = at.render(scene, camera(), light, ground=-2.0)
    assert frame.ground.visibility[0][frame.ground.mask].mean() < 0.7
    assert frame.ground.share.min() > 0.99


def test_refined_edges_include_the_ground():
    box = np.array([[[-1.0, 0, 0], [1, 0, 0], [1, 2, 0]], [[-1, 0, 0], [1, 2, 0], [-1, 2, 0]]])
    scene = at.Scene.from_arrays(box)
    view = at.Camera((0.5, 5, 5), (0, 1, 0), vfov=30.0, width=96, height=72)
    lights = [at.DirectionalLight((0, -0.5, -1), intensity=10.0), at.Sky()]  # the shadow is behind it
    frame = at.render(scene, view, lights, adaptive=16, ground=True)
    big = at.render(scene, view.resized(96 * 8, 72 * 8), lights, ground=True)
    edge = (frame.coverage > 0.0) & (frame.coverage < 1.0)
    truth = big.image.reshape(72, 8, 96, 8, 3).mean((1, 3))
    shaded = edge & (frame.ground.share[..., 0] < 0.7)
    assert shaded.sum() > 10
    assert np.abs(frame.image - truth)[shaded].mean() < 0.05 * truth[shaded].mean()


def test_the_height_of_the_ground():
    still = soup()
    low = still.bounds[0, 1]
    assert low - 1e-3 < still.ground_height() < low and still.ground_height(0.0) == still.ground_height()
    frame = at.render(still, camera(), LIGHTS[1], ground=True)
    assert frame.ground.height == still.ground_height()
    assert at.render(still, camera(), LIGHTS[1], ground=-7).ground.height == -7.0
    below = at.Camera((0, -5, 5), (0, 0, 0), width=8, height=8)
    ground = at.render(still, below, LIGHTS[1], ground=True).ground
    assert not ground.mask.any() and (ground.share == 1.0).all()
    assert at.render(still, camera(), LIGHTS[1]).ground is None


@pytest.mark.parametrize("bad", [np.nan, np.inf, "deep"])
def test_a_bad_height_is_one_line(scene, bad):
    with pytest.raises(at.InputError, match="ground"):
        at.render(scene, camera(), LIGHTS[1], ground=bad)


@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
@pytest.mark.parametrize("cutouts", [False, True])
def test_a_store_has_the_ground_of_its_scene(tmp_path, scene, kind, cutouts):
    scene = scene_with_cutouts() if cutouts else scene
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    stored, view = at.load(tmp_path / "a.antumbra"), scene.default_camera(40, 30, kind)
    assert stored.ground_height() == scene.ground_height()
    options = {"spp": 4, "adaptive": 16, "ground": True, "filter": True}
    a, b = (at.render(each, view, LIGHTS, **options) for each in (scene, stored))
    for name, mine, other in zip(a.ground._fields, a.ground, b.ground):
        np.testing.assert_array_equal(mine, other, err_msg=name)
    np.testing.assert_array_equal(a.image, b.image)
    assert (a.ground.share < 1.0).any() and a.rays == b.rays


def test_bands_of_a_store_have_the_ground_of_the_whole(tmp_path, scene):
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    renderer = Renderer(at.load(tmp_path / "a.antumbra"))
    options = at.RenderOptions(spp=4, adaptive=16, ground=True)
    whole, request = renderer.render(camera(), LIGHTS, options=options), renderer.request(camera(), LIGHTS, options)
    rows = renderer.rows(request)
    bands = [rows.band(first, min(first + 16, SIZE[1])) for first in range(0, SIZE[1], 16)]
    arrays = {name: np.concatenate([band[name] for band in bands]) for name in band_array_names(request)}
    again = Renderer(at.load(tmp_path / "a.antumbra"))  # as a process that merges
    made = again.from_rows(again.request(camera(), LIGHTS, options), bits_of_bands(arrays))
    np.testing.assert_array_equal(made.ground.share, whole.ground.share)
    np.testing.assert_array_equal(made.image, whole.image)
    assert (whole.ground.share < 1.0).any()
