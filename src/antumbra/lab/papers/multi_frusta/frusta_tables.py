"""Prints the tables of ``antumbra bench multi-frusta``, with the paper's figures [Benthin and Wald 2009]."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from ..bench_runner import TableColumn, columns_of, item, label, ms, print_notes, print_table
from . import frusta_published
from .frusta_costs import (
    OPERATIONS,
    FittedCosts,
    SpeedupExplanation,
    explain,
    operations_of,
    published_costs,
    published_counts,
)
from .frusta_measurements import (
    BASELINES,
    COSTED,
    FIGURE6,
    HARD,
    PRIMARY,
    TABLE1,
    TABLE2,
    Case,
    Rows,
    SoftShadowQuality,
    exponents,
)


class MeasuredScene(NamedTuple):
    """The results of a scene."""

    case: Case
    tables: dict[str, Any]  # see `frusta_measurements.tables`
    quality: SoftShadowQuality


def print_tables(scenes: Sequence[MeasuredScene], costs: Mapping[str, FittedCosts]) -> None:
    """Print all tables: those of each scene, then the costs over all scenes."""
    for scene in scenes:
        _print_scene(scene)
    _print_costs(scenes, costs)
    print("Where the paper contradicts itself")
    print_notes(frusta_published.contradictions())


def _print_scene(scene: MeasuredScene) -> None:
    (case, tables, quality), name = scene, scene.case.name
    _print_counts(f"Table 1, {name}, primary rays", case, tables["table 1 primary"])
    _print_reduction(tables["table 1 primary"], "packet16:paper", tuple(PRIMARY)[1:], "P")
    _print_counts(f"Hard shadows, {name}, rays to a point light", case, tables["hard shadows"])
    _print_counts(f"Table 1, {name}, shadow rays", case, tables["table 1"])
    for base in BASELINES:
        _print_reduction(tables["table 1"], base, TABLE1[len(BASELINES) :], "S")
    _print_packet256(tables["table 1"])
    _print_table2(case, tables["table 2"])
    title = f"Figure 5, {name}: visibility error x 1000 against 256 samples per pixel (the paper: pictures)"
    print_table(title, _FIGURE5, quality.rows.items())
    _print_figure6(case, tables["figure 6"])
    _print_lights(case, tables["section 6.1"])
    ours, theirs = f"{100 * quality.edges:.1f} %", f"{100 * frusta_published.EDGES:.1f} % in Saloon"
    print(f"Figure 7, {name}: {ours} of the pixels are at edges (the paper: {theirs})\n")


# --- Table 1 ----------------------------------------------------------------------------------------------------------


def _thousands(row: Mapping[str, float], counter: str) -> str:
    return f"{row[counter] / 1e3:,.0f}K"


def _published_thousands(row: frusta_published.PublishedRow, counter: str) -> str:
    return f"{getattr(row, counter):,}K"


def _published_time(row: frusta_published.PublishedRow) -> str:
    return f"{row.cycles / 1e3:.4f}"  # cycles of 1 GHz


def _print_counts(title: str, case: Case, rows: Rows) -> None:
    """Print the counts and times of tracers, and for Table 1 the paper's rows of all scenes."""
    rays = next(iter(rows.values()))["rays"]
    columns = [
        label("tracer", item(0), lambda row: f"{row.scene}, {row.name}"),
        *columns_of(frusta_published.COUNTERS, lambda row, counter: _thousands(row[1], counter), _published_thousands),
        TableColumn("seconds", item(1, lambda row: f"{row['seconds']:.4f}"), _published_time),
    ]
    kind = "P" if "shaded" in next(iter(rows.values())) else "S"
    if kind == "P":
        shaded = lambda row: f"{row.with_shading / 1e3:.4f}"
        columns.append(TableColumn("with shading", item(1, lambda row: f"{row['shaded']:.4f}"), shaded))
    columns.append(TableColumn("M rays/s", item(1, lambda row: f"{rays / row['seconds'] / 1e6:.2f}")))
    size = f"{len(case.triangles.vertices):,} triangles, {rays / 1e6:.2f} M rays"
    published = [row for row in frusta_published.TABLE1 if row.rays == kind] if "Table 1" in title else []
    print_table(f"{title}: {size}", columns, rows.items(), published)


