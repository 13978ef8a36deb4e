"""Draws the figures of the CHC+RT paper [Mattausch et al. 2015].

Figures 4, 5, 6 and 9 show a place in memory after two frames of its near walk: tiles, tree parts, the pairs of rays and
triangles that queries cover, and colour bleeding. Figures 7 and 8 are curves frame by frame, and bars of the phases.
"""

import re
from colorsys import hsv_to_rgb
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...bvh.block_tree import BlockTree
from ...bvh.nodes import CHILDREN, block_leaf, is_leaf
from ...errors import InputError
from ...files import atomic_output
from ...query.ray_passes import RayPass
from ...query.shadow_query import Surfaces
from ...techniques.chcrt.chc_rt import ChcRtState, camera_hits
from ...techniques.chcrt.occlusion_queries import Tiles
from ...techniques.chcrt.picture_ray_sets import PassRaySet
from ...techniques.chcrt.ray_bundles import pass_rays
from ...techniques.chcrt.tree_parts import TreeParts, parts_of
from ...techniques.chcrt.visibility_fronts import INNER, VISIBLE, Fronts
from ...techniques.tracer_options import ChcRtOptions
from ...trace.tree_list import ROOT, Hits
from ..published_methods import tracer_name
from . import chcrt_published as published
from .walkthrough_timing import PHASES, InCore, Say, Turn, bled, error_of, later, of, rows_of, speedup, value_of
from .walkthroughs import DIFFUSE, SAMPLER, Culling, FrameRays, timed

# --- The tiles, parts and triangles that query pairs cover [Mattausch et al. 2015, Fig. 4 to 6] -----------------------
#
# The matrix of Fig. 6 has a row for each ray and a column for each triangle. Rays come tile by tile, in the order of
# the quadtree. Triangles come part by part, in the order of the tree. So each query pair covers a rectangle of the
# matrix, and the pairs of both fronts cover all of it exactly once.


class MatrixColumns(NamedTuple):
    """The columns of the matrix: the triangles of a scene in memory."""

    spans: np.ndarray  # (r, 2) int64: first and end column of each row of `Parts`
    places: np.ndarray  # (n,) int64: the column of each slot of the tree


class Rectangles(NamedTuple):
    """The part of the matrix that each of k pairs covers."""

    rays: np.ndarray  # (k, 2) int64: first and end row
    triangles: np.ndarray  # (k, 2) int64: first and end column
    visible: np.ndarray  # (k,) bool


def columns_of(parts: TreeParts) -> MatrixColumns:
    """The columns of the matrix; the parts are subtrees of a `BlockTree`."""
    tree = parts.keeps
    assert isinstance(tree, BlockTree)
    spans = np.zeros((len(parts.lines), 2), np.int64)
    places, n = np.zeros(len(tree.prim_ids), np.int64), 0
    for part in np.argsort(parts.order):
        slots = _slots(tree, int(parts.trees[part, ROOT]))
        places[slots] = np.arange(n, n + len(slots))
        spans[parts.inner + part] = n, n + len(slots)
        n += len(slots)
    for row in range(parts.inner - 1, -1, -1):
        below = spans[[child for child in parts.children[row] if child >= 0]]
        spans[row] = below[:, 0].min(), below[:, 1].max()
    return MatrixColumns(spans, places)


def _slots(tree: BlockTree, root: int) -> np.ndarray:
    """The slots below a link, in the order of the blocks."""
    blocks, links = [], np.array([root])
    while len(links):
        blocks.append(block_leaf(links[is_leaf(links)]).block)
        links = tree.links[links[links >= 0], CHILDREN].ravel()
    slots = tree.slots[np.sort(np.concatenate(blocks))].ravel()
    return slots[slots >= 0]


def covered(tiles: Tiles) -> np.ndarray:
    """(t, smallest) bool: the smallest tiles inside each tile."""
    x0, x1, y0, y1 = (column[:, None] for column in tiles.spans.T)
    left, _, top, _ = tiles.spans[: tiles.smallest].T
    return (x0 <= left) & (left < x1) & (y0 <= top) & (top < y1)


def overdraw(fronts: Fronts) -> np.ndarray:
    """(smallest,) int64: the number of visible and invisible pairs over each smallest tile (Fig. 4, left)."""
    pairs = np.bincount(fronts.tile[fronts.state != INNER], minlength=len(fronts.tiles.spans))
    return pairs @ covered(fronts.tiles)


