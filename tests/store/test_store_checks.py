"""A forged store, whose checksums are correct, is refused or gives the answers of the store that it was made from."""

import json

import numpy as np
import pytest

import antumbra as at
from antumbra.store.store_format import OLDEST, PAGE, Chunk, Chunks, StoreMeta
from bvh_scenes import terrain
from forged_stores import ARRAYS, COUNT_FIELDS, HEADER_FIELDS, ForgedStore
from stores import CHUNK, built, soup_scene

LARGE = 1_000_000, 2**31 - 1, 2**31, 2**32 - 1, 2**62
NUMBERS = 0, -1, 1, -(2**31), *LARGE  # and the correct value, by one more and one less
WORDS = np.array([0, 1, -1, -2, 7, 1_000_000, 2**31 - 1, -(2**31)], np.int32)
FLOATS = np.nan, np.inf, -np.inf, 0.0, 1e30, -1e30, 1e-40
ODD = None, True, -1, 0, 2.5, 1e300, float("nan"), 10**30, "", "x", [], {}, [0], [[]], [None] * 3, {"a": 1}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """(path for a forged copy, the bytes of the store, rays, the right answers)."""
    soup = terrain(600)
    colours = np.random.default_rng(1).random((len(soup), 3)).round(1).astype(np.float32)
    path = built(tmp_path_factory.mktemp("forged"), soup_scene(soup, colours), chunk=2 * CHUNK).path
    rng = np.random.default_rng(2)
    scene = at.load(path)
    origins = rng.uniform(*scene.bounds, (300, 3)) + [0.0, 0.5, 0.0]
    rays = origins, rng.normal(size=(300, 3))
    right = answers(path, rays)
    blocked = right[0]
    assert 0 < blocked.sum() < len(blocked) and len(scene.store) > 3
    return path, path.read_bytes(), rays, right


def answers(path, rays):
    scene = at.load(path)
    with scene.store:
        for k in range(len(scene.store)):
            scene.store.check(k)
        hit = scene.closest_hit(*rays)
        return scene.occluded(*rays), hit.face, hit.t, scene.count_hits(*rays)


def check_forged(whole, forged: ForgedStore, refused=False) -> bool:
    """Whether a forged store is refused; if not, its answers are the right ones."""
    path, _, rays, right = whole
    path.write_bytes(forged.data)
    try:
        found = answers(path, rays)
    except at.InputError as error:
        assert str(error).startswith(path.name) and str(error).isprintable(), str(error)
        return True
    assert not refused
    assert all(np.array_equal(a, b) for a, b in zip(found, right))
    return False


def test_a_store_with_other_checksums_only_is_the_same_store(whole):
    forged = ForgedStore(whole[1]).seal()
    assert forged.data == whole[1]
    assert not check_forged(whole, forged)


@pytest.mark.parametrize("field", HEADER_FIELDS[1:])
def test_forged_header(whole, field):
    right = ForgedStore(whole[1])
    for value in (0, 1, 2, PAGE, PAGE + 1, *LARGE, len(whole[1]) - 1, len(whole[1]) + 1):
        forged = ForgedStore(whole[1])
        forged.header[field] = value & (2**32 - 1 if field in ("version", "complete", "crc") else 2**64 - 1)
        is_other = forged.data != right.data and (field, value) != ("version", OLDEST)  # version 2 is read, too
        check_forged(whole, forged, refused=is_other)


@pytest.mark.parametrize("field", COUNT_FIELDS)
def test_forged_counts(whole, field):
    size = {"chunks": len(ForgedStore(whole[1]).table), "nodes": len(ForgedStore(whole[1]).top)}.get(field, 700)
    for value in (0, 1, *LARGE, size - 1, size + 1, 2**64 - 1):
        forged = ForgedStore(whole[1])
        forged.counts[field] = value
        check_forged(whole, forged, refused=True)


@pytest.mark.parametrize("field", ["offset", "bytes", "triangles", "nodes", "colours"])
def test_forged_numbers_of_the_table(whole, field):
    for k in (0, 2, len(ForgedStore(whole[1]).table) - 1):
        right = int(ForgedStore(whole[1]).table[field][k])
        for value in {*NUMBERS, right + 1, right - 1, right + PAGE, right - PAGE} - {right}:
            forged = ForgedStore(whole[1])
            forged.table[field][k] = value
            check_forged(whole, forged, refused=True)


