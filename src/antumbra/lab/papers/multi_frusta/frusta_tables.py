"""Prints the tables of ``antumbra bench multi-frusta``, with the paper's figures [Benthin and Wald 2009]."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..bench_runner import TableColumn, columns_of, few_rounds, item, label, ms, print_notes, print_table
from . import frusta_published
from .frusta_measurements import (
    BASELINES,
    FIGURE6,
    HARD,
    PRIMARY,
    TABLE1,
    TABLE2,
    MeasuredScene,
    Rows,
    SoftShadowQuality,
    exponents,
)


def print_tables(scenes: Sequence[MeasuredScene]) -> None:
    """Print all tables that were measured: those of each scene, then the operations per 16 rays."""
    for scene in scenes:
        _print_scene(scene)
    _print_operations([scene for scene in scenes if "table 1" in scene.tables])
    print("Where the paper contradicts itself")
    print_notes(frusta_published.contradictions())


def _print_scene(scene: MeasuredScene) -> None:
    printers: dict[str, Callable[[MeasuredScene, Any], None]] = {
        "table 1 primary": _print_primary,
        "hard shadows": _print_hard,
        "table 1": _print_soft,
        "table 2": _print_table2,
        "figure 6": _print_figure6,
        "section 6.1": _print_lights,
    }
    for table, rows in scene.tables.items():
        printers[table](scene, rows)
    if scene.quality is not None:
        _print_quality(scene.name, scene.quality)


def _print_primary(scene: MeasuredScene, rows: Rows) -> None:
    _print_counts(f"Table 1, {scene.name}, primary rays", scene, rows)
    _print_reduction(rows, "packet16:paper", tuple(PRIMARY)[1:], "P")


def _print_hard(scene: MeasuredScene, rows: Rows) -> None:
    _print_counts(f"Hard shadows, {scene.name}, rays to a point light", scene, rows)


def _print_soft(scene: MeasuredScene, rows: Rows) -> None:
    _print_counts(f"Table 1, {scene.name}, shadow rays", scene, rows)
    for base in BASELINES:
        _print_reduction(rows, base, TABLE1[len(BASELINES) :], "S")
    _print_packet256(rows)


def _print_quality(name: str, quality: SoftShadowQuality) -> None:
    title = f"Figure 5, {name}: visibility error x 1000 against 256 samples per pixel (the paper: pictures)"
    print_table(title, _FIGURE5, quality.rows.items())
    ours, theirs = f"{100 * quality.edges:.1f} %", f"{100 * frusta_published.EDGES:.1f} % in Saloon"
    print(f"Figure 7, {name}: {ours} of the pixels are at edges (the paper: {theirs})\n")


# --- Table 1 ----------------------------------------------------------------------------------------------------------


def _thousands(row: Mapping[str, float], counter: str) -> str:
    return f"{row[counter] / 1e3:,.0f}K"


def _published_thousands(row: frusta_published.PublishedRow, counter: str) -> str:
    return f"{getattr(row, counter):,}K"


def _published_time(row: frusta_published.PublishedRow) -> str:
    return f"{row.cycles / 1e3:.4f}"  # cycles of 1 GHz


def _print_counts(title: str, scene: MeasuredScene, rows: Rows) -> None:
    """Print the counts and times of tracers, and for Table 1 the paper's rows of all scenes."""
    rays = next(iter(rows.values()))["rays"]
    columns = [
        label("tracer", item(0), lambda row: f"{row.scene}, {row.name}"),
        *columns_of(frusta_published.COUNTERS, lambda row, counter: _thousands(row[1], counter), _published_thousands),
        TableColumn(
            "seconds", item(1, lambda row: few_rounds(f"{row['seconds']:.4f}", row["rounds"])), _published_time
        ),
    ]
    kind = "P" if "shaded" in next(iter(rows.values())) else "S"
    if kind == "P":
        shaded = lambda row: f"{row.with_shading / 1e3:.4f}"
        columns.append(TableColumn("with shading", item(1, lambda row: f"{row['shaded']:.4f}"), shaded))
    columns.append(TableColumn("M rays/s", item(1, lambda row: f"{rays / row['seconds'] / 1e6:.2f}")))
    size = f"{scene.triangles:,} triangles, {rays / 1e6:.2f} M rays"
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
    TableColumn("seconds, elapsed, once", item(1, lambda row: f"{row['seconds']:.3f}")),
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