def _print_reduction(rows: Rows, base: str, tracers: Sequence[str], kind: str) -> None:
    """Print by what factor the tracers reduce the counts and time of `base`, and the paper's factors in each scene."""
    names = {**frusta_published.COUNTERS, "seconds": "seconds", **({"shaded": "with shading"} if kind == "P" else {})}
    ratio = lambda row, name: f"{rows[base][name] / max(row[1][name], 1e-9):.2f}"
    columns = [label("tracer", item(0), lambda pair: pair[0].scene), *columns_of(names, ratio, _published_ratio)]
    title = f"Reduction factor over {base} (Table 1, and the paper's factors)"
    print_table(title, columns, [(tracer, rows[tracer]) for tracer in tracers], frusta_published.pairs(kind))


def _published_ratio(pair: frusta_published.Pair, name: str) -> str:
    return frusta_published.printed_factor(pair, {"seconds": "cycles", "shaded": "with_shading"}.get(name, name))


# --- Sec. 5.2, Table 2 and Figures 5 and 6 ----------------------------------------------------------------------------


_FIGURE5 = (
    label("frame", item(0)),
    TableColumn("M rays", item(1, lambda row: f"{row['rays'] / 1e6:.2f}")),
    TableColumn("seconds", item(1, lambda row: f"{row['seconds']:.3f}")),
    TableColumn("rms", item(1, lambda row: f"{1e3 * row['rms']:.1f}")),
    TableColumn("mean", item(1, lambda row: f"{1e3 * row['mean']:.1f}")),
)


def _print_packet256(rows: Rows) -> None:
    """Print the comparison of Sec. 5.2. The paper counts a box once for all 256 rays, as this counts nodes."""
    many, frusta, packets = (rows[t] for t in ("packet256", "multifrusta:paper", "packet16:paper"))
    change = (
        f"{100 * (many['nodes'] / max(frusta['nodes'], 1) - 1):+.0f} % (the paper: {frusta_published.PACKET256[0]})"
    )
    speed = f"{frusta['seconds'] / many['seconds']:.2f} (the paper: {frusta_published.PACKET256[1]})"
    over_packets = f"{packets['seconds'] / many['seconds']:.2f} (the paper: in some cases less than 1)"
    print("Packets of 256 rays compared with multifrusta:paper (Sec. 5.2)")
    print_notes([("nodes", change), ("speedup", speed), ("speedup over packet16:paper", over_packets)])


def _print_table2(case: Case, rows: Rows) -> None:
    none = rows[TABLE2[0]]
    columns = (
        label("tracer", item(0)),
        *_per_counter(lambda row, counter: f"{100 * (row[counter] / max(none[counter], 1) - 1):+.1f}"),
        label("the paper", item(0, frusta_published.TABLE2.__getitem__)),
        TableColumn("shrinks", item(1, lambda row: f"{row['shrinks'] / 1e3:,.0f}K")),
        TableColumn("speedup", item(1, lambda row: f"{none['seconds'] / row['seconds']:.2f}")),
    )
    print_table(f"Table 2, {case.name}: change in %, with the paper's for T-Rex", columns, rows.items())


def _per_counter(cell: Callable[[dict[str, float], str], str]) -> list[TableColumn]:
    """A column per counter. Rows are (tracer, counters)."""
    return columns_of(frusta_published.COUNTERS, lambda row, counter: cell(row[1], counter))


def _print_figure6(case: Case, sizes: dict[str, Rows]) -> None:
    thousands = lambda row: f"{row['triangles'] / 1e3:,.0f} {row['triangle_tests'] / 1e3:,.0f}"
    columns = columns_of({size: size for size in sizes}, lambda tracer, size: thousands(sizes[size][tracer]))
    title = f"Figure 6, {case.name}: #tris and #isec in thousands, by edge length of the light (area: its square)"
    print_table(title, [label("tracer", str), *columns], FIGURE6)
    for tracer in FIGURE6:
        powers = {frusta_published.COUNTERS[c]: exponents(sizes, tracer, c) for c in ("triangles", "triangle_tests")}
        text = ", ".join(f"{name} edge^{edge:.2f} or area^{area:.2f}" for name, (edge, area) in powers.items())
        print_notes([(f"{tracer} grows as", f"{text} (the paper: {frusta_published.FIGURE6})")])


