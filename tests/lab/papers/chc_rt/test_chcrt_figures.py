"""The pictures of CHC+RT: what pairs cover, the states they are drawn from, and the files."""

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.engine.scene import procedural
from antumbra.lab.papers.benchmark_views import scene_view
from antumbra.lab.papers.chc_rt import chcrt_figures
from antumbra.lab.papers.chc_rt.chcrt_figures import (
    FIGURES,
    culling_state,
    differences_of,
    name_of,
    options_of,
    shaded,
    subtrees,
    write_pictures,
)
from antumbra.lab.papers.chc_rt.walkthrough_timing import InCore
from antumbra.lab.papers.chc_rt.walkthroughs import AO, PRIMARY, place_of, timed
from antumbra.scene.camera import Camera

SIZE = 160, 100
BENCH = "bench", "chc-rt", "--table", "queries", "--frames", "1"


@pytest.fixture(scope="module")
def core():
    return InCore(place_of(scene_view("city", procedural("city", triangles=120_000), SIZE)), 2)


@pytest.fixture(scope="module")
def shown(core):
    return culling_state(core)


@pytest.fixture(scope="module")
def columns(shown):
    return chcrt_figures.columns_of(shown.parts)


@pytest.mark.parametrize("kind", ["camera", "short", "long"])
def test_pairs_cover_each_ray_and_triangle_once(shown, columns, kind):
    seen = getattr(shown, kind)
    found = chcrt_figures.rectangles(seen.fronts, columns, shown.shape)
    edges = [np.unique(spans) for spans in (found.rays, found.triangles)]
    assert [(e[0], e[-1]) for e in edges] == [(0, SIZE[0] * SIZE[1]), (0, shown.triangles)]
    covered = np.zeros([len(e) - 1 for e in edges], int)
    for rays, triangles in zip(found.rays, found.triangles):
        covered[slice(*np.searchsorted(edges[0], rays)), slice(*np.searchsorted(edges[1], triangles))] += 1
    assert (covered == 1).all() and found.visible.any() and not found.visible.all()


@pytest.mark.parametrize("kind", ["camera", "short", "long"])
def test_hits_lie_in_visible_pairs(shown, columns, kind):
    seen = getattr(shown, kind)
    found = chcrt_figures.rectangles(seen.fronts, columns, shown.shape)
    rows, places = chcrt_figures.crossings(seen.hits, seen.fronts.tiles, columns)
    assert len(rows) == np.count_nonzero(seen.hits.face >= 0) > 0
    rays, triangles = found.rays[found.visible], found.triangles[found.visible]
    inside = (rays[:, :1] <= rows) & (rows < rays[:, 1:]) & (triangles[:, :1] <= places) & (places < triangles[:, 1:])
    assert (inside.sum(0) == 1).all()


def test_columns_are_the_triangles_part_by_part(shown, columns):
    inner, n = shown.parts.inner, len(shown.parts.trees)
    assert (np.sort(columns.places) == np.arange(shown.triangles)).all()
    sizes = np.diff(columns.spans)[inner:, 0]
    assert n >= 64 and sizes.sum() == shown.triangles and sizes.max() <= shown.triangles // 64
    assert columns.spans[0].tolist() == [0, shown.triangles]
    hit = shown.camera.hits.face >= 0
    spans = columns.spans[inner + shown.camera.hits.part[hit]]
    places = columns.places[shown.camera.hits.slot[hit]]
    assert ((spans[:, 0] <= places) & (places < spans[:, 1])).all()


def test_rows_are_the_rays_in_squares_of_squares(shown):
    tiles = shown.camera.fronts.tiles
    rows = chcrt_figures.rows_of_rays(tiles, shown.shape)
    assert (np.sort(rows.ravel()) == np.arange(rows.size)).all()
    side = 2 * tiles.pixels
    assert sorted(rows[:side, :side].ravel()) == list(range(side * side))
    assert rows[: tiles.pixels, : tiles.pixels].max() == tiles.pixels**2 - 1


def test_numbers_of_tiles(shown, columns):
    fronts, tiles = shown.camera.fronts, shown.camera.fronts.tiles
    lists, pairs = chcrt_figures.list_lengths(fronts), chcrt_figures.overdraw(fronts)
    assert tiles.smallest == 5 * 4 and (lists <= pairs).all() and lists.max() > lists.min()
    assert chcrt_figures.covered(tiles)[-1].all()
    for tile in range(tiles.smallest):
        mine = chcrt_figures.tile_of_pixels(tiles, shown.shape) == tile
        part = shown.camera.hits.part[mine]
        assert lists[tile] >= len(np.unique(part[part >= 0]))
    short, long = (chcrt_figures.reachable(seen.fronts, columns) for seen in (shown.short, shown.long))
    assert 0 < short.sum() < long.sum() and long.max() <= shown.triangles
    assert (shown.short.hits.t[shown.short.hits.face >= 0] <= shown.length / 50).all()
    assert (long > shown.many).any() and (short < shown.many).any()


