"""Stores are read as they were written, bit for bit. The scenes alone decide the bytes."""

import json
import pickle
import subprocess
import sys
import weakref

import numpy as np
import pytest

import antumbra as at
import gis_files
from antumbra.engine.scene import Scene
from antumbra.engine.store_building import build_store
from antumbra.formats.format_registry import FORMATS
from antumbra.generate import city
from antumbra.generate.generated_scene import StreamedCity
from antumbra.scene.light_lists import PointLights
from antumbra.scene.lights import AmbientOcclusion, DirectionalLight, DiskLight, PointLight, QuadLight, SphereLight
from antumbra.scene.mesh import Piece
from antumbra.store.read_units import ReadUnit
from antumbra.store.staging_files import palette_of
from antumbra.store.store_build import PieceSizes, write_store
from antumbra.store.store_file import open_store
from antumbra.store.store_format import StoreMeta, meta_from_json, meta_to_json
from bvh_scenes import HAZARDS, scattered, terrain
from formats.test_format_registry import sample
from range_server import serving
from stores import CHUNK, built, check_whole, contents, mesh_piece, same_bits, scene_of, soup_scene

RNG = np.random.default_rng(5)
UTM = (448262.5, 5e6, 120.0)
SCENES = {
    "one triangle": soup_scene(scattered(1)),
    "two triangles": soup_scene(scattered(2)),
    "less than a chunk": soup_scene(scattered(CHUNK)),
    "a soup": soup_scene(terrain(5000)),
    "a colour for each": soup_scene(scattered(3000), RNG.random((3000, 3)).astype(np.float32)),
    "float64, far away": scene_of(mesh_piece(RNG, offset=UTM)),
    "float32": scene_of(mesh_piece(RNG, dtype=np.float32, one_colour=True)),
    "copies": scene_of(mesh_piece(RNG, 100, copies=30), mesh_piece(RNG, 3, copies=4, one_colour=True)),
    "nothing, and something": scene_of(
        Piece(np.empty((0, 3, 3)), np.array([[0, 1, 2]], np.int32), np.ones(3, np.float32), "x"), mesh_piece(RNG)
    ),
    "procedural": at.procedural("cellar", triangles=6000),
    "all in one point": soup_scene(np.full((1000, 3, 3), 2.5)),
    "identical": soup_scene(HAZARDS["all identical"]),
    "one dense spot": soup_scene(np.concatenate([scattered(4000) * 1e-5, scattered(900) * 100])),
    "a few dense spots": soup_scene(np.concatenate([scattered(2000) * 1e-3 + k for k in (1e-3, 1, 50)])),
    "huge": soup_scene(scattered(900) * 1e15),
    "tiny": soup_scene(scattered(900) * 1e-28),
}


@pytest.mark.parametrize("name", SCENES)
def test_what_is_written_is_what_is_read(tmp_path, name):
    with built(tmp_path, SCENES[name]) as store:
        check_whole(store, SCENES[name])
        assert store.chunks.triangles.max() <= CHUNK
        if store.n_triangles > 100:
            assert len(store) < 4 * store.n_triangles / CHUNK


def test_scenes_are_merged_in_their_order(tmp_path):
    first, second = at.procedural("atrium", triangles=2000), at.procedural("cellar", triangles=3000)
    store = built(tmp_path, first, second)
    pieces = [*first.source.pieces(0.0), *second.source.pieces(0.0)]
    check_whole(store, scene_of(*pieces))
    assert store.meta.name == "atrium + cellar" and store.meta.up == "y"
    positions = [c.position.tolist() for c in store.meta.cameras]
    assert positions == [c.position.tolist() for c in (*first.cameras, *second.cameras)]
    assert len(store.meta.lights) == 2