# --- Sec. 6.1 ---------------------------------------------------------------------------------------------------------


def _print_lights(case: Case, lights: dict[str, Rows]) -> None:
    """Print times of the lights of Sec. 6.1, and how much faster than `packet16` the tracers are."""
    rows = [
        (light, tracer, row, light_rows[HARD[0]])
        for light, light_rows in lights.items()
        for tracer, row in light_rows.items()
    ]
    columns = [
        label("light", item(0)),
        label("tracer", item(1)),
        *columns_of(frusta_published.COUNTERS, lambda row, counter: _thousands(row[2], counter)),
        TableColumn("ms", item(2, lambda row: ms(row["seconds"]))),
        TableColumn("speedup", lambda row: f"{row[3]['seconds'] / row[2]['seconds']:.2f}"),
    ]
    print_table(f"Section 6.1, {case.name}: speedup over {HARD[0]} (the paper: no figures)", columns, rows)


# --- Costs ------------------------------------------------------------------------------------------------------------


def _print_costs(scenes: Sequence[MeasuredScene], costs: Mapping[str, FittedCosts]) -> None:
    """Print costs per operation, counts per 16 rays, and what explains the speedups of the paper's tracer."""
    theirs = {"the paper, packets": published_costs(False), "the paper, frusta": published_costs(True)}
    worst = lambda row: f"{100 * max(map(abs, row[1].errors)):.0f}"
    columns = [
        label("tracer", item(0), item(0)),
        *columns_of(OPERATIONS, lambda row, name: f"{1e9 * row[1].costs[name]:.1f}", _cycles),
        TableColumn("largest error, %", worst, worst),
    ]
    title = "Costs per operation in ns, fitted to all scenes and sizes of the light (the paper: cycles at 1 GHz)"
    print_table(title, columns, costs.items(), theirs.items())
    packets, frusta = COSTED[:2]
    columns = [label("scene", item(0)), label("tracer", item(1)), *_per_16_rays()]
    title = "Operations per 16 rays (the paper: with primary rays)"
    print_table(title, columns, [(s.case.name, t, _counts(s, t)) for s in scenes for t in COSTED] + _published_rows())
    rows = [
        (s.case.name, explain(_counts(s, packets), _counts(s, frusta), (costs[packets], costs[frusta]), _speedup(s)))
        for s in scenes
    ]
    heads = {"measured": "measured", "predicted": "from fitted costs", "their_costs": "our counts at the paper's costs"}
    heads["their_counts"] = "the paper's counts at our costs"
    cell: Callable[[tuple[str, SpeedupExplanation], str], str] = lambda row, name: f"{getattr(row[1], name):.2f}"
    title = f"What explains the speedup of {frusta} over {packets} (the paper: {_published_speedups()})"
    print_table(title, [label("scene", item(0)), *columns_of(heads, cell)], rows)


def _cycles(row: tuple[str, FittedCosts], name: str) -> str:
    return f"{row[1].costs[name]:.1f}" if name in row[1].costs else ""


def _counts(scene: MeasuredScene, tracer: str) -> dict[str, float]:
    return operations_of(scene.tables["costs"]["1.0"][tracer])


def _speedup(scene: MeasuredScene) -> float:
    packets, frusta = (scene.tables["costs"]["1.0"][tracer]["seconds"] for tracer in COSTED[:2])
    return float(packets / frusta)


def _per_16_rays() -> list[TableColumn]:
    names = {name: text for name, text in OPERATIONS.items() if name != "packets"}
    per = lambda row, name: f"{row[2][name] / row[2]['packets']:.2f}" if name in row[2] else ""
    return columns_of(names, per)


def _published_rows() -> list[tuple[str, str, dict[str, float]]]:
    return [
        (row.scene, f"the paper, {row.name}", published_counts(row))
        for row in frusta_published.TABLE1
        if row.rays == "S"
    ]


def _published_speedups() -> str:
    factors = [packets.cycles / frusta.cycles for packets, frusta in frusta_published.pairs("S")]
    return f"{min(factors):.1f} to {max(factors):.1f}"