@pytest.mark.parametrize("field", ["box", "root"])
def test_forged_boxes_and_roots_of_the_table(whole, field):
    for place in range(ForgedStore(whole[1]).table[field].shape[1]):
        for value in FLOATS:
            forged = ForgedStore(whole[1])
            forged.table[field][1, place] = value
            same = forged.data == whole[1]
            check_forged(whole, forged, refused=not same)


def test_every_field_of_the_table_is_forged():
    assert set(Chunks._fields) == {"offset", "bytes", "triangles", "nodes", "colours", "box", "root", "crc"}
    assert {"palette", "palette_rows"} < set(ARRAYS) and Chunk._fields == ("tree", "palette", "palette_rows")


def test_chunks_of_a_table_in_another_order(whole):
    forged = ForgedStore(whole[1])
    forged.table[[0, 1]] = forged.table[[1, 0]]
    check_forged(whole, forged, refused=True)
    forged = ForgedStore(whole[1])
    forged.table[1] = forged.table[0]
    check_forged(whole, forged, refused=True)


@pytest.mark.parametrize("word", range(16))
def test_forged_nodes_above_the_chunks(whole, word):
    seen = set()
    for node in (0, 1):
        for value in WORDS if word >= 12 else np.array(FLOATS, np.float32).view(np.int32):
            forged = ForgedStore(whole[1])
            words = forged.top.view(np.int32)
            same = words[node, word] == value
            words[node, word] = value
            refused = check_forged(whole, forged)
            assert refused or same or word >= 14  # the child order, and a word that nothing reads
            seen.add(refused)
    assert True in seen or word == 15


@pytest.mark.parametrize("word", range(16))
@pytest.mark.parametrize("node", [0, 3])
def test_forged_nodes_of_a_chunk(whole, node, word):
    for value in WORDS if word >= 12 else np.array(FLOATS, np.float32).view(np.int32):
        forged = ForgedStore(whole[1])
        links = forged.arrays[1]["links"]
        same = links[node, word] == value
        links[node, word] = value
        assert check_forged(whole, forged.seal()) or same or word >= 14


def test_trees_that_never_end_or_share_nodes(whole):
    for node, link in ((1, 0), (1, 1), (2, 1), (3, 2)):
        for side in (12, 13):
            forged = ForgedStore(whole[1])
            forged.arrays[0]["links"][node, side] = link
            check_forged(whole, forged.seal())
            forged = ForgedStore(whole[1])
            node_above = min(node, len(forged.top) - 1)
            forged.top.view(np.int32)[node_above, side] = min(link, node_above)
            check_forged(whole, forged, refused=True)


def test_a_tree_that_is_too_deep_is_refused(whole):
    forged = ForgedStore(whole[1])
    arrays = forged.arrays[0]
    nodes, links = arrays["nodes"], arrays["links"]
    links[:, 12], links[:, 13] = np.arange(1, len(nodes) + 1), ~0
    links[-1, 12] = ~8
    assert len(nodes) > 5
    check_forged(whole, forged.seal(), refused=True)


@pytest.mark.parametrize("name", ["corners", "palette"])
def test_forged_numbers_of_a_chunk(whole, name):
    for value in (np.nan, np.inf, -np.inf, 1e30, 1e-40) if name == "corners" else (np.nan, np.inf, -1.0):
        for place in range(ForgedStore(whole[1]).arrays[0][name].shape[1]):
            forged = ForgedStore(whole[1])
            forged.arrays[0][name][0, place] = value
            check_forged(whole, forged.seal(), refused=True)


def test_forged_ids_and_colours_of_a_chunk(whole):
    first = ForgedStore(whole[1]).arrays[0]
    for name, values in (
        ("prim_ids", (-1, 600, 2**31 - 1, -(2**31), int(first["prim_ids"][1]))),
        ("palette_rows", (len(first["palette"]), 255)),
    ):
        for value in values:
            forged = ForgedStore(whole[1])
            forged.arrays[0][name][0] = value
            check_forged(whole, forged.seal(), refused=True)


