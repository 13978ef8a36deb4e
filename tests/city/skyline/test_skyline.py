"""Skylines: closed forms, brute force over all edges, exact rays above and below, and their files."""

import json
from io import StringIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
from antumbra.scene.alpha_masks import cutouts_of
from cutout_scenes import MASKS, pane, scene_with_cutouts
from scenes import scene_path
from strength import examples

M = 72  # azimuths of small tests
STEP = 360.0 / M


def slopes_of_edges(corners, eye, azimuth):
    """(m,) the greatest slope along each azimuth of all edges, by their crossings with the vertical half-plane.

    corners : (n, 3, 3) easting, northing, height
    """
    a = (corners - eye).reshape(-1, 3)
    b = (np.roll(corners, -1, 1) - eye).reshape(-1, 3)
    out = np.full(len(azimuth), -np.inf)
    for k, angle in enumerate(np.radians(azimuth)):
        along, across = np.array([np.sin(angle), np.cos(angle)]), np.array([np.cos(angle), -np.sin(angle)])
        s, t = a[:, :2] @ across, b[:, :2] @ across
        cut = (s <= 0.0) != (t <= 0.0)
        share = (s[cut] / (s[cut] - t[cut]))[:, None]
        at_cut = a[cut] + share * (b[cut] - a[cut])
        r = at_cut[:, :2] @ along
        out[k] = (at_cut[r > 0.0, 2] / r[r > 0.0]).max(initial=-np.inf)
    return out


def highest_of_edges(corners, eye, step, fine=64):
    """(m,) degrees: the greatest elevation near each azimuth, from samples of it and from the corners in its bin."""
    m = round(360.0 / step)
    samples = (np.arange(m * fine) + 0.5) * step / fine - step / 2.0
    ends = np.arange(m) * step - step / 2.0
    values = np.degrees(np.arctan(slopes_of_edges(corners, eye, samples))).reshape(m, fine).max(1)
    limits = np.degrees(np.arctan(slopes_of_edges(corners, eye, ends)))
    values = np.maximum(values, np.maximum(limits, np.roll(limits, -1)))
    x, y, z = (corners - eye).reshape(-1, 3).T
    k = np.floor(np.degrees(np.arctan2(x, y)) % 360.0 / step + 0.5).astype(int) % m
    np.maximum.at(values, k, np.degrees(np.arctan2(z, np.hypot(x, y))))
    return values


def world(corners, up):
    """Corners (easting, northing, height) in the axes of a scene."""
    return corners if up == "z" else np.stack([corners[..., 0], corners[..., 2], -corners[..., 1]], -1)


def soup(seed, n=40):
    """(n, 3, 3) triangles all around the origin, none above it, of float32 coordinates."""
    rng = np.random.default_rng(seed)
    angle, r = rng.uniform(0, 2 * np.pi, n), rng.uniform(2.0, 30.0, n)
    middle = np.stack([r * np.sin(angle), r * np.cos(angle), rng.uniform(-3, 8, n)], 1)
    corners = middle[:, None] + rng.uniform(-1.0, 1.0, (n, 3, 3)) * [1.0, 1.0, 3.0]
    return corners.astype(np.float32).astype(np.float64)


def scene_of(corners, up="z"):
    """A scene whose frame has its origin at 0, so that corners stay as they are."""
    return at.Scene.from_arrays(world(np.asarray(corners), up), up=up)


def seen_from(scene):
    """(n, 3, 3) float64 easting, northing and height of the corners as kernels see them, in world coordinates."""
    corners = scene.triangles().vertices.astype(np.float64) + scene.triangles().origin
    return corners if scene.up == "z" else np.stack([corners[..., 0], -corners[..., 2], corners[..., 1]], -1)


def rounded(scene, points):
    """Points as kernels see them: rounded to float32 in the frame of the scene."""
    origin = scene.triangles().origin
    return (np.asarray(points) - origin).astype(np.float32).astype(np.float64) + origin


