"""The claims of the paper on CHC+RT [Mattausch et al. 2015]."""

from statistics import median

from antumbra.lab.papers.chc_rt import chcrt_published, walkthrough_timing
from antumbra.lab.papers.chc_rt.chcrt_plots import moved_points
from antumbra.lab.papers.chc_rt.store_walkthroughs import RIVAL
from antumbra.lab.papers.chc_rt.walkthrough_timing import Turn
from antumbra.lab.papers.chc_rt.walkthroughs import FRUSTA, SINGLE
from antumbra.store.chunk_residency import POLICIES

from .claim import NO_GPU, RANGE, Claim, Condition, Results, at_size, spread

_DIFFUSE, _EXACT = "diffuse", walkthrough_timing.CHCRT


def _turns(r: Results, table: str, **fields: str) -> list[Turn]:
    return walkthrough_timing.of([Turn(**row) for row in r[table]], **fields)


def _speedups(r: Results, kind: str, method: str = FRUSTA) -> tuple[float, float, float]:
    """The speedups of CHC+RT over a method for a ray kind, over scenes and views."""
    return spread(walkthrough_timing.speedups(_turns(r, "times"), method)[kind])


def _all_speedups(r: Results, method: str) -> list[float]:
    """The speedups of CHC+RT over a method for all ray kinds."""
    return [x for found in walkthrough_timing.speedups(_turns(r, "times"), method).values() for x in found]


def _all_without(r: Results, *features: str) -> list[float]:
    """How much longer frames in memory take without features, or with other parameters."""
    turns = [t for t in _turns(r, "ablation") if "bytes" not in t.statistics]
    found = []
    for row in walkthrough_timing.rows_of(turns, "scene", "view", "kind"):
        base, *others = (walkthrough_timing.of(turns, **row, method=m) for m in ("default", *features))
        found += [walkthrough_timing.typical(other) / walkthrough_timing.typical(base) for other in others]
    return found


def _without(r: Results, *features: str) -> tuple[float, float, float]:
    """The spread of `_all_without`."""
    return spread(_all_without(r, *features))


def _view_median(r: Results, view: str, method: str) -> float:
    """The median speedup of CHC+RT over a method in a view, over scenes and ray kinds."""
    return median(
        x for found in walkthrough_timing.speedups(_turns(r, "times", view=view), method).values() for x in found
    )


def _beside_single(r: Results) -> tuple[float, float]:
    """The times of diffuse rays with full randomisation, relative to single rays with rotations of 36 degrees."""
    found = []
    for row in walkthrough_timing.rows_of(_turns(r, "randomisation"), "scene"):
        full = _turns(r, "randomisation", kind=_DIFFUSE, sampler=walkthrough_timing.SAMPLERS[-1], **row)
        single = _turns(r, "times", kind=_DIFFUSE, view="near", method=SINGLE, **row)
        found.append(walkthrough_timing.typical(full) / walkthrough_timing.typical(single))
    return spread(found)[:2]


def _table4(r: Results, stored: bool) -> list[Turn]:
    """The turns of aggressive mode, from the store or in memory."""
    return [t for t in _turns(r, "aggressive") if ("bytes" in t.statistics) == stored]


def _aggressive(turns: list[Turn], method: str | None = None) -> tuple[float, float, float]:
    """The speedups of aggressive mode, over scenes, views and thresholds; `method`: of one threshold."""
    found = []
    for row in walkthrough_timing.rows_of(turns, "scene", "view", "method"):
        mine, exact = (walkthrough_timing.of(turns, **{**row, "method": m}) for m in (row["method"], _EXACT))
        if row["method"] != _EXACT and method in (None, row["method"]):
            found.append(walkthrough_timing.typical(exact) / walkthrough_timing.typical(mine))
    return spread(found)


def _skipped(turns: list[Turn], method: str, count: str) -> tuple[float, float]:
    """The share of a count that aggressive mode skips, over scenes and views."""
    found = []
    for row in walkthrough_timing.rows_of(turns, "scene", "view"):
        mine, exact = (walkthrough_timing.of(turns, **row, method=m) for m in (method, _EXACT))
        counts = [walkthrough_timing.typical(each, count) for each in (mine, exact)]
        found.append(1 - counts[0] / counts[1])
    return spread(found)[:2]


