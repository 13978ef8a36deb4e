"""Draws the diagrams on the pages of the papers: docs/papers/NAME.svg, one per paper.

    python scripts/paper_diagrams.py
    python scripts/paper_diagrams.py --check

What a diagram shows is computed from its own small scene: which boxes frusta meet, which cells and triangles remain,
which nodes are tested. --check exits with code 1 if a file differs.
"""

import random
import sys
from collections.abc import Callable
from itertools import pairwise, product
from math import cos, sin
from pathlib import Path

PAGES = Path(__file__).resolve().parents[1] / "docs" / "papers"
WIDTH, HEIGHT = 720, 330
INK, GREY, PALE, SUN, BLUE, RED, GREEN = "#1f2937", "#6b7280", "#e5e7eb", "#e8a317", "#2f6fd0", "#d1495b", "#2f9e6e"
FOUR = BLUE, GREEN, SUN, RED

Point = tuple[float, float]


# --- Shapes -----------------------------------------------------------------------------------------------------------


def polygon(points: list[Point], fill: str, opacity: float = 1.0, stroke: str = "none") -> str:
    corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polygon points="{corners}" fill="{fill}" fill-opacity="{opacity}" stroke="{stroke}"/>'


def box(x: float, y: float, w: float, h: float, fill: str = "none", stroke: str = INK, opacity: float = 1.0) -> str:
    where = f'x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}"'
    return f'<rect {where} fill="{fill}" fill-opacity="{opacity}" stroke="{stroke}"/>'


def line(a: Point, b: Point, stroke: str = INK, width: float = 1.0, dashes: str = "") -> str:
    dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
    ends = f'x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}"'
    return f'<line {ends} stroke="{stroke}" stroke-width="{width}"{dashed}/>'


def dot(x: float, y: float, fill: str = INK, radius: float = 3.0, stroke: str = "none") -> str:
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{fill}" stroke="{stroke}"/>'


def text(x: float, y: float, words: str, size: int = 14, fill: str = INK, anchor: str = "start") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" fill="{fill}" text-anchor="{anchor}">{words}</text>'


def picture(title: str, parts: list[str], halves: bool = True) -> str:
    """An SVG file with a white ground, which stays readable on dark pages.

    halves : whether its left and right half stand alone; phones show one below the other (docs/_ext/charts.py)
    """
    mark = ' data-halves=""' if halves else ""
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif"{mark}>'
    ground = f'<rect width="{WIDTH}" height="{HEIGHT}" rx="8" fill="white"/>'
    return "\n".join([head, f"<title>{title}</title>", ground, *parts, "</svg>"]) + "\n"


def blend(a: Point, b: Point, t: float) -> Point:
    return a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])


# --- Multi-frusta tracing: frusta of receivers, shafts of strata ------------------------------------------------------


LAMP, FLOOR = 60.0, 270.0  # heights of the light and of the receivers
NODE = 186.0, 82.0, 24.0, 22.0  # a node's box: x, y, width, height


def meets_node(low: list[Point], high: list[Point], left: float) -> bool:
    """Whether the hull of two horizontal segments, from the floor to the lamp, meets the node's box."""
    x, y, w, h = NODE
    for k in range(33):
        t = (FLOOR - y - h * k / 32) / (FLOOR - LAMP)
        if blend(low[0], high[0], t)[0] <= left + x + w and blend(low[1], high[1], t)[0] >= left + x:
            return True
    return False


def multi_frusta() -> str:
    parts = []
    for left, name in (
        (0.0, "The paper: a frustum per receiver"),
        (360.0, "Antumbra: a shaft per stratum of the light"),
    ):
        cuts = [left + 60 + 60 * k for k in range(5)]
        receivers = [left + 120 + 10 * k for k in range(4)]
        hulls = (
            [([(x, FLOOR), (x, FLOOR)], [(cuts[0], LAMP), (cuts[4], LAMP)]) for x in receivers]
            if left == 0.0
            else [([(receivers[0], FLOOR), (receivers[3], FLOOR)], [(a, LAMP), (b, LAMP)]) for a, b in pairwise(cuts)]
        )
        met = sum(meets_node(*hull, left) for hull in hulls)
        parts.append(text(left + 180, 28, name, 15, anchor="middle"))
        parts += [polygon([*low, *high[::-1]], c, 0.22, c) for (low, high), c in zip(hulls, FOUR)]
        parts += [line((a, LAMP), (b, LAMP), c, 6) for a, b, c in zip(cuts, cuts[1:], FOUR if left else [SUN] * 4)]
        parts += [line((left + 30, FLOOR), (left + 330, FLOOR), GREY), *(dot(x, FLOOR) for x in receivers)]
        parts.append(box(left + NODE[0], NODE[1], NODE[2], NODE[3], "white"))
        lanes = "frusta" if left == 0.0 else "shafts"
        parts.append(
            text(
                left + 180,
                312,
                f"{met} of 4 {lanes} {'meet' if met > 1 else 'meets'} the node's box",
                14,
                GREY,
                "middle",
            )
        )
    return picture("Frusta from receivers to the whole light, and shafts from all receivers to its strata", parts)