def test_a_scene_is_gone_when_the_next_one_is_opened(tmp_path):
    opened = []

    def scenes():
        for k in range(3):
            assert all(scene() is None for scene in opened)
            scene = soup_scene(scattered(70, k))
            opened.append(weakref.ref(scene))
            yield scene
            del scene

    assert isinstance(build_store(scenes(), tmp_path / "a.antumbra", chunk=CHUNK), at.BuildReport)
    assert len(opened) == 3 and open_store(tmp_path / "a.antumbra").n_triangles == 210


@pytest.mark.parametrize("name", ["copies", "a colour for each", "float64, far away", "one dense spot"])
def test_neither_memory_nor_threads_change_a_byte(tmp_path, name):
    path = built(tmp_path, SCENES[name], threads=1).path
    once = path.read_bytes()
    assert built(tmp_path, SCENES[name], threads=3).path.read_bytes() == once
    split = PieceSizes(staged=7, run=50, unit=200)
    write_store([ReadUnit(lambda: [SCENES[name].data])], path, threads=2, chunk=CHUNK, sizes=split)
    assert path.read_bytes() == once
    assert built(tmp_path, SCENES[name], chunk=CHUNK + 1).path.read_bytes() != once


def test_a_streamed_city_is_the_city():
    # Large enough for two groups of blocks, made by two processes.
    whole, streamed = at.procedural("city", triangles=1_700_000, seed=3), StreamedCity(1_700_000, 3, processes=2)
    (mesh,), blocks = whole.source.pieces(0.0), list(streamed.source.pieces(0.0))
    starts = np.cumsum([0, *(b.vertices.shape[1] for b in blocks)])[:-1]
    assert len(blocks) == 81
    assert same_bits(np.concatenate([b.vertices for b in blocks], axis=1), mesh.vertices)
    assert same_bits(np.concatenate([b.faces + np.int32(s) for b, s in zip(blocks, starts)]), mesh.faces)
    assert same_bits(np.concatenate([b.colour for b in blocks]), mesh.colour)
    for a, b in zip((*whole.cameras, *whole.lights), (*streamed.cameras(0.0), *streamed.lights(0.0))):
        assert repr(a) == repr(b)
    assert (streamed.name, streamed.up, streamed.duration) == (whole.name, whole.up, whole.duration)


def test_a_store_of_a_streamed_city(tmp_path):
    whole = at.procedural("city", triangles=30_000)
    for processes in (1, 2, 3):
        with built(tmp_path, StreamedCity(30_000, processes=processes), chunk=1024) as store:
            check_whole(store, whole)


def test_processes_that_make_a_city_end_with_who_reads(monkeypatch):
    started = []
    monkeypatch.setattr(
        city, "start_worker", lambda *a, start=city.start_worker: started.append(start(*a)) or started[-1]
    )
    pieces = StreamedCity(5_000_000, processes=2).pieces(0.0)
    next(pieces)
    assert [worker.poll() for worker in started] == [None, None]
    pieces.close()
    assert all(worker.returncode for worker in started)


@pytest.mark.parametrize("code", ["raise SystemExit(3)", "import os; os.write(1, bytes([9] + 15 * [0]))"])
def test_a_process_that_fails_is_no_end_of_the_city(monkeypatch, code):
    command = [sys.executable, "-c", code]
    monkeypatch.setattr(city, "start_worker", lambda *_: subprocess.Popen(command, stdout=subprocess.PIPE))
    with pytest.raises(RuntimeError, match=r"has failed|ended too early"):
        list(StreamedCity(20_000).pieces(0.0))


