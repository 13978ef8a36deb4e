"""Draws a bar chart of shadow rays per second of Antumbra and its peers, from rows of `soft_shadows`.

    python benchmarks/soft_shadows.py --plans bsah+auto --threads 1 --clock cpu --json rows.json
    python benchmarks/peer_chart.py rows.json ... -o docs/images/peers.svg

Each bar is the median of a library's best mode. The caption has the command, the processor and the versions.
"""

import argparse
import json
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from antumbra.base.extras import import_extra
from peers.ray_contest import OURS

COLOURS = {OURS: "#d9480f", "Embree": "#1c7ed6", "Mitsuba": "#7048e8", "Open3D": "#868e96"}
PACKAGES = {"embreex": "Embree", "mitsuba": "Mitsuba", "open3d": "Open3D"}


def best(rows: list[dict]) -> dict[tuple[str, int], dict[str, float]]:
    """(scene and light, threads) -> million rays per second of each library's best mode."""
    cases: dict = {}
    for row in rows:
        if row["rounds"]:
            case = cases.setdefault((f"{row['scene']}\n{row['light']} light", row["threads"]), {})
            library = row["family"].partition(" ")[0]
            case[library] = max(case.get(library, 0.0), row["mrays"])
    return cases


def caption(about: dict) -> str:
    """The caption: command, processor and versions."""
    names = []
    for package, name in PACKAGES.items():
        try:
            names.append(f"{name} ({package} {version(package)})")
        except PackageNotFoundError:
            continue
    command = about.get("command", "python benchmarks/soft_shadows.py")
    return f"{command}\n{about['processor']}; {', '.join(names)}; best mode of each, medians"


def draw(rows: list[dict], about: dict, output: Path) -> None:
    """Write the chart."""
    pyplot = import_extra("matplotlib.pyplot", "the chart", "plot")
    cases = best(rows)
    families = [name for name in COLOURS if any(name in case for case in cases.values())]
    threads = {threads for _, threads in cases}
    figure, axes = pyplot.subplots(figsize=(8, 3.6), layout="constrained")
    width = 0.8 / len(families)
    for k, family in enumerate(families):
        at = [i + (k - (len(families) - 1) / 2) * width for i in range(len(cases))]
        heights = [case.get(family, 0.0) for case in cases.values()]
        bars = axes.bar(at, heights, 0.92 * width, color=COLOURS[family], label=family.replace(OURS, "Antumbra"))
        axes.bar_label(bars, [f"{height:.1f}" if height else "" for height in heights], fontsize=7, padding=1)
    axes.set_xticks(range(len(cases)), [name for name, _ in cases], fontsize=8)
    axes.set_ylabel("million shadow rays per second", fontsize=8)
    count = f"{' and '.join(map(str, sorted(threads)))} thread{'' if threads == {1} else 's'}"
    axes.set_title(f"Soft shadows, {count}: more is better", fontsize=10)
    axes.legend(fontsize=8, frameon=False, ncols=len(families))
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_ylim(top=1.18 * max(max(case.values()) for case in cases.values()))
    figure.supxlabel(caption(about), fontsize=6, color="#555555")
    figure.savefig(output, metadata={"Date": None} if output.suffix == ".svg" else None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="+", type=Path, help="files of soft_shadows --json")
    parser.add_argument("-o", "--output", type=Path, default=Path("peers.svg"))
    options = parser.parse_args()
    files = [json.loads(path.read_text()) for path in options.rows]
    draw([row for file in files for row in file["rows"]], files[0]["machine"], options.output)


if __name__ == "__main__":
    main()