def _unrotated(r: Results) -> tuple[float, float]:
    """How much faster than single rays diffuse rays without rotation are."""
    found = []
    for row in walkthrough_timing.rows_of(_turns(r, "randomisation"), "scene"):
        least = _turns(r, "randomisation", kind=_DIFFUSE, sampler=walkthrough_timing.SAMPLERS[0], **row)
        single = _turns(r, "times", kind=_DIFFUSE, view="near", method=SINGLE, **row)
        found.append(walkthrough_timing.typical(single) / walkthrough_timing.typical(least))
    return spread(found)[:2]


def _requested(r: Results) -> tuple[float, float]:
    """How many times as many chunks as primary rays AO rays request, near and far."""
    found = []
    for view in ("near", "far"):
        mine = [_turns(r, "store", view=view, kind=kind, method=POLICIES[0]) for kind in ("AO", "primary")]
        ao, primary = (walkthrough_timing.typical(each, "wanted") for each in mine)
        found.append(ao / primary)
    return found[0], found[1]


def _grown(r: Results) -> list[float]:
    """The triangles and the times near the street of the store, relative to those of the city in memory."""
    held = [t for t in _turns(r, "times", view="near", method=_EXACT) if t.scene.startswith("city")]
    stored = _turns(r, "store", view="near", method=POLICIES[0])
    sizes = [next(s for s in r["scenes"] if s["scene"] == each[0].scene)["triangles"] for each in (stored, held)]
    times = [
        walkthrough_timing.typical(walkthrough_timing.of(stored, kind=kind))
        / walkthrough_timing.typical(walkthrough_timing.of(held, kind=kind))
        for kind in chcrt_published.KINDS
    ]
    return [sizes[0] / sizes[1], *times]


def _randomised(r: Results, kind: str) -> tuple[float, float]:
    """How much longer fully randomised directions take."""
    turns, found = _turns(r, "randomisation", kind=kind), []
    for row in walkthrough_timing.rows_of(turns, "scene"):
        mine = walkthrough_timing.of(turns, **row)
        least, *_, full = (
            walkthrough_timing.typical(walkthrough_timing.of(mine, sampler=s)) for s in walkthrough_timing.SAMPLERS
        )
        found.append(full / least)
    return spread(found)[:2]


def _moved(r: Results, kind: str) -> float:
    """The median share of the store that is read per frame, in per cent."""
    ours, _ = moved_points(_turns(r, "store"), {s["scene"]: s["total"] for s in r["scenes"]})[kind]
    return 100 * median(ours)


def _phase3(r: Results, table: str) -> float:
    """The share of phase 3 in the frames after the first."""
    turns = walkthrough_timing.later([t for t in _turns(r, table) if t.statistics])
    return sum(t.statistics["phase 3"] for t in turns) / sum(t.seconds for t in turns)


_SAME_KERNEL = "over `multifrusta`, whose kernel it uses"
_NOISE = 0.01  # of times: less does not say that a setting is worse
_FEW_RAYS = (
    "the pairs have few rays and cost little: here a pair costs as much as its rays, not a shader pass over its tile"
)
_NO_RIVAL = "in memory, queries cost these frusta more than they save"


def _median(kind: str, theirs: float, span: str) -> Claim:
    """The claim of Table 2 for a ray kind."""
    return Claim(
        "Table 2",
        f"{kind} rays {theirs} times as fast in the median ({span})",
        RANGE + ", " + _SAME_KERNEL + "; median {:.2f} over single rays",
        lambda r: (*_speedups(r, kind), _speedups(r, kind, SINGLE)[2]),
        lambda low, high, ours, single: ours >= theirs,
        _NO_RIVAL,
    )