def test_every_light_comes_back_to_the_bit():
    third = 1 / 3
    lights = [
        PointLight((third, 2, 3), intensity=0.1, colour=(0.1, third, 1.0)),
        QuadLight((0, third, 0), (1, 0, 0), (0, -0.0, 1)).named("Lämp"),
        DiskLight((0, 1, 2), (1, third, 7), 0.7),
        SphereLight((0, 1, 2), 0.1),
        *(DirectionalLight(RNG.normal(size=3), 0.53) for _ in range(50)),
        AmbientOcclusion(spp=3),
        AmbientOcclusion(0.3),
        PointLights(RNG.random((5, 3)), RNG.random(5), normals=RNG.normal(size=(5, 3)), interleave=True),
    ]
    flat = at.Camera((0, 5, 0.1), (0, 0, 0), projection="orthographic", extent=third)
    cameras = [at.Camera((third, 0, 9), (0, 0, 0), vfov=41.3, width=77, height=33), flat]
    box = np.float32([[0, 0, third], [1, 2, 3]])
    meta = StoreMeta(
        "näme", "z", 9, RNG.normal(size=(2, 3)), RNG.normal(size=3), box, cameras, lights, ("note",), {"a": 1}
    )
    again = meta_from_json(meta_to_json(meta))
    assert meta_to_json(again) == meta_to_json(meta) and json.loads(meta_to_json(meta))["name"] == "näme"
    for a, b in zip(lights, again.lights, strict=True):
        assert type(a) is type(b) and repr(a) == repr(b) and a.name == b.name
        assert all(getattr(a, n).tobytes() == getattr(b, n).tobytes() for n in vars(a) if hasattr(vars(a)[n], "dtype"))
    assert same_bits(again.bounds, meta.bounds) and same_bits(again.box, box)
    assert repr(again.cameras) == repr(cameras) and (again.notes, again.built) == (("note",), {"a": 1})


def test_palettes():
    some = RNG.random((9, 3)).astype(np.float32)
    some[3] = -0.0  # differs from the colour 0.0, because bits are kept
    some[4] = 0.0
    for colours, rows in ((some[RNG.integers(0, 9, 5000)], 9), (RNG.random((4000, 3)), 4000), (some[:1], 1)):
        colours = np.asarray(colours, np.float32)
        palette, index = palette_of(colours)
        assert len(palette) == rows and same_bits(palette[index], colours)


def test_chunks_are_read_into_memory_of_their_own(tmp_path):
    store = built(tmp_path, at.procedural("cellar", triangles=20_000), chunk=4096)
    memory, chunks = store.memory(), [store.chunk(k) for k in range(len(store))]
    assert all(c.tree.nodes.ctypes.data % 64 == 0 and np.shares_memory(c.tree.nodes, c.tree.links) for c in chunks)
    assert all(a.flags.c_contiguous and a.flags.aligned and type(a) is np.ndarray for c in chunks for a in c.tree)
    for k, chunk in enumerate(chunks):  # the memory of the caller is used again
        again = store.chunk(k, memory)
        assert np.shares_memory(again.tree.corners, memory) and same_bits(again.tree.corners, chunk.tree.corners)
    before = [c.tree.corners.copy() for c in chunks]
    store.path.write_bytes(b"")
    store.close()
    assert all((c.tree.corners == b).all() for c, b in zip(chunks, before))  # arrays outlive the store and the file
    with pytest.raises(at.InputError, match="is closed"):
        store.chunk(0)


def test_two_read_the_same_store(tmp_path):
    scene = SCENES["procedural"]
    first = built(tmp_path, scene)
    with open_store(first.path) as second:
        assert same_bits(contents(first).vertices, contents(second).vertices)
    check_whole(first, scene)


@pytest.mark.parametrize(
    "scenes, options, words",
    [
        ([], {}, "no scenes"),
        (["a.glb"], {}, "no such file"),
        (None, dict(max_memory=100 << 20), "max_memory"),
        (None, dict(chunk=3), "chunk"),
        (None, dict(threads=0), "threads"),
        ([soup_scene(scattered(2)), Scene.from_arrays(scattered(2), up="z")], {}, "up axis"),
        ([soup_scene(scattered(2)), soup_scene(scattered(2) + np.float32(2e18))], {}, "1e\\+18"),
    ],
    ids=["none", "a name", "memory", "chunk", "threads", "up", "far"],
)
def test_what_cannot_be_built(tmp_path, scenes, options, words):
    with pytest.raises(at.InputError, match=words) as caught:
        build_store([soup_scene(scattered(2))] if scenes is None else scenes, tmp_path / "a.antumbra", **options)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_moving_scene_is_taken_at_its_beginning(tmp_path):
    folder = tmp_path / "moving"
    folder.mkdir()
    np.save(folder / "frames.npy", np.zeros((2, 3, 3), np.float32) + np.eye(3, dtype=np.float32))
    np.save(folder / "faces.npy", np.array([[0, 1, 2]], np.int32))
    scene = at.load(folder)
    assert scene.animated
    store = built(tmp_path, scene)
    check_whole(store, scene)
    assert any("first moment" in note for note in store.meta.notes)


