"""The tables of sizes, of stores and of the ablation: their figures, and the command that prints them."""

import pytest

from antumbra.base.errors import InputError
from antumbra.engine.scene import procedural
from antumbra.engine.scene_loading import load
from antumbra.engine.store_building import build_store
from antumbra.lab.papers.benchmark_views import scene_view
from antumbra.lab.papers.chc_rt import (
    chcrt_measurements,
    chcrt_published,
    mapped_tree,
    store_walkthroughs,
    walkthrough_timing,
)
from antumbra.lab.papers.chc_rt.chcrt_plots import moved_points, shares, speedup_points
from antumbra.lab.papers.chc_rt.chcrt_published import ChcrtTable
from antumbra.lab.papers.chc_rt.store_walkthroughs import StoreCase
from antumbra.lab.papers.chc_rt.walkthrough_timing import InCore, Pace
from antumbra.lab.papers.chc_rt.walkthroughs import AO, DIFFUSE, KINDS, PRIMARY, SOFT, place_of
from antumbra.techniques.tracer_options import WHOLE_SCREEN, ChcRtOptions

SIZE = 24
PACE = Pace(3, 1, 60.0)
WALK = "--size", "24", "--frames", "2", "--compared", "1"
WITHOUT_PARTS = [
    name for name, changed in chcrt_measurements.VARIANTS.items() if not {"triangles", "build"} & changed.keys()
]


def quiet(text):
    """Hears progress."""


@pytest.fixture(scope="module")
def core():
    view = scene_view("city", procedural("city", triangles=120_000), (SIZE, SIZE))
    return InCore(place_of(view), 2, ChcRtOptions(triangles=1 << 12))


@pytest.fixture(scope="module")
def place(core, tmp_path_factory):
    """The same city in a store of small chunks."""
    path = tmp_path_factory.mktemp("store") / "city.antumbra"
    build_store([core.place.scene], path, chunk=1 << 9)
    return core.place._replace(scene=load(path))


def one_walk(walks):
    """The turns of the only walkthrough."""
    (turns,) = walks
    return turns


def test_sizes_in_memory_are_of_what_is_traced(core):
    size = chcrt_measurements.size_in_memory(core)
    assert (size.scene, size.triangles, size.share) == ("city", core.place.scene.n_triangles, 1.0)
    assert size.total == size.bvh + size.geometry and size.geometry >= 52 * size.triangles
    assert 0 < size.bvh < size.geometry


