"""Draws how many times as many shadow rays per second Antumbra traces as Embree, from rows of `soft_shadows`.

    python benchmarks/soft_shadows.py --threads 1 --clock cpu --json rows.json
    python benchmarks/peer_chart.py rows.json ... -o docs/images/peers.svg

A bar is the geometric mean over a scene's lights and numbers of threads; each library runs in its best mode, which is a
median. The chart fits a telephone, and its greys suit light and dark pages; docs/figures.md names the machine.
"""

import argparse
import json
from html import escape
from pathlib import Path
from statistics import geometric_mean

from peers.ray_contest import OURS

PEER = "Embree"
WIDTH, BAR, STEP, TOP = 420, 22, 48, 34  # units of the SVG: widths, heights, and the first row
GREY, ORANGE = "#767c82", "#d9480f"
TITLES = {
    "sponza_crytek": "Sponza",
    "sanmiguel_lite": "San Miguel, a part",
    "bart_robots": "Robots",
    "forest": "Forest",
}
"""Scene -> its title; others bear their names."""


def ratios(rows: list[dict]) -> dict[str, float]:
    """Scene -> our rays per second over the peer's, best modes."""
    best: dict[tuple[str, str, int], dict[str, float]] = {}
    for row in rows:
        if row["rounds"]:
            case = best.setdefault((row["scene"], row["light"], row["threads"]), {})
            library = row["family"].partition(" ")[0]
            case[library] = max(case.get(library, 0.0), row["mrays"])
    scenes: dict[str, list[float]] = {}
    for (scene, _, _), case in best.items():
        if OURS in case and PEER in case:
            scenes.setdefault(scene, []).append(case[OURS] / case[PEER])
    return {scene: geometric_mean(each) for scene, each in scenes.items()}


def chart(bars: dict[str, float]) -> str:
    """The chart as SVG."""
    unit = 0.86 * WIDTH / max([1.0, *bars.values()])
    bottom = TOP + STEP * len(bars)
    height = bottom + 20

    def text(x: float, y: float, words: str, size: int = 15, more: str = "") -> str:
        return f'<text x="{x:g}" y="{y:g}" font-size="{size}" {more}>{escape(words)}</text>'

    parts = [text(0, 14, f"Soft shadows: rays per second, times {PEER}", 16, 'font-weight="600"')]
    for k, (scene, ratio) in enumerate(bars.items()):
        y = TOP + k * STEP
        parts.append(text(0, y + 12, TITLES.get(scene, scene)))
        parts.append(f'<rect x="0" y="{y + 18}" width="{ratio * unit:.1f}" height="{BAR}" rx="2" fill="{ORANGE}"/>')
        parts.append(text(ratio * unit + 6, y + 35, f"{ratio:.1f}"))
        ends = f'x1="{unit:.1f}" x2="{unit:.1f}" y1="{y + 15}" y2="{y + BAR + 21}"'
        parts += [f'<line {ends} stroke="{c}" stroke-width="{w}"/>' for c, w in (("#fff", 4), (GREY, 2))]
    parts.append(text(unit, bottom + 12, f"{PEER} = 1", 13, 'text-anchor="middle"'))
    style = f'font-family="system-ui, sans-serif" fill="{GREY}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" viewBox="0 0 {WIDTH} {height}" {style}>'
    return "\n".join([head, *parts, "</svg>"]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="+", type=Path, help="files of soft_shadows --json")
    parser.add_argument("-o", "--output", type=Path, default=Path("peers.svg"))
    options = parser.parse_args()
    files = [json.loads(path.read_text()) for path in options.rows]
    bars = ratios([row for file in files for row in file["rows"]])
    if not bars:
        parser.error(f"no scene has rows of both {OURS} and {PEER}; install embreex and measure again")
    options.output.write_text(chart(bars), encoding="utf-8")


if __name__ == "__main__":
    main()