# --- Pre-BVH culling: cells between receivers and light ---------------------------------------------------------------


CELL, COLUMNS, ROWS = 36, 19, 7
SOURCES = [(column, 6) for column in range(2, 8)]
TARGETS = [(15, 0), (16, 0)]


def marked_cells() -> set[tuple[int, int]]:
    """The cells that some segment from a source cell to a target cell passes."""
    found = set()
    ends = [(dx, dy) for dx in (0.02, 0.5, 0.98) for dy in (0.02, 0.5, 0.98)]
    for (a, b), (p, q) in product(product(SOURCES, TARGETS), product(ends, ends)):
        for k in range(101):
            x, y = blend((a[0] + p[0], a[1] + p[1]), (b[0] + q[0], b[1] + q[1]), k / 100)
            found.add((int(x), int(y)))
    return found


def pre_bvh_culling() -> str:
    marked, rng, parts, kept = marked_cells(), random.Random(4), [], 0
    place = lambda x, y: (18 + CELL * x, 18 + CELL * y)
    for cell in product(range(COLUMNS), range(ROWS)):
        fill = BLUE if cell in SOURCES else SUN if cell in TARGETS else "#fdf0c8" if cell in marked else "white"
        parts.append(box(*place(*cell), CELL, CELL, fill, PALE, 0.75))
    triangles = []
    for _ in range(60):
        x, y = rng.uniform(0.3, COLUMNS - 0.6), rng.uniform(0.3, ROWS - 0.6)
        turn, size = rng.uniform(0.0, 2.1), rng.uniform(0.12, 0.26)
        triangles.append([(x + size * cos(turn + 2.1 * k), y + size * sin(turn + 2.1 * k)) for k in range(3)])
    for corners in triangles:
        (x0, x1), (y0, y1) = ((int(min(c)), int(max(c))) for c in zip(*corners))
        needed = any((x, y) in marked for x in range(x0, x1 + 1) for y in range(y0, y1 + 1))
        kept += needed
        parts.append(polygon([place(*c) for c in corners], INK if needed else "white", 0.9 if needed else 0.6, GREY))
    legend = (
        f"blue: cells with receivers; orange: cells with the light; yellow: between them. {kept} of {len(triangles)}"
    )
    parts += [
        text(18, 296, legend, 13, GREY),
        text(18, 316, "triangles touch a marked cell. Only these go into the BVH.", 13, GREY),
    ]
    return picture("A grid in which only the triangles between receivers and light remain", parts, halves=False)


# --- SRDH: the same triangles, ordered by shadow rays -----------------------------------------------------------------


Tree = tuple["Tree", "Tree"] | str  # the first child is visited first; a leaf is named


def visits(tree: Tree, blocker: str) -> tuple[int, bool]:
    """Boxes that a ray enters until the blocker ends it, if it enters every box."""
    if isinstance(tree, str):
        return 1, tree == blocker
    count = 1
    for child in tree:
        entered, ended = visits(child, blocker)
        count += entered
        if ended:
            return count, True
    return count, False


def leaves(tree: Tree) -> list[str]:
    return [tree] if isinstance(tree, str) else [name for child in tree for name in leaves(child)]


def draw_tree(tree: Tree, left: float, y: float) -> tuple[list[str], float]:
    """A tree whose first leaf is at `left`, and the x of its root."""
    if isinstance(tree, str):
        fill = SUN if tree == "blinds" else "white"
        return [box(left - 24, y - 11, 48, 22, fill), text(left, y + 4, tree, 12, anchor="middle")], left
    first, a = draw_tree(tree[0], left, y + 52)
    second, b = draw_tree(tree[1], left + 56 * len(leaves(tree[0])), y + 52)
    x = (a + b) / 2
    return [
        line((x, y), (a, y + 52), GREY),
        line((x, y), (b, y + 52), GREY),
        *first,
        *second,
        dot(x, y, "white", 8, INK),
    ], x