# --- Closed forms -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_wall(up):
    wall = np.array([[-20, 10, 0], [20, 10, 0], [20, 10, 6], [-20, 10, 6]], float)
    scene = scene_of(wall[[[0, 1, 2], [0, 2, 3]]], up)
    skyline = at.skyline(scene, world(np.array([[0.0, 0.0, 1.0]]), up), azimuth_step=STEP)
    angle = (skyline.azimuth + 180.0) % 360.0 - 180.0
    in_front = np.abs(angle) < np.degrees(np.arctan2(20, 10))
    cosine = np.cos(np.radians(angle))
    want = np.where(in_front, np.degrees(np.arctan(5.0 * cosine / 10.0)), -90.0)
    assert 0 < in_front.sum() < M
    assert np.allclose(skyline.elevation[0], want, atol=1e-9, rtol=0)
    nearest = np.maximum(np.abs(angle) - STEP / 2.0, 0.0)  # the azimuth in each bin at which the wall is highest
    reached = nearest <= np.degrees(np.arctan2(20, 10))
    want = np.where(reached, np.degrees(np.arctan(5.0 * np.cos(np.radians(nearest)) / 10.0)), -90.0)
    assert np.allclose(skyline.highest[0], want, atol=1e-9, rtol=0) and reached.sum() > in_front.sum()


def test_a_cone_of_terrain():
    """Tangents of a cone's outline; from inside its foot, the apex."""
    n, radius, apex = 720, 100.0, 50.0
    angle = np.arange(n) * 2 * np.pi / n
    foot = np.stack([radius * np.sin(angle), 300.0 + radius * np.cos(angle), np.zeros(n)], 1)
    faces = np.stack([foot, np.roll(foot, -1, 0), np.broadcast_to([0.0, 300.0, apex], foot.shape)], 1)
    scene = scene_of(faces)
    skyline = at.skyline(scene, [[0.0, 0.0, 0.0]], azimuth_step=1.0)
    azimuth = np.radians((skyline.azimuth + 180.0) % 360.0 - 180.0)
    # z / r over the half-plane's section of the cone z = apex (1 - d / radius), which is highest where d z_r = z d_r.
    r = np.linspace(150.0, 450.0, 60_001)[:, None]
    d = np.hypot(r * np.sin(azimuth), r * np.cos(azimuth) - 300.0)
    slope = np.where(d <= radius, apex * (1.0 - d / radius) / r, -np.inf).max(0)
    hit = slope > 0.01
    assert 20 < hit.sum() < 60 and skyline.elevation[0, 0] == pytest.approx(
        np.degrees(np.arctan2(apex, 300.0)), abs=1e-6
    )
    assert np.allclose(skyline.elevation[0, hit], np.degrees(np.arctan(slope[hit])), atol=0.01, rtol=0)
    assert (skyline.elevation[0, np.abs(azimuth) > np.arcsin(radius / 300.0)] == -90.0).all()


def test_a_ring_hides_the_share_of_the_sky_below_it():
    n, radius, height = 2000, 10.0, 5.0
    angle = np.arange(n + 1) * 2 * np.pi / n
    low = np.stack([radius * np.sin(angle), radius * np.cos(angle), np.zeros(n + 1)], 1)
    high = low + [0, 0, height]
    scene = scene_of(
        np.concatenate([np.stack([low[:-1], low[1:], high[1:]], 1), np.stack([low[:-1], high[1:], high[:-1]], 1)])
    )
    skyline = at.skyline(scene, [[0.0, 0.0, 0.0]])
    elevation = np.arctan2(height, radius)
    assert skyline.sky_view_factor()[0] == pytest.approx(np.cos(elevation) ** 2, abs=1e-5)
    # A wall sees half of the ring: integrate cos(e) max(n d, 0) over the open directions.
    assert skyline.sky_view_factor(90.0)[0] == pytest.approx(
        (np.pi / 2 - elevation - np.sin(elevation) * np.cos(elevation)) / np.pi, abs=1e-4
    )


