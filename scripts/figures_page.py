"""Generates the page of figures, docs/figures.md, from results of measurements.

    python scripts/figures_page.py
    python scripts/figures_page.py --check

The results are docs/results/NAME.json, from the option --json of the scripts in benchmarks/, and
docs/papers/results/NAME.json, from ``antumbra bench``. docs/results/transcribed.json has tables that commands printed
before their results were kept; once docs/results/ has the file of such a table (`RERUN` lists them), the table is made
from it. Each table on the page names its command, machine and date. --check exits with code 1 if the page differs.
"""

import json
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from statistics import geometric_mean, median
from typing import Any, NamedTuple

from document_numbers import title_of

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
PAPERS = ROOT / "docs" / "papers" / "results"
PAGE = ROOT / "docs" / "figures.md"

INTRO = """# Figures

A ratio above 1 means that Antumbra is faster. Each table names its command, machine and date. To measure on your
machine, run the commands in a clone; they alternate with the peers in one process. Times on shared machines vary by
10 to 20 %, ratios less. Bars show the numbers above them; the bar of a ratio below 1 is grey. Long tables are folded.
`python scripts/figures_page.py` generates this page from results in `docs/results/` and `docs/papers/results/`.
"""


LONGEST = 6
"""Rows of a table that is not folded."""

SCENES = {
    "bart_museum8_subdivided": "Museum",
    "bart_robots": "Robots",
    "delft_city": "Delft",
    "japanese_temple": "Temple",
    "sanmiguel_lite": "San Miguel",
    "sponza_crytek": "Sponza",
    "stanford_bunny": "Bunny",
    "synthetic_garden_foxes": "Foxes in a garden",
}
"""Name of a file of a scene -> what the page calls the scene."""


def readable(text: str) -> str:
    """A text with the names of scenes instead of those of their files."""
    return re.sub(rf"\b(?:{'|'.join(SCENES)})\b", lambda match: SCENES[match[0]], text)


def legend(tables: str) -> str:
    """The files of the scenes that tables name."""
    files = [
        f"{name} (`{file}`)" for file, name in SCENES.items() if re.search(rf"(?m)^(?:\||<summary>).*{name}", tables)
    ]
    return f"Scenes and their files: {', '.join(files)}.\n"


def load(name: str, folder: Path | None = None) -> dict[str, Any]:
    """A file of results, of docs/results/ by default."""
    return json.loads(((folder or RESULTS) / f"{name}.json").read_text(encoding="utf-8"))


def where(rows: Iterable[dict], **fields: Any) -> list[dict]:
    """The rows with these values of fields; at least one."""
    found = [row for row in rows if all(row.get(name) == value for name, value in fields.items())]
    if not found:
        raise LookupError(f"no rows with {fields}")
    return found


class Bars(NamedTuple):
    """Columns whose numbers have bars of one scale."""

    columns: Sequence[str]
    are_ratios: bool = False  # those below 1 are grey