def srdh() -> str:
    by_area: Tree = ((("vase", "chair"), ("lamp", "table")), ("bed", "blinds"))
    by_rays: Tree = ("blinds", (("vase", "chair"), ("lamp", ("table", "bed"))))
    parts = []
    for left, tree, name in ((0, by_area, "By area alone (SAH)"), (360, by_rays, "By shadow rays (SRDH)")):
        parts.append(text(left + 180, 30, name, 15, anchor="middle"))
        parts += draw_tree(tree, left + 40, 62)[0]
        count, _ = visits(tree, "blinds")
        parts.append(text(left + 180, 312, f"a ray that the blinds block enters {count} boxes", 14, GREY, "middle"))
    return picture(
        "Two trees of a room behind blinds: in the second, the blinds are the first child of the root", parts
    )


# --- Ray hierarchies: triangles go down a tree of rays ----------------------------------------------------------------


LIGHT, N_RAYS, WAYS = (190.0, 44.0), 16, 4
BLOCKER = [(140.0, 150.0), (172.0, 138.0), (160.0, 172.0)]


def slope(point: Point) -> float:
    """Where a line from the light through a point meets the floor."""
    return LIGHT[0] + (point[0] - LIGHT[0]) * (FLOOR - LIGHT[1]) / (point[1] - LIGHT[1])


def ray_hierarchy() -> str:
    ends = [30.0 + 320.0 * (k + 0.5) / N_RAYS for k in range(N_RAYS)]
    low, high = min(map(slope, BLOCKER)), max(map(slope, BLOCKER))
    groups = [ends[k : k + WAYS] for k in range(0, N_RAYS, WAYS)]
    meets = lambda rays: max(rays) >= low and min(rays) <= high
    parts = [text(190, 26, "Rays in cones, cones in cones", 15, anchor="middle")]
    parts += [polygon([LIGHT, (g[0], FLOOR), (g[-1], FLOOR)], c, 0.2, c) for g, c in zip(groups, FOUR)]
    parts += [line(LIGHT, (x, FLOOR), GREY, 0.6) for x in ends]
    parts += [line((20, FLOOR), (360, FLOOR), GREY), dot(*LIGHT, SUN, 7, INK)]
    parts += [dot(x, FLOOR, RED if low <= x <= high else INK) for x in ends]
    parts.append(polygon(BLOCKER, INK))
    parts.append(text(550, 26, "The triangle goes down the hierarchy", 15, anchor="middle"))
    root, tested = (550.0, 70.0), 1
    for k, (group, colour) in enumerate(zip(groups, FOUR)):
        node, hit = (420.0 + 87 * k, 160.0), meets(group)
        tested += 1
        parts.append(line(root, node, INK if hit else PALE, 2))
        for i, x in enumerate(group):
            leaf = node[0] - 30 + 20 * i, 250.0
            tested += hit
            blocked = hit and low <= x <= high
            parts += [line(node, leaf, INK if blocked else PALE, 2 if blocked else 1)]
            parts.append(dot(*leaf, RED if blocked else "white", 6, INK if hit else PALE))
        parts.append(dot(*node, colour if hit else "white", 11, INK if hit else GREY))
    parts.append(dot(*root, PALE, 13, INK))
    blocked = sum(low <= x <= high for x in ends)
    words = f"{tested} of {1 + WAYS + N_RAYS} nodes tested, {blocked} rays blocked"
    parts += [
        text(190, 312, "light, shadow rays, receivers", 14, GREY, "middle"),
        text(550, 312, words, 14, GREY, "middle"),
    ]
    return picture("Cones of shadow rays around a light, and the nodes that one triangle visits", parts)


# --- CHC+RT: pairs of tiles and nodes ---------------------------------------------------------------------------------


EYE, TILES, SCREEN = (40.0, 165.0), 4, (150.0, 60.0, 270.0)  # x, lowest and highest y of the screen
BOXES = {
    "A": (170.0, 60.0, 26.0, 90.0),
    "B": (240.0, 96.0, 60.0, 40.0),
    "C": (235.0, 180.0, 60.0, 36.0),
    "D": (326.0, 66.0, 30.0, 110.0),
    "E": (316.0, 215.0, 40.0, 100.0),
}