@pytest.mark.parametrize("tilt", [0.0, 20.0, 90.0, 135.0, 180.0])
def test_a_plane_on_open_ground_sees_its_share_of_the_sky(tilt):
    ground = np.array([[-1e3, -1e3, 0], [1e3, -1e3, 0], [1e3, 1e3, 0], [-1e3, 1e3, 0]])
    scene = scene_of(ground[[[0, 1, 2], [0, 2, 3]]])
    open_ground = at.skyline(scene, [[0.0, 0.0, 1.0]])
    assert (open_ground.elevation < 0.0).all() and (open_ground.elevation > -1.0).all()
    assert open_ground.sky_view_factor(tilt, 90.0)[0] == pytest.approx((1 + np.cos(np.radians(tilt))) / 2, abs=1e-4)


def test_sky_view_traces_the_same_share_of_the_sky():
    scene = at.procedural("city", triangles=3000)
    points = np.random.default_rng(4).uniform([-40, 1.5, -40], [40, 1.5, 40], (30, 3))
    skyline = at.skyline(scene, points, azimuth_step=1.0)
    rays = at.sky_view(scene, at.point_sensors(points, np.broadcast_to([0.0, 1.0, 0.0], points.shape)), directions=4096)
    free = skyline.elevation[:, 0] < 90.0
    assert free.sum() > 10 and np.ptp(rays["sky_view"][free]) > 0.2
    # Trees have sky below their crowns, so the skyline sees less; it never sees more than rays do.
    share = skyline.sky_view_factor()[free]
    assert (share <= rays["sky_view"][free] + 0.01).all()
    assert np.median(np.abs(share - rays["sky_view"][free])) < 0.02


def test_below_a_roof_all_is_closed():
    roof = np.array([[[-1, -1, 3], [1, -1, 3], [0, 2, 3]]], float)
    skyline = at.skyline(
        scene_of(roof), [[0.0, 0.0, 1.0], [0.0, 5.0, 1.0], [1.0, -1.0, 0.0], [0.0, 0.0, 4.0]], azimuth_step=STEP
    )
    assert (skyline.elevation[[0, 2]] == 90.0).all() and (skyline.highest[[0, 2]] == 90.0).all()
    assert (skyline.elevation[[1, 3]] < 90.0).all() and skyline.sky_view_factor()[0] == 0.0


def test_north_turns_the_skyline():
    scene = scene_of(soup(1))
    plain = at.skyline(scene, [[0.0, 0.0, 0.0]], azimuth_step=STEP)
    for turn in (STEP, -3 * STEP, 360.0 - STEP):
        turned = at.skyline(scene, [[0.0, 0.0, 0.0]], azimuth_step=STEP, north=turn)
        shift = round(turn / STEP)
        assert np.allclose(turned.elevation, np.roll(plain.elevation, -shift, 1), atol=1e-9)
        assert np.allclose(turned.highest, np.roll(plain.highest, -shift, 1), atol=1e-9)
    assert np.ptp(plain.elevation) > 10.0


def test_grid_convergence_of_the_crs():
    corners = soup(2) + [400_000.0, 5_800_000.0, 0.0]
    scene = at.Scene.from_arrays(corners, up="z")
    scene.crs = "EPSG:32632"
    eye = [[400_000.0, 5_800_000.0, 0.0]]
    north = at.place_of(scene).north
    skyline = at.skyline(scene, eye, azimuth_step=STEP)
    assert abs(north) > 0.5 and skyline.about["north"] == north
    assert np.array_equal(skyline.elevation, at.skyline(scene, eye, azimuth_step=STEP, north=north).elevation)
    assert not np.array_equal(skyline.elevation, at.skyline(scene, eye, azimuth_step=STEP, north=0.0).elevation)


# --- Brute force ------------------------------------------------------------------------------------------------------


