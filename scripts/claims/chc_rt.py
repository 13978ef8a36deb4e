"""The claims of the paper on CHC+RT [Mattausch et al. 2015]."""

from statistics import median

from antumbra.lab.papers.chc_rt import chcrt_published, walkthrough_timing
from antumbra.lab.papers.chc_rt.chcrt_plots import moved_points
from antumbra.lab.papers.chc_rt.walkthrough_timing import Turn
from antumbra.lab.papers.chc_rt.walkthroughs import FRUSTA, SINGLE

from .claim import NO_GPU, RANGE, UNKNOWN, Claim, Condition, Results, spread

_DIFFUSE, _EXACT = "diffuse", walkthrough_timing.CHCRT


def _turns(r: Results, table: str, **fields: str) -> list[Turn]:
    return walkthrough_timing.of([Turn(**row) for row in r[table]], **fields)


def _speedups(r: Results, kind: str, method: str = FRUSTA) -> tuple[float, float, float]:
    """The speedups of CHC+RT over a method for a ray kind, over scenes and views."""
    return spread(walkthrough_timing.speedups(_turns(r, "times"), method)[kind])


def _all_speedups(r: Results, method: str) -> list[float]:
    """The speedups of CHC+RT over a method for all ray kinds."""
    return [x for found in walkthrough_timing.speedups(_turns(r, "times"), method).values() for x in found]


def _without(r: Results, feature: str) -> tuple[float, float, float]:
    """How much longer frames in memory take without a feature."""
    turns = [t for t in _turns(r, "ablation") if not t.scene.startswith("store")]
    found = []
    for row in walkthrough_timing.rows_of(turns, "scene", "view", "kind"):
        base, without = (walkthrough_timing.of(turns, **row, method=m) for m in ("default", feature))
        found.append(walkthrough_timing.typical(without) / walkthrough_timing.typical(base))
    return spread(found)


def _aggressive(r: Results) -> tuple[float, float, float]:
    """The speedups of aggressive mode, over scenes, views and thresholds."""
    turns, found = _turns(r, "aggressive"), []
    for row in walkthrough_timing.rows_of(turns, "scene", "view", "method"):
        mine, exact = (walkthrough_timing.of(turns, **{**row, "method": m}) for m in (row["method"], _EXACT))
        if row["method"] != _EXACT:
            found.append(walkthrough_timing.typical(exact) / walkthrough_timing.typical(mine))
    return spread(found)


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
_NO_RIVAL = "in memory, queries cost these frusta more than they save"


def _median(kind: str, theirs: float, span: str) -> Claim:
    """The claim of Table 2 for rays that frusta trace."""
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
    Claim(
        "Table 2",
        "diffuse rays 1.79 times as fast in the median (0.89 to 5.92)",
        "{:.2f} to {:.2f}, median {:.2f}, over single rays",
        lambda r: _speedups(r, _DIFFUSE, SINGLE),
        lambda low, high, middle: middle >= 1.79,
        UNKNOWN + "; the same kernel without culling was not measured",
    ),
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
        "7, Table 4",
        "aggressive mode up to 8 times as fast with diffuse rays",
        RANGE,
        _aggressive,
        lambda low, high, middle: high >= 8,
        "little is skipped (see its error); " + UNKNOWN,
    ),
    Claim(
        "7, Figure 9",
        "mean absolute error of 9.04 with 20 pixels",
        "at most {:.3f}",
        lambda r: (max(t.error or 0.0 for t in _turns(r, "aggressive", method="chcrt:20")),),
        lambda error: error <= 9.04,
        "",
        "aggressive mode skips little here",
    ),
    Claim(
        "7, Table 5",
        "full randomisation of directions slows diffuse rays by 3.5 to 6.2 times",
        "{:.2f} to {:.2f} times",
        lambda r: _randomised(r, _DIFFUSE),
        lambda low, high: high >= 3.5,
        UNKNOWN,
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
        "{:.0f}, {:.0f} and {:.0f} %",
        lambda r: [_moved(r, kind) for kind in ("primary", "AO", _DIFFUSE)],
        lambda *ours: all(x <= 100 * max(chcrt_published.moved(k)) for k, x in enumerate(ours)),
        "the store is much smaller than the paper's, so a view needs more of it",
    ),
    Claim(
        "7, Table 3",
        "AO and diffuse rays move significantly more than primary rays",
        "primary {:.0f} %, AO {:.0f} %, diffuse {:.0f} % of the store",
        lambda r: [_moved(r, kind) for kind in ("primary", "AO", _DIFFUSE)],
        lambda primary, ao, diffuse: min(ao, diffuse) >= 1.5 * primary,
        "AO rays do not; " + UNKNOWN,
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
        "at the paper's size, measured once, one ray differed: two coplanar triangles at the same distance",
    ),
    Claim("7, Table 2", "narrows the gap between GLSL and CUDA in the 777", "", reason=NO_GPU + " and model"),
    Claim(
        "7, Table 2",
        "a city 12 times as large takes about as long near the street",
        "",
        reason="no scene in two sizes was measured",
    ),
    Claim(
        "Abstract, Table 1",
        "renders 138 to 350 M triangles (8 to 19 GB) out of core",
        "{:.1f} M triangles, {:.2f} GB",
        lambda r: (r["scenes"][-1]["triangles"] / 1e6, r["scenes"][-1]["total"] / 1e9),
        None,
        "not at this size in the benchmark",
    ),
    Claim("5.2", "without a cache of leaves the shader is 30 % slower", "", reason=NO_GPU),
    Claim("5.2", "tiles of 200 pixels and subtrees of 24 levels are best", "", reason="parameters of a shader's stack"),
    Claim("6", "several bounces, with rays sorted between them", "", reason="rays are not sorted between bounces yet"),
)

CONDITIONS: tuple[Condition, ...] = (
    lambda r: (
        "**Attribution**: `chcrt` traces with the kernel of frusta. Its speedup over `single`, "
        f"{median(walkthrough_timing.speedups(_turns(r, 'times'))['primary']):.2f} in the median for primary rays, "
        "compares frusta with single rays; the paper uses one kernel for both. Against the same kernel it is "
        f"{min(_all_speedups(r, FRUSTA)):.2f} to {max(_all_speedups(r, FRUSTA)):.2f} in memory."
    ),
    "**What it is for**: with limited memory, 10 M triangles and far diffuse rays, measured once, a rival with the "
    "same limit reads 15.4 GB and takes 54 s; `chcrt` reads 0.6 to 0.7 GB and takes 17 s.",
    lambda r: (
        f"**Sizes**: {r['size'][0]} x {r['size'][1]}, the paper at 1920 x 1080; at most "
        f"{max(s['triangles'] for s in r['scenes']) / 1e6:.1f} M triangles in memory (the paper: 11.7 to 21.5 M) and "
        f"{r['scenes'][-1]['triangles'] / 1e6:.1f} M in the store (139 to 350 M)."
    ),
)
