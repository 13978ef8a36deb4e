"""Terrain in a store is traced as in memory: answers have the bits of the scene in memory, and of the store's trees."""

import pickle

import numpy as np
import pytest

import antumbra as at
import gis_files
from antumbra.engine.sources import terrain_shadows
from antumbra.engine.sources.terrain_shadows import TerrainShadows
from antumbra.store.store_file import open_store
from antumbra.trace.terrain import paged_terrain
from forged_stores import ForgedStore

pytest.importorskip("rasterio")

PLACE = (2.0, 0.0, 84000.0, 0.0, -2.0, 446000.0)
FEET = (6.0, 0.0, 980000.0, 0.0, -6.0, 200000.0)  # US survey feet
TALL = (2.0, 0.0, 84000.0, 0.0, -3.0, 446000.0)  # cells that are not square
MERCATOR = (2.0, 0.0, 500000.0, 0.0, -2.0, 400000.0)  # close to the equator


def mountains(shape=(280, 530), holes=80, seed=0):
    """Heights with valleys, a mountain, holes, and a cell without a triangle."""
    random, (y, x) = np.random.default_rng(seed), np.mgrid[: shape[0], : shape[1]]
    heights = 12.0 * np.sin(x / 13.0) * np.cos(y / 9.0) + random.normal(size=shape)
    heights += 60.0 * np.exp(-(((x - 0.4 * shape[1]) / 20.0) ** 2) - ((y - 0.7 * shape[0]) / 20.0) ** 2)
    if holes:
        some = random.integers(0, [[shape[0]], [shape[1]]], (2, holes))
        heights[tuple(some)] = np.nan
        heights[100:140, 500:520] = heights[:20, :35] = np.nan
        heights[5:8, 5] = 9.0
    return heights


RASTERS = {
    "holes": (mountains().astype(np.float32), PLACE, "EPSG:28992"),
    "float64": (mountains(seed=1), PLACE, "EPSG:28992"),
    "whole numbers": (mountains(holes=0).astype(np.int16), PLACE, "EPSG:28992"),
    "turned": (np.ascontiguousarray(mountains().T.astype(np.float32)), PLACE, "EPSG:28992"),
    "feet": ((3.0 * mountains()).astype(np.float32), FEET, "EPSG:2263"),
    "Web Mercator": (mountains(seed=2).astype(np.float32), MERCATOR, "EPSG:3857"),
    "cells that are not square": (mountains(seed=3).astype(np.float32), TALL, "EPSG:28992"),
}


@pytest.fixture(scope="module", params=RASTERS)
def scenes(request, tmp_path_factory):
    """(in memory, in a store, in a store without its heights)."""
    heights, place, crs = RASTERS[request.param]
    folder = tmp_path_factory.mktemp("stored")
    path = gis_files.write_raster(folder / "a.tif", heights, place, crs)
    at.build_store(path, folder / "a.antumbra", chunk=4096)
    return at.from_raster(path), at.load(folder / "a.antumbra"), without_heights(folder / "a.antumbra")


def without_heights(path) -> at.PagedScene:
    """The scene of a store as one of an earlier version, which has no heights."""
    store = open_store(path)
    store.meta = store.meta._replace(heights=None)
    return at.PagedScene(store)


def stored(tmp_path, heights, place=PLACE, crs="EPSG:28992", **options):
    """(in memory, in a store)."""
    path = gis_files.write_raster(tmp_path / "a.tif", heights, place, crs)
    at.build_store(path, tmp_path / "a.antumbra", **options)
    return at.from_raster(path), at.load(tmp_path / "a.antumbra")


def same(a, b) -> bool:
    return all(np.array_equal(x, y, equal_nan=np.asarray(x).dtype.kind == "f") for x, y in zip(a, b, strict=True))


def rays_over(scene, n=2000, seed=1):
    random = np.random.default_rng(seed)
    low, high = scene.bounds
    origins = random.uniform(low - [9.0, 9.0, 0.0], high + [9.0, 9.0, 20.0], (n, 3))
    directions = random.normal(size=(n, 3)) * [1.0, 1.0, 0.2]
    return origins, directions


