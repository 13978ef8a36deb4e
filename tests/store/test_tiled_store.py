"""Tiles of a manifest are one scene, with the bits of a single store and faces numbered by 64 bits."""

import json
import pickle
import shutil

import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.engine import store_building
from antumbra.store import read_units, store_build
from antumbra.store.store_build import PieceSizes
from antumbra.store.store_file import Store, open_store
from antumbra.store.tiled_store import Tile, manifest_from_json, manifest_to_json, open_tiles
from formats.test_face_ranges import ply
from stores import check_whole, contents, same_bits, with_small_chunks

TILES = 5


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """The path of a single store of a city, and of a manifest of its tiles."""
    folder, scene = tmp_path_factory.mktemp("tiles"), at.procedural("city", triangles=6_000)
    at.build_store(scene, folder / "one.antumbra", chunk=128)
    at.build_store(scene, folder / "town.tiles", chunk=128, tile=scene.n_triangles // TILES + 1)
    return folder / "one.antumbra", folder / "town.tiles"


@pytest.fixture(autouse=True)
def opened(monkeypatch):
    """Close all stores that a test opens."""
    stores, begin = [], Store.__init__

    def noted(store, *arguments):
        begin(store, *arguments)
        stores.append(store)

    monkeypatch.setattr(Store, "__init__", noted)
    yield
    for store in stores:
        store.close()


@pytest.fixture
def copy(town, tmp_path):
    """The path of a manifest whose files may be changed."""
    shutil.copytree(town[1].parent, tmp_path / "copy")
    return tmp_path / "copy" / "town.tiles"


def rewritten(path, **changes):
    """Change fields of all tiles in a manifest: functions of the tile's number."""
    meta, tiles = manifest_from_json(path.read_bytes(), path.name)
    tiles = [tile._replace(**{name: of(k, tile) for name, of in changes.items()}) for k, tile in enumerate(tiles)]
    meta = meta._replace(n_triangles=tiles[-1].first + tiles[-1].triangles)
    path.write_bytes(manifest_to_json(meta, tiles))
    return tiles


def test_tiles_hold_the_scene_in_one_frame(town):
    one, tiles = at.load(town[0]), at.load(town[1])
    check_whole(tiles.store, at.procedural("city", triangles=6_000))
    assert len(tiles.store.tiles) >= TILES - 1
    for name in ("bounds", "origin"):
        assert same_bits(getattr(one, name), getattr(tiles, name))
    assert one.n_triangles == tiles.n_triangles and one.notes == tiles.notes and one.name == tiles.name
    for tile in tiles.store.tiles:
        with open_store(town[1].parent / tile.file) as store:
            assert same_bits(store.meta.origin, one.origin)


def test_a_tile_alone_is_its_part_of_the_scene(town):
    vertices = at.procedural("city", triangles=6_000).triangles().vertices
    for tile in open_tiles(town[1]).tiles:
        part = at.load(town[1].parent / tile.file)
        found = contents(part.store)
        assert (found.times == 1).all()
        assert same_bits(found.vertices, vertices[tile.first : tile.first + tile.triangles])


def test_neither_memory_nor_threads_change_a_byte_of_a_tile(town, tmp_path):
    scene = at.procedural("city", triangles=6_000)
    size = scene.n_triangles // TILES + 1
    at.build_store(scene, tmp_path / "town.tiles", chunk=128, tile=size, threads=1, max_memory=384 << 20)
    for path in town[1].parent.glob("town*"):
        assert path.read_bytes() == (tmp_path / path.name).read_bytes(), path.name


def test_tiles_are_pickled_by_their_path(copy):
    scene = at.load(copy)
    again = pickle.loads(pickle.dumps(scene))
    assert again.store.tiles == scene.store.tiles
    data = pickle.dumps(scene)
    rewritten(copy, first=lambda k, tile: tile.first + 10)
    with pytest.raises(InputError, match=r"town\.tiles: was written again after it was pickled"):
        pickle.loads(data)


# --- Builds in units --------------------------------------------------------------------------------------------------


@pytest.fixture
def small_units(monkeypatch):
    """Units so small that a scene of 900 triangles has several tiles, each of several units."""
    monkeypatch.setattr(store_build, "USUAL_SIZES", PieceSizes(staged=30, run=40, unit=60))
    monkeypatch.setattr(store_building, "write_store", with_small_chunks)


def test_shards_write_the_tiles_of_the_build_in_one_piece(cli, tmp_path, small_units):
    for folder in ("one", "shards"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.ply").write_bytes(ply(of="face"))
    names = {
        folder: (str(tmp_path / folder / "a.ply"), "-o", str(tmp_path / folder / "a.tiles"))
        for folder in ("one", "shards")
    }
    options = "--tile", "250", "--quiet"
    assert cli("build", *names["one"], *options).code == 0
    for k in range(3):
        assert cli("build", *names["shards"], *options, "--shard", f"{k}/3").code == 0
    assert cli("merge", str(tmp_path / "shards" / "a.shards")).code == 0
    written = {path.name: path.read_bytes() for path in (tmp_path / "one").iterdir()}
    assert len(written) > 4
    assert {path.name: path.read_bytes() for path in (tmp_path / "shards").iterdir() if path.is_file()} == written


def test_an_interrupted_build_resumes(cli, tmp_path, small_units, monkeypatch):
    (tmp_path / "a.ply").write_bytes(ply(of="face"))
    command = "build", str(tmp_path / "a.ply"), "-o", str(tmp_path / "a.tiles"), "--tile", "250", "--quiet"
    assert cli(*command).code == 0
    written = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for path in tmp_path.glob("*.antumbra"):
        path.unlink()
    finish = store_build._Build._finish

    def interrupted(build, tile, *rest):
        if tile.first:
            raise KeyboardInterrupt
        finish(build, tile, *rest)

    monkeypatch.setattr(store_build._Build, "_finish", interrupted)
    assert cli(*command).code == 130
    assert (tmp_path / "a.parts").is_dir()
    monkeypatch.setattr(store_build._Build, "_finish", finish)
    monkeypatch.setattr(store_build._Build, "_sort", None)  # sorted parts are not made again
    assert cli(*command).code == 0
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == written


def test_a_scene_too_large_for_a_store_is_refused_with_the_remedy(monkeypatch, tmp_path):
    monkeypatch.setattr(read_units, "MAX_TRIANGLES", 500)
    scene = at.procedural("city", triangles=2_000)
    with pytest.raises(InputError, match=r"a store holds at most 500; build tiles: -o a\.tiles"):
        at.build_store(scene, tmp_path / "a.antumbra")
    at.build_store(scene, tmp_path / "a.tiles", tile=300)
    assert at.load(tmp_path / "a.tiles").n_triangles == scene.n_triangles


def test_a_tile_size_is_for_tiles(tmp_path, cli):
    with pytest.raises(InputError, match=r"tile is 100, and a\.antumbra a single store; write \*\.tiles"):
        at.build_store(at.procedural("city", triangles=1_000), tmp_path / "a.antumbra", tile=100)
    result = cli("build", "procedural:city?triangles=1k", "-o", str(tmp_path / "a.tiles"), "--tile", "0")
    assert result.code == 2 and "tile is 0" in result.err


# --- Faults -----------------------------------------------------------------------------------------------------------


def exchange(path, tiles):
    first, second = (path.parent / tile.file for tile in tiles[:2])
    first.rename(path.parent / "aside")
    second.rename(first)
    (path.parent / "aside").rename(second)


def cut(path, tiles):
    file = path.parent / tiles[1].file
    file.write_bytes(file.read_bytes()[:-4096])


def flip(path, tiles):
    file = path.parent / tiles[1].file
    data = bytearray(file.read_bytes())
    data[-1] ^= 1
    file.write_bytes(data)


def move_frame(path, tiles):
    at.build_store(at.procedural("museum", triangles=2_000), path.parent / tiles[1].file)


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda path, tiles: (path.parent / tiles[1].file).unlink(), r"tile town-0001\.antumbra: .*"),
        (exchange, r"tile town-0000\.antumbra is not the one of the manifest"),
        (cut, r"tile town-0001\.antumbra: is cut short"),
        (flip, r"tile town-0001\.antumbra: its chunk directory is damaged"),
        (move_frame, r"tile town-0001\.antumbra is in another frame"),
        (lambda path, tiles: path.write_bytes(path.read_bytes().replace(b'"first": 0', b'"first": 9')), "is damaged"),
        (lambda path, tiles: path.write_bytes(path.read_bytes()[:100]), "is no manifest of tiles"),
        (lambda path, tiles: rewritten(path, first=lambda k, tile: 0), "does not follow the one before it"),
        (lambda path, tiles: rewritten(path, file=lambda k, tile: f"../{tile.file}"), "outside the scene's folder"),
    ],
)  # fmt: skip
def test_a_fault_of_a_tile_is_one_line_that_names_it(copy, change, words):
    change(copy, manifest_from_json(copy.read_bytes(), copy.name)[1])
    with pytest.raises(InputError, match=rf"^town\.tiles: .*{words}") as error:
        at.load(copy)
    assert "\n" not in str(error.value)


def test_a_damaged_chunk_is_named_by_its_tile(copy, cli):
    file = copy.parent / open_tiles(copy).tiles[2].file
    data = bytearray(file.read_bytes())
    data[4096 + 70] ^= 1
    file.write_bytes(data)
    assert cli("info", str(copy)).code == 0
    result = cli("info", str(copy), "--check")
    assert result.code == 2 and f"{file.name}: chunk 0 of" in result.err


def test_a_manifest_of_a_later_version_is_refused_by_name(copy):
    record = json.loads(copy.read_bytes())
    copy.write_text(json.dumps(record | {"antumbra_tiles": 2}))
    with pytest.raises(InputError, match=r"town\.tiles: is a manifest of version 2"):
        at.load(copy)


def test_info_describes_the_tiles(town, cli):
    result = cli("info", str(town[1]))
    assert result.code == 0 and f"tiles   {len(open_tiles(town[1]).tiles)}, up to" in result.out
    answer = json.loads(cli("info", str(town[1]), "--json").out)
    assert [Tile(**each) for each in answer["tiles"]] == open_tiles(town[1]).tiles