@examples(15)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["y", "z"]))
def test_soups_equal_brute_force_over_all_edges(seed, up):
    scene = scene_of(soup(seed), up)
    eyes = np.random.default_rng(seed).uniform(-1.0, 1.0, (3, 3)) * [1, 1, 6]
    skyline = at.skyline(scene, world(eyes, up), azimuth_step=STEP)
    here = rounded(scene, world(eyes, up))
    here = here if up == "z" else here[:, [0, 2, 1]] * [1, -1, 1]
    for k, eye in enumerate(here):
        if skyline.elevation[k, 0] == 90.0:
            continue
        want = np.degrees(np.arctan(slopes_of_edges(seen_from(scene), eye, skyline.azimuth)))
        assert np.allclose(skyline.elevation[k], want, atol=1e-7, rtol=0)
        least = highest_of_edges(seen_from(scene), eye, STEP)
        assert (skyline.highest[k] >= least - 1e-7).all() and np.allclose(skyline.highest[k], least, atol=0.2, rtol=0)
        assert (skyline.highest[k] >= skyline.elevation[k]).all()


@examples(10)
@given(st.integers(0, 2**32 - 1))
def test_exact_rays_pass_just_above_and_meet_something_below(seed):
    scene = scene_of(soup(seed, 200))
    skyline = at.skyline(scene, [[0.0, 0.0, 0.0]], azimuth_step=STEP)
    eye, least = rounded(scene, np.zeros((1, 3))), 1e-3

    def blocked(azimuth, elevation):
        azimuth, elevation = np.radians(azimuth), np.radians(elevation)
        flat = np.cos(elevation)
        return scene.occluded(eye, np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1))

    there = skyline.elevation[0] > -90.0
    assert there.any()
    azimuth, elevation = skyline.azimuth[there], skyline.elevation[0, there]
    above = elevation + least + np.linspace(0.0, 1.0, 50)[:, None] * (90.0 - elevation - 2 * least)
    assert not blocked(np.broadcast_to(azimuth, above.shape), above).any()
    # Just below, the ray is blocked, except where the silhouette is a corner thinner than the step downwards.
    assert blocked(azimuth, elevation - least).mean() > 0.9
    beside = (skyline.azimuth + np.linspace(-0.499, 0.499, 21)[:, None] * STEP).ravel()
    top = np.tile(skyline.highest[0], 21)
    assert not blocked(beside, np.minimum(top + least, 90.0)).any()


def test_many_azimuths_and_threads_agree():
    scene = scene_of(soup(5, 300))
    eyes = np.random.default_rng(0).uniform(-20, 20, (40, 3))
    few, many = (
        at.skyline(scene, eyes, azimuth_step=STEP, threads=1),
        at.skyline(scene, eyes, azimuth_step=STEP / 8, threads=2),
    )
    assert np.allclose(few.elevation, many.elevation[:, ::8], atol=1e-9)
    assert (few.highest >= many.elevation[:, ::8] - 1e-9).all()
    inside = np.stack([np.roll(many.highest, k, 1)[:, ::8] for k in range(-3, 4)]).max(0)
    assert (few.highest >= inside - 1e-9).all() and (few.elevation[:, 0] < 90.0).any()


def test_a_point_on_a_tilted_roof_sees_the_roof_behind_it():
    roof = np.array([[-5, 0, 0], [5, 0, 0], [5, 5, 5], [-5, 5, 5]], float)[[[0, 1, 2], [0, 2, 3]]]
    scene = scene_of(roof)
    on = at.skyline(scene, [[0.3, 2.0, 2.0]], normals=[0, -1, 1], azimuth_step=90.0)
    assert on.elevation[0, 0] == pytest.approx(45.0, abs=1e-3) and on.elevation[0, 2] == pytest.approx(-45.0, abs=1e-3)
    lifted = at.skyline(scene, [[0.3, 2.0, -7.0]], on_surface=True, eye_height=1.0, azimuth_step=90.0)
    assert np.allclose(lifted.points, [[0.3, 2.0, 3.0]], atol=1e-6)
    assert lifted.elevation[0, 0] == pytest.approx(np.degrees(np.arctan2(2.0, 3.0)), abs=1e-4)
    assert len(at.skyline(scene, "face", azimuth_step=90.0).points) == 2