def table(
    title: str, about: dict[str, Any], columns: Sequence[str], rows: Iterable[Sequence[str]], bars: Sequence[Bars] = ()
) -> str:
    """A table that folds below its title, with its command, machine and date; numbers are aligned right."""
    title, columns = readable(title), [readable(name) for name in columns]
    bars = [group._replace(columns=[readable(name) for name in group.columns]) for group in bars]
    rows = [[readable(str(cell)) for cell in row] for row in rows]
    numeric = [all(len(row[k]) < 20 and row[k].strip("*")[:1] <= "9" for row in rows) for k in range(len(columns))]
    for group in bars:
        places = [columns.index(name) for name in group.columns]
        _draw_bars(rows, places, group.are_ratios)
        numeric = [right and k not in places for k, right in enumerate(numeric)]
    heading = re.sub(r"`([^`]*)`", r"<code>\1</code>", title)  # within HTML, which is not read as Markdown
    lines = ["<details>" if len(rows) > LONGEST else "<details open>", f"<summary>{heading}</summary>", ""]
    lines.append(f"| {' | '.join(columns)} |")
    lines.append(f"|{'|'.join('---:' if right else '---' for right in numeric)}|")
    lines += [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([*lines, "", source(about), "", "</details>"]) + "\n"


def _draw_bars(rows: list[list[str]], columns: Sequence[int], are_ratios: bool) -> None:
    """Add bars to the cells of columns that begin with a number. Without the site's styles, the numbers remain."""
    numbers = {
        (row, k): float(match[1].replace(",", ""))
        for row, cells in enumerate(rows)
        for k in columns
        if (match := re.match(r"(\d[\d,]*\.?\d*)", cells[k]))
    }
    most = max(numbers.values())
    for (row, k), number in numbers.items():
        kind = "bar below" if are_ratios and number < 1.0 else "bar"
        rows[row][k] += f' <span class="{kind}" style="width:{100 * number / most:.0f}%"></span>'


def source(about: dict[str, Any]) -> str:
    """The command, machine and date of a table, as a line."""
    parts = [about["processor"]]
    if about.get("threads"):
        parts.append(f"{about['threads']} thread{'s' if about['threads'] > 1 else ''}")
    parts += [about[key] for key in ("embree", "versions") if about.get(key)]
    parts.append(about["date"].partition(" ")[0])
    return f"`{about['command']}`: {'; '.join(parts)}."


def transcribed(part: str) -> Iterable[str]:
    """The tables of a part that commands printed, each unless a newer file of results has it."""
    older = [each for each in load("transcribed")["tables"] if each["part"] == part]
    for title, run in RERUN.items():
        if run.part == part and (RESULTS / f"{run.results}.json").is_file():
            older = [each for each in older if not each["title"].startswith(title)]
            yield run.make(load(run.results))
    for each in older:
        note = f"\n{each['note']}\n" if "note" in each else ""
        yield table(each["title"], each, each["columns"], each["rows"]) + note


# --- Speed ------------------------------------------------------------------------------------------------------------


PEERS = """![Shadow rays per second, as multiples of Embree, in four scenes](images/peers.svg)

Bars are geometric means of two lights, of medians over alternating rounds on the same rays. Each peer runs in its best
mode; Embree has up to 24, including packets and coherent streams. Peers trace rays made beforehand, while Antumbra's
time includes making its own. The larger the light, the fewer triangles the rays of neighbouring pixels have in
common, and the less shafts gain.
"""


def soft_shadows() -> str:
    results = load("soft_shadows")
    plans = {"bsah+multifrusta": "`bsah+multifrusta`", "bsah+reinsert+multifrusta": "`bsah+reinsert+multifrusta`"}
    ratios = {plan: where(results["rows"], contender=plan) for plan in plans}
    rows = [
        [one["scene"], one["light"], f"{one['rays'] / 1e6:.1f}", *(f"{ratios[p][k]['ratio']:.2f}" for p in plans)]
        for k, one in enumerate(ratios["bsah+multifrusta"])
    ]
    means = [f"{geometric_mean(row['ratio'] for row in ratios[plan]):.2f}" for plan in plans]
    rows.append(["geometric mean", "", "", *means])
    columns = ["scene", "light", "million rays", *plans.values()]
    title, bars = "Soft shadows, relative to the fastest peer in its best mode", [Bars(columns[3:], are_ratios=True)]
    return table(title, results["machine"], columns, rows, bars)


def moving_scenes() -> str:
    results = load("dynamic")
    rows = [
        [row["scene"], f"`{row['contender']}`", f"{row['ratio']:.2f}", f"{row['fps']:.1f}"]
        for row in where(results["rows"], family="antumbra")
    ]
    title = "Moving scenes: frames of soft shadows, relative to a pipeline around Embree"
    columns = ["scene", "plan", "ratio", "frames per second"]
    return table(title, results["machine"], columns, rows, [Bars(["ratio"], are_ratios=True)])


def trees() -> Iterable[str]:
    for name in ("build", "build-hills"):
        results = load(name)
        times = {(r["method"], r["scene"]): f"{r['median_ms']:,.0f}" for r in results["rows"]}
        methods, scenes = (list(dict.fromkeys(pair[k] for pair in times)) for k in (0, 1))
        rows = [[method, *(times.get((method, scene), "") for scene in scenes)] for method in methods]
        which = "of 10 million triangles" if name == "build-hills" else "of scenes"
        bars = [Bars([scene]) for scene in scenes]
        yield table(f"Building trees {which}: ms", results["machine"], ["method", *scenes], rows, bars)


REBUILD = (
    "cones",
    "lbvh+single",
    "lbvh+packet16",
    "lbvh+multifrusta",
    "auto",
    "Embree rtcOccluded1",
    "Embree rtcOccluded16",
)


def rebuilds() -> str:
    results, rows = load("rebuild"), []
    for scene in dict.fromkeys(row["scene"] for row in results["rows"]):
        ms = [1000 * where(results["rows"], scene=scene, method=method)[0]["shadows"] for method in REBUILD]
        cells = [f"**{each:.0f}**" if each == min(ms) else f"{each:.0f}" for each in ms]
        rows.append([scene, f"{where(results['rows'], scene=scene)[0]['triangles']:,}", *cells])
    title = "New triangles in every frame: ms to cull, build and trace one hard shadow ray per pixel, 1024 x 1024"
    return table(title, results["machine"], ["scene", "triangles", *(f"`{name}`" for name in REBUILD)], rows)


def updates() -> str:
    results, rows = load("update"), []
    for ours in where(results["rows"], method="update + occluded"):
        peers = where(results["rows"], scene=ours["scene"], kind=ours["kind"])
        best = min((r for r in peers if "wrong" not in r), key=lambda r: r["total_ms"])
        ms = f"{ours['total_ms']:,.0f}", f"{best['total_ms']:,.0f}"
        ratio, wrong = f"{best['we_are_faster']:.2f}", ours["wrong"] or "·"
        rows.append([ours["scene"], ours["kind"], ratio, *ms, best["method"], wrong])
    columns = ["scene", "rays", "ratio", "ms", "the fastest peer's ms", "the fastest peer", "our wrong answers"]
    title, bars = "Updates: a million triangles move, then a million rays", [Bars(["ratio"], are_ratios=True)]
    return table(title, results["machine"], columns, rows, bars)


def drop_in() -> str:
    """Geometric means over scenes; calls that are slower with few rays or many come first."""
    results = load("drop_in")
    counts = sorted({row["queries"] for row in results["rows"]})
    ratios: dict[tuple[str, str], dict[int, list[float]]] = {}
    for row in results["rows"]:
        ratios.setdefault((row["query"], row["peer"]), {}).setdefault(row["queries"], []).append(row["ratio"])
    means = {call: {n: geometric_mean(each) for n, each in of_call.items()} for call, of_call in ratios.items()}
    cells = [
        [*call, *(f"{means[call][n]:.2f}" if n in means[call] else "" for n in counts)]
        for call in sorted(means, key=lambda call: min(means[call].values()))
    ]
    scenes = ", ".join(dict.fromkeys(row["scene"] for row in results["rows"]))
    title = f"Drop-in replacements, by rays or points a call: means of {scenes}"
    sizes = [f"{n:,}" for n in counts]
    return table(title, results["machine"], ["query", "library", *sizes], cells, [Bars(sizes, are_ratios=True)])


def server() -> str:
    results = load("server")
    calls = where(results["rows"], part="latency")
    counts, libraries = (list(dict.fromkeys(call[key] for call in calls)) for key in ("rays", "library"))
    cells = {(r["library"], r["rays"]): f"{r['median_us']:,.0f} ({r['p99_us']:,.0f})" for r in calls}
    rows = [[library, *(cells.get((library, n), "") for n in counts)] for library in libraries]
    sizes = ["1 ray" if n == 1 else f"{n:,} rays" for n in counts]
    title = "Latency of a call, microseconds: median, and at most in 99 of 100 calls"
    return table(title, results["machine"], ["library", *sizes], rows, [Bars([size]) for size in sizes])


def server_scaling() -> str:
    results, rows = load("server"), []
    for one in where(results["rows"], part="scaling", library="antumbra", workers="threads", count=1):
        speedups = [
            where(results["rows"], part="scaling", library="antumbra", rays=one["rays"], workers=workers, count=8)[0]
            for workers in ("threads", "processes")
        ]
        rows.append(
            [f"{one['rays']:,}", f"{one['calls_per_second']:,.0f}", *(f"x {s['speedup']:.1f}" for s in speedups)]
        )
    columns = ["rays per call", "calls per second, one thread", "eight threads", "eight processes"]
    title = f"Calls from many threads and processes, on {results['machine']['cores']} cores"
    return table(title, results["machine"], columns, rows)


def sun() -> str:
    results = load("sun")
    rows = [
        [
            r["method"],
            f"{r['million_pairs_per_second']:.1f}",
            f"{r['seconds_for_all']:.0f}",
            f"{r['we_are_faster']:.1f}",
        ]
        for r in results["rows"]
    ]
    one = results["rows"][0]
    title = f"Sun hours: {one['sensors']:,} sensors, {one['suns']:,} suns of a year, {one['scene']}"
    columns = ["method", "million pairs a second", "seconds", "ratio"]
    return table(title, results["machine"], columns, rows, [Bars(["million pairs a second"])])


def startup() -> str:
    results = load("startup")
    rows = [[f"`{name}`", f"{median(seconds):.2f}"] for name, seconds in results["rows"].items()]
    return table("Start-up, whole processes", results["machine"], ["process", "seconds"], rows, [Bars(["seconds"])])


def small_queries() -> str:
    """Of `benchmarks/small.py`: microseconds a call."""
    results = load("small")
    rows = [[r["query"], f"{r['microseconds']:.0f}", f"{r['ratio']:.2f}"] for r in results["rows"]]
    columns = ["query", "microseconds", "relative to one ray by trimesh"]
    return table(f"Small queries: {results['rows'][0]['scene']}", results["machine"], columns, rows)


def small_soft_shadows(results: dict[str, Any]) -> str:
    families = list(dict.fromkeys(row["family"].partition(" ")[0] for row in results["rows"]))
    rows = []
    for one in where(results["rows"], family="antumbra"):
        case = where(results["rows"], scene=one["scene"], light=one["light"])
        rates = {name: [r["mrays"] for r in case if r["family"].startswith(name)] for name in families}
        rows.append([one["scene"], one["light"], *(f"{max(some):.1f}" if some else "" for some in rates.values())])
    title = "Soft shadows in small images, 512 x 512, plan `bsah+auto`: million rays per second"
    libraries = [name.capitalize() for name in families]
    return table(title, results["machine"], ["scene", "light", *libraries], rows, [Bars(libraries)])


def rays_in_arrays(results: dict[str, Any]) -> str:
    """Of `benchmarks/arrays.py`: ratios over scenes, to Embree's fastest mode and to Python libraries."""
    rows = []
    for kind in dict.fromkeys(row["kind"] for row in results["rows"]):
        some = where(results["rows"], kind=kind)
        scenes = dict.fromkeys(row["scene"] for row in some)
        fastest = [min(r["we_are_faster"] for r in where(some, scene=s) if "embree " in r["method"]) for s in scenes]
        others = ([r["we_are_faster"] for r in some if r["method"] == each] for each in ("embreex", "open3d"))
        rows.append([kind, f"{some[0]['rays']:,}", *(_extent(ratios) for ratios in (fastest, *others))])
    columns = ["rays", "number", "relative to Embree's best mode and tree", "relative to embreex", "relative to Open3D"]
    query = "closest hits" if "--query closest" in results["machine"]["command"] else "any hit"
    return table(f"Arrays of rays, {query}: least and largest ratio over scenes", results["machine"], columns, rows)


def _extent(ratios: list[float]) -> str:
    return f"{min(ratios):.2f} to {max(ratios):.2f}" if ratios else ""


def both_queries(results: dict[str, Any]) -> str:
    closest = [rays_in_arrays(load("arrays-closest"))] if (RESULTS / "arrays-closest.json").is_file() else []
    return "\n".join([rays_in_arrays(results), *closest])


def method_selection(results: dict[str, Any]) -> str:
    """Of `benchmarks/auto.py`: `auto` and the named plan with the least mean, relative to the best of each case."""
    cases = [row["seconds"] for row in results["rows"]]
    plans = set.intersection(*map(set, cases)) - {"auto"}
    least = [min(seconds for plan, seconds in case.items() if plan != "auto") for case in cases]
    ratios = {plan: [case[plan] / best for case, best in zip(cases, least)] for plan in (*plans, "auto")}
    named = min(plans, key=lambda plan: geometric_mean(ratios[plan]))
    rows = [[f"`{p}`", f"{geometric_mean(ratios[p]):.2f}", f"{max(ratios[p]):.2f}"] for p in ("auto", named)]
    title = f"Method selection by `auto`: time relative to the best plan of each of {len(cases)} cases"
    return table(title, results["machine"], ["plan", "geometric mean", "at worst"], rows)


def walks() -> Iterable[str]:
    """Of `benchmarks/auto.py --walk`: all frames of walks through large cities."""
    for path in sorted(RESULTS.glob("walks-*.json")):
        results = load(path.stem)
        rows = []
        for row in results["rows"]:
            of_plan = {plan: seconds for plan, seconds in row["seconds"].items() if plan != "auto"}
            best = min(of_plan, key=of_plan.__getitem__)
            ours, ratio = row["seconds"]["auto"], row["seconds"]["auto"] / of_plan[best]
            what = row["camera"], row["light"], row["spp"], f"{1e3 * ours:,.0f} ms", f"`{best}`", f"{ratio:.2f}"
            rows.append([str(each) for each in what])
        scene, frames = results["rows"][0]["scene"], results["rows"][0]["frames"]
        columns = ["camera", "light", "samples", "`auto`", "best plan", "`auto` relative to it"]
        title = f"Walks of {frames} frames through {scene.rpartition('=')[2]} triangles, with trees: computing time"
        yield table(title, results["machine"], columns, rows)


def jobs(results: dict[str, Any]) -> str:
    """Of `benchmarks/jobs.py`: matrices and bakes."""
    rows = []
    for r in results["rows"]:
        if r["what"] == "matrix":
            pairs = r["points"] ** 2
            rows.append(
                [
                    f"who sees whom: {r['points']:,} points in {r['scene']}",
                    f"{r['seconds']:.0f}",
                    f"{pairs / r['seconds'] / 1e6:.0f} million pairs a second",
                ]
            )
        elif r["what"] == "bake":
            what = f"baking {r['points']:,} vertices of {r['scene']}, {r['rays'] / 1e6:.1f} million rays"
            rows.append([what, f"{r['seconds']:.1f}", f"{1e6 * r['seconds'] / r['points']:.0f} s a million vertices"])
    return table("Jobs", results["machine"], ["work", "CPU seconds", "rate"], rows)


def viewer(results: dict[str, Any]) -> str:
    """Of `benchmarks/jobs.py`: the images of `antumbra.view`, coarse to fine."""
    some = where(results["rows"], what="viewer")
    scenes = dict.fromkeys((r["scene"], r["triangles"]) for r in some)
    rows = [
        [step, *(f"{where(some, step=step, scene=scene)[0]['seconds']:.2f}" for scene, _ in scenes)]
        for step in dict.fromkeys(r["step"] for r in some)
    ]
    title = "Images of the viewer, CPU seconds; the first one includes the tree"
    return table(title, results["machine"], ["image", *(f"{s}, {n:,} triangles" for s, n in scenes)], rows)


# --- Rows in which a peer is faster -----------------------------------------------------------------------------------


_FEW = "a call with few rays spends its time in Python; peers are in C++"


class Below(NamedTuple):
    """Rows of a table in which a peer is faster."""

    what: str
    ratios: list[float]  # below 1; empty: none
    of: int  # rows of this kind
    why: str


def below_in_rebuilds() -> Below:
    results, ratios = load("rebuild"), []
    for ours in where(results["rows"], method="auto"):
        peers = [r["shadows"] for r in where(results["rows"], scene=ours["scene"]) if r["method"].startswith("Embree")]
        ratios.append(min(peers) / ours["shadows"])
    why = "these frames take 11 to 26 ms, of which `auto` spends 1 to 3 ms on choosing a method"
    return Below("new triangles in every frame, `auto`", ratios, len(ratios), why)


def below_in_updates() -> Below:
    rows, ratios = load("update")["rows"], []
    for ours in where(rows, method="update + occluded"):
        peers = [r for r in where(rows, scene=ours["scene"], kind=ours["kind"]) if "wrong" not in r]
        ratios.append(min(r["total_ms"] for r in peers) / ours["total_ms"])
    why = "an update keeps the old arrays, which running queries still read, and refits two trees instead of one"
    return Below("updates: a million triangles move", ratios, len(ratios), why)


def below_in_builds() -> Iterable[Below]:
    for ours, theirs in (("lbvh", "embree low"), ("bsah", "embree medium")):
        both = [[where(load("build")["rows"], method=m), m] for m in (ours, theirs)]
        ratios = [b["median_ms"] / a["median_ms"] for a, b in zip(both[0][0], both[1][0])]
        why = "the trees are as good as Embree's best ones, and times vary by a tenth between runs"
        yield Below(f"building trees, `{ours}` beside {theirs}", ratios, len(ratios), why)


_OPEN = "in scenes with gaps, up to 14 rays vote on a point, where Open3D traces one and is wrong"
_ALL = "Antumbra counts triangles hit at one point once, and computes the exact distance of each hit to find them"
_DROP_IN = {"contains": _OPEN, "signed distance": _OPEN, "hit counts": _ALL, "all hits": _ALL}
"""Query -> why a peer is faster; other queries: see `below_in_drop_in`."""


def below_in_drop_in() -> Iterable[Below]:
    rows = [row for row in load("drop_in")["rows"] if row["ratio"] is not None]
    few = [row["ratio"] for row in rows if row["queries"] <= 100]
    yield Below("drop-in calls of 1 and 100", few, len(few), _FEW)
    by_reason: dict[str, list[dict[str, Any]]] = {}
    for row in (row for row in rows if row["queries"] > 100):
        why = _DROP_IN.get(row["query"], "first hits and locations include the exact t and weights")
        by_reason.setdefault(why, []).append(row)
    for why, some in by_reason.items():
        queries = dict.fromkeys(row["query"] for row in some if row["ratio"] < 1.0)
        ratios = [row["ratio"] for row in some]
        yield Below(f"drop-in calls of 10,000 and a million: {', '.join(queries)}", ratios, len(ratios), why)


def below_in_latency() -> Below:
    rows, ratios = load("server")["rows"], []
    for ours in where(rows, part="latency", library="antumbra"):
        peers = [r for r in where(rows, part="latency", rays=ours["rays"]) if r["library"] != "antumbra"]
        ratios.append(min(r["median_us"] for r in peers) / ours["median_us"])
    return Below("latency of a call", ratios, len(ratios), _FEW)


def below_in_small_pictures() -> Below:
    file, why = RESULTS / "soft_shadows_small.json", "pixels lie far apart, so that shafts gain less"
    if file.is_file():
        rows = where(load(file.stem)["rows"], family="antumbra")
        ratios = [row["ratio"] for row in rows]
    else:
        cells = _transcribed_rows("Soft shadows in small images")
        ratios = [float(row[2]) / max(map(float, row[3:])) for row in cells]
    return Below("soft shadows in small images", ratios, len(ratios), why)


def below_in_arrays() -> Below:
    why = "reading rays and writing exact t and weights takes 16 of the 39 ns of a camera ray in the robots"
    if (RESULTS / "arrays-occluded.json").is_file():
        files = [name for name in ("arrays-occluded", "arrays-closest") if (RESULTS / f"{name}.json").is_file()]
        rows = [row for name in files for row in load(name)["rows"] if "embree " in row["method"]]
        cases = dict.fromkeys((row["scene"], row["kind"]) for row in rows)
        ratios = [min(r["we_are_faster"] for r in where(rows, scene=s, kind=k)) for s, k in cases]
    else:
        ratios = [float(row[1].partition(" ")[0]) for row in _transcribed_rows("Arrays of rays")]
    return Below("arrays of rays, beside Embree's best mode", ratios, len(ratios), why)


def _transcribed_rows(title: str) -> list[list[str]]:
    return next(each["rows"] for each in load("transcribed")["tables"] if each["title"].startswith(title))


def below_one() -> str:
    """The rows of all tables with peers in which a peer is faster, each with its reason."""
    every = [below_in_rebuilds(), below_in_updates(), *below_in_builds(), *below_in_drop_in(), below_in_latency()]
    every += [below_in_small_pictures(), below_in_arrays()]
    rows = []
    for each in every:
        ratios = [ratio for ratio in each.ratios if ratio < 1.0]
        if ratios:
            assert each.why, f"{each.what}: a peer is faster; state why"
            cases = f"{len(ratios)} of {each.of} cases, with a ratio of {min(ratios):.2f} at worst"
            rows.append(f"- **{each.what[0].upper()}{each.what[1:]}**: {cases}. {each.why[0].upper()}{each.why[1:]}.")
    return "\n".join(["## Where a peer is faster", "", *rows]) + "\n"


# --- Wrong answers, papers, scale -------------------------------------------------------------------------------------


def wrong() -> str:
    results = load("drop_in")
    names = list(dict.fromkeys(row["contender"] for row in results["wrong"]))
    count = {(row["case"], row["contender"]): f"{row['wrong']:,}" if row["wrong"] else "·" for row in results["wrong"]}
    rows = [[case, *(count[case, name] for name in names)] for case in dict.fromkeys(case for case, _ in count)]
    title = f"All hits and insides, {results['wrong'][0]['queries']:,} queries each"
    return table(title, results["machine"], ["case", *names], rows)


def sun_rays() -> str:
    results = load("radiance_sun")
    rows = [[f"{results['sensors']:,}", f"{results['suns']:,}", f"{results['pairs']:,}", f"{len(results['rows']):,}"]]
    title = "Sun hours: pairs of sensor and sun for which Radiance and Antumbra differ"
    return table(title, results["machine"], ["sensors", "suns", "pairs", "differ"], rows)


def primary_rays(results: dict[str, Any]) -> str:
    tables = [scene["table 1 primary"] for scene in results["rows"].values()]
    ratios = [each["packet16:paper"]["seconds"] / each["multifrusta"]["seconds"] for each in tables]
    return f"primary rays are {min(ratios):.1f} to {max(ratios):.1f} times as fast as the paper's packets"


def culled_cellar(results: dict[str, Any]) -> str:
    rows = where(results["time_to_image"], figure="Figure 6", tracer="single")
    seconds = lambda name: sum(r["cull"] + r["build"] + r["trace"]["1"] for r in where(rows, method=name))
    share = 100 * seconds("LBVH, grid32") / seconds("LBVH")
    return f"culling before the build takes {share:.0f} % of the time to image without it, in a cellar"


def srdh_gains(results: dict[str, Any]) -> str:
    gains = [100 * (1 - row["trace"]) for row in where(results["gains"], tracer="single")]
    return f"`single` takes {min(gains):.0f} to {max(gains):.0f} % less time in trees for shadow rays"


CLAIMS = {"multi-frusta": primary_rays, "pre-bvh-culling": culled_cellar, "srdh": srdh_gains}
"""Paper -> its main figure, from its results."""


def papers() -> Iterable[str]:
    for path in sorted(PAPERS.glob("*.json")):
        results = load(path.stem, PAPERS)
        claim = f"{CLAIMS[path.stem](results)}; " if path.stem in CLAIMS else ""
        same = results.get("same_bits", results.get("same_answers"))
        answers = "all methods gave the same answers" if same else "**answers differ**"
        title = title_of(PAPERS.parent / f"{path.stem}.md")
        yield f"- [{title}](papers/{path.stem}.md): {claim}{answers}. {source(results['about'])}"


def scale() -> str:
    results = load("instances")
    large = results["large"]
    rows = [
        ["triangles", f"{large['triangles']:,}, in {large['trees']:,} instances of trees"],
        ["loading", f"{large['load']:.1f} s"],
        ["first picture", f"{large['first']:.0f} s, {large['rays'] / 1e6:.0f} million shadow rays"],
        ["memory at most", f"{large['peak'] / 1e6:,.0f} MB"],
    ]
    return table("A forest of instances", results["machine"], ["what", "figure"], rows)


def irradiance(results: dict[str, Any]) -> str:
    percent = lambda errors, spp: f"{errors[spp]:.2f} %" if spp in errors else "none"
    rows = [
        [r["case"], f"{r['lit']:.3f} %", percent(r["penumbra"], "256"), percent(r["penumbra"], "4096")]
        for r in results["rows"]
        if "lit" in r
    ]
    columns = ["light", "fully lit", "penumbra, 256 samples", "penumbra, 4,096 samples"]
    note = (
        "\nFully lit: mean relative error, mostly from the noise of Mitsuba. Penumbrae: mean difference over mean "
        "irradiance, without a filter, over pixels that see 2 to 98 % of the light. d is the "
        "distance, R the radius.\n"
    )
    return table("Irradiance: errors relative to Mitsuba 3", results["machine"], columns, rows) + note


def skies(results: dict[str, Any]) -> str:
    """Skies in the pictures of `radiometry` and of `radiometry-large`, whose command differs in the size."""
    runs = [results, *([load("radiometry-large")] if (RESULTS / "radiometry-large.json").is_file() else [])]
    some = [
        {**row, "case": f"{row['case']}, {4 * run['size']} x {3 * run['size']}"}
        for run in runs
        for row in run["rows"]
        if "count" in row
    ]
    names = list(dict.fromkeys(row["case"] for row in some))
    rows = [
        [f"{count:,}", *(f"{where(some, case=name, count=count)[0]['relative']:.1f} %" for name in names)]
        for count in dict.fromkeys(row["count"] for row in some)
    ]
    return table("Skies: mean relative error in a town of boxes", results["machine"], ["`Sky(count=)`", *names], rows)


def cluster_nodes(results: dict[str, Any]) -> str:
    """Of `benchmarks/cluster.py`: seconds and efficiency of simulated nodes."""
    some = results["simulated"]
    stores = list(dict.fromkeys(row["store"] for row in some))
    cell = lambda r: f"{r['seconds']:,.0f}, {r['of_ideal']:.2f}"
    rows = [
        [
            f"{r['hours']:g} h",
            r["nodes"],
            *(cell(where(some, hours=r["hours"], nodes=r["nodes"], store=s)[0]) for s in stores),
        ]
        for r in where(some, store=stores[0])
    ]
    names = ["scene by path" if not store else f"{store:g} GB to fetch" for store in stores]
    parts = median(results["rows"][0]["parts"])
    title = f"Nodes of a cluster, simulated from measured parts of {parts:.2f} s: seconds, efficiency"
    return table(title, results["about"], ["single-node work", "nodes", *names], rows)


def store(results: dict[str, Any]) -> str:
    (r,) = where(results["rows"], what="store")
    rows = [
        ["building", f"{r['build']:,.0f} s", f"a file of {r['bytes'] / 1e9:.1f} GB"],
        ["first frame in a street", f"{r['first']:.1f} s", f"at most {r['peak'] / 1e9:.1f} GB of memory"],
        ["later frames", f"{r['later']:.2f} s", ""],
    ]
    title = f"A store of {r['triangles'] / 1e6:,.0f} million triangles (`procedural:city`)"
    return table(title, results["machine"], ["step", "time", "size"], rows)


DEVICES = """Speed on a card is not yet measured. Registers can be counted without one, by ptxas: a multiprocessor has
65,536, so with 64 per thread it runs 1,024 threads, which hide the latency of memory. No kernel spills.
"""


def devices() -> str:
    results = load("device-code")
    architectures = list(dict.fromkeys(row["architecture"] for row in results["rows"]))
    rows = []
    for name in dict.fromkeys(row["kernel"] for row in results["rows"]):
        of_kernel = [row for row in results["rows"] if row["kernel"] == name]
        assert not any(row["spill_bytes"] for row in of_kernel), f"{name} spills registers"
        sizes = [f"{of_kernel[0][size] / 1e3:.0f} kB" for size in ("ptx_bytes", "spirv_bytes")]
        rows.append([f"`{name}`", *(str(row["registers"]) for row in of_kernel), *sizes])
    columns = ["kernel", *(f"`{each}`" for each in architectures), "PTX", "SPIR-V"]
    return table("Registers per thread of the kernels of devices", results["machine"], columns, rows)


class Rerun(NamedTuple):
    """The run of a benchmark that replaces a transcribed table."""

    part: str
    results: str  # name of its file in docs/results/
    make: Callable[[dict[str, Any]], str]  # makes the table


RERUN = {
    "Soft shadows in small images": Rerun("speed", "soft_shadows_small", small_soft_shadows),
    "Arrays of rays": Rerun("speed", "arrays-occluded", both_queries),
    "Method selection by `auto`": Rerun("speed", "auto", method_selection),
    "Jobs": Rerun("speed", "jobs", jobs),
    "Images of the viewer": Rerun("speed", "jobs", viewer),
    "Irradiance": Rerun("radiometry", "radiometry", irradiance),
    "Skies": Rerun("radiometry", "radiometry", skies),
    "A store of": Rerun("scale", "store", store),
    "Nodes of a cluster": Rerun("scale", "cluster", cluster_nodes),
}
"""Beginning of a title -> its run; docs/results/transcribed.json has the tables of those that are not run yet."""


TASKS = {
    "Pictures": ("Soft shadows", "Moving scenes", "Method selection", "Walks", "Images of the viewer"),
    "Trees and updates": ("Building trees", "New triangles", "Updates"),
    "Rays and points": ("Arrays of rays", "Drop-in", "Latency", "Calls", "Small queries"),
    "Jobs and start-up": ("Jobs", "Sun hours", "Start-up"),
}
"""Heading in the part on speed -> the beginnings of its tables' titles."""


def speed() -> Iterable[str]:
    """All tables of speed, below the headings of their tasks."""
    every = [soft_shadows(), moving_scenes(), *trees(), rebuilds(), updates(), drop_in(), server(), server_scaling()]
    every += [small_queries(), sun(), startup(), *transcribed("speed"), *walks()]
    for task, beginnings in TASKS.items():
        yield f"### {task}\n"
        for beginning in beginnings:
            found = [each for each in every if f"<summary>{beginning}" in each]
            assert found, f"no table begins with {beginning}"
            every = [each for each in every if each not in found]
            yield from found
    assert not every, f"no task has the table {every[0]}"


def page() -> str:
    """The text of the page."""
    tables = list(speed())
    parts = [
        INTRO,
        legend("\n".join(tables)),
        below_one(),
        "## Speed\n",
        PEERS,
        *tables,
        "## Devices\n",
        DEVICES,
        devices(),
        "## Wrong answers\n",
    ]
    parts += ["[Wrong answers elsewhere](wrong-elsewhere.md) has the counts of any-hit rays, and explains them.\n"]
    parts += [wrong(), sun_rays()]
    parts += ["## Papers\n", "Each page has the tables of a paper beside ours.\n", "\n".join(papers()) + "\n"]
    parts += ["## Radiometry\n", *transcribed("radiometry"), "## Scale\n", scale(), *transcribed("scale")]
    return "\n".join(parts)


if __name__ == "__main__":
    text = page()
    if "--check" not in sys.argv[1:]:
        PAGE.write_text(text, encoding="utf-8")
    elif not PAGE.is_file() or PAGE.read_text(encoding="utf-8") != text:
        sys.exit("docs/figures.md is out of date; run scripts/figures_page.py")