def written_as_it_is(tmp_path, path):
    """Check that the store of a file has the name, the frame and the bounds of its scene, and its triangles."""
    scene = at.load(path)
    with built(tmp_path, path, name="store.antumbra") as store:
        check_whole(store, scene)
    paged = at.load(tmp_path / "store.antumbra")
    for field in ("name", "up", "crs", "raster", "n_triangles"):
        assert getattr(paged, field) == getattr(scene, field), field
    assert paged.notes[: len(scene.notes)] == scene.notes  # then those of the build
    assert same_bits(paged.bounds, scene.bounds) and same_bits(paged.origin, scene.origin)


@pytest.mark.parametrize("suffix", [suffix for each in FORMATS for suffix in each.suffixes or ("",)])
def test_a_store_of_any_file_has_the_bounds_of_its_scene(tmp_path, suffix):
    written_as_it_is(tmp_path, sample(suffix, tmp_path))


def averaged(path, heights, shape):
    """A virtual raster of `shape` that averages the cells of a raster; GDAL averages by the window that is read."""
    pytest.importorskip("rasterio", reason="rasters need antumbra[gis]: NOT checked")
    gis_files.write_raster(path.with_suffix(".tif"), heights)
    size = f'xOff="0" yOff="0" xSize="{heights.shape[1]}" ySize="{heights.shape[0]}"'
    whole = f'xOff="0" yOff="0" xSize="{shape[1]}" ySize="{shape[0]}"'
    path.write_text(
        f'<VRTDataset rasterXSize="{shape[1]}" rasterYSize="{shape[0]}"><SRS>{gis_files.CRS}</SRS>'
        "<GeoTransform>100000,2,0,450000,0,-2</GeoTransform>"
        '<VRTRasterBand dataType="Float64" band="1"><SimpleSource resampling="average">'
        f'<SourceFilename relativeToVRT="1">{path.stem}.tif</SourceFilename><SourceBand>1</SourceBand>'
        f"<SrcRect {size}/><DstRect {whole}/></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    return path


@pytest.mark.parametrize("heights", ["averaged", "holes", "scaled", "south up", "undeclared nodata"])
def test_a_store_of_any_raster_has_the_bounds_of_its_scene(tmp_path, heights):
    hills, path = RNG.random((300, 40)) * 100, tmp_path / "a.tif"
    if heights == "averaged":
        return written_as_it_is(tmp_path, averaged(tmp_path / "a.vrt", hills, (1724, 31)))  # in seven blocks of rows
    if heights == "holes":
        hills[:, :3], hills[200:], hills[50:60, 10:20] = np.nan, np.nan, np.nan
        hills[250, 20] = 1e6  # a lonely height, of which no triangle is made
    elif heights == "undeclared nodata":
        hills[40:50] = -9999.0
    more = {"scales": (0.01,), "offsets": (0.3,)} if heights == "scaled" else {}
    place = (2.0, 0.0, 1e5, 0.0, 2.0, 45e4) if heights == "south up" else gis_files.PLACE
    written = hills.astype(np.int16) if heights == "scaled" else hills
    return written_as_it_is(tmp_path, gis_files.write_raster(path, written, place, **more))


# --- Stores at URLs ---------------------------------------------------------------------------------------------------


@pytest.fixture
def town(tmp_path, monkeypatch):
    """A server of a store of many chunks, and the store."""
    pytest.importorskip("obstore", reason="stores at URLs need antumbra[cloud]: NOT checked")
    (tmp_path / "web").mkdir()
    build_store(at.procedural("city", triangles=6000), tmp_path / "web" / "town.antumbra", chunk=CHUNK)
    with serving(tmp_path / "web", monkeypatch) as server:
        yield server, tmp_path / "web" / "town.antumbra"


def test_a_store_at_a_url_answers_as_the_file_and_is_read_as_far_as_rays_go(town):
    server, path = town
    local, remote = at.load(path), at.load(f"{server.url}/town.antumbra")
    opening = server.sent
    assert remote.n_triangles == local.n_triangles and same_bits(remote.bounds, local.bounds)
    low, high = local.bounds
    origins = np.linspace(low, high, 9) * [1.0, 0.0, 1.0] + [0.0, high[1] + 1.0, 0.0]
    found, expected = (each.closest_hit(origins, (0.0, -1.0, 0.0)) for each in (remote, local))
    assert same_bits(found.t, expected.t) and (found.face == expected.face).all() and np.isfinite(found.t).any()
    assert 0 < server.sent - opening < path.stat().st_size / 2
    assert server.paths() == {"/town.antumbra"}


def test_a_store_at_a_url_is_checked_and_pickled_as_the_file(town):
    server, path = town
    store, local = open_store(f"{server.url}/town.antumbra"), open_store(path)
    assert store.size == path.stat().st_size and len(store) == len(local) > 9
    for k in range(0, len(store), 5):
        assert same_bits(store.chunk(k).tree.corners, local.chunk(k).tree.corners)
    again = pickle.loads(pickle.dumps(store))
    assert again.path == store.path and same_bits(again.chunk(3).tree.nodes, local.chunk(3).tree.nodes)
    data = bytearray(path.read_bytes())
    data[int(store.chunks.offset[4]) + 9] ^= 1
    path.write_bytes(data)
    with pytest.raises(at.InputError, match=r"town\.antumbra: chunk 4 of .* is damaged"):
        store.chunk(4)
    path.write_bytes(data[:-4096])
    with pytest.raises(at.InputError, match=r"town\.antumbra: cannot be read from|is cut short"):
        open_store(f"{server.url}/town.antumbra")
    store.close()
    with pytest.raises(at.InputError, match="is closed"):
        store.chunk(0)


def test_object_storage_is_read_with_the_settings_of_the_environment(town, monkeypatch):
    server, path = town
    (path.parent / "bucket").mkdir()
    path.rename(path.parent / "bucket" / "town.antumbra")
    settings = {"AWS_ENDPOINT_URL": server.url, "AWS_ALLOW_HTTP": "true", "AWS_SKIP_SIGNATURE": "true"}
    for name, value in {**settings, "AWS_REGION": "us-east-1"}.items():
        monkeypatch.setenv(name, value)
    assert at.load("s3://bucket/town.antumbra").n_triangles > 5000
    assert server.paths() == {"/bucket/town.antumbra"}


def test_a_command_describes_and_studies_a_store_at_a_url(town, cli):
    server, path = town
    for form in ("info", "--check", "--json"), ("viewshed", "--observer", "0,9,0", "--sensors", "raster:9", "--json"):
        name, *words = form
        answers = [cli(name, each, *words).json() for each in (path, f"{server.url}/town.antumbra")]
        for answer in answers:
            answer.pop("source", None), answer.pop("load", None), answer.pop("seconds", None)
        assert answers[0] == answers[1] and len(answers[0]) > 3


def test_a_missing_store_at_a_url_is_one_line_with_the_remedy(town):
    server, _ = town
    with pytest.raises(at.InputError, match=r"no\.antumbra: cannot be read from .*check the URL") as caught:
        at.load(f"{server.url}/no.antumbra")
    assert "\n" not in str(caught.value)
