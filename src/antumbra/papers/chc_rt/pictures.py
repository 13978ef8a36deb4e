"""Draws Figures 4, 5, 6 and 9 of the CHC+RT paper, for a place in memory after two frames of its near walk."""

import re
from colorsys import hsv_to_rgb
from pathlib import Path

import numpy as np

from ...output import replacing
from ...techniques.chcrt.occlusion_queries import Tiles
from . import coverage, published
from .culled import ERROR, SHORT, Culled, Seen, culled
from .measure import InCore, Say, error_of

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
    shown = culled(core)
    for figure, draw in zip(FIGURES, (_draw_tiles, _draw_parts, _draw_matrix, _draw_bleeding), strict=True):
        sheet = draw(shown)
        with replacing(folder / name_of(shown.name, figure)) as temporary:
            sheet.savefig(temporary, format="png", dpi=_DPI)


def shaded(shown: Culled) -> np.ndarray:
    """(h, w) float32: the surfaces in grey, lit from the camera; the background is light."""
    gbuffer = shown.surfaces.gbuffer
    ahead = gbuffer.position / np.maximum(np.linalg.norm(gbuffer.position, axis=2, keepdims=True), 1e-30)
    facing = np.abs((gbuffer.normal * ahead).sum(2))
    grey = shown.surfaces.triangles.colour[gbuffer.face].mean(2) ** 0.45
    return np.where(gbuffer.face >= 0, grey * (0.4 + 0.6 * facing), np.float32(_SKY)).astype(np.float32)


def subtrees(shown: Culled) -> np.ndarray:
    """(h, w, 3) float64: a colour for each part, where the camera's rays hit it."""
    part = shown.camera.hits.part
    met, number = np.unique(part, return_inverse=True)
    tones = [hsv_to_rgb(n * _GOLDEN % 1.0, 0.9 - 0.25 * (n % 3), 1.0 - 0.2 * (n % 2)) for n in range(len(met))]
    lit = np.array(tones)[number.reshape(part.shape)] * (0.3 + 0.7 * shaded(shown)[..., None])
    return np.where((part >= 0)[..., None], lit, 0.06)


def apart(shown: Culled) -> tuple[np.ndarray, int]:
    """((h, w) int16: the differences of Fig. 9, the factor that makes them easy to see)."""
    found = np.abs(shown.exact.astype(np.int16) - shown.neglecting).max(2)
    typical = float(np.median(found[found > 0])) if found.any() else 1.0
    return found, 2 ** max(0, int(np.ceil(np.log2(_FAINT / typical))))


def _sheet(panels: int, shown: Culled, title: str):
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


def _draw_tiles(shown: Culled):
    """Figure 4."""
    sheet, panels = _sheet(3, shown, "query pairs and triangles of each tile (Figure 4)")
    pairs, columns = coverage.overdraw(shown.camera.fronts), coverage.columns_of(shown.parts)
    tiles = shown.camera.fronts.tiles
    for panel in panels:
        panel.imshow(shaded(shown), cmap="gray", vmin=0, vmax=1)
    title = "camera rays: occlusion queries over each tile, few (blue) to many (red)"
    _show(panels[0], pairs[coverage.tile_of_pixels(tiles, shown.shape)], title, cmap="jet", vmin=0, alpha=0.5)
    _mark_tiles(panels[0], shown.shape, tiles, pairs)
    for panel, seen, length in ((panels[1], shown.short, SHORT * shown.length), (panels[2], shown.long, shown.length)):
        triangles, tiles = coverage.reachable(seen.fronts, columns), seen.fronts.tiles
        opacity = _BRIGHTEST * np.minimum(triangles / shown.many, 1.0)[coverage.tile_of_pixels(tiles, shown.shape)]
        green = np.broadcast_to(_OVER, (*shown.shape, 3))
        title = f"diffuse rays of {length:,.3g} units: triangles in reach; opaque from {shown.many:,}"
        _show(panel, np.dstack([green, opacity]), title)
        _mark_tiles(panel, shown.shape, tiles, triangles)
    return sheet


def _draw_parts(shown: Culled):
    """Figure 5."""
    from matplotlib.colors import LinearSegmentedColormap

    sheet, panels = _sheet(2, shown, "subtrees that are scheduled (Figure 5)")
    sheet.set_figwidth(2 * _PANEL + 0.8)
    lists, tiles = coverage.listed(shown.camera.fronts), shown.camera.fronts.tiles
    part = shown.camera.hits.part
    seen = len(np.unique(part[part >= 0]))
    title = f"a colour for each subtree: the camera's rays hit {seen} of {len(shown.parts.trees)}"
    _show(panels[0], subtrees(shown), title)
    colours = LinearSegmentedColormap.from_list("lists", ["#d00000", "#ff9000", "#ffe060", "white"])
    colours = colours.with_extremes(under="black")
    image = lists[coverage.tile_of_pixels(tiles, shown.shape)]
    drawn = _show(panels[1], image, "subtrees in the list of each tile", cmap=colours, vmin=1, vmax=_LONGEST)
    _mark_tiles(panels[1], shown.shape, tiles, lists)
    sheet.colorbar(drawn, ax=panels[1], shrink=0.8, ticks=[1, 6, 12, 18, 24], extend="max")
    return sheet


def _draw_matrix(shown: Culled):
    """Figure 6."""
    sheet, panels = _sheet(2, shown, "rays by triangles (Figure 6)")
    sheet.set_figheight(8.0)
    sheet.set_figwidth(14.0)
    columns = coverage.columns_of(shown.parts)
    kinds = ("camera rays", shown.camera), ("a pass of diffuse rays", shown.long)
    for panel, (kind, seen) in zip(panels, kinds):
        _draw_pairs(panel, kind, seen, columns, shown)
    panels[0].set_ylabel("rays, tile after tile in the order of the quadtree", fontsize=8)
    _add_legend(sheet)
    return sheet


def _draw_pairs(panel, kind: str, seen: Seen, columns: coverage.Columns, shown: Culled) -> None:
    from matplotlib.collections import PolyCollection

    found = coverage.rectangles(seen.fronts, columns, shown.shape)
    (top, bottom), (left, right) = found.rays.T, found.triangles.T
    corners = np.stack([np.stack([left, right, right, left], 1), np.stack([top, top, bottom, bottom], 1)], 2)
    fills = np.where(found.visible, _RED, _GREEN)
    panel.add_collection(PolyCollection(corners.astype(float), facecolors=fills, edgecolors="white", linewidths=0.25))
    rows, places = coverage.crossings(seen.hits, seen.fronts.tiles, columns)
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


def _draw_bleeding(shown: Culled):
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