def entry(ray: Point, shape: tuple[float, float, float, float]) -> float:
    """The parameter at which a ray from the eye enters a box; inf if it misses."""
    near, far = 0.0, float("inf")
    for start, along, low, size in zip(EYE, ray, shape[:2], shape[2:]):
        if abs(along) < 1e-9:
            if not low <= start <= low + size:
                return float("inf")
            continue
        a, b = sorted(((low - start) / along, (low + size - start) / along))
        near, far = max(near, a), min(far, b)
    return near if near <= far else float("inf")


def visible_pairs() -> set[tuple[int, str]]:
    """The pairs of tile and box such that a ray of the tile ends at the box."""
    x, top, bottom = SCREEN
    pairs = set()
    for k in range(64 * TILES):
        y = top + (bottom - top) * (k + 0.5) / (64 * TILES)
        ray = x - EYE[0], y - EYE[1]
        first = min(BOXES, key=lambda name: entry(ray, BOXES[name]))
        if entry(ray, BOXES[first]) < float("inf"):
            pairs.add((k // 64, first))
    return pairs


def chc_rt() -> str:
    x, top, bottom = SCREEN
    pairs, height = visible_pairs(), (bottom - top) / TILES
    parts = []
    for k, colour in enumerate(FOUR):
        ends = [blend(EYE, (x, top + height * (k + j)), 3.2) for j in (0, 1)]
        parts.append(polygon([EYE, *ends], colour, 0.12))
        parts.append(line((x, top + height * k + 1), (x, top + height * (k + 1) - 1), colour, 4))
    seen = {name for _, name in pairs}
    for name, (bx, by, w, h) in BOXES.items():
        parts += [
            box(bx, by, w, h, PALE if name in seen else "white"),
            text(bx + w / 2, by + h / 2 + 5, name, 13, anchor="middle"),
        ]
    parts += [dot(*EYE, INK, 5), f'<rect x="360" y="0" width="{WIDTH - 360}" height="{HEIGHT}" rx="8" fill="white"/>']
    parts.append(f'<rect width="{WIDTH}" height="44" rx="8" fill="white"/>')
    parts.append(text(182, 28, "Rays of a tile stop at what is in front", 15, anchor="middle"))
    parts.append(text(560, 28, "Pairs of tile and node", 15, anchor="middle"))
    for k, colour in enumerate(FOUR):
        parts += [box(436, 66 + 46 * k, 12, 34, colour, "none"), text(432, 88 + 46 * k, f"{k + 1}", 13, GREY, "end")]
        for i, name in enumerate(BOXES):
            visible = (k, name) in pairs
            parts.append(box(462 + 46 * i, 66 + 46 * k, 38, 34, GREEN if visible else "white", GREY, 0.7))
    parts += [text(481 + 46 * i, 58, name, 13, anchor="middle") for i, name in enumerate(BOXES)]
    share = f"green: {len(pairs)} of {TILES * len(BOXES)} pairs are visible and traced;"
    hidden = ", ".join(sorted(set(BOXES) - seen))
    last = f"{hidden} need not be in memory" if hidden else "all others are only queried"
    parts += [text(560, 284, share, 13, GREY, "middle"), text(560, 306, last, 13, GREY, "middle")]
    return picture("Four screen tiles, five nodes, and which pairs of them are visible", parts)


# --- Files ------------------------------------------------------------------------------------------------------------


DIAGRAMS: dict[str, Callable[[], str]] = {
    "multi-frusta": multi_frusta,
    "pre-bvh-culling": pre_bvh_culling,
    "srdh": srdh,
    "ray-hierarchy": ray_hierarchy,
    "chc-rt": chc_rt,
}
"""Page -> its diagram."""


def differing() -> list[Path]:
    """The files that are missing or differ from what this script draws."""
    paths = {PAGES / f"{name}.svg": draw for name, draw in DIAGRAMS.items()}
    return [path for path, draw in paths.items() if not path.is_file() or path.read_text(encoding="utf-8") != draw()]


if __name__ == "__main__":
    if "--check" in sys.argv[1:]:
        sys.exit("\n".join(f"{path.name} is out of date; run scripts/paper_diagrams.py" for path in differing()) or 0)
    for name, draw in DIAGRAMS.items():
        (PAGES / f"{name}.svg").write_text(draw(), encoding="utf-8")
