"""Draws the figures of the CHC+RT paper [Mattausch et al. 2015].

They show a scene in memory after two frames of its near walk: tiles, tree parts, the pairs of rays and triangles that
queries cover, and colour bleeding, in aggressive mode and by rotations of the directions. `chcrt_plots` has Figures 7
and 8.
"""

import re
from colorsys import hsv_to_rgb
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ....base.errors import InputError
from ....bvh.block_tree import BlockTree
from ....bvh.nodes import CHILDREN, block_leaf, is_leaf
from ....query.ray_passes import RayPass
from ....query.shadow_query import Surfaces
from ....techniques.chcrt.chc_rt import ChcRtState, camera_hits
from ....techniques.chcrt.occlusion_queries import Tiles
from ....techniques.chcrt.picture_ray_sets import PassRaySet
from ....techniques.chcrt.ray_bundles import pass_rays
from ....techniques.chcrt.tree_parts import TreeParts, parts_of
from ....techniques.chcrt.visibility_fronts import INNER, VISIBLE, Fronts
from ....techniques.tracer_options import ChcRtOptions
from ....trace.tree_list import ROOT, Hits
from ..bench_runner import SHEET_WIDTH, Say, save_sheet
from ..published_methods import tracer_name
from . import chcrt_published
from .walkthrough_timing import SAMPLERS, InCore, colour_bleeding, error_of
from .walkthroughs import DIFFUSE, SAMPLER, Culling, FrameRays, WalkPlace, timed

# --- The tiles, parts and triangles that query pairs cover [Mattausch et al. 2015, Fig. 4 to 6] -----------------------
#
# The matrix of Fig. 6 has a row per ray and a column per triangle. Rays are sorted by tile, in quadtree order, and
# triangles by part, in tree order. Each query pair therefore covers a rectangle of the matrix, and the pairs of both
# fronts cover the matrix exactly once.


class MatrixColumns(NamedTuple):
    """The matrix columns: the triangles of a scene in memory."""

    spans: np.ndarray  # (r, 2) int64: first and end column of each row of `Parts`
    places: np.ndarray  # (n,) int64: the column of each slot of the tree


class Rectangles(NamedTuple):
    """The rectangles of the matrix that k pairs cover."""

    rays: np.ndarray  # (k, 2) int64: first and end row
    triangles: np.ndarray  # (k, 2) int64: first and end column
    visible: np.ndarray  # (k,) bool


def columns_of(parts: TreeParts) -> MatrixColumns:
    """The matrix columns; the parts are subtrees of a `BlockTree`."""
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
    """The slots below a link, in block order."""
    blocks, links = [], np.array([root])
    while len(links):
        blocks.append(block_leaf(links[is_leaf(links)]).block)
        links = tree.links[links[links >= 0], CHILDREN].ravel()
    slots = tree.slots[np.sort(np.concatenate(blocks))].ravel()
    used: np.ndarray = slots[slots >= 0]
    return used


def covered(tiles: Tiles) -> np.ndarray:
    """(t, smallest) bool: whether each tile contains each smallest tile."""
    x0, x1, y0, y1 = (column[:, None] for column in tiles.spans.T)
    x, _, y, _ = tiles.spans[: tiles.smallest].T
    inside: np.ndarray = (x0 <= x) & (x < x1) & (y0 <= y) & (y < y1)
    return inside


def overdraw(fronts: Fronts) -> np.ndarray:
    """(smallest,) int64: the number of visible and invisible pairs over each smallest tile (Fig. 4, left)."""
    pairs = np.bincount(fronts.tile[fronts.state != INNER], minlength=len(fronts.tiles.spans))
    counts: np.ndarray = pairs @ covered(fronts.tiles)
    return counts


def list_lengths(fronts: Fronts) -> np.ndarray:
    """(smallest,) int64: the number of parts that the rays of each smallest tile traverse (Fig. 5, right)."""
    return np.bincount(fronts.tile[fronts.of(VISIBLE)], minlength=fronts.tiles.smallest)


def reachable(fronts: Fronts, columns: MatrixColumns) -> np.ndarray:
    """(smallest,) int64: the number of triangles in those parts (Fig. 4, middle and right)."""
    visible = fronts.of(VISIBLE)
    first, end = columns.spans[fronts.row[visible]].T
    return np.bincount(fronts.tile[visible], end - first, fronts.tiles.smallest).astype(np.int64)