def listed(fronts: Fronts) -> np.ndarray:
    """(smallest,) int64: the number of parts that the rays of each smallest tile go through (Fig. 5, right)."""
    return np.bincount(fronts.tile[fronts.of(VISIBLE)], minlength=fronts.tiles.smallest)


def reachable(fronts: Fronts, columns: MatrixColumns) -> np.ndarray:
    """(smallest,) int64: the number of triangles in these parts (Fig. 4, middle and right)."""
    shown = fronts.of(VISIBLE)
    first, end = columns.spans[fronts.row[shown]].T
    return np.bincount(fronts.tile[shown], end - first, fronts.tiles.smallest).astype(np.int64)


def tile_of_pixels(tiles: Tiles, shape: tuple[int, int]) -> np.ndarray:
    """(h, w) int64: the smallest tile that each pixel is in."""
    y, x = np.indices(shape) // tiles.pixels
    return y * tiles.across + x


def rows_of_rays(tiles: Tiles, shape: tuple[int, int]) -> np.ndarray:
    """(h, w) int64: the row of each pixel's ray in the matrix."""
    own = tile_of_pixels(tiles, shape)
    order = np.argsort(_z_places(tiles)[own].ravel(), kind="stable")
    rows = np.empty(own.size, np.int64)
    rows[order] = np.arange(own.size)
    return rows.reshape(shape)


def _z_places(tiles: Tiles) -> np.ndarray:
    """(smallest,) int64: the place of each smallest tile in the order of the quadtree."""
    y, x = np.divmod(np.arange(tiles.smallest), tiles.across)
    code = sum((x >> k & 1) << 2 * k | (y >> k & 1) << 2 * k + 1 for k in range(16))
    return np.argsort(np.argsort(code))


def rectangles(fronts: Fronts, columns: MatrixColumns, shape: tuple[int, int]) -> Rectangles:
    """The rectangles of the visible and invisible pairs (Fig. 6)."""
    tiles, pairs = fronts.tiles, np.flatnonzero(fronts.state != INNER)
    places = _z_places(tiles)
    rays = np.bincount(places[tile_of_pixels(tiles, shape)].ravel(), minlength=tiles.smallest)
    starts = np.concatenate([[0], np.cumsum(rays)])
    inside = covered(tiles)[fronts.tile[pairs]]
    first = np.where(inside, places, tiles.smallest).min(1)
    last = np.where(inside, places, -1).max(1)
    spans = np.stack([starts[first], starts[last + 1]], 1)
    return Rectangles(spans, columns.spans[fronts.row[pairs]], fronts.state[pairs] == VISIBLE)


def crossings(hits: Hits, tiles: Tiles, columns: MatrixColumns) -> tuple[np.ndarray, np.ndarray]:
    """(row, column) of each actual hit in the matrix, (k,) int64 each."""
    hit = hits.face >= 0
    return rows_of_rays(tiles, hits.face.shape)[hit], columns.places[hits.slot[hit]]


# --- Traces the first two frames of a place's near walk, for the pictures of `pictures`, and keeps the fronts ---------
#
# Parts and tiles have the paper's sizes in proportion: a screen is ten tiles wide, and a scene has at least 64 parts.


ERROR = 20
"""The threshold of Fig. 9."""
SHORT = 1 / 100
"""The length of the short rays of Fig. 4, as a share of the long ones'."""

_FRAMES = 2
_WALK = 60  # frames of the walk, whose first ones are drawn
_TILES = 1920 / 200  # tiles in a row of the paper's screen
_PARTS = 64  # at least
_MANY, _MUCH = 2_000_000, 1 / 6  # triangles of an opaque tile of Fig. 4; at most this share of the scene's


class PassState(NamedTuple):
    """A question of the last frame: the hits of its rays, and the state that it left."""

    hits: Hits
    fronts: Fronts


class CullingState(NamedTuple):
    """The data behind the pictures of a place."""

    name: str
    parts: TreeParts
    surfaces: Surfaces
    length: float  # of the long rays, in world units
    camera: PassState
    short: PassState  # one pass of diffuse rays that end early
    long: PassState  # the same pass, across the whole scene
    exact: np.ndarray  # (h, w, 3) uint8: diffuse colour bleeding
    neglecting: np.ndarray  # (h, w, 3) uint8: the same with a threshold of ERROR rays

    @property
    def shape(self) -> tuple[int, int]:
        return self.surfaces.ids.shape

    @property
    def triangles(self) -> int:
        return len(self.surfaces.triangles.vertices)

    @property
    def many(self) -> int:
        """The number of triangles that makes a tile of Fig. 4 opaque."""
        return max(1, min(_MANY, int(self.triangles * _MUCH)))


