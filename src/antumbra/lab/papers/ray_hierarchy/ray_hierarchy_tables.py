"""Prints the tables of the report on ray hierarchies with its results beside ours."""

from collections.abc import Callable

from ..bench_runner import TableColumn, beside, columns_of, few_rounds, label, ms, print_notes, print_table
from . import ray_hierarchy_published
from .ray_hierarchy_measurements import (
    BEST,
    OURS,
    PLANS,
    Claim,
    Cost,
    Measured,
    RelativeCost,
    Spread,
    fewest,
    never_more,
)
from .ray_hierarchy_views import MUSEUM

NOT_RUN = "not run"


def print_tables(
    measured: Measured,
    film: Measured,
    claims: list[Claim],
    relative: list[RelativeCost],
    spreads: list[Spread],
    filmed: bool,
) -> None:
    """Print all tables that were measured.

    film : frames of animations
    filmed : whether the film was to be measured
    relative : the variants of Figure 7, in `film`, or in `measured` if there is no animation
    """
    _print_claims(claims)
    if measured.pictures:
        _print_pictures(measured)
        _print_museum(measured)
    if filmed or film.pictures:
        _print_film(film, spreads)
    _print_figure7(relative)
    _print_notes(measured, film, spreads)


def _millions(count: float | None) -> str:
    return NOT_RUN if count is None else f"{count / 1e6:,.3f}"


def _milliseconds(cost: Cost) -> str:
    return few_rounds(ms(cost.seconds), cost.rounds) or NOT_RUN


def _print_claims(claims: list[Claim]) -> None:
    """Print the report's ratios beside ours."""
    columns = (
        label("ratio (of nodes passed, or of times)", "text"),
        TableColumn("report", lambda c: f"{c.published:,.1f}"),
        TableColumn("here", lambda c: f"{c.ours:,.1f}"),
        label("measured in", "picture"),
    )
    if claims:
        print_table("The report's claims", columns, claims)


def _print_pictures(measured: Measured) -> None:
    """Print Figures 6 and 7 as tables."""
    sizes = (
        label("picture", "picture"),
        TableColumn("triangles", lambda s: f"{s.triangles:,}"),
        TableColumn("rays", lambda s: f"{s.rays:,}"),
        TableColumn("% blocked", lambda s: f"{100 * s.blocked / s.rays:.0f}"),
    )
    print_table("Pictures: one point light, one shadow ray per visible surface point", sizes, measured.pictures)

    def print_variants(title: str, cell: Callable[[Cost], str]) -> None:
        variants = columns_of({name: name for name in PLANS}, lambda s, name: cell(measured.of(s.picture, name)))
        print_table(title, [label("picture", "picture"), *variants], measured.pictures)

    print_variants("Nodes tested, millions (Figures 6 and 7)", lambda c: _millions(c.nodes))
    print_variants("Nodes passed, millions (Figures 6 and 7)", lambda c: _millions(c.passed))
    print_variants("Ray tests of up to 16 rays, millions", lambda c: _millions(c.tests))
    print_variants("Shadows, ms (Figures 6 and 7)", _milliseconds)
    if any(c.nodes is None for c in measured.costs):
        print(f"{NOT_RUN}: predicted to take longer than --limit\n")


def _print_museum(measured: Measured) -> None:
    """Print Table 2, with the report's values in brackets."""
    places = [s.picture for s in measured.pictures if s.of == MUSEUM]
    if not places:
        return
    heads = dict(enumerate(places))

    def print_places(title: str, cell: Callable[[Cost, int], str]) -> None:
        columns = columns_of(heads, lambda variant, k: cell(measured.of(places[k], variant), k))
        title = f"{title} (Table 2; in brackets the report's, for frames that it does not name, on a GPU)"
        print_table(title, [label("variant", str), *columns], ray_hierarchy_published.MEASURED)

    def nodes(cost: Cost, k: int) -> str:
        counts = NOT_RUN if cost.nodes is None else f"{_millions(cost.nodes)}, {_millions(cost.passed)}"
        return beside(counts, ray_hierarchy_published.NODES[cost.variant][k] / 1e6, 2)

    def times(cost: Cost, k: int) -> str:
        return beside(_milliseconds(cost), ray_hierarchy_published.MILLISECONDS[cost.variant][k])

    print_places("Nodes tested and passed, millions", nodes)
    print_places("Shadows, ms", times)