def test_states_are_those_of_the_last_frame(core):
    culling, walk = core.culling(), core.place.walks[0]
    asked = core.frame_rays(walk.first, "halton:36")
    for kinds, sets in (((PRIMARY, AO), [1, 16, 4]), ((PRIMARY,), [1])):  # AO: 20 directions, 16 in a question
        culling.scheduled.begin()
        assert list(culling.scheduled.states()) == []
        for kind in kinds:
            timed(culling, asked, kind)
        states = list(culling.scheduled.states())
        assert [question for question, _ in states] == list(range(len(sets)))
        assert [fronts.sets for _, fronts in states] == sets


def test_options_follow_the_paper_in_proportion():
    assert options_of(11_700_000, 1920)[:2] == (192, 182_812)
    assert options_of(1_000_000, 640)[:2] == (64, 15_625)
    assert options_of(350_000_000, 1920).triangles == 1 << 20
    assert options_of(10, 16)[:2] == (32, 1)


def test_images_are_no_wider_than_figures_show(core, monkeypatch):
    monkeypatch.setattr(chcrt_figures, "_WIDEST", SIZE[0] // 4)
    assert culling_state(core).shape == (SIZE[1] // 4, SIZE[0] // 4)


def test_colours(shown):
    grey, colours = shaded(shown), subtrees(shown)
    background = shown.camera.hits.part < 0
    assert 0.0 <= grey.min() < grey.max() <= 1.0 and 0.0 <= colours.min() < colours.max() <= 1.0
    assert background.any() and np.ptp(colours[background]) == 0.0
    assert len(np.unique(np.round(colours[~background], 3), axis=0)) > len(np.unique(shown.camera.hits.part))
    found, times = differences_of(shown)
    assert found.any() and times > 1 and found.max() <= 255 and shown.exact.any()
    assert differences_of(shown._replace(neglecting=shown.exact))[0].max() == 0


def test_files(core, tmp_path):
    pytest.importorskip("matplotlib")
    from PIL import Image

    write_pictures(core, tmp_path, lambda text: None)
    assert {path.name for path in tmp_path.iterdir()} == {name_of("city", figure) for figure in FIGURES}
    matrix = np.asarray(Image.open(tmp_path / name_of("city", 6)).convert("RGB")).reshape(-1, 3)
    shares = [(matrix == colour).all(1).mean() for colour in ((224, 48, 30), (44, 160, 44), (16, 48, 255))]
    red, green, blue = shares
    assert green > red > blue > 0.0 and green > 0.3
    with pytest.raises(InputError, match="cannot be written"):
        write_pictures(core, tmp_path / "none", lambda text: None)


@pytest.mark.parametrize("size", ["70x1", "1x40", "1"])
def test_pictures_of_few_pixels(cli, tmp_path, size):
    """Their sheets are no larger than those of other pictures: of 40 pixels above one another, they took 9 GB."""
    pytest.importorskip("matplotlib")
    from PIL import Image

    done = cli(*BENCH, "--scene", "procedural:atrium?triangles=2k", "--size", size, "--pictures", ".")
    assert done.code == 0, done.err
    sizes = [Image.open(path).size for path in tmp_path.iterdir()]
    assert len(sizes) == len(FIGURES) and all(height < 8 * width for width, height in sizes)


def test_bad_folders_and_stores_are_refused_before_anything_is_measured(cli, tmp_path):
    pytest.importorskip("matplotlib")
    (tmp_path / "file").touch()
    cli(*BENCH, "--pictures", "none").refused("none", "make it first")
    cli(*BENCH, "--pictures", "file").refused("file", "is a file; name a folder")
    cli("bench", "chc-rt", "--store", "none.antumbra", "--pictures", ".").refused("--pictures", "omit --store")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_names_of_files():
    assert name_of("city?triangles=1.5M", 4) == "city-triangles-1-5M-figure-4.png"
    assert name_of("models/room.glb", 9) == "models-room-glb-figure-9.png"


def test_a_camera_that_sees_nothing_is_refused(core):
    away = Camera((1e4, 1e4, 1e4), (2e4, 2e4, 2e4), width=32, height=32)
    walks = core.place.walks[0]._replace(first=away, last=away), core.place.walks[1]
    place, core.place = core.place, core.place._replace(walks=walks)
    try:
        with pytest.raises(InputError, match="city: the near camera sees nothing"):
            culling_state(core)
    finally:
        core.place = place