def test_sizes_of_a_store_are_of_its_file(place, core):
    size = chcrt_measurements.size_of_store(StoreCase(place, 2))
    store = place.scene.store
    assert size.triangles == core.place.scene.n_triangles and size.share == 1.0
    assert size.bvh == 64 * (int(store.chunks.nodes.sum()) + len(store.top.nodes))
    assert 41 * size.triangles <= size.geometry < 53 * size.triangles
    assert size.bvh + size.geometry < size.total == store.path.stat().st_size
    assert chcrt_measurements.size_of_store(StoreCase(place, 2, size.total // 4)).share == pytest.approx(0.25, abs=1e-6)
    with pytest.raises(InputError, match="--scene instead"):
        chcrt_measurements.size_of_store(StoreCase(core.place, 2))


def test_variants_change_what_they_say(core):
    whole = core.culling_by("whole", chcrt_measurements.VARIANTS["no screen hierarchy"]).scheduled
    assert whole.options == ChcRtOptions(triangles=1 << 12)._replace(tile=WHOLE_SCREEN)
    assert whole.parts is core.culling().scheduled.parts
    larger = core.culling_by("larger", chcrt_measurements.VARIANTS["parts of 4 M triangles"]).scheduled
    assert 0 < len(larger.parts.trees) < len(whole.parts.trees)
    assert (
        chcrt_measurements.VARIANTS[chcrt_measurements.BASELINE] == {}
        and len(WITHOUT_PARTS) == len(chcrt_measurements.VARIANTS) - 3
    )


def told(core, walk, changed, name, frames):
    """A statistic of primary rays in each frame of a walk, with some options changed."""
    methods, pace = [core.culling_by("some", changed)], PACE._replace(frames=frames)
    turns = walkthrough_timing.walk_through(core, walk, methods, (PRIMARY,), "halton:36", pace, quiet)
    return [t.statistics[name] for t in turns]


def test_without_state_each_frame_is_as_the_first(core):
    near = core.place.walks[0]
    still = near._replace(last=near.first)
    first, *others = told(core, still, {"keep": False}, "queries", 3)
    assert others == [first, first]
    first, *others = told(core, still, {}, "queries", 3)
    assert max(others) < first


def test_without_pull_up_pairs_are_never_forgotten(core):
    near, far = core.place.walks
    away = far._replace(last=near.last)
    kept, pulled = (told(core, away, {"pull_up": pull_up}, "pairs", 6) for pull_up in (False, True))
    assert kept == sorted(kept) and pulled != sorted(pulled)


def test_ablation_in_memory(core):
    turns = one_walk(chcrt_measurements.ablate_in_memory(core, PACE, quiet))
    assert {(t.kind, t.method, t.frame) for t in turns} == {
        (kind, name, frame)
        for kind in (AO, DIFFUSE, SOFT)
        for name in chcrt_measurements.VARIANTS
        for frame in range(3)
    }
    assert all(t.differs == 0 and t.view == "near" for t in turns)

    def of(name, value):
        return sum(
            walkthrough_timing.typical(walkthrough_timing.of(turns, method=name, kind=kind), value)
            for kind in (AO, DIFFUSE, SOFT)
        )

    assert of("no temporal coherence", "queries") > of(chcrt_measurements.BASELINE, "queries") > 0
    assert of("no pull-up", "pairs") >= of(chcrt_measurements.BASELINE, "pairs") > 0
    assert of("parts of 4 M triangles", "visible") < of(chcrt_measurements.BASELINE, "visible")


def test_ablation_of_a_store(place):
    walks = list(chcrt_measurements.ablate_out_of_core(StoreCase(place, 2), PACE._replace(frames=2), quiet))
    assert [turns[0].method for turns, _ in walks] == WITHOUT_PARTS
    assert all({t.kind for t in turns} == {*KINDS} and {t.frame for t in turns} == {0, 1} for turns, _ in walks)
    assert len({tuple(digests) for _, digests in walks}) == 1
    assert all(sum(t.statistics["bytes"] for t in turns) > 0 for turns, _ in walks)


def test_variants_of_a_store_have_as_many_frames_as_the_first(place, monkeypatch):
    some = {name: chcrt_measurements.VARIANTS[name] for name in WITHOUT_PARTS[:2]}
    monkeypatch.setattr(chcrt_measurements, "VARIANTS", some)
    walks = list(chcrt_measurements.ablate_out_of_core(StoreCase(place, 2), PACE._replace(limit=0.0), quiet))
    assert all({t.frame for t in turns} == {0, 1} for turns, _ in walks)


def test_bytes_read_are_of_nodes_and_of_geometry(place):
    run = chcrt_measurements.ChcrtRun([ChcrtTable.times, ChcrtTable.queries], 2, PACE, quiet, quiet)
    found, same = chcrt_measurements.measure_out_of_core(StoreCase(place, 2), run)
    turns = found[ChcrtTable.store]
    assert {t.method for t in turns} == {"lru"} and same is None
    begun = walkthrough_timing.of(turns, kind="primary", frame=0)
    assert all(0 < t.statistics["bvh_bytes"] < t.statistics["bytes"] for t in begun)
    for t in turns:
        assert (
            walkthrough_timing.value_of(t, "geometry_bytes") == t.statistics["bytes"] - t.statistics["bvh_bytes"] >= 0
        )
    assert sum(shares(begun).values()) == pytest.approx(1.0)


def test_the_mapped_tree_is_the_stores_tree(place, tmp_path):
    """The rival gives the answers of CHC+RT, and in later frames, it reads nothing that it has read before."""
    case, pace = StoreCase(place, 2), PACE._replace(frames=2)
    mapped_tree.write_tree(mapped_tree.whole_tree(case.store), tmp_path, 2)
    ours = list(store_walkthroughs.out_of_core(case, pace, ["lru"], quiet))
    theirs = list(store_walkthroughs.map_through(case, tmp_path, pace, quiet))
    for (turns, digests), (others, hits) in zip(ours, theirs, strict=True):
        assert [(t.view, t.kind, t.frame, t.rays) for t in turns] == [(t.view, t.kind, t.frame, t.rays) for t in others]
        assert {t.method for t in others} == {mapped_tree.NAME} and len(hits) == 2 * len(KINDS)
        assert set(hits) <= set(digests) and len(set(dict(hits).values())) > 2
    size = sum(path.stat().st_size for path in mapped_tree.files_of(tmp_path))
    assert size > 100 * place.scene.n_triangles
    assert all(0 <= t.statistics.get("bytes", 0) <= 2 * size for others, _ in theirs for t in others)


def test_paths_of_several_bounces_have_the_hits_of_the_tree_in_memory(place):
    case = StoreCase(place, 2, share=0.1)
    bvh = mapped_tree.whole_tree(case.store)
    for turns in store_walkthroughs.bounce_through(case, bvh, PACE._replace(most=2), quiet):
        kinds = [store_walkthroughs.bounce_kind(bounce) for bounce in range(store_walkthroughs.BOUNCES + 1)]
        assert [(t.frame, t.kind) for t in turns] == [(frame, kind) for frame in range(2) for kind in kinds]
        assert all(t.differs == 0 and t.rays > 0 for t in turns)
        assert all(t.statistics["bytes"] > 0 for t in turns[: len(kinds)])
        rays = [t.rays for t in turns[1 : len(kinds)]]
        assert rays == sorted(rays, reverse=True) and rays[0] > rays[-1]
    other = bvh._replace(corners=bvh.corners + 0.5)
    (turns, *_) = store_walkthroughs.bounce_through(case, other, PACE._replace(most=1), quiet)
    assert sum(t.differs for t in turns) > 0


def test_a_share_limits_the_chunks_in_memory(place):
    few, whole = (
        [
            t
            for turns, _ in store_walkthroughs.out_of_core(StoreCase(place, 2, share=share), PACE, ["lru"], quiet)
            for t in turns
        ]
        for share in (0.1, 1.0)
    )
    later = [sum(t.statistics["bytes"] for t in walkthrough_timing.later(turns)) for turns in (few, whole)]
    assert later[0] > later[1] and store_walkthroughs.hit_rate(few) < store_walkthroughs.hit_rate(whole)


def test_a_temporary_store_is_measured_and_removed(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    tables = [ChcrtTable.scenes, ChcrtTable.queries, ChcrtTable.bounces]
    run = chcrt_measurements.ChcrtRun(tables, 2, PACE._replace(frames=2), quiet, quiet)
    rows, same = chcrt_measurements.measure_scenes([], 20_000, (SIZE, SIZE), run)
    assert same and {*rows} == {ChcrtTable.scenes, ChcrtTable.store, ChcrtTable.bounces}
    (size,) = rows[ChcrtTable.scenes]
    assert size.share == chcrt_published.MODELS["City-200"][-1] / 100 and 15_000 < size.triangles < 25_000
    assert sum(t.statistics["bytes"] for t in rows[ChcrtTable.store]) > size.total / 4
    assert not list(tmp_path.iterdir())


def test_the_overview_has_our_points_and_the_papers(core, place):
    turns = []
    for walk in core.place.walks:
        methods = [core.culling(), *core.plain()]
        turns += walkthrough_timing.walk_through(
            core, walk, methods, KINDS, "halton:36", PACE._replace(frames=2), quiet
        )
    stored = [
        t for turns, _ in store_walkthroughs.out_of_core(StoreCase(place, 2), PACE, ["lru"], quiet) for t in turns
    ]
    points = speedup_points([*turns, *stored])
    assert [(len(ours), len(theirs)) for ours, theirs in points.values()] == [(2, 6)] * 3 + [(2, 0)]
    moved = moved_points([*turns, *stored], {place.name: 10_000_000})
    assert [(len(ours), len(theirs)) for ours, theirs in moved.values()] == [(2, 6)] * 3
    assert moved_points(turns, {})[PRIMARY][0] == [] and max(moved[DIFFUSE][1]) == 2310 / 11400


def test_walkthroughs_are_shown_when_they_have_ended(core, capsys):
    shown = []
    tables = [ChcrtTable.scenes, ChcrtTable.phases, ChcrtTable.randomisation]
    run = chcrt_measurements.ChcrtRun(tables, 2, PACE._replace(frames=2), quiet, shown.append)
    found, same = chcrt_measurements.measure_in_memory([core.place], run)
    assert same and [t for turns in shown for t in turns] == found[ChcrtTable.times] + found[ChcrtTable.randomisation]
    assert len(shown) == 2 + len(walkthrough_timing.SAMPLERS) and found[ChcrtTable.scenes][0].triangles > 0
    chcrt_measurements.show_medians(shown[0])
    told = capsys.readouterr()
    assert told.out == "" and [line.split(":")[0] for line in told.err.splitlines()] == [
        f"city, near, {kind}, chcrt" for kind in KINDS
    ]
    assert chcrt_measurements.measure_in_memory([core.place], run._replace(tables=[ChcrtTable.scenes]))[1] is None


def test_published_bytes_add_up_or_are_noted():
    for name, (_, _, moved) in chcrt_published.STATISTICS.items():
        for v in range(2):
            for k in range(3):
                parts = sum(split[v][k] for split in chcrt_published.MOVED[name])
                assert parts == pytest.approx(moved[v][k], rel=0.01, abs=0.02) or (name, v) == ("City-200", 1)
    for *_, total, bvh, geometry, _ in chcrt_published.MODELS.values():
        assert bvh + geometry == pytest.approx(total, rel=0.05)


def test_the_command_prints_the_tables(cli):
    scene = "procedural:cellar?triangles=2k"
    cli("build", scene, "-o", "small.antumbra", "--quiet")
    done = cli("bench", "chc-rt", "--scene", scene, *WALK, "--table", "scenes", "--table", "ablation")
    for part in ("Table 1", "(paper: Powerplant x 16)", "no pull-up", "parts of 4 M triangles", "Section 6"):
        assert part in done.out, (part, done.out)
    assert "MB read" not in done.out and "the same by all methods" in done.out and "Table 2" not in done.out
    assert "near, AO, no screen hierarchy: " in done.err
    names = ("scenes", "times", "queries", "ablation")
    stored = "--store", "small.antumbra", *WALK, *(word for name in names for word in ("--table", name))
    done = cli("bench", "chc-rt", *stored)
    for part in ("Table 1", "25,975", "MB moved", "BVH", "geometry", "total MB read", "tiles of 64 pixels"):
        assert part in done.out, (part, done.out)
    assert "parts of" not in done.out and "round-robin" not in done.out and "the same by all" in done.out
    told = cli("bench", "chc-rt", *stored, "--json")
    assert "ms per frame" not in told.err and told.json()["same_answers"]
    assert {*told.json()} >= {"scenes", "store", "ablation"} and "times" not in told.json()
    (size,) = told.json()["scenes"]
    assert (
        size["triangles"] == procedural("cellar", triangles=2000).n_triangles
        and 0 < size["bvh"] < size["total"]
        and size["share"] == 1.0
    )


def test_the_plot_of_a_store(cli, tmp_path):
    pytest.importorskip("matplotlib")
    cli("build", "procedural:cellar?triangles=2k", "-o", "small.antumbra", "--quiet")
    done = cli("bench", "chc-rt", "--store", "small.antumbra", *WALK, "--table", "phases", "--plot", "store.png")
    assert done.code == 0 and (tmp_path / "store.png").stat().st_size > 10_000