CLAIMS: tuple[Claim, ...] = (
    Claim(
        "Abstract, Table 2",
        "up to 5.94 times as fast as the same tracer without culling",
        "up to {:.2f} " + _SAME_KERNEL + "; up to {:.2f} over single rays",
        lambda r: (max(_all_speedups(r, FRUSTA)), max(_all_speedups(r, SINGLE))),
        lambda same, single: same >= 5.94,
        _NO_RIVAL,
        "the speedup over single rays is mostly that of frusta",
    ),
    _median("primary", 3.43, "1.12 to 5.50"),
    _median("AO", 2.54, "0.97 to 4.46"),
    _median(_DIFFUSE, 1.79, "0.89 to 5.92"),
    Claim(
        "7",
        "comparable to a state-of-the-art ray tracer (CUDA) in memory",
        "{:.2f} to {:.2f} times as fast as `multifrusta`, {:.2f} to {:.2f} as `packet16`",
        lambda r: (*spread(_all_speedups(r, FRUSTA))[:2], *spread(_all_speedups(r, "packet16"))[:2]),
        None,
        NO_GPU,
    ),
    Claim(
        "7",
        "faster than all others in near views of the city",
        "{:.2f} to {:.2f} times as fast as `multifrusta`",
        lambda r: spread(
            [
                x
                for found in walkthrough_timing.speedups(
                    [t for t in _turns(r, "times", view="near") if t.scene.startswith("city")], FRUSTA
                ).values()
                for x in found
            ]
        )[:2],
        lambda low, high: low > 1,
        _NO_RIVAL,
    ),
    Claim(
        "7",
        "gains most in occluded walkthroughs, such as near views of the city",
        "near {:.2f}, far {:.2f} times as fast as `multifrusta`; {:.2f} and {:.2f} as single rays (medians)",
        lambda r: [_view_median(r, view, method) for method in (FRUSTA, SINGLE) for view in ("near", "far")],
        lambda near, far, *_: near > far,
        "near frames are short, so queries weigh more",
    ),
    Claim(
        "7",
        "in less occluded views queries can cost more than they save",
        "in far views {:.2f} times as fast as `multifrusta` at least",
        lambda r: (
            min(
                x
                for found in walkthrough_timing.speedups(_turns(r, "times", view="far"), FRUSTA).values()
                for x in found
            ),
        ),
        lambda least: least < 1,
    ),
    Claim(
        "6",
        "the screen hierarchy makes Powerplant 3 times as fast",
        RANGE,
        lambda r: _without(r, "no screen hierarchy"),
        lambda low, high, middle: high >= 3,
        "queries take a small part of a frame here (Figure 8), so fewer of them save little",
    ),
    Claim(
        "4.5",
        "temporal coherence makes frames faster (no figure)",
        RANGE,
        lambda r: _without(r, "no temporal coherence"),
        lambda low, high, middle: low > 1,
    ),
    Claim(
        "5.3",
        "benefits more from temporal than from spatial coherence",
        "without temporal coherence {:.2f}, fully randomised {:.2f} times the time (medians)",
        lambda r: (
            _without(r, "no temporal coherence")[2],
            median(x for kind in ("AO", _DIFFUSE) for x in _randomised(r, kind)),
        ),
        lambda temporal, spatial: temporal > spatial,
        "both matter little here, and about as much",
        "the paper has no figure; its own Table 5 has 3.5 to 6.2 for diffuse rays",
    ),
    Claim(
        "4.4",
        "comparing areas with t_q = 0.5 splits best",
        "0.125 and 2 take {:.2f} to {:.2f} times the time, median {:.2f}",
        lambda r: _without(r, "t_q 0.125", "t_q 2"),
        lambda low, high, middle: middle >= 1 - _NOISE,
        "the difference is smaller than that between two runs of the same frame",
        "t_q hardly matters here; other criteria were not built",
    ),
    Claim(
        "5.2",
        "tiles of about 200 pixels are best",
        "64 pixels take {:.2f}, 256 take {:.2f} times the time of 128 (medians)",
        lambda r: [_without(r, f"tiles of {side} pixels")[2] for side in (64, 256)],
        lambda small, large: min(small, large) >= 1 - _NOISE,
        "the difference is smaller than that between two runs of the same frame",
    ),
    Claim(
        "5.2",
        "shadow rays gain from an order front to back",
        "1.6 times as long in San Miguel, measured once",
        lambda r: (),
        lambda: False,
        "in foliage, a tile starts inside many boxes; any blocker will do, so the tree's order is used",
    ),
    Claim(
        "7, Table 4",
        "aggressive mode up to 8 times as fast with diffuse rays",
        RANGE + " from the store; in memory {:.2f} to {:.2f}",
        lambda r: (*_aggressive(_table4(r, True)), *_aggressive(_table4(r, False))[:2]),
        lambda low, high, *_: high >= 8,
        _FEW_RAYS,
    ),
    Claim(
        "7, Table 4",
        "20 pixels make diffuse rays about 3 times as fast (1.1 to 3.5)",
        "{:.2f} to {:.2f} from the store, where they skip {:.0f} to {:.0f} % of the pairs and {:.0f} to {:.0f} % of "
        "the bytes; in memory {:.2f} to {:.2f}",
        lambda r: (
            *_aggressive(_table4(r, True), "chcrt:20")[:2],
            *(100 * x for count in ("traced pairs", "bytes") for x in _skipped(_table4(r, True), "chcrt:20", count)),
            *_aggressive(_table4(r, False), "chcrt:20")[:2],
        ),
        lambda low, high, *_: high >= 3,
        _FEW_RAYS,
    ),
    Claim(
        "7, Figure 9",
        "mean absolute error of 9.04 with 20 pixels",
        "at most {:.3f}",
        lambda r: (max(t.error or 0.0 for t in _turns(r, "aggressive", method="chcrt:20")),),
        lambda error: error <= 9.04,
        "",
        "the pairs that it skips have few rays",
    ),
    Claim(
        "7, Table 5",
        "full randomisation of directions slows diffuse rays by 3.5 to 6.2 times",
        "{:.2f} to {:.2f} times; without randomisation {:.2f} to {:.2f} times as fast as single rays",
        lambda r: (*_randomised(r, _DIFFUSE), *_unrotated(r)),
        lambda low, high, *_: high >= 3.5,
        "coherent directions gain little over single rays, so rotation has little to take away",
    ),
    Claim(
        "7, Table 5",
        "fully randomised, diffuse rays are still comparable to GLSL (0.4 to 1.6 times its time)",
        "{:.2f} to {:.2f} times the time of single rays, rotated by up to 36 degrees",
        _beside_single,
        lambda low, high: high <= 1.6,
    ),
    Claim(
        "7, Table 5",
        "AO rays are affected much less: 1.24 to 1.42 times",
        "{:.2f} to {:.2f} times",
        lambda r: _randomised(r, "AO"),
        lambda low, high: high <= 1.42,
    ),
    Claim(
        "7, Table 3",
        "{:.2f}, {:.2f} and {:.1f} % of the store are moved per frame (medians: primary, AO, diffuse)".format(
            *(100 * median(chcrt_published.moved(k)) for k in range(3))
        ),
        "{:.1f}, {:.1f} and {:.1f} %",
        lambda r: [_moved(r, kind) for kind in ("primary", "AO", _DIFFUSE)],
        lambda *ours: all(x <= 100 * max(chcrt_published.moved(k)) for k, x in enumerate(ours)),
        "from afar, nearly all chunks are in view; near the street, by count, diffuse rays request all of them",
    ),
    Claim(
        "7, Table 3",
        "AO and diffuse rays move significantly more than primary rays",
        "primary {:.1f} %, AO {:.1f} %, diffuse {:.1f} % of the store; AO rays request {:.2f} times as many chunks as "
        "primary rays near, and {:.2f} far",
        lambda r: (*(_moved(r, kind) for kind in ("primary", "AO", _DIFFUSE)), *_requested(r)),
        lambda primary, ao, diffuse, *_: min(ao, diffuse) >= 1.5 * primary,
        "AO rays are short and start where camera rays end, so that they need the same chunks",
    ),
    Claim(
        "7, Figure 8",
        "phase 3 takes a larger share out of core",
        "{:.1%} in memory, {:.1%} out of core",
        lambda r: (_phase3(r, "times"), _phase3(r, "store")),
        lambda memory, store: store > memory,
    ),
    Claim(
        "7",
        "conservative: the same hits as without culling",
        "{} rays differ",
        lambda r: (r["differs"],),
        lambda n: n == 0,
        "two coplanar triangles at the same distance",
    ),
    Claim("7, Table 2", "narrows the gap between GLSL and CUDA in the 777", "", reason=NO_GPU + " and model"),
    Claim(
        "7, Table 2",
        "a city 12 times as large takes about as long near the street (2.3, 2.1 and 7.1 times: primary, AO, diffuse)",
        "a store {:.0f} times as large as the city in memory: {:.1f}, {:.1f} and {:.1f} times the time",
        _grown,
        lambda _, primary, ao, diffuse: primary <= 2.3 and ao <= 2.1 and diffuse <= 7.1,
        "the time of primary rays includes reading chunks, and making the surfaces from which the others start",
    ),
    Claim(
        "Abstract, Table 1",
        "renders 138 to 350 M triangles (8 to 19 GB) out of core",
        "{:.0f} M triangles, {:.1f} GB",
        lambda r: (_store(r)["triangles"] / 1e6, _store(r)["total"] / 1e9),
        lambda triangles, size: True,
        "",
        "and 350 M, 26 GB, with a limit of 2 GiB: 0.8 s for a frame in a street, measured once",
    ),
    Claim("5.2", "without a cache of leaves the shader is 30 % slower", "", reason=NO_GPU),
    Claim(
        "5.2",
        "subtrees of 24 levels work well",
        "16 levels take {:.2f}, 32 take {:.2f} times the time (medians)",
        lambda r: [_without(r, f"parts of {levels} levels")[2] for levels in (16, 32)],
        lambda few, many: min(few, many) >= 1 - _NOISE,
        "fewer parts need fewer queries",
    ),
    Claim("5.2", "subtrees are scheduled faster tile by tile than one by one", "", reason="always sorted by tile here"),
    Claim(
        "5.1",
        "one query for many pairs is more efficient than a query for each",
        "{:.1f} pairs per query in the median",
        lambda r: (
            median(t.statistics["queries"] / t.statistics["multi_queries"] for t in _turns(r, "times", method=_EXACT)),
        ),
        None,
        "queries are always joined here",
    ),
    Claim("7", "trees of many levels slow GLSL, not CHC+RT", "", reason=NO_GPU + " and models"),
    Claim(
        "6",
        "several bounces, rays sorted between them for coherence (future work)",
        "a quarter at a time, sorted rays read 0.29 to 0.66 of those in the order of pixels, measured once",
        lambda r: (),
        lambda: True,
        "",
        "it does not pay off here: all rays of a bounce are traced together, and read hardly more when unsorted",
    ),
)