def test_a_triangle_without_area_is_refused(whole):
    forged = ForgedStore(whole[1])
    corners = forged.arrays[0]["corners"]
    inner = next(i for i in range(len(corners)) if forged.arrays[0]["prim_ids"][i])
    corners[inner, 3:] = np.tile(corners[inner, :3], 2)
    check_forged(whole, forged.seal(), refused=True)


@pytest.mark.parametrize("field", StoreMeta._fields)
def test_forged_metadata(whole, field):
    outcomes = set()
    for value in ODD:
        forged = ForgedStore(whole[1])
        forged.meta[field] = value
        outcomes.add(check_forged(whole, forged))
    assert True in outcomes


@pytest.mark.parametrize(
    "change",
    [
        {"box": [[0, 0, 0]]},
        {"box": [[1e30] * 3, [1e30] * 3]},
        {"dense": [0, 0]},
        {"dense": [float("nan")] * 3},
        {"more": 1},
    ],
    ids=str,
)
def test_forged_detail(whole, change):
    forged = ForgedStore(whole[1])
    forged.meta["detail"].update(change)
    assert check_forged(whole, forged, refused=True)


@pytest.mark.parametrize("value", FLOATS)
def test_forged_frames(whole, value):
    """The origin and the box follow from the bounds, so that none of them can be changed alone."""
    for name, rows in (("bounds", 2), ("origin", 1), ("box", 2)):
        for axis in range(3):
            for row in range(rows):
                forged = ForgedStore(whole[1])
                numbers = forged.meta[name] if rows == 1 else forged.meta[name][row]
                if numbers[axis] == value:
                    continue  # of a scene whose frame has its origin at 0
                numbers[axis] = value
                check_forged(whole, forged, refused=name != "box" or abs(value) != 1e30)


LIGHTS = (
    {"type": "number", "value": 1, "what": "x", "colour": [1, 1, 1]},  # a name of the module, but no light
    {"type": ["PointLight"], "colour": [1, 1, 1]},
    {"type": "PointLight", "position": [0, 0, float("nan")], "intensity": 1, "colour": [1, 1, 1]},
    {"type": "DirectionalLight", "direction": [0, -2, 0], "angular_diameter": 0.5, "intensity": 1, "colour": [1, 1, 1]},
    {"type": "DirectionalLight", "direction": [[0, -1, 0]], "intensity": 1, "colour": [1, 1, 1]},
    {"type": "PointLight", "position": [0, 0, 0], "intensity": -1, "colour": [1, 1, 1]},
    {"type": "PointLight", "position": [0, 0, 0], "intensity": 1, "colour": 5},
)  # fmt: skip


@pytest.mark.parametrize("light", LIGHTS, ids=range(len(LIGHTS)))
def test_forged_lights(whole, light):
    forged = ForgedStore(whole[1])
    forged.meta["lights"] = [json.loads(json.dumps(light))]
    check_forged(whole, forged, refused=True)


@pytest.mark.parametrize(
    "camera", [{}, {"position": 1}, {"position": [0, 0, 0], "target": [0, 0, 0], "eval": "x"}, [], 5]
)
def test_forged_cameras(whole, camera):
    forged = ForgedStore(whole[1])
    forged.meta["cameras"] = [camera]
    check_forged(whole, forged, refused=True)


@pytest.mark.parametrize("cells", [(0, 5), (5, -1), (2**31, 2**31), (2.5, 2), (10**30, 1)])
def test_forged_rasters(whole, cells):
    forged = ForgedStore(whole[1])
    forged.meta["raster"] = [0.0, 0.0, 1.0, 9, 9, None]
    assert not check_forged(whole, forged)
    forged.meta["raster"] = [0.0, 0.0, 1.0, *cells, None]
    check_forged(whole, forged, refused=True)
    forged.meta["raster"] = [0.0, float("inf"), 1.0, 9, 9, None]
    check_forged(whole, forged, refused=True)


def test_metadata_that_nest_without_end_are_refused(whole):
    path, data, *_ = whole
    forged = ForgedStore(data)
    forged.meta = {"name": "x"}
    path.write_bytes(forged.data.replace(b'{"name": "x"}', b"[" * 13))
    with pytest.raises(at.InputError):
        at.load(path)