def test_instances_have_the_skyline_of_their_copies():
    mesh = soup(7, 5)
    moves = np.repeat(np.eye(4)[None], 3, 0)
    moves[1, :3, 3], moves[2, :3, 3] = [3, 0, 1], [0, -4, 2]
    copies = at.Scene.from_instances([mesh], [moves], up="z")
    flat = scene_of(seen_from(copies))
    found, want = (at.skyline(scene, [0.0, 0.0, 1.0], azimuth_step=STEP) for scene in (copies, flat))
    assert np.allclose(found.elevation, want.elevation, atol=1e-4) and (want.elevation > -90.0).any()


def test_a_store_has_the_skyline_of_its_scene(tmp_path):
    scene = scene_of(np.concatenate([soup(3, 200), [[[-9, -9, 8], [9, -9, 8], [0, 1, 8]]]]))  # with a roof
    assert at.build_store(scene, tmp_path / "a.antumbra", chunk=32).chunks > 4
    eyes = np.random.default_rng(3).uniform(-9, 9, (40, 3))
    found, want = (at.skyline(each, eyes, azimuth_step=STEP) for each in (at.load(tmp_path / "a.antumbra"), scene))
    assert (found.elevation == want.elevation).all() and (found.highest == want.highest).all()
    assert (want.elevation == 90.0).any() and (want.elevation < 90.0).any() and (want.elevation > 0.0).any()


def test_a_store_on_a_curved_earth_has_the_skyline_of_its_scene_if_it_fits_in_memory(tmp_path):
    scene = scene_of(soup(3).astype(np.float32))
    at.build_store(scene, tmp_path / "a.antumbra")
    store = at.load(tmp_path / "a.antumbra")
    found, want = (at.skyline(each, [0, 0, 0], curvature=True) for each in (store, scene))
    assert (found.elevation == want.elevation).all() and (found.highest == want.highest).all()
    store.max_memory = 1 << 20
    with pytest.raises(at.InputError, match=r"needs all .* triangles at once"):
        at.skyline(store, [0, 0, 0], curvature=True)


@pytest.mark.parametrize("kind", ["without area", "clear", "with holes"])
def test_the_highest_point_of_a_store_is_on_a_face_that_is_seen(tmp_path, kind):
    corners = soup(3, 60).astype(np.float32)
    corners[0] = [[3, 0, 90], [3, 1, 90], [3, 0.5, 90.5]] if kind != "without area" else [[3, 0, 90]] * 3
    scene = scene_of(corners)
    if kind != "without area":
        mask = np.full(60, -1, np.int32)
        mask[0] = 0
        uv = np.tile(np.float32([[0, 0], [3, 0], [0, 3]]), (60, 1, 1))
        scene.data.cutouts = cutouts_of(uv, mask, [pane(1.0) if kind == "clear" else MASKS[0]])
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    found, want = (at.skyline(each, [0.0, 0.0, 3.0]) for each in (at.load(tmp_path / "a.antumbra"), scene))
    assert np.array_equal(found.highest, want.highest, equal_nan=True)
    assert np.array_equal(found.elevation, want.elevation)


def test_stored_terrain_on_a_curved_earth_has_the_skyline_of_the_scene(tmp_path):
    hills = at.examples.hills()
    at.build_store(hills, tmp_path / "a.antumbra")
    eye = hills.bounds.mean(0) + [0.0, 0.0, 200.0]
    found, want = (at.skyline(each, eye, curvature=True) for each in (at.load(tmp_path / "a.antumbra"), hills))
    assert np.array_equal(found.elevation, want.elevation) and (want.elevation > -90.0).any()


def test_faces_with_holes_count_as_solid():
    scene = scene_with_cutouts()
    assert scene.cutouts is not None
    eye = scene.bounds.mean(0) + [0.0, 3.0 * np.ptp(scene.bounds[:, 1]), 0.0]
    solid = at.Scene.from_arrays(scene.triangles().vertices + scene.triangles().origin, up=scene.up)
    with_holes, without = at.skyline(scene, [eye], azimuth_step=10.0), at.skyline(solid, [eye], azimuth_step=10.0)
    assert np.allclose(with_holes.elevation, without.elevation, atol=1e-4) and (without.elevation > -90.0).any()