def _print_table2(scene: MeasuredScene, rows: Rows) -> None:
    none = rows[TABLE2[0]]
    columns = (
        label("tracer", item(0)),
        *_per_counter(lambda row, counter: f"{100 * (row[counter] / max(none[counter], 1) - 1):+.1f}"),
        label("the paper", item(0, frusta_published.TABLE2.__getitem__)),
        TableColumn("shrinks", item(1, lambda row: f"{row['shrinks'] / 1e3:,.0f}K")),
        TableColumn("speedup", item(1, lambda row: f"{none['seconds'] / row['seconds']:.2f}")),
    )
    print_table(f"Table 2, {scene.name}: change in %, with the paper's for T-Rex", columns, rows.items())


def _per_counter(cell: Callable[[dict[str, float], str], str]) -> list[TableColumn]:
    """A column per counter. Rows are (tracer, counters)."""
    return columns_of(frusta_published.COUNTERS, lambda row, counter: cell(row[1], counter))


def _print_figure6(scene: MeasuredScene, sizes: dict[str, Rows]) -> None:
    thousands = lambda row: f"{row['triangles'] / 1e3:,.0f} {row['triangle_tests'] / 1e3:,.0f}"
    columns = columns_of({size: size for size in sizes}, lambda tracer, size: thousands(sizes[size][tracer]))
    title = f"Figure 6, {scene.name}: #tris and #isec in thousands, by edge length of the light (area: its square)"
    print_table(title, [label("tracer", str), *columns], FIGURE6)
    for tracer in FIGURE6:
        powers = {frusta_published.COUNTERS[c]: exponents(sizes, tracer, c) for c in ("triangles", "triangle_tests")}
        text = ", ".join(f"{name} edge^{edge:.2f} or area^{area:.2f}" for name, (edge, area) in powers.items())
        print_notes([(f"{tracer} grows as", f"{text} (the paper: {frusta_published.FIGURE6})")])


# --- Sec. 6.1 ---------------------------------------------------------------------------------------------------------


def _print_lights(scene: MeasuredScene, lights: dict[str, Rows]) -> None:
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
        TableColumn("ms", item(2, lambda row: few_rounds(ms(row["seconds"]), row["rounds"]))),
        TableColumn("speedup", lambda row: f"{row[3]['seconds'] / row[2]['seconds']:.2f}"),
    ]
    print_table(f"Section 6.1, {scene.name}: speedup over {HARD[0]} (the paper: no figures)", columns, rows)


# --- Operations per 16 rays -------------------------------------------------------------------------------------------


_OPERATIONS = {"nodes": "node", "triangles": "triangle", "candidates": "triangle left", "triangle_tests": "16-ray test"}
"""Counter -> its name in tables."""


def _print_operations(scenes: Sequence[MeasuredScene]) -> None:
    """Print counts per 16 rays, which do not depend on the size of the picture, beside the paper's."""
    rows = [
        (scene.name, tracer, scene.tables["table 1"][tracer])
        for scene in scenes
        for tracer in ("packet16:paper", *_OURS)
    ]
    per = lambda row, name: f"{16 * row[2][name] / (row[2]['rays'] - row[2]['below_horizon']):.2f}"
    columns = [label("scene", item(0)), label("tracer", item(1)), *columns_of(_OPERATIONS, per)]
    theirs = [
        (row.scene, f"the paper, {row.name}", _published_operations(row))
        for row in frusta_published.TABLE1
        if row.rays == "S"
    ]
    if rows:
        print_table("Operations per 16 rays (the paper: with primary rays)", columns, [*rows, *theirs])


_OURS = ("multifrusta:paper", "multifrusta")


def _published_operations(row: frusta_published.PublishedRow) -> dict[str, float]:
    """The counts of an S row of Table 1, for its primary and shadow rays."""
    counts = {"nodes": row.box_tests / 2, "triangles": row.triangles, "candidates": row.candidates}
    rays = frusta_published.PIXELS * (1 + frusta_published.SPP)
    thousands = {**counts, "triangle_tests": row.triangle_tests}
    return {**{name: 1e3 * count for name, count in thousands.items()}, "rays": rays, "below_horizon": 0}