def test_the_heights_the_cells_and_their_faces_are_those_of_the_raster(scenes):
    memory, store, trees = scenes
    assert isinstance(store.engine.terrain, TerrainShadows) and trees.engine.terrain is None
    assert np.array_equal(store.data.terrain.rows(0, store.data.terrain.grid.rows), memory.data.terrain.heights, True)
    assert store.data.terrain.grid == memory.data.terrain.grid and store.raster == memory.raster
    assert store.data.terrain.dtype == memory.data.terrain.dtype
    assert same(store.data.cell_tops(), memory.data.cell_tops())
    plan = rays_over(memory)[0][:, :2]
    assert same([store.data.terrain.at(plan)], [memory.data.terrain.at(plan)])
    assert (store.origin == memory.origin).all() and [each.type for each in store.objects] == ["TINRelief"]


def test_rays_have_the_bits_of_the_scene_in_memory_and_of_the_trees(scenes):
    memory = scenes[0]
    origins, directions = rays_over(memory)
    blocked = [scene.occluded(origins, directions) for scene in scenes]
    assert (blocked[0] == blocked[1]).all() and (blocked[0] == blocked[2]).all() and 0.2 < blocked[0].mean() < 0.8
    hits = [scene.closest_hit(origins, directions) for scene in scenes]
    for name in "face", "t", "u", "v", "normal":
        first, *others = (getattr(hit, name) for hit in hits)
        assert same([first, first], others), name
    culled = [scene.closest_hit(origins, directions, cull_faces="back", tmax=80.0) for scene in scenes]
    assert same([culled[0].face, culled[0].t], [culled[1].face, culled[1].t])
    assert same([culled[0].face, culled[0].t], [culled[2].face, culled[2].t]) and (culled[0].t != hits[0].t).any()
    skipped = [scene.occluded(origins, directions, skip_face=np.maximum(hits[0].face, 0)) for scene in scenes]
    assert (skipped[0] == skipped[1]).all() and (skipped[0] == skipped[2]).all()
    some = slice(0, 200)
    every = [scene.all_hits(origins[some], directions[some]) for scene in scenes]
    assert same([every[0].face, every[0].t], [every[1].face, every[1].t]) and len(every[0].face)


@pytest.mark.parametrize(
    "light",
    [
        at.DirectionalLights(-np.array([[1.0, 0.01, 0.1], [0.2, -1.0, 0.3], [-1.0, 0.4, -0.2]])),
        at.PointLights(np.array([[300.0, -200.0, 90.0], [500.0, -100.0, 3000.0]])),
        at.AmbientOcclusion(),
    ],
    ids=["suns", "points", "sky"],
)
def test_lights_have_the_bits_of_the_scene_in_memory_and_of_the_trees(scenes, light):
    memory = scenes[0]
    if isinstance(light, at.PointLights):
        light = at.PointLights(light.positions + [*memory.bounds[[0, 1], [0, 1]], 0.0])
    grid = memory.data.terrain.grid
    rows, columns = np.mgrid[20:120, 60:200]
    points = np.stack([grid.eastings()[columns.ravel()], grid.northings()[rows.ravel()], np.zeros(rows.size)], 1)
    points[:, 2] = np.nan_to_num(memory.data.terrain.at(points[:, :2])) + 0.5
    normals = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    bits = [at.visibility(scene, points, light, normals, spp=4) for scene in scenes]
    assert (bits[0].bits == bits[1].bits).all() and (bits[0].bits == bits[2].bits).all()
    assert bits[0].seen_samples.mean() > 0.01


def test_studies_have_the_results_of_the_scene_in_memory(scenes):
    memory, store, _ = scenes
    if memory.raster is None:
        return
    options = {"days": "2026-12-21", "step": 120}
    hours = [at.sun_hours(scene, at.raster_sensors(scene, None), **options) for scene in (memory, store)]
    assert same([hours[0]["sun_hours"]], [hours[1]["sun_hours"]]) and np.ptp(hours[0]["sun_hours"]) > 0.0
    eye = [*memory.bounds.mean(0)[:2], memory.bounds[1, 2]]
    seen = [at.viewshed(scene, at.raster_sensors(scene, None), eye) for scene in (memory, store)]
    for name in "seen", "first", "nearest", "distance":
        assert same([seen[0].table[name]], [seen[1].table[name]]), name
    assert 0.0 < seen[0].table["seen"].mean() < 1.0
    least = [at.viewshed(scene, at.raster_sensors(scene, None), eye, least_height=True) for scene in (memory, store)]
    assert same([least[0].table["least_height"]], [least[1].table["least_height"]])