def test_delft_within_a_hundredth_of_a_degree_of_brute_force():
    scene = at.load(scene_path("delft_city/scene.glb"), up="z")
    eyes = np.array([[-29.5, -60.0, 1.6], [100.0, 40.0, 1.6], [0.0, 0.0, 30.0], [10.0, -100.0, 6.0]])
    skyline = at.skyline(scene, eyes)
    assert (skyline.elevation[:, 0] < 90.0).sum() >= 3
    for k, eye in enumerate(rounded(scene, eyes)):
        if skyline.elevation[k, 0] < 90.0:
            want = np.degrees(np.arctan(slopes_of_edges(seen_from(scene), eye, skyline.azimuth)))
            assert np.abs(skyline.elevation[k] - want).max() < 1e-6


# --- Files ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def skyline():
    return at.skyline(scene_of(soup(3)), [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]], azimuth_step=7.5)


def test_files_hold_the_arrays(skyline, tmp_path):
    for suffix in (".csv", ".json", ".npz"):
        skyline.save(tmp_path / f"a{suffix}")
    table = np.genfromtxt(tmp_path / "a.csv", delimiter=",", names=True)
    assert table.dtype.names == ("point", "x", "y", "z", "azimuth", "elevation", "highest") and len(table) == 2 * 48
    assert np.allclose(table["elevation"].reshape(2, 48), skyline.elevation, atol=1e-6)
    document = json.loads((tmp_path / "a.json").read_text())
    assert document["azimuth"] == skyline.azimuth.tolist() and document["about"] == skyline.about
    assert np.allclose(document["highest"], skyline.highest, atol=1e-6) and len(document["sky_view_factor"]) == 2
    with np.load(tmp_path / "a.npz") as arrays:
        assert all(np.array_equal(arrays[name], getattr(skyline, name)) for name in ("elevation", "highest", "points"))


def test_pvgis_and_pvlib_take_the_skyline(skyline, tmp_path):
    values = np.array([float(word) for word in skyline.userhorizon(1, highest=True).split(",")])
    assert len(values) == 48 and (values >= 0.0).all() and (values > 1.0).any()
    assert np.allclose(values, np.maximum(skyline.highest[1], 0.0), rtol=1e-5)
    skyline.save(tmp_path / "horizon.txt", point=0)
    lines = np.loadtxt(StringIO((tmp_path / "horizon.txt").read_text()))
    assert np.allclose(lines, np.maximum(skyline.elevation[0], 0.0), rtol=1e-5)
    series = skyline.series(0)
    assert series.index.name == "horizon_azimuth" and np.array_equal(series.to_numpy(), skyline.elevation[0])
    assert "48 azimuths" in repr(skyline)


def test_bad_input(skyline, tmp_path):
    scene = scene_of(soup(3))
    for words, call in {
        r"^azimuth_step \(degrees\) is 7; it must divide 360": lambda: at.skyline(scene, [[0, 0, 0]], azimuth_step=7.0),
        r"^azimuth_step \(degrees\) is 0": lambda: at.skyline(scene, [[0, 0, 0]], azimuth_step=0.0),
        "there is no point": lambda: at.skyline(scene, np.empty((0, 3))),
        "^points": lambda: at.skyline(scene, [[0, np.nan, 0]]),
        "^north": lambda: at.skyline(scene, [[0, 0, 0]], north=np.nan),
        "holds one point": lambda: skyline.save(tmp_path / "a.txt"),
        r"\.png.*\.csv, \.json, \.npz or \.txt": lambda: skyline.save(tmp_path / "a.png"),
        "^point is 2": lambda: skyline.userhorizon(2),
        "^tilt": lambda: skyline.sky_view_factor(-1.0),
        "^points is 'no such form'": lambda: at.skyline(scene, "no such form"),
    }.items():
        with pytest.raises(at.InputError, match=words):
            call()
    assert not list(tmp_path.iterdir())