def _store(r: Results) -> Results:
    """The size of the store."""
    stored = r["store"][0]["scene"]
    return next(size for size in r["scenes"] if size["scene"] == stored)


def _rival(r: Results) -> str:
    """What CHC+RT saves with limited memory, over a tracer that pages on demand."""
    text = "**What it is for**: limited memory, here with diffuse rays in the far view"
    if "rival" not in r:
        return (
            f"{text}. With 10 M triangles at 1920 x 1080 and room for 47 % of the chunks, `chcrt` reads 0.2 to 0.4 GB "
            "and takes 20 s in each of two frames (33 M rays, CPU time of two threads, measured once); a rival that "
            "pages on demand with the same kernel and limit reads 55 GB and takes 70 s."
        )
    found = []
    for name in (_EXACT, RIVAL):
        turns = _turns(r, "rival", view="far", method=name)
        gigabytes = median(t.statistics["bytes"] for t in turns) / 1e9
        found.append(f"{gigabytes:.1f} GB and {median(t.seconds for t in turns):.0f} s per frame")
    return f"{text}: `chcrt` {found[0]}, a rival that pages on demand with the same kernel and limit {found[1]}."


_TABLES = {"aggressive": "Table 4", "randomisation": "Table 5", "ablation": "the ablation"}


def _where(r: Results) -> str:
    """Which tables are of some scenes only, and which were not measured."""
    places = dict[str, list[str]]()
    for table, title in _TABLES.items():
        views = {row["view"] for row in r.get(table, ()) if row["scene"] == _store(r)["scene"]}
        stored = {0: "", 1: f", and in the {' '.join(views)} view the store"}.get(len(views), " and the store")
        places.setdefault(f"the city in memory{stored}", []).append(title)
    text = "; ".join(f"{' and '.join(titles)}: {found}" for found, titles in places.items())
    missing = [f"*{name}*" for name in ("mapped", "rival", "bounces") if not r.get(name)]
    if missing:
        text += f". Not measured at this size: {', '.join(missing)}, which the paper lacks"
    return f"{text[0].upper()}{text[1:]}."