def test_terrain_among_other_objects_is_traced_by_trees(tmp_path):
    memory, alone = stored(tmp_path, mountains().astype(np.float32))
    box = at.Scene.from_arrays(np.array([[[84100, 445900, 0], [84140, 445900, 0], [84140, 445940, 40.0]]]), up="z")
    at.build_store([memory, box], tmp_path / "both.antumbra", chunk=4096)
    both = at.load(tmp_path / "both.antumbra")
    assert both.data.terrain is None and both.engine.terrain is None and alone.engine.terrain is not None
    rays = rays_over(alone)
    joined = at.Scene.from_arrays(np.concatenate([memory.data.corners(), box.data.corners()]), up="z")
    assert (both.occluded(*rays) == joined.occluded(*rays)).all()


def test_tiles_of_one_surface_are_terrain(tmp_path):
    heights = mountains(holes=0).astype(np.float32)
    east = (*PLACE[:2], PLACE[2] + 2.0 * 300, *PLACE[3:])
    gis_files.write_raster(tmp_path / "b.tif", heights[:, 300:], east)
    gis_files.write_raster(tmp_path / "a.tif", heights[:, :300])
    gis_files.write_raster(tmp_path / "a.tif", heights[:, :300], PLACE)
    at.build_store([tmp_path / "a.tif", tmp_path / "b.tif"], tmp_path / "a.antumbra")
    memory, store = at.from_raster([str(tmp_path / f"{k}.tif") for k in "ab"]), at.load(tmp_path / "a.antumbra")
    rays = rays_over(memory)
    assert store.engine.terrain is not None and (memory.occluded(*rays) == store.occluded(*rays)).all()


@pytest.mark.parametrize("max_memory", ["none", "window", "whole"])
def test_heights_beyond_the_memory_are_read_by_window_or_traced_by_trees(tmp_path, monkeypatch, max_memory):
    memory, store = stored(tmp_path, mountains((900, 500)).astype(np.float32), chunk=4096)
    cells = at.raster_sensors(memory, None)
    some = np.arange(100 * 500, 200 * 500)
    points, up = cells.points[some], cells.normals[some]
    lights = at.DirectionalLights(-np.array([[0.3, 1.0, 0.4], [1.0, -0.2, 0.5]]))
    size = paged_terrain.PAGED_BYTES * memory.raster.n_cells
    left = {"none": 0, "window": int(0.7 * size), "whole": int(1.1 * size)}[max_memory]
    monkeypatch.setattr(type(store.engine.source), "left", lambda self: left)
    bits = [at.visibility(scene, points, lights, up) for scene in (memory, store)]
    assert (bits[0].bits == bits[1].bits).all() and 0.05 < bits[0].seen_samples.mean() < 1.95
    held = store.data._surface.pages.held
    assert {"none": held == 0.0, "window": 0.0 < held <= left, "whole": held == size}[max_memory]
    rays = rays_over(memory)
    assert (memory.occluded(*rays) == store.occluded(*rays)).all()
    assert same([memory.closest_hit(*rays).t], [store.closest_hit(*rays).t])
    eye = [*memory.bounds.mean(0)[:2], memory.bounds[1, 2]]
    seen = [at.viewshed(scene, cells, eye).table["nearest"] for scene in (memory, store)]
    assert same([seen[0]], [seen[1]])


@pytest.mark.parametrize("seconds", [0.0, 1e9])
def test_long_lists_of_slow_rays_are_traced_by_trees_with_the_same_bits(tmp_path, monkeypatch, seconds):
    memory, store = stored(tmp_path, mountains().astype(np.float32), chunk=4096)
    monkeypatch.setattr(terrain_shadows, "_SLOW", seconds)
    source, traced = type(store.engine.source), []
    trace = source.trace_rays
    counted = lambda self, rays, *more: traced.append(rays.n) or trace(self, rays, *more)
    monkeypatch.setattr(source, "trace_rays", counted)
    for n in 2000, 6000:
        rays = rays_over(memory, n)
        assert (memory.occluded(*rays) == store.occluded(*rays)).all()
        assert same([memory.closest_hit(*rays).t], [store.closest_hit(*rays).t])
    assert traced == ([6000, 6000] if seconds == 0.0 else [])