def tile_of_pixels(tiles: Tiles, shape: tuple[int, int]) -> np.ndarray:
    """(h, w) int64: the smallest tile of each pixel."""
    y, x = np.indices(shape) // tiles.pixels
    return y * tiles.across + x


def rows_of_rays(tiles: Tiles, shape: tuple[int, int]) -> np.ndarray:
    """(h, w) int64: the row of each pixel's ray in the matrix."""
    tile = tile_of_pixels(tiles, shape)
    order = np.argsort(_z_places(tiles)[tile].ravel(), kind="stable")
    rows = np.empty(tile.size, np.int64)
    rows[order] = np.arange(tile.size)
    return rows.reshape(shape)


def _z_places(tiles: Tiles) -> np.ndarray:
    """(smallest,) int64: the rank of each smallest tile in quadtree order."""
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


# --- Traces the first two frames of the near walk and records the fronts ----------------------------------------------
#
# Part and tile sizes are proportional to the paper's: the screen is ten tiles wide, and a scene has at least 64 parts.


ERROR = 20
"""Threshold of Fig. 9."""
SHORT = 1 / 100
"""Length of the short rays of Fig. 4, as a share of the long ones."""

_FRAMES = 2
_WALK = 60  # frames of the walk, of which the first _FRAMES are traced
_WIDEST = 640  # pixels; a panel of a figure has fewer
_TILES = 1920 / 200  # tiles across the paper's screen
_PARTS = 64  # minimum
_MANY, _MUCH = 2_000_000, 1 / 6  # triangles that make a tile of Fig. 4 opaque; at most this share of the scene


class PassState(NamedTuple):
    """A query of the last frame: the hits of its rays, and the fronts after it."""

    hits: Hits
    fronts: Fronts


class CullingState(NamedTuple):
    """The data behind the figures of a scene."""

    name: str
    parts: TreeParts
    surfaces: Surfaces
    length: float  # of the long rays, in world units
    camera: PassState
    short: PassState  # one pass of diffuse rays that end early
    long: PassState  # the same pass, across the whole scene
    exact: np.ndarray  # (h, w, 3) uint8: diffuse colour bleeding
    neglecting: np.ndarray  # (h, w, 3) uint8: the same in aggressive mode with threshold ERROR
    rotated: dict[str, np.ndarray]  # sampler -> (h, w, 3) uint8: the same with other rotations between pixels

    @property
    def shape(self) -> tuple[int, int]:
        return self.surfaces.ids.shape

    @property
    def triangles(self) -> int:
        return len(self.surfaces.triangles.vertices)

    @property
    def many(self) -> int:
        """The number of triangles from which a tile of Fig. 4 is opaque."""
        return max(1, min(_MANY, int(self.triangles * _MUCH)))