def options_of(triangles: int, width: int) -> ChcRtOptions:
    """The options of the pictures: see this module."""
    tile = 32 * max(1, round(width / _TILES / 32))
    return ChcRtOptions(tile=tile, triangles=min(1 << 20, max(1, triangles // _PARTS)))


def culling_state(core: InCore) -> CullingState:
    """Trace the two frames.

    InputError if the camera sees nothing.
    """
    tree, walk = core.culling().scheduled.parts.keeps, core.place.walks[0]
    assert isinstance(tree, BlockTree)
    options = options_of(len(core.triangles.vertices), walk.first.width)
    parts = parts_of(tree, options)
    low, high = parts.boxes[0].astype(np.float64)
    length = float(np.linalg.norm(high - low))
    camera, short, long = (ChcRtState(parts, options) for _ in range(3))
    methods = [
        Culling(tracer_name(n), ChcRtState(parts, options._replace(threshold=n)), core.threads) for n in (0, ERROR)
    ]
    for frame in range(_FRAMES):
        asked = core.asked(walk.camera(frame, _WALK), SAMPLER)
        if not (asked.surfaces.ids >= 0).any():
            raise InputError(f"{core.place.name}: the {walk.name} camera sees nothing; choose another scene")
        rays = next(q for q in asked.questions(DIFFUSE) if isinstance(q, RayPass))
        seen = _looked(camera, asked, core.threads)
        bounced = [
            _bounced(s, rays, asked.shape, n, core.threads) for s, n in ((short, SHORT * length), (long, length))
        ]
        pictures = [_bled(method, asked) for method in methods]
    return CullingState(core.place.name, parts, asked.surfaces, length, seen, *bounced, *pictures)


def _looked(scheduled: ChcRtState, asked: FrameRays, threads: int) -> PassState:
    """A frame of the camera's rays."""
    scheduled.begin()
    hits = camera_hits(scheduled, asked.camera, threads)
    return PassState(hits, _state(scheduled))


def _bounced(scheduled: ChcRtState, rays: RayPass, shape: tuple[int, int], length: float, threads: int) -> PassState:
    """A frame of diffuse rays of this length."""
    scheduled.begin()
    low, high = scheduled.parts.boxes[0].astype(np.float64)
    made = pass_rays(rays, *shape, 2.0 * float(np.linalg.norm(high - low)))
    made = made._replace(spans=np.array([[0.0, length]]))
    scheduled.run(PassRaySet(scheduled.parts, scheduled.options, made, threads), shape)
    return PassState(made.hits, _state(scheduled))


def _state(scheduled: ChcRtState) -> Fronts:
    """The state of the frame's only question."""
    ((_, fronts),) = scheduled.states()
    return fronts


def _bled(method: Culling, asked: FrameRays) -> np.ndarray:
    """A frame of diffuse rays as a picture of colour bleeding."""
    method.scheduled.begin()
    colour = asked.surfaces.triangles.colour
    return bled(asked.surfaces, [(colour, met) for met, _ in timed(method, asked, DIFFUSE)[1]])


# --- Draws Figures 4, 5, 6 and 9 of the CHC+RT paper, for a place in memory after two frames of its near walk ---------


FIGURES = 4, 5, 6, 9
_PANEL = 5.2  # width of a panel, in inches
_DPI = 110
_RED, _GREEN, _BLUE = "#e0301e", "#2ca02c", "#1030ff"
_OVER = 0.05, 0.65, 0.1  # colour of tiles whose rays may meet many triangles
_LONGEST = 24  # subtrees of a list that is drawn white
_BRIGHTEST = 0.85  # opacity of an opaque tile
_LABEL = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.7}
_SKY = 0.85  # grey of the background
_GOLDEN = 0.618034  # hues of neighbouring numbers differ by this turn
_FAINT = 128  # at least half the differences of Fig. 9 become so large


def name_of(place: str, figure: int) -> str:
    """The name of a picture's file, from the name of a scene."""
    return f"{re.sub(r'[^A-Za-z0-9_-]+', '-', place).strip('-')}-figure-{figure}.png"


def write_pictures(core: InCore, folder: Path, say: Say) -> None:
    """Write a PNG file for each of FIGURES."""
    say(f"{core.place.name}, pictures")
    shown = culling_state(core)
    for figure, draw in zip(FIGURES, (_draw_tiles, _draw_parts, _draw_matrix, _draw_bleeding), strict=True):
        sheet = draw(shown)
        with atomic_output(folder / name_of(shown.name, figure)) as temporary:
            sheet.savefig(temporary, format="png", dpi=_DPI)


def shaded(shown: CullingState) -> np.ndarray:
    """(h, w) float32: the surfaces in grey, lit from the camera; the background is light."""
    gbuffer = shown.surfaces.gbuffer
    ahead = gbuffer.position / np.maximum(np.linalg.norm(gbuffer.position, axis=2, keepdims=True), 1e-30)
    facing = np.abs((gbuffer.normal * ahead).sum(2))
    grey = shown.surfaces.triangles.colour[gbuffer.face].mean(2) ** 0.45
    return np.where(gbuffer.face >= 0, grey * (0.4 + 0.6 * facing), np.float32(_SKY)).astype(np.float32)


def subtrees(shown: CullingState) -> np.ndarray:
    """(h, w, 3) float64: a colour for each part, where the camera's rays hit it."""
    part = shown.camera.hits.part
    met, number = np.unique(part, return_inverse=True)
    tones = [hsv_to_rgb(n * _GOLDEN % 1.0, 0.9 - 0.25 * (n % 3), 1.0 - 0.2 * (n % 2)) for n in range(len(met))]
    lit = np.array(tones)[number.reshape(part.shape)] * (0.3 + 0.7 * shaded(shown)[..., None])
    return np.where((part >= 0)[..., None], lit, 0.06)


def apart(shown: CullingState) -> tuple[np.ndarray, int]:
    """((h, w) int16: the differences of Fig. 9, the factor that makes them easy to see)."""
    found = np.abs(shown.exact.astype(np.int16) - shown.neglecting).max(2)
    typical = float(np.median(found[found > 0])) if found.any() else 1.0
    return found, 2 ** max(0, int(np.ceil(np.log2(_FAINT / typical))))


def _sheet(panels: int, shown: CullingState, title: str):
    from matplotlib.figure import Figure

    h, w = shown.shape
    sheet = Figure(figsize=(_PANEL * panels, _PANEL * h / w + 0.6), layout="constrained")
    sheet.suptitle(f"{shown.name}: {title}", fontsize=11)
    return sheet, sheet.subplots(1, panels, squeeze=False)[0]


def _show(panel, image: np.ndarray, title: str, **how):
    panel.set_title(title, fontsize=9)
    panel.set_axis_off()
    return panel.imshow(image, interpolation="nearest", **how)


def _mark_tiles(panel, shape: tuple[int, int], tiles: Tiles, values: np.ndarray) -> None:
    """Draw the borders of the smallest tiles, and a number in each."""
    h, w = shape
    panel.hlines(np.arange(tiles.pixels, h, tiles.pixels) - 0.5, -0.5, w - 0.5, color="black", lw=0.4)
    panel.vlines(np.arange(tiles.pixels, w, tiles.pixels) - 0.5, -0.5, h - 0.5, color="black", lw=0.4)
    for tile, value in enumerate(values):
        y, x = np.multiply(np.divmod(tile, tiles.across), tiles.pixels)
        at = min(x + tiles.pixels / 2, (x + w) / 2), min(y + tiles.pixels / 2, (y + h) / 2)
        text = f"{value / 1e3:,.0f}k" if value > 999 else f"{value}"
        panel.text(*at, text, fontsize=6, ha="center", va="center", bbox=_LABEL)


def _draw_tiles(shown: CullingState):
    """Figure 4."""
    sheet, panels = _sheet(3, shown, "query pairs and triangles of each tile (Figure 4)")
    pairs, columns = overdraw(shown.camera.fronts), columns_of(shown.parts)
    tiles = shown.camera.fronts.tiles
    for panel in panels:
        panel.imshow(shaded(shown), cmap="gray", vmin=0, vmax=1)
    title = "camera rays: occlusion queries over each tile, few (blue) to many (red)"
    _show(panels[0], pairs[tile_of_pixels(tiles, shown.shape)], title, cmap="jet", vmin=0, alpha=0.5)
    _mark_tiles(panels[0], shown.shape, tiles, pairs)
    for panel, seen, length in ((panels[1], shown.short, SHORT * shown.length), (panels[2], shown.long, shown.length)):
        triangles, tiles = reachable(seen.fronts, columns), seen.fronts.tiles
        opacity = _BRIGHTEST * np.minimum(triangles / shown.many, 1.0)[tile_of_pixels(tiles, shown.shape)]
        green = np.broadcast_to(_OVER, (*shown.shape, 3))
        title = f"diffuse rays of {length:,.3g} units: triangles in reach; opaque from {shown.many:,}"
        _show(panel, np.dstack([green, opacity]), title)
        _mark_tiles(panel, shown.shape, tiles, triangles)
    return sheet


def _draw_parts(shown: CullingState):
    """Figure 5."""
    from matplotlib.colors import LinearSegmentedColormap

    sheet, panels = _sheet(2, shown, "subtrees that are scheduled (Figure 5)")
    sheet.set_figwidth(2 * _PANEL + 0.8)
    lists, tiles = listed(shown.camera.fronts), shown.camera.fronts.tiles
    part = shown.camera.hits.part
    seen = len(np.unique(part[part >= 0]))
    title = f"a colour for each subtree: the camera's rays hit {seen} of {len(shown.parts.trees)}"
    _show(panels[0], subtrees(shown), title)
    colours = LinearSegmentedColormap.from_list("lists", ["#d00000", "#ff9000", "#ffe060", "white"])
    colours = colours.with_extremes(under="black")
    image = lists[tile_of_pixels(tiles, shown.shape)]
    drawn = _show(panels[1], image, "subtrees in the list of each tile", cmap=colours, vmin=1, vmax=_LONGEST)
    _mark_tiles(panels[1], shown.shape, tiles, lists)
    sheet.colorbar(drawn, ax=panels[1], shrink=0.8, ticks=[1, 6, 12, 18, 24], extend="max")
    return sheet


def _draw_matrix(shown: CullingState):
    """Figure 6."""
    sheet, panels = _sheet(2, shown, "rays by triangles (Figure 6)")
    sheet.set_figheight(8.0)
    sheet.set_figwidth(14.0)
    columns = columns_of(shown.parts)
    kinds = ("camera rays", shown.camera), ("a pass of diffuse rays", shown.long)
    for panel, (kind, seen) in zip(panels, kinds):
        _draw_pairs(panel, kind, seen, columns, shown)
    panels[0].set_ylabel("rays, tile after tile in the order of the quadtree", fontsize=8)
    _add_legend(sheet)
    return sheet


def _draw_pairs(panel, kind: str, seen: PassState, columns: MatrixColumns, shown: CullingState) -> None:
    from matplotlib.collections import PolyCollection

    found = rectangles(seen.fronts, columns, shown.shape)
    (top, bottom), (left, right) = found.rays.T, found.triangles.T
    corners = np.stack([np.stack([left, right, right, left], 1), np.stack([top, top, bottom, bottom], 1)], 2)
    fills = np.where(found.visible, _RED, _GREEN)
    panel.add_collection(PolyCollection(corners.astype(float), facecolors=fills, edgecolors="white", linewidths=0.25))
    rows, places = crossings(seen.hits, seen.fronts.tiles, columns)
    panel.plot(places, rows, ",", color=_BLUE)
    areas = (bottom - top) * (right - left)
    share = areas[found.visible].sum() / areas.sum()
    title = f"{kind}: {len(areas):,} pairs; the visible ones cover {100.0 * share:.1f} % of the matrix"
    panel.set_title(title, fontsize=9)
    panel.set(xlim=(0, len(columns.places)), ylim=(seen.hits.face.size, 0), xticks=[], yticks=[])
    panel.set_xlabel(f"{len(columns.places):,} triangles, subtree after subtree", fontsize=8)


def _add_legend(sheet) -> None:
    from matplotlib.patches import Patch

    meanings = {_RED: "visible pairs", _GREEN: "invisible pairs", _BLUE: "actual hits"}
    patches = [Patch(color=colour, label=meaning) for colour, meaning in meanings.items()]
    sheet.legend(handles=patches, loc="outside lower center", ncols=3, fontsize=9)


def _draw_bleeding(shown: CullingState):
    """Figure 9."""
    sheet, panels = _sheet(3, shown, "diffuse colour bleeding, exact and aggressive (Figure 9)")
    found, times = apart(shown)
    error, differ = error_of(shown.exact, shown.neglecting), np.count_nonzero(found)
    _show(panels[0], shown.exact, "chcrt: exact")
    _show(panels[1], shown.neglecting, f"chcrt:{ERROR}: mean absolute error {error:.2f} (paper: {published.ERROR})")
    title = f"differences x {times}, black on white: {differ:,} of {found.size:,} pixels"
    _show(panels[2], times * found, title, cmap="gray_r", vmin=0, vmax=255)
    panels[2].set_axis_on()
    panels[2].set(xticks=[], yticks=[])
    return sheet


# --- Draws Figures 7 and 8 of the CHC+RT paper: curves frame by frame, and bars of the phases -------------------------


_TIME_PARTS = ("before", *PHASES)
_COLOURS = ("0.7", "tab:blue", "tab:orange", "tab:red")
_ROOT = "bsah+single"  # stands for GLSL in Fig. 8


def write_plot(turns: list[Turn], path: Path) -> None:
    """Write a plot with a row for each scene and view: bars on the left, then curves, a panel for each kind of rays."""
    from matplotlib.figure import Figure

    walks, kinds = rows_of(turns, "scene", "view"), rows_of(turns, "kind")
    colours = {row["method"]: f"C{i}" for i, row in enumerate(rows_of(turns, "method"))}
    columns, widths = 1 + len(kinds), [1.5] + [1.0] * len(kinds)
    sheet = Figure(figsize=(3.6 * sum(widths), 3.0 * len(walks) + 0.4), layout="constrained")
    panels = sheet.subplots(len(walks), columns, squeeze=False, width_ratios=widths)
    for row, walk in zip(panels, walks):
        mine = of(turns, **walk)
        _draw_bars(row[0], mine)
        row[0].set_title(", ".join(walk.values()), fontsize=9)
        for panel, kind in zip(row[1:], kinds):
            _draw_curves(panel, of(mine, **kind), colours)
            panel.set_title(kind["kind"], fontsize=9)
    bars = panels[0, 0].get_legend_handles_labels()
    sheet.legend(*bars, loc="outside lower left", ncols=len(bars[0]), fontsize=8)
    lines = {line.get_label(): line for panel in panels[:, 1:].flat for line in panel.get_lines()}
    sheet.legend(lines.values(), lines, loc="outside lower right", ncols=len(lines), fontsize=8)
    with atomic_output(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)


def shares(turns: list[Turn]) -> dict[str, float]:
    """Phase -> its share of the time of the frames after the first. The shares add up to 1."""
    after = later(turns)
    return {part: sum(value_of(t, part) for t in after) / sum(t.seconds for t in after) for part in _TIME_PARTS}


def _draw_bars(panel, turns: list[Turn]) -> None:
    """Draw a bar for each kind of rays and each method with phases, and beside it plain tracing from the root."""
    rows = rows_of([t for t in turns if t.told], "kind", "method")
    at, bottom, bars = np.arange(len(rows)), np.zeros(len(rows)), [of(turns, **row) for row in rows]
    root = [of(turns, kind=row["kind"], method=_ROOT) for row in rows]
    width = 0.4 if any(root) else 0.8
    for name, colour in zip(_TIME_PARTS, _COLOURS):
        part = np.array([shares(bar)[name] for bar in bars])
        panel.bar(at, part, width, bottom, color=colour, label=name)
        bottom += part
    if any(root):
        ratios = [speedup(ours, theirs) if theirs else 0.0 for ours, theirs in zip(bars, root)]
        panel.bar(at + width, ratios, width, color="white", edgecolor="black", hatch="//", label=_ROOT)
    several = len({row["method"] for row in rows}) > 1
    names = [", ".join(row.values()) if several else row["kind"] for row in rows]
    middle = at + width / 2 if any(root) else at
    panel.set_xticks(middle, names, fontsize=7, rotation=25, ha="right", rotation_mode="anchor")
    panel.set_ylabel("share of the time of CHC+RT", fontsize=8)


def _draw_curves(panel, turns: list[Turn], colours: dict[str, str]) -> None:
    highest = 0.0
    for row in rows_of(turns, "method"):
        some = of(turns, **row)
        name, ms = row["method"], [1e3 * t.seconds for t in some]
        panel.plot([t.frame for t in some], ms, marker=".", color=colours[name], label=name)
        highest = max(highest, *ms)
    panel.set(ylim=(0, 1.08 * highest), xlabel="frame", ylabel="ms")
    panel.xaxis.get_major_locator().set_params(integer=True)
    panel.grid(alpha=0.3)
