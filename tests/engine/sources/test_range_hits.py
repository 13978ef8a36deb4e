"""Tiles answer every query with the bits of a single store, also in several ranges of faces and beyond 2^32 faces."""

import shutil
from contextlib import closing

import numpy as np
import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.picture.frame_request import TimeSample
from antumbra.picture.image_files import exr_channels
from antumbra.picture.renderer import Renderer
from antumbra.picture.traversal_steps import explain
from antumbra.store import tiled_store
from antumbra.store.tiled_store import manifest_from_json, manifest_to_json
from gis_files import write_raster

FAR = (1 << 33) + 7  # number of the first face of far tiles
SIZE = 72, 60


class Case:
    """A single store, and its tiles in several ranges."""

    def __init__(self, folder, scene, tiles):
        self.one, self.tiles, self._opened = folder / "one.antumbra", folder / "all.tiles", []
        at.build_store(scene, self.one, chunk=64)
        self.n = self.load(self.one).n_triangles
        at.build_store(scene, self.tiles, chunk=64, tile=self.n // tiles)

    def load(self, path):
        self._opened.append(at.load(path))
        return self._opened[-1]

    def close(self):
        for scene in self._opened:
            scene.store.close()

    def single(self):
        return self.load(self.one)

    def opened(self, monkeypatch, ranges):
        """The tiles in at least so many ranges."""
        if ranges > 1:
            monkeypatch.setattr(tiled_store, "MAX_TRIANGLES", 2 * self.n // 3 if ranges == 2 else self.n // 4)
        scene = self.load(self.tiles)
        assert len(scene.store.ranges) >= ranges and scene.store.ranges[0].is_all == (ranges == 1)
        return scene


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    with closing(Case(tmp_path_factory.mktemp("city"), at.procedural("city", triangles=6_000), 7)) as case:
        yield case


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    """Terraces: rays straight down through vertices meet up to six triangles at once, also of two tiles."""
    folder = tmp_path_factory.mktemp("terrain")
    heights = np.random.default_rng(5).integers(0, 4, (40, 31)).astype(np.float32)
    heights[10:14, 5:20] = -9999.0
    write_raster(folder / "dem.tif", heights, nodata=-9999.0)
    with closing(Case(folder, str(folder / "dem.tif"), 6)) as case:
        yield case


@pytest.fixture(params=["city", "terrain"])
def case(request):
    return request.getfixturevalue(request.param)


def rays_in(scene, n=3000):
    """Rays between random points, and rays straight down that meet edges and vertices of terrain."""
    rng = np.random.default_rng(2)
    points = rng.uniform(*scene.bounds, (2, n, 3))
    up = "xyz".index(scene.up)
    above = points[0].copy()
    above[:, up] = scene.bounds[1, up] + 1.0
    across = [k for k in range(3) if k != up]
    above[:, across] = scene.bounds[0, across] + np.round((above[:, across] - scene.bounds[0, across]) * 2.0) / 2.0
    down = np.zeros((n, 3))
    down[:, up] = -1.0
    return np.concatenate([points[0], above]), np.concatenate([points[1] - points[0], down])


def equal(a, b):
    return all(np.array_equal(x, y, equal_nan=True) for x, y in zip(a, b, strict=True))


RANGES = pytest.mark.parametrize("ranges", [1, 2, 4])


@RANGES
@pytest.mark.parametrize("options", [{}, {"cull_faces": "back"}, {"tmin": 0.1, "tmax": 0.7}], ids=str)
def test_ray_lists_have_the_hits_of_a_single_store(case, monkeypatch, ranges, options):
    one, tiles = case.single(), case.opened(monkeypatch, ranges)
    rays = rays_in(one)
    hits, found = one.closest_hit(*rays, **options), tiles.closest_hit(*rays, **options)
    assert hits.mask.mean() > 0.05 and equal(hits, found)
    assert found.face.dtype == (np.int32 if ranges == 1 else np.int64)
    assert equal([hits.corners, hits.normal, hits.object], [found.corners, found.normal, found.object])
    assert np.array_equal(one.occluded(*rays, **options), tiles.occluded(*rays, **options))
    for more in ({}, {"max_hits": 2}):
        assert equal(one.all_hits(*rays, **options, **more), tiles.all_hits(*rays, **options, **more))
    assert np.array_equal(one.count_hits(*rays, **options), tiles.count_hits(*rays, **options))


@RANGES
def test_rays_skip_faces_of_any_tile(case, monkeypatch, ranges):
    one, tiles = case.single(), case.opened(monkeypatch, ranges)
    rays = rays_in(one)
    hits = one.closest_hit(*rays)
    others = np.random.default_rng(3).integers(0, case.n, hits.face.shape)
    skip = np.where(np.arange(len(others)) % 3 > 0, hits.face, others)
    skipped, found = one.closest_hit(*rays, skip_face=skip), tiles.closest_hit(*rays, skip_face=skip)
    assert (skipped.face != hits.face).mean() > 0.05 and equal(skipped, found)
    assert np.array_equal(one.occluded(*rays, skip_face=skip), tiles.occluded(*rays, skip_face=skip))
    assert equal(one.all_hits(*rays, skip_face=skip), tiles.all_hits(*rays, skip_face=skip))


def test_terraces_have_hits_that_only_the_number_of_the_face_decides(terrain, monkeypatch):
    tiles = terrain.opened(monkeypatch, 4)
    hits = tiles.all_hits(*rays_in(tiles))
    ends = np.array([each.first for each in tiles.store.ranges[1:]])
    ties = (hits.t[1:] == hits.t[:-1]) & (hits.ray[1:] == hits.ray[:-1])
    apart = np.searchsorted(ends, hits.face[1:], "right") != np.searchsorted(ends, hits.face[:-1], "right")
    assert ties.sum() > 100 and (ties & apart).sum() > 5


def far_away(case, folder):
    """The path of a manifest of the same tiles, with gaps between their numbers, beyond 2^33."""
    shutil.copytree(case.tiles.parent, folder)
    path = folder / case.tiles.name
    meta, tiles = manifest_from_json(path.read_bytes(), path.name)
    moved = [tile._replace(first=tile.first + FAR + 3_000_000_000 * k) for k, tile in enumerate(tiles)]
    last = moved[-1].first + moved[-1].triangles
    path.write_bytes(manifest_to_json(meta._replace(n_triangles=last, objects=None), moved))
    firsts, offsets = (
        np.array([tile.first for tile in tiles]),
        np.array([b.first - a.first for a, b in zip(tiles, moved)]),
    )

    def renumbered(faces):
        tile = np.searchsorted(firsts, faces, "right") - 1
        return np.where(faces >= 0, faces + offsets[tile], -1)

    return path, renumbered


def test_faces_beyond_32_bits_come_back(case, tmp_path):
    path, renumbered = far_away(case, tmp_path / "far")
    one, tiles = case.single(), case.load(path)
    assert tiles.n_triangles > 1 << 34 and len(tiles.store.ranges) > 5
    rays = rays_in(one)
    hits, found = one.closest_hit(*rays), tiles.closest_hit(*rays)
    assert found.face.dtype == np.int64 and found.face.max() > 1 << 33
    assert equal((hits.t, renumbered(hits.face), hits.u, hits.v), found)
    assert np.array_equal(hits.corners, found.corners, equal_nan=True) and (found.object[found.mask] == 0).all()
    skipped = one.closest_hit(*rays, skip_face=hits.face)
    assert np.array_equal(renumbered(skipped.face), tiles.closest_hit(*rays, skip_face=found.face).face)
    every, of_tiles = one.all_hits(*rays), tiles.all_hits(*rays)
    assert np.array_equal(renumbered(every.face), of_tiles.face) and np.array_equal(every.t, of_tiles.t)
    with pytest.raises(InputError, match=rf"skip_face must lie between -1 and {tiles.n_triangles - 1}"):
        tiles.closest_hit(*rays, skip_face=tiles.n_triangles)


LIGHTS = [
    at.QuadLight((-30, 60, -20), (30, 0, 0), (0, 0, 30)),
    at.DirectionalLight((0.4, -1, 0.3)),
    at.AmbientOcclusion(3.0),
]


def same_frames(frame, other, renumbered=lambda faces: faces):
    for name in ("position", "normal", "depth", "side"):
        assert np.array_equal(getattr(frame.gbuffer, name), getattr(other.gbuffer, name), equal_nan=True), name
    assert np.array_equal(renumbered(frame.gbuffer.face), other.gbuffer.face)
    assert len(frame.bits) == len(other.bits) and all(np.array_equal(*pair) for pair in zip(frame.bits, other.bits))
    assert np.array_equal(frame.image, other.image)


@RANGES
@pytest.mark.parametrize("options", [{}, {"adaptive": 4, "filter": True}], ids=str)
def test_pictures_are_those_of_a_single_store(city, monkeypatch, ranges, options):
    one, tiles = city.single(), city.opened(monkeypatch, ranges)
    renderer, other = Renderer(tiles, None, 2), Renderer(one, None, 2)
    for camera in (one.cameras[0].resized(*SIZE), at.Camera((7, 1.7, 30), (7, 3, -60), width=SIZE[0], height=SIZE[1])):
        same_frames(other.render(camera, LIGHTS, spp=4, **options), renderer.render(camera, LIGHTS, spp=4, **options))


@RANGES
def test_light_that_bounces_has_the_bits_of_a_single_store(city, monkeypatch, ranges):
    one, tiles = city.single(), city.opened(monkeypatch, ranges)
    camera = at.Camera((7, 1.7, 30), (7, 3, -60), width=32, height=24)
    frame, other = (at.render(each, camera, LIGHTS[:2], spp=2, bounce=2, threads=2) for each in (one, tiles))
    same_frames(frame, other)
    assert np.array_equal(frame.indirect, other.indirect)


def test_pictures_show_faces_beyond_32_bits(city, tmp_path):
    path, renumbered = far_away(city, tmp_path / "far")
    one, tiles = city.single(), city.load(path)
    camera = one.cameras[0].resized(*SIZE)
    frame, other = (Renderer(each, None, 2).render(camera, LIGHTS, spp=4) for each in (one, tiles))
    assert other.gbuffer.face.max() > 1 << 33
    same_frames(frame, other, renumbered)


@RANGES
def test_points_see_the_lights_of_a_single_store(city, monkeypatch, ranges):
    one, tiles = city.single(), city.opened(monkeypatch, ranges)
    points = np.random.default_rng(3).uniform((-40, 0.2, -40), (40, 12, 40), (500, 3))
    for light in LIGHTS[:2]:
        truth, found = (at.visibility(each, points, light, spp=20) for each in (one, tiles))
        assert 0.05 < truth.fraction.mean() < 0.95 and np.array_equal(truth.bits, found.bits)


@RANGES
def test_sun_hours_are_those_of_a_single_store(terrain, monkeypatch, ranges):
    one, tiles = terrain.single(), terrain.opened(monkeypatch, ranges)
    tables = [at.sun_hours(each, "raster", "2026-12-21", step=60) for each in (one, tiles)]
    hours, found = (table["sun_hours"] if "sun_hours" in table.columns else table["hours"] for table in tables)
    assert np.nanmax(hours) > np.nanmin(hours) and np.array_equal(hours, found, equal_nan=True)


def test_tiles_share_one_budget(city, monkeypatch):
    tiles = city.opened(monkeypatch, 4)
    renderer = Renderer(tiles, None, 2)
    paged, camera = renderer.source, tiles.cameras[0].resized(*SIZE)
    whole = renderer.render(camera, LIGHTS[:1], spp=4)
    limit = paged.residency.min_budget() * 2
    monkeypatch.setattr(paged, "budget", lambda *_: limit)
    frame = renderer.render(camera, LIGHTS[:1], spp=4)
    assert frame.paging["loaded"] > 50 and paged.residency.used <= limit
    same_frames(whole, frame)


def test_steps_are_counted_in_a_tile_not_in_several_ranges(city, monkeypatch):
    tiles = city.opened(monkeypatch, 2)
    with pytest.raises(InputError, match=r"has too many faces for this; explain one of its tiles"):
        explain(tiles, [TimeSample(0.0, tiles.cameras[0].resized(*SIZE), LIGHTS[:1])], ["bsah+chcrt"], spp=1)


# --- Jobs that number faces -------------------------------------------------------------------------------------------


def test_lines_of_sight_name_faces_beyond_32_bits(terrain, tmp_path):
    path, renumbered = far_away(terrain, tmp_path / "far")
    one, tiles = terrain.single(), terrain.load(path)
    points = np.random.default_rng(4).uniform(*one.bounds, (2, 400, 3))
    lines, found = (at.line_of_sight(each, *points) for each in (one, tiles))
    assert 0.02 < lines.visible.mean() < 0.95 and np.array_equal(lines.visible, found.visible)
    assert found.face.max() > 1 << 33 and np.array_equal(renumbered(lines.face), found.face)


def test_exr_files_hold_both_halves_of_ids(city, tmp_path):
    path, _ = far_away(city, tmp_path / "far")
    tiles = city.load(path)
    frame = at.render(tiles, tiles.cameras[0].resized(*SIZE), LIGHTS[1], spp=1)
    channels = exr_channels(frame)
    ids = channels["triangle.high"].astype(np.int64) << 32 | channels["triangle.id"]
    assert channels["triangle.id"].dtype == channels["triangle.high"].dtype == np.uint32
    assert (
        np.array_equal(np.where(frame.mask, ids, -1), frame.gbuffer.face)
        and ids[frame.mask.astype(bool)].max() > 1 << 33
    )
    frame.save(tmp_path / "a.exr")


def test_data_sets_refuse_faces_beyond_their_layers(city, tmp_path):
    tiles = city.load(far_away(city, tmp_path / "far")[0])
    with pytest.raises(InputError, match=r"data sets number at most 2\^31 - 1 faces; use one of its tiles"):
        at.dataset(tiles, tmp_path / "set", cameras=2)
    assert not (tmp_path / "set").exists()