def options_of(triangles: int, width: int) -> ChcRtOptions:
    """The CHC+RT options for the figures, with proportional part and tile sizes."""
    tile = 32 * max(1, round(width / _TILES / 32))
    return ChcRtOptions(tile=tile, triangles=min(1 << 20, max(1, triangles // _PARTS)))


def culling_state(core: InCore) -> CullingState:
    """Trace the first frames; InputError if no surface is visible from the camera."""
    tree, walk = core.culling().scheduled.parts.keeps, _no_wider(core.place).walks[0]
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
        frame_rays = core.frame_rays(walk.camera(frame, _WALK), SAMPLER)
        if not (frame_rays.surfaces.ids >= 0).any():
            raise InputError(f"{core.place.name}: the {walk.name} camera sees nothing; choose another scene")
        bounce = next(q for q in frame_rays.queries(DIFFUSE) if isinstance(q, RayPass))
        camera_state = _camera_state(camera, frame_rays, core.threads)
        short_state, long_state = (
            _diffuse_state(s, bounce, frame_rays.shape, n, core.threads)
            for s, n in ((short, SHORT * length), (long, length))
        )
        exact, neglecting = (_bleeding(method, frame_rays) for method in methods)
    surfaces, rotated = frame_rays.surfaces, dict[str, np.ndarray]()
    for sampler in SAMPLERS[1:]:
        rays = core.frame_rays(walk.camera(_FRAMES - 1, _WALK), sampler)
        rotated[sampler] = _bleeding(Culling(sampler, ChcRtState(parts, options), core.threads), rays)
    return CullingState(
        core.place.name, parts, surfaces, length, camera_state, short_state, long_state, exact, neglecting, rotated
    )


def _no_wider(place: WalkPlace) -> WalkPlace:
    """The place, with images that are no wider than a figure shows."""
    width, height = place.walks[0].first.width, place.walks[0].first.height
    return place if width <= _WIDEST else place.resized(_WIDEST, max(1, round(height * _WIDEST / width)))


def _camera_state(scheduled: ChcRtState, frame_rays: FrameRays, threads: int) -> PassState:
    """Trace a frame of camera rays."""
    scheduled.begin()
    hits = camera_hits(scheduled, frame_rays.camera, threads)
    return PassState(hits, _state(scheduled))


def _diffuse_state(
    scheduled: ChcRtState, rays: RayPass, shape: tuple[int, int], length: float, threads: int
) -> PassState:
    """Trace a frame of diffuse rays of this length."""
    scheduled.begin()
    low, high = scheduled.parts.boxes[0].astype(np.float64)
    bounce_rays = pass_rays(rays, *shape, 2.0 * float(np.linalg.norm(high - low)))
    bounce_rays = bounce_rays._replace(spans=np.array([[0.0, length]]))
    scheduled.run(PassRaySet(scheduled.parts, scheduled.options, bounce_rays, threads), shape)
    return PassState(bounce_rays.hits, _state(scheduled))


def _state(scheduled: ChcRtState) -> Fronts:
    """The fronts of the frame's only query."""
    ((_, fronts),) = scheduled.states()
    return fronts


def _bleeding(method: Culling, frame_rays: FrameRays) -> np.ndarray:
    """Trace a frame of diffuse rays; the colour-bleeding picture."""
    method.scheduled.begin()
    colour = frame_rays.surfaces.triangles.colour
    return colour_bleeding(frame_rays.surfaces, [(colour, face) for face, _ in timed(method, frame_rays, DIFFUSE)[1]])


# --- Draws Figures 4, 5, 6, 9 and 10 ----------------------------------------------------------------------------------


FIGURES = 4, 5, 6, 9, 10
_RED, _GREEN, _BLUE = "#e0301e", "#2ca02c", "#1030ff"
_OVER = 0.05, 0.65, 0.1  # colour of tiles whose rays may hit many triangles
_LONGEST = 24  # list length that is drawn white
_BRIGHTEST = 0.85  # opacity of an opaque tile
_LABEL = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.7}
_SKY = 0.85  # grey of the background
_GOLDEN = 0.618034  # hue step between consecutive parts, in turns
_TALLEST = 2.0  # height of a panel in widths: narrow images are centred in wider panels
_FAINT = 128  # Fig. 9 is amplified until at least half its differences reach this value


def name_of(place: str, figure: int) -> str:
    """The file name of a figure of a scene."""
    return f"{re.sub(r'[^A-Za-z0-9_-]+', '-', place).strip('-')}-figure-{figure}.png"


def write_pictures(core: InCore, folder: Path, say: Say) -> None:
    """Write a PNG file for each of FIGURES."""
    say(f"{core.place.name}, figures")
    state = culling_state(core)
    for figure, draw in zip(
        FIGURES, (_draw_tiles, _draw_parts, _draw_matrix, _draw_bleeding, _draw_rotations), strict=True
    ):
        save_sheet(draw(state), folder / name_of(state.name, figure))


def shaded(state: CullingState) -> np.ndarray:
    """(h, w) float32: the surfaces in grey, lit from the camera, on a light background."""
    gbuffer = state.surfaces.gbuffer
    ahead = gbuffer.position / np.maximum(np.linalg.norm(gbuffer.position, axis=2, keepdims=True), 1e-30)
    facing = np.abs((gbuffer.normal * ahead).sum(2))
    grey = state.surfaces.triangles.colour[gbuffer.face].mean(2) ** 0.45
    return np.where(gbuffer.face >= 0, grey * (0.4 + 0.6 * facing), np.float32(_SKY)).astype(np.float32)


def subtrees(state: CullingState) -> np.ndarray:
    """(h, w, 3) float64: the visible surfaces in a colour per part."""
    part = state.camera.hits.part
    hit_parts, number = np.unique(part, return_inverse=True)
    tones = [hsv_to_rgb(n * _GOLDEN % 1.0, 0.9 - 0.25 * (n % 3), 1.0 - 0.2 * (n % 2)) for n in range(len(hit_parts))]
    lit = np.array(tones)[number.reshape(part.shape)] * (0.3 + 0.7 * shaded(state)[..., None])
    return np.where((part >= 0)[..., None], lit, 0.06)


def differences_of(state: CullingState) -> tuple[np.ndarray, int]:
    """((h, w) int16: the differences of Fig. 9, the factor that makes them visible)."""
    differences = np.abs(state.exact.astype(np.int16) - state.neglecting).max(2)
    typical = float(np.median(differences[differences > 0])) if differences.any() else 1.0
    return differences, 2 ** max(0, int(np.ceil(np.log2(_FAINT / typical))))


def _sheet(panels: int, state: CullingState, title: str, aside: int = 1) -> tuple[Any, Any]:
    """A figure, and its panels: `aside` of them side by side, the others below, so that pages show readable letters."""
    from matplotlib.figure import Figure

    h, w = state.shape
    rows = -(-panels // aside)
    height = rows * (SHEET_WIDTH / aside * min(h / w, _TALLEST) + 0.25 * aside) + 0.3
    sheet = Figure(figsize=(SHEET_WIDTH, height), layout="constrained")
    sheet.suptitle(f"{state.name}: {title}", fontsize=11)
    found = sheet.subplots(rows, aside, squeeze=False).ravel()
    for panel in found:
        panel.set_axis_off()
    return sheet, found[:panels]


def _show(panel: Any, image: np.ndarray, title: str, **options: Any) -> Any:
    panel.set_title(title, fontsize=9)
    return panel.imshow(image, interpolation="nearest", **options)


def _mark_tiles(panel: Any, shape: tuple[int, int], tiles: Tiles, values: np.ndarray) -> None:
    """Draw the borders of the smallest tiles, with a number in each."""
    h, w = shape
    panel.hlines(np.arange(tiles.pixels, h, tiles.pixels) - 0.5, -0.5, w - 0.5, color="black", lw=0.4)
    panel.vlines(np.arange(tiles.pixels, w, tiles.pixels) - 0.5, -0.5, h - 0.5, color="black", lw=0.4)
    for tile, value in enumerate(values):
        y, x = np.multiply(np.divmod(tile, tiles.across), tiles.pixels)
        at = min(x + tiles.pixels / 2, (x + w) / 2), min(y + tiles.pixels / 2, (y + h) / 2)
        text = f"{value / 1e3:,.0f}k" if value > 999 else f"{value}"
        panel.text(*at, text, fontsize=8, ha="center", va="center", bbox=_LABEL)


def _draw_tiles(state: CullingState) -> Any:
    """Figure 4."""
    sheet, panels = _sheet(3, state, "query pairs and triangles of each tile (Figure 4)")
    pairs, columns = overdraw(state.camera.fronts), columns_of(state.parts)
    tiles = state.camera.fronts.tiles
    for panel in panels:
        panel.imshow(shaded(state), cmap="gray", vmin=0, vmax=1)
    title = "camera rays: occlusion queries over each tile, few (blue) to many (red)"
    _show(panels[0], pairs[tile_of_pixels(tiles, state.shape)], title, cmap="jet", vmin=0, alpha=0.5)
    _mark_tiles(panels[0], state.shape, tiles, pairs)
    for panel, pass_state, length in (
        (panels[1], state.short, SHORT * state.length),
        (panels[2], state.long, state.length),
    ):
        triangles, tiles = reachable(pass_state.fronts, columns), pass_state.fronts.tiles
        opacity = _BRIGHTEST * np.minimum(triangles / state.many, 1.0)[tile_of_pixels(tiles, state.shape)]
        green = np.broadcast_to(_OVER, (*state.shape, 3))
        title = f"diffuse rays of length {length:,.3g}: reachable triangles, opaque from {state.many:,}"
        _show(panel, np.dstack([green, opacity]), title)
        _mark_tiles(panel, state.shape, tiles, triangles)
    return sheet


def _draw_parts(state: CullingState) -> Any:
    """Figure 5."""
    from matplotlib.colors import LinearSegmentedColormap

    sheet, panels = _sheet(2, state, "scheduled subtrees (Figure 5)")
    lists, tiles = list_lengths(state.camera.fronts), state.camera.fronts.tiles
    part = state.camera.hits.part
    n_hit = len(np.unique(part[part >= 0]))
    title = f"one colour per subtree: camera rays hit {n_hit} of {len(state.parts.trees)}"
    _show(panels[0], subtrees(state), title)
    ramp = LinearSegmentedColormap.from_list("lists", ["#d00000", "#ff9000", "#ffe060", "white"])
    colours = ramp.with_extremes(under="black")
    image = lists[tile_of_pixels(tiles, state.shape)]
    picture = _show(panels[1], image, "subtrees in the list of each tile", cmap=colours, vmin=1, vmax=_LONGEST)
    _mark_tiles(panels[1], state.shape, tiles, lists)
    sheet.colorbar(
        picture,
        ax=panels[1],
        shrink=0.9,
        pad=0.02,
        aspect=40,
        location="bottom",
        ticks=[1, 6, 12, 18, 24],
        extend="max",
    )
    return sheet


def _draw_matrix(state: CullingState) -> Any:
    """Figure 6."""
    sheet, panels = _sheet(2, state, "rays by triangles (Figure 6)")
    sheet.set_figheight(10.0)
    columns = columns_of(state.parts)
    kinds = ("camera rays", state.camera), ("a pass of diffuse rays", state.long)
    for panel, (kind, pass_state) in zip(panels, kinds):
        panel.set_axis_on()
        _draw_pairs(panel, kind, pass_state, columns, state)
    panels[0].set_ylabel("rays by tile, in quadtree order", fontsize=8)
    _add_legend(sheet)
    return sheet


def _draw_pairs(panel: Any, kind: str, pass_state: PassState, columns: MatrixColumns, state: CullingState) -> None:
    from matplotlib.collections import PolyCollection

    pairs = rectangles(pass_state.fronts, columns, state.shape)
    (top, bottom), (left, right) = pairs.rays.T, pairs.triangles.T
    corners = np.stack([np.stack([left, right, right, left], 1), np.stack([top, top, bottom, bottom], 1)], 2)
    fills = np.where(pairs.visible, _RED, _GREEN)
    panel.add_collection(
        PolyCollection(list(corners.astype(float)), facecolors=fills, edgecolors="white", linewidths=0.25)
    )
    rows, places = crossings(pass_state.hits, pass_state.fronts.tiles, columns)
    panel.plot(places, rows, ",", color=_BLUE)
    areas = (bottom - top) * (right - left)
    share = areas[pairs.visible].sum() / areas.sum()
    title = f"{kind}: {len(areas):,} pairs; visible pairs cover {100.0 * share:.1f} % of the matrix"
    panel.set_title(title, fontsize=9)
    panel.set(xlim=(0, len(columns.places)), ylim=(pass_state.hits.face.size, 0), xticks=[], yticks=[])
    panel.set_xlabel(f"{len(columns.places):,} triangles by subtree", fontsize=8)


def _add_legend(sheet: Any) -> None:
    from matplotlib.patches import Patch

    meanings = {_RED: "visible pairs", _GREEN: "invisible pairs", _BLUE: "actual hits"}
    patches = [Patch(color=colour, label=meaning) for colour, meaning in meanings.items()]
    sheet.legend(handles=patches, loc="outside lower center", ncols=3, fontsize=9)


def _draw_bleeding(state: CullingState) -> Any:
    """Figure 9."""
    sheet, panels = _sheet(3, state, "diffuse colour bleeding, exact and aggressive (Figure 9)", 2)
    differences, times = differences_of(state)
    error, differ = error_of(state.exact, state.neglecting), np.count_nonzero(differences)
    _show(panels[0], state.exact, "chcrt: exact")
    _show(panels[1], state.neglecting, f"chcrt:{ERROR}: mean error {error:.2f} (paper: {chcrt_published.ERROR})")
    title = f"differences x {times}: {differ:,} of {differences.size:,} pixels"
    _show(panels[2], times * differences, title, cmap="gray_r", vmin=0, vmax=255)
    panels[2].set_axis_on()
    panels[2].set(xticks=[], yticks=[])
    return sheet


def _draw_rotations(state: CullingState) -> Any:
    """Figure 10."""
    title = "diffuse colour bleeding by rotation of directions (Figure 10)"
    sheet, panels = _sheet(len(state.rotated), state, title, 2)
    for panel, (sampler, picture) in zip(panels, state.rotated.items()):
        degrees = sampler.partition(":")[2]
        _show(panel, picture, f"{degrees} degrees" if degrees.isdigit() else f"{degrees} randomisation")
    return sheet
