"""Prints the tables of the SRDH paper for people, with the paper's figures."""

from ...cli import console as report
from . import measure as bench
from . import published as paper
from .measure import Counted
from .rtsah import Assumed
from .times import BUILDS, PIXELS, SPP, TRACERS, BuildTimes, RenderTimes

_WIDTH = 150  # width of the tables, in characters


def _percent(share: float) -> str:
    return f"{100 * share:.0f}"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.1f}"


def print_orders(rows: list[Counted]) -> None:
    """Print the numbers of rays, then Figure 2 as a table."""

    asked, table = [], []
    for name in bench.scenes_of(rows):
        base = bench.of(rows, name, bench.BASE)
        asked.append((name, f"{base.triangles:,}", f"{base.rays:,}", _percent(base.blocked / base.rays)))
        for method in (*bench.SAH_ORDERS, bench.PUBLISHED, bench.OURS):
            r = bench.of(rows, name, method)
            parts = [_percent(part / base.total) for part in (r.total, *r.boxes)]
            table.append((name, method, *parts, f"{r.total / r.rays:.1f}", f"{r.tested / r.rays:.2f}"))
    print("Shadow rays that are counted")
    report.print_table(("scene", "triangles", "rays", "% blocked"), asked, right=range(1, 4), width=_WIDTH)
    classes = "path to the hit", "faux hits", "unoccluded"
    head = ("scene", "method", "all", *classes, "boxes a ray", "triangles a ray")
    print("Box tests in percent of random order, SRDH shown all rays (Figure 2)")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)


def print_saved(rows: list[Counted]) -> None:
    """Print the savings that the paper's text derives from Figure 2."""

    table = []
    for name in bench.scenes_of(rows):
        r = bench.of(rows, name, bench.PUBLISHED)
        shares = [bench.saved(rows, r, order) for order in bench.SAH_ORDERS]
        table.append((name, *map(_percent, shares), _percent(bench.saved_unoccluded(rows, r))))
    blinds = (_percent(paper.BEDROOM[order]) if order in paper.BEDROOM else "" for order in bench.SAH_ORDERS)
    table.append(("(paper: BEDROOM)", *blinds, ""))
    table += [(f"(paper: {name})", *[""] * 4, _percent(share)) for name, share in paper.UNOCCLUDED.items()]
    least, most = map(_percent, paper.REDUCTION)
    table.append(("(paper: all scenes)", f"{least} to {most}", *[""] * 4))
    head = ("scene", *(f"than {order}" for order in bench.SAH_ORDERS), "of unoccluded rays")
    print("Box tests that SRDH, as published and shown all rays, saves, in percent (Section 4.1)")
    report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def print_rtsah(rows: list[Assumed]) -> None:
    """Print RTSAH for the lines that it assumes, and for shadow rays."""
    bedroom = (1 - paper.BEDROOM["random"]) / (1 - paper.BEDROOM["rtsah"])
    table = [(r.scene, *map(_percent, r[1:])) for r in rows] + [("(paper: BEDROOM)", "", "", _percent(bedroom), "")]
    head = ("scene", "even lines", "reversed", "shadow rays", "reversed")
    print("Box tests by RTSAH, and by the opposite order, in percent of random order")
    report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def print_pixels(rows: list[Counted]) -> None:
    """Print Figure 4 as a table."""

    table, beyond = [], dict[str, list[float]]()
    for name in bench.scenes_of(rows):
        for method in (bench.PUBLISHED, bench.OURS):
            shown = [bench.of(rows, name, method, k) for k in (*bench.PIXELS, None)]
            sixteen = bench.beyond_all(rows, bench.of(rows, name, method, 16))
            beyond.setdefault(method, []).append(sixteen)
            cells = [f"{100 * bench.relative(rows, r):.1f}" for r in shown]
            table.append((name, method, *cells, f"{100 * sixteen:+.1f} %"))
    head = ("scene", "method", *(f"{k} x {k}" for k in bench.PIXELS), "all", "16 x 16 over all")
    print("Box tests in percent of random order, by the size of the pre-render (Figure 4)")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)
    most = {method: f"at most {100 * max(shares):.1f} % over all rays" for method, shares in beyond.items()}
    report.print_fields([*most.items(), ("the paper's", f"at most {_percent(paper.WITHIN)} %")])
    print()


def print_kernels(rows: list[Counted]) -> None:
    """Print Figure 5 as a table."""

    methods = (bench.CONSTANT, bench.DISTANCE, bench.PUBLISHED)
    table = []
    for name in bench.scenes_of(rows):
        found = [bench.of(rows, name, method) for method in methods]
        table.append((name, *(f"{100 * bench.relative(rows, r):.1f}" for r in found)))
    head = ("scene", *methods[:2], "all kernels")
    print("Box tests in percent of random order, by the kernels to choose from, all rays shown (Figure 5)")
    report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def print_builds(times: list[BuildTimes]) -> None:
    """Print Table 1 with the paper's rows, and the build times of a renderer that has no other tree."""
    table = []
    for t in times:
        published = _ms(t.sah_single), _ms(t.rays_by_sah), _ms(t.published), f"{t.both:.2f}"
        ours = _ms(t.sah), _ms(t.rays_by_lbvh), _ms(t.srdh), f"{t.instead:.2f}"
        size = f"{t.pixels} x {t.pixels}"
        table.append((t.scene, f"{t.triangles:,}", size, f"{t.rays:,}", f"{t.hits:,}", *published, *ours))
    for name, (triangles, sah, shown) in paper.BUILDS.items():
        for k, (rays, srdh) in shown.items():
            theirs = _ms(sah), "", _ms(srdh), f"{(sah + srdh) / sah:.2f}"
            table.append((f"(paper: {name})", f"{triangles:,}", f"{k} x {k}", f"{rays:,}", "", *theirs, *[""] * 4))
    head = (
        "scene", "triangles", "pixels", "rays", "hits", "SAH", "its rays", "SRDH", "both / SAH",
        "bsah", "lbvh, rays", "srdh", "instead / bsah",
    )  # fmt: skip
    print("Build times, ms: as published, one triangle in a leaf and one thread; then as a renderer does it (Table 1)")
    report.print_table(head, table, right=(1, *range(3, len(head))), width=_WIDTH)
    means = []
    for k in PIXELS:
        some = [t for t in times if t.pixels == k]
        both, instead = (sum(getattr(t, name) for t in some) / len(some) for name in ("both", "instead"))
        theirs = paper.both_over_sah(k)
        means.append((f"{k} x {k}", f"both / SAH {both:.2f} (the paper's {theirs:.2f}), instead / bsah {instead:.2f}"))
    report.print_fields(means)
    print()


def print_renders(times: list[RenderTimes]) -> None:
    """Print the gain of each tracer."""

    table = []
    for name in dict.fromkeys(t.scene for t in times):
        for tracer in TRACERS:
            sah, ours = (next(t for t in times if t[:3] == (name, build, tracer)) for build in BUILDS)
            ms = (f"{1e3 * t:.0f}" for t in (sah.built, ours.built, sah.traced, ours.traced))
            all_ = (ours.built + ours.traced) / (sah.built + sah.traced)
            rate = f"{ours.rays / ours.traced / 1e6:.1f}"
            table.append((name, tracer, *ms, f"{ours.traced / sah.traced:.2f}", f"{all_:.2f}", rate))
    head = ("scene", "tracer", "build bsah", "srdh", "trace bsah", "srdh", "trace, ratio", "both, ratio", "M rays/s")
    print(f"Direct light of what the camera sees, {SPP} samples, ms: srdh beside bsah")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)
