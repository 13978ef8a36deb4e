"""The tables of sizes, of stores and of the ablation: their figures, and the command that prints them."""

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.engine.scene import procedural
from antumbra.engine.scene_loading import load
from antumbra.engine.store_building import build_store
from antumbra.lab.bench_parts import BenchParts
from antumbra.lab.papers.benchmark_views import agree, scene_view
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
from antumbra.lab.papers.chc_rt.walkthroughs import AO, DIFFUSE, KINDS, PRIMARY, SOFT, TRACERS, place_of
from antumbra.query.ray_passes import RayPass
from antumbra.techniques.tracer_options import WHOLE_SCREEN, ChcRtOptions

SIZE = 24
PACE = Pace(3, 1, 60.0)
WALK = "--size", "24", "--frames", "2", "--compared", "1"
WITHOUT_PARTS = [
    name
    for name, changed in chcrt_measurements.VARIANTS.items()
    if not {"triangles", "height", "build"} & changed.keys()
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


def walked(walks):
    """What each of several walkthroughs measures."""
    return [measure() for _, measure in walks]


def parts_of(*tables):
    """Empty parts, of which these tables are measured."""
    return BenchParts({table: {} for table in ChcrtTable}, tables=chcrt_measurements.tables_of(tables))


def run_of(*tables, policies=("lru",), pace=PACE, show=quiet):
    return chcrt_measurements.ChcrtRun(parts_of(*tables), policies, 2, (SIZE, SIZE), pace, quiet, show)


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
        and len(WITHOUT_PARTS) == len(chcrt_measurements.VARIANTS) - 5
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
    ((turns, *_),) = walked(chcrt_measurements.ablate_in_memory(core.place, lambda: core, PACE, quiet))
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
    case, pace = StoreCase(place, 2), PACE._replace(frames=2)
    ((turns, digests, _),) = walked(chcrt_measurements.ablate_out_of_core(lambda: case, (SIZE, SIZE), pace, quiet))
    assert list(dict.fromkeys(t.method for t in turns)) == WITHOUT_PARTS
    assert {(t.method, t.kind, t.frame) for t in turns} == {
        (name, kind, frame) for name in WITHOUT_PARTS for kind in KINDS for frame in (0, 1)
    }
    assert agree(digests) and len(digests) == len(WITHOUT_PARTS) * len(dict(digests))
    assert all(sum(t.statistics["bytes"] for t in turns if t.method == name) > 0 for name in WITHOUT_PARTS)


def test_variants_of_a_store_have_as_many_frames_as_the_first(place, monkeypatch):
    some = {name: chcrt_measurements.VARIANTS[name] for name in WITHOUT_PARTS[:2]}
    monkeypatch.setattr(chcrt_measurements, "VARIANTS", some)
    case, pace = StoreCase(place, 2), PACE._replace(frames=9, limit=0.0)
    ((turns, *_),) = walked(chcrt_measurements.ablate_out_of_core(lambda: case, (SIZE, SIZE), pace, quiet))
    assert {(t.method, t.frame) for t in turns} == {
        (name, frame) for name in some for frame in range(walkthrough_timing.LEAST)
    }


def test_bytes_read_are_of_nodes_and_of_geometry(place):
    run = run_of(ChcrtTable.times, ChcrtTable.queries)
    chcrt_measurements.add_out_of_core("city", 120_000, None, None, lambda: StoreCase(place, 2), run)
    found, same = chcrt_measurements.rows_of(run.parts)
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
    ours = walked(store_walkthroughs.out_of_core(lambda: case, pace, ["lru"], quiet))
    theirs = walked(store_walkthroughs.map_through(lambda: case, lambda: tmp_path, lambda: pace, quiet))
    for (turns, digests, _), (others, hits, _) in zip(ours, theirs, strict=True):
        assert [(t.view, t.kind, t.frame, t.rays) for t in turns] == [(t.view, t.kind, t.frame, t.rays) for t in others]
        assert {t.method for t in others} == {mapped_tree.NAME} and len(hits) == 2 * len(KINDS)
        assert set(hits) <= set(digests) and len(set(dict(hits).values())) > 2
    size = sum(path.stat().st_size for path in mapped_tree.files_of(tmp_path))
    assert size > 100 * place.scene.n_triangles
    assert all(0 <= t.statistics.get("bytes", 0) <= 2 * size for others, *_ in theirs for t in others)


def test_a_rival_that_pages_on_demand_has_the_same_hits_and_reads_more(place, monkeypatch):
    monkeypatch.setattr(store_walkthroughs, "_ROWS", 4)
    case, pace = StoreCase(place, 2, share=0.1), PACE._replace(frames=2)
    for turns, digests, _ in walked(store_walkthroughs.rival_through(lambda: case, pace, quiet)):
        ours, theirs = (walkthrough_timing.of(turns, method=name) for name in ("chcrt", store_walkthroughs.RIVAL))
        assert [(t.frame, t.kind, t.rays) for t in ours] == [(t.frame, t.kind, t.rays) for t in theirs]
        assert [t.frame for t in ours] == [0, 1] and {t.kind for t in ours} == {DIFFUSE}
        assert agree(digests) and len(digests) == 2 * len(dict(digests)) == 4
        assert sum(t.statistics["bytes"] for t in theirs) > sum(t.statistics["bytes"] for t in ours) > 0


def test_paths_of_several_bounces_have_the_hits_of_the_tree_in_memory(place):
    case = StoreCase(place, 2, share=0.1)
    bvh = mapped_tree.whole_tree(case.store)
    pace = PACE._replace(most=2)
    for turns, _, compared in walked(store_walkthroughs.bounce_through(lambda: case, lambda: bvh, pace, quiet)):
        kinds = [store_walkthroughs.bounce_kind(bounce) for bounce in range(store_walkthroughs.BOUNCES + 1)]
        assert [(t.frame, t.kind) for t in turns] == [(frame, kind) for frame in range(2) for kind in kinds]
        assert compared and all(t.differs == 0 and t.rays > 0 for t in turns)
        assert all(t.statistics["bytes"] > 0 for t in turns[: len(kinds)])
        rays = [t.rays for t in turns[1 : len(kinds)]]
        assert rays == sorted(rays, reverse=True) and rays[0] > rays[-1]
    other = bvh._replace(corners=bvh.corners + 0.5)
    ((_, near), *_) = store_walkthroughs.bounce_through(lambda: case, lambda: other, pace._replace(most=1), quiet)
    assert sum(t.differs for t in near().turns) > 0


def test_a_share_limits_the_chunks_in_memory(place):
    few, whole = (
        [
            t
            for turns, *_ in walked(
                store_walkthroughs.out_of_core(
                    lambda share=share: StoreCase(place, 2, share=share), PACE, ["lru"], quiet
                )
            )
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
    run = run_of(*tables, pace=PACE._replace(frames=2))
    chcrt_measurements.add_temporary_store(20_000, (SIZE, SIZE), run)
    rows, same = chcrt_measurements.rows_of(run.parts)
    assert same and {*rows} == {ChcrtTable.scenes, ChcrtTable.store, ChcrtTable.bounces}
    (size,) = rows[ChcrtTable.scenes]
    assert size.share == chcrt_published.MODELS["City-200"][-1] / 100 and 15_000 < size.triangles < 25_000
    assert sum(t.statistics["bytes"] for t in rows[ChcrtTable.store]) > size.total / 4
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(chcrt_measurements, "build_store", None)  # nothing is built for parts that are there
    chcrt_measurements.add_temporary_store(20_000, (SIZE, SIZE), run)
    assert run.parts.resumed == run.parts.measured == 1 + 2 + 4  # paths of bounces are traced sorted, too


def test_the_overview_has_our_points_and_the_papers(core, place):
    turns = []
    for walk in core.place.walks:
        methods = [core.culling(), *core.plain()]
        turns += walkthrough_timing.walk_through(
            core, walk, methods, KINDS, "halton:36", PACE._replace(frames=2), quiet
        )
    stored = [
        t
        for turns, *_ in walked(store_walkthroughs.out_of_core(lambda: StoreCase(place, 2), PACE, ["lru"], quiet))
        for t in turns
    ]
    points = speedup_points([*turns, *stored])
    assert [tuple(map(len, each)) for each in points.values()] == [(2, 2, 6), (2, 2, 6), (2, 2, 6), (2, 2, 0)]
    moved = moved_points([*turns, *stored], {place.name: 10_000_000})
    assert [(len(ours), len(theirs)) for ours, theirs in moved.values()] == [(2, 6)] * 3
    assert moved_points(turns, {})[PRIMARY][0] == [] and max(moved[DIFFUSE][1]) == 2310 / 11400


def test_walkthroughs_are_shown_when_they_have_ended(core, capsys):
    shown = []
    tables = [ChcrtTable.scenes, ChcrtTable.phases, ChcrtTable.randomisation]
    run = run_of(*tables, pace=PACE._replace(frames=2), show=shown.append)
    chcrt_measurements.add_in_memory([core.place], run)
    found, same = chcrt_measurements.rows_of(run.parts)
    assert same and [t for turns in shown for t in turns] == found[ChcrtTable.times] + found[ChcrtTable.randomisation]
    assert len(shown) == 2 + len(walkthrough_timing.SAMPLERS) and found[ChcrtTable.scenes][0].triangles > 0
    chcrt_measurements.show_medians(shown[0])
    told = capsys.readouterr()
    lines = [line.split(":")[0] for line in told.err.splitlines()]
    assert told.out == "" and sorted(lines) == sorted(
        f"city, near, {kind}, {method}"
        for kind in KINDS
        for method in ("chcrt", *TRACERS)
        if method == "chcrt" or kind in TRACERS[method]
    )
    sizes = run_of(ChcrtTable.scenes)
    chcrt_measurements.add_in_memory([core.place], sizes)
    assert chcrt_measurements.rows_of(sizes.parts)[1] is None


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
    told = cli("bench", "chc-rt", *stored, "--ablation-size", "12x9", "--json")
    assert "ms per frame" not in told.err and told.json()["same_answers"]
    assert {*told.json()} >= {"scenes", "store", "ablation"} and "times" not in told.json()
    rays = {table: {t["rays"] for t in told.json()[table] if t["kind"] == PRIMARY} for table in ("store", "ablation")}
    assert rays == {"store": {24 * 24}, "ablation": {12 * 9}}
    (size,) = told.json()["scenes"]
    assert (
        size["triangles"] == procedural("cellar", triangles=2000).n_triangles
        and 0 < size["bvh"] < size["total"]
        and size["share"] == 1.0
    )


def test_a_percentage_of_a_store_is_in_memory(cli):
    cli("build", "procedural:cellar?triangles=2k", "-o", "small.antumbra", "--quiet")
    told = cli("bench", "chc-rt", "--store", "small.antumbra", "--in-core", "50", *WALK, "--table", "scenes", "--json")
    assert [size["share"] for size in told.json()["scenes"]] == [0.5]


def test_the_plot_of_a_store(cli, tmp_path):
    pytest.importorskip("matplotlib")
    cli("build", "procedural:cellar?triangles=2k", "-o", "small.antumbra", "--quiet")
    done = cli("bench", "chc-rt", "--store", "small.antumbra", *WALK, "--table", "phases", "--plot", "store.png")
    assert done.code == 0 and (tmp_path / "store.png").stat().st_size > 10_000


# --- The order of rays ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(30, 41), (16, 16), (3, 50), (1, 1), (4, 4)])
def test_rays_change_places_within_their_sample_set(shape):
    rng, n = np.random.default_rng(3), shape[0] * shape[1]
    directions = rng.normal(size=(n, 3)).astype(np.float32)
    directions[rng.random(n) < 0.2] = 0.0
    rays = RayPass(rng.random((n, 3)).astype(np.float32), directions, np.full(n, -1, np.int32))
    order = store_walkthroughs.coherent_order(rays, shape)
    np.testing.assert_array_equal(np.sort(order), np.arange(n))
    (y, x), (old_y, old_x) = np.divmod(np.arange(n), shape[1]), np.divmod(order, shape[1])
    assert (y % 4 == old_y % 4).all() and (x % 4 == old_x % 4).all()


def test_sorted_rays_are_similar_to_their_neighbours():
    rng, shape = np.random.default_rng(4), (160, 160)
    n = shape[0] * shape[1]
    rays = RayPass(*rng.normal(size=(2, n, 3)).astype(np.float32), np.full(n, -1, np.int32))
    order = store_walkthroughs.coherent_order(rays, shape)

    def apart(vectors):
        picture = vectors.reshape(*shape, 3)
        return np.linalg.norm(picture[:, :-4] - picture[:, 4:], axis=2).mean()

    for vectors in rays.origins, rays.directions:
        assert apart(vectors[order]) < 0.8 * apart(vectors)