def test_a_store_is_pickled_without_the_heights_that_were_read(tmp_path):
    memory, store = stored(tmp_path, mountains().astype(np.float32))
    rays = rays_over(memory)
    blocked = store.occluded(*rays)
    assert store.data._surface.pages.held > 0.0
    text = pickle.dumps(store)
    assert len(text) < 20_000 and (pickle.loads(text).occluded(*rays) == blocked).all()


def test_heights_take_four_bytes_a_cell_and_the_bytes_do_not_depend_on_memory(tmp_path):
    heights = mountains().astype(np.float32)
    _, store = stored(tmp_path, heights)
    section = store.store.meta.heights
    assert heights.nbytes <= section.bytes < heights.nbytes + 4096
    whole = (tmp_path / "a.antumbra").read_bytes()
    at.build_store(tmp_path / "a.tif", tmp_path / "b.antumbra", max_memory=400 << 20, threads=1)
    assert (tmp_path / "b.antumbra").read_bytes() == whole
    at.build_store(at.from_raster(tmp_path / "a.tif"), tmp_path / "c.antumbra")
    assert (tmp_path / "c.antumbra").read_bytes() == whole


@pytest.mark.parametrize("place", [0.0, 0.5, 1.0])
def test_damaged_heights_are_refused(tmp_path, place):
    memory, store = stored(tmp_path, mountains((300, 30)).astype(np.float32))
    section, data = store.store.meta.heights, bytearray((tmp_path / "a.antumbra").read_bytes())
    data[section.offset + int(place * (section.bytes - 1))] ^= 4
    (tmp_path / "a.antumbra").write_bytes(data)
    with pytest.raises(at.InputError, match=r"a\.antumbra: its heights are damaged; copy the file again"):
        at.load(tmp_path / "a.antumbra").occluded(*rays_over(memory))
    with pytest.raises(at.InputError, match="its heights are damaged"):
        open_store(tmp_path / "a.antumbra").heights().check()


OTHER_SECTIONS = {
    "offset": lambda s: [s[0] + 4096, *s[1:]],
    "bytes": lambda s: [s[0], s[1] - 4096, *s[2:]],
    "rows": lambda s: [*s[:2], [*s[2][:4], 10**9, s[2][5]], *s[3:]],
    "one row": lambda s: [*s[:2], [*s[2][:4], 1, s[2][5]], *s[3:]],
    "spacing": lambda s: [*s[:2], [*s[2][:2], -2.0, *s[2][3:]], *s[3:]],
    "place": lambda s: [*s[:2], [float("nan"), *s[2][1:]], *s[3:]],
    "another place": lambda s: [*s[:2], [s[2][0] + 2.0, *s[2][1:]], *s[3:]],
    "dtype": lambda s: [*s[:3], "<i4", s[4]],
    "checksums": lambda s: [*s[:4], []],
    "a text": lambda s: [*s[:4], ["x" for _ in s[4]]],
    "nothing": lambda s: [],
    "a number": lambda s: 7,
}


@pytest.mark.parametrize("change", OTHER_SECTIONS)
def test_forged_places_of_heights_are_refused(tmp_path, change):
    stored(tmp_path, mountains((300, 30)).astype(np.float32))
    forged = ForgedStore((tmp_path / "a.antumbra").read_bytes())
    forged.meta["heights"] = OTHER_SECTIONS[change](forged.meta["heights"])
    (tmp_path / "a.antumbra").write_bytes(forged.data)
    with pytest.raises(at.InputError, match=r"^a\.antumbra: "):
        at.load(tmp_path / "a.antumbra")


def test_heights_of_another_surface_are_refused(tmp_path):
    memory, _ = stored(tmp_path, mountains((60, 30), 0).astype(np.float32))
    forged = ForgedStore((tmp_path / "a.antumbra").read_bytes())
    for change in (lambda z: z + 1.0), (lambda z: np.where(z == z[20, 20], np.nan, z)), (lambda z: z * np.inf):
        forged.change_heights(change)
        (tmp_path / "a.antumbra").write_bytes(forged.data)
        with pytest.raises(at.InputError, match=r"^a\.antumbra: its heights are "):
            at.load(tmp_path / "a.antumbra").occluded(*rays_over(memory))