def _print_film(film: Measured, spreads: list[Spread]) -> None:
    """Print the nodes and times over the frames of an animation, and their variation."""
    if not spreads:
        print("No animation with at least two frames, so no curves (Figures 6 and 7)\n")
        return
    columns = (
        label("animation", "of"),
        label("variant", "variant"),
        TableColumn("frames", lambda s: f"{s.frames}"),
        TableColumn("nodes tested, M", lambda s: _millions(s.nodes)),
        TableColumn("most", lambda s: _millions(s.most_nodes)),
        TableColumn("nodes passed, M", lambda s: _millions(s.passed)),
        TableColumn("shadows, ms", lambda s: ms(s.median)),
        TableColumn("longest / shortest", lambda s: f"{s.ratio:.2f}"),
        TableColumn("interquartile range, ms", lambda s: ms(s.quartiles)),
        TableColumn("deviation, % of mean", lambda s: f"{100 * s.deviation:.0f}"),
    )
    rays = max(s.rays for s in film.pictures)
    title = f"Medians over the frames of an animation, up to {rays:,} rays each (Figures 6 and 7)"
    print_table(title, columns, spreads)


def _print_figure7(rows: list[RelativeCost]) -> None:
    """Print Figure 7 as a table: early accept and two passes."""
    columns = (
        label("scene", "of"),
        label("variant", "variant"),
        TableColumn("pictures", lambda b: f"{b.pictures}"),
        TableColumn("nodes tested", lambda b: f"{b.nodes:.2f}"),
        TableColumn("nodes passed", lambda b: f"{b.passed:.2f}"),
        TableColumn("time", lambda b: f"{b.seconds:.2f}"),
    )
    title = f"Early accept and two passes relative to {BEST} (Figure 7; in the report, nodes fall and time rises)"
    print_table(title, columns, [b for b in rows if b.variant != BEST])


_ORDERS = (
    ("Precise", "Spheres", "always"),
    ("PreciseSorted", "SpheresSorted", "always"),
    ("SpheresSorted", "Spheres", "always"),
    ("PreciseSorted", "Precise", "always"),
)
"""(a, b, how often a visits fewer nodes than b in Figure 6, by the text of Section 5)."""


def _print_notes(measured: Measured, film: Measured, spreads: list[Spread]) -> None:
    """Print who tests the fewest nodes, and which variant is the steadiest."""
    rows = []
    for one, other, theirs in _ORDERS:
        counts = [never_more(part, one, other) for part in (measured, film)]
        large, small = (f"{n} of {total}" for n, total in counts)
        frames = f", and {small} frames of animations" if counts[1][1] else ""
        rows.append((f"{one} tests no more nodes than {other}", f"in {large} pictures{frames} (report: {theirs})"))
    for title, among in (
        ("of Figure 6", ray_hierarchy_published.MEASURED),
        ("of Table 1", ray_hierarchy_published.VARIANTS),
        (f"with {OURS}", tuple(PLANS)),
    ):
        best = [fewest(measured, s.picture, among) for s in measured.pictures]
        wins = ", ".join(f"{name or NOT_RUN} {best.count(name)}" for name in dict.fromkeys(best))
        rows.append((f"fewest nodes {title}", f"in {len(best)} pictures: {wins}"))
    for name in dict.fromkeys(s.of for s in spreads):
        least = min((s for s in spreads if s.of == name), key=lambda s: s.deviation)
        text = f"{least.variant}, standard deviation {100 * least.deviation:.0f} % of the mean"
        rows.append((f"steadiest in {name}", text))
    print_notes(rows)