CONDITIONS: tuple[Condition, ...] = (
    lambda r: (
        "**Attribution**: `chcrt` traces with the kernel of frusta. Its speedup over `single`, "
        f"{median(walkthrough_timing.speedups(_turns(r, 'times'))['primary']):.2f} in the median for primary rays, "
        "compares frusta with single rays; the paper uses one kernel for both. Against the same kernel it is "
        f"{min(_all_speedups(r, FRUSTA)):.2f} to {max(_all_speedups(r, FRUSTA)):.2f} in memory."
    ),
    _rival,
    lambda r: (
        f"**Sizes**: {at_size(r, '1920 x 1080')}; the ablation at {' x '.join(map(str, r['ablation_size']))}; at most "
        f"{max(s['triangles'] for s in r['scenes'] if s != _store(r)) / 1e6:.1f} M triangles in memory (the paper: "
        f"11.7 to 21.5 M) and {_store(r)['triangles'] / 1e6:.1f} M in the store (139 to 350 M), of whose chunks "
        f"{100 * _store(r)['share']:.0f} % are in memory (20 to 47 %). {_where(r)}"
    ),
    "**Frames**: the second of each walkthrough counts, and the first is shown beside it. CHC+RT still traces what the "
    "first frame found visible, which it queries every third frame.",
    lambda r: (
        "**Times** are CPU time of one thread; from a store, they include the reading thread, but not waiting "
        "for the disk."
        if r.get("clock") == "cpu"
        else "**Times** are elapsed time."
    ),
)
