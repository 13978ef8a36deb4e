"""Render a picture in bands of rows: trace the occlusion bits of each band, and shade the picture from all bits.

Bands hold bits rather than colours, so the filter, ambient light and exposure work on the whole picture, as without
bands. docs/design/shards.md compares this with bands of finished pixels.
"""

import numpy as np

from ..engine.engine import Engine
from ..query.pixel_refinement import blocks_of, edges, picture_of
from ..query.receivers import NOTHING
from ..query.shadow_query import Surfaces
from ..query.surface_links import picture_surfaces
from ..trace.transmission import TracedQuery
from .bounced_light import indirect_light
from .frame import FrameState, TracedBits, cpu_sees_if_full, edge_colours, queries_of, trace_queries, trace_query
from .frame_passes import evaluate, find_surfaces, trace
from .frame_request import Request
from .light_visibility import finer_query, without_equal_samples
from .sparse_bounce import sparse_grid, sparse_surfaces

BAND = 32
"""Rows of a band: four rows of the sparsest grid of bounced light, so that each pixel keeps its sample set."""

_ABOVE, _BELOW = 4, 1  # additional rows; the penumbra test reads one row on each side


def band_array_names(request: Request) -> list[str]:
    """The names of the arrays in `RowBands.band`."""
    lights = range(len(request.lights))
    kinds = ["bits"] if request.finer is None else ["bits", "finer", "edges"]
    return [f"{kind} {i}" for kind in kinds for i in lights] + (["indirect"] if request.passes else [])


def bits_of_bands(arrays: dict[str, np.ndarray]) -> TracedBits:
    """The bits of a picture; `arrays`: those of its bands, each concatenated."""

    def named(kind: str) -> list[np.ndarray]:
        return [values for name, values in arrays.items() if name.startswith(f"{kind} ")]

    return TracedBits(named("bits"), named("finer"), named("edges"), arrays.get("indirect"))


class RowBands:
    """Traces bands of one picture, which share the visible surfaces, and the tree if the plan allows it.

    Bands of a store do not share surfaces: a store reads only the chunks that a band's rays enter.
    """

    def __init__(self, engine: Engine, request: Request) -> None:
        self._engine, self._request = engine, request
        self._begin()

    def _begin(self) -> None:
        self._state = FrameState(self._engine, self._request)
        evaluate(self._state)
        self._surfaces: Surfaces | None = None  # of the whole picture
        self._edges: tuple[np.ndarray, Surfaces] | None = None  # mask of all edges, (H, W) bool, and their sub-pixels

    def band(self, first: int, last: int) -> dict[str, np.ndarray]:
        """The arrays `band_array_names` of the rows from `first` up to but excluding `last`.

        first : a multiple of 4, and of 4 times `bounce_step` with bounced light
        """
        while True:
            with cpu_sees_if_full(self._engine):
                return self._traced(first, last)
            self._begin()  # without the surfaces and the tree on the device

    def _traced(self, first: int, last: int) -> dict[str, np.ndarray]:
        request = self._request
        rows = slice(max(first - _ABOVE, 0), min(last + _BELOW, request.camera.height))
        if request.finer is None:
            rows = slice(first, last)
        inner = slice(first - rows.start, last - rows.start)
        surfaces = self._surfaces_of(rows)
        surfaces.gbuffer.side[: max(inner.start - 1, 0)] = NOTHING
        traced = self._trace(surfaces)
        arrays = {f"bits {i}": each.bits[inner] for i, each in enumerate(traced)}
        if request.finer is not None:
            arrays |= self._trace_penumbrae(surfaces, traced, inner) | self._trace_edges(surfaces, traced, rows, inner)
        if request.passes:
            arrays["indirect"] = self._bounce(_rows(surfaces, inner), traced[0].query.origins[inner])
        return arrays

    def _surfaces_of(self, rows: slice) -> Surfaces:
        state = self._state
        if state.tracer.memory is not None:
            return find_surfaces(state, rows)
        if self._surfaces is None:
            self._surfaces = find_surfaces(state, slice(0, state.request.camera.height))
        return _rows(self._surfaces, rows)

    def _trace(self, surfaces: Surfaces) -> list[TracedQuery]:
        self._state.tracer.reuse_tree()
        return trace(self._state, surfaces, slice(0))

    def _trace_penumbrae(self, surfaces: Surfaces, traced: list[TracedQuery], inner: slice) -> dict[str, np.ndarray]:
        """Trace refined penumbrae: the bits of their finer samples."""
        state, arrays = self._state, {}
        assert state.request.finer is not None
        visible = picture_surfaces(surfaces.gbuffer, state.tracer.view)
        for i, (each, samples) in enumerate(zip(traced, state.request.finer.penumbra)):
            finer = finer_query(visible, each, samples, state.threads)
            sides = np.full_like(finer.sides, NOTHING)
            sides[inner] = finer.sides[inner]
            arrays[f"finer {i}"] = trace_query(state, finer._replace(sides=sides)).bits[inner]
        return arrays

    def _trace_edges(
        self, surfaces: Surfaces, traced: list[TracedQuery], rows: slice, inner: slice
    ) -> dict[str, np.ndarray]:
        """Trace refined edges: the bits of their sub-pixels."""
        state, finer = self._state, self._state.request.finer
        assert finer is not None
        pixels, blocks = self._subpixels(surfaces, rows, inner)
        if not len(blocks):
            needed = [without_equal_samples(t.query._replace(samples=s)) for t, s in zip(traced, finer.edges)]
            words = [-(-query.samples.shape[1] // 64) for query in needed]
            return {f"edges {i}": np.zeros((0, 4, 4, n), np.uint64) for i, n in enumerate(words)}
        g = pixels.gbuffer

        def row(array: np.ndarray) -> np.ndarray:
            return picture_of(blocks_of(array)[blocks], (4, 4 * len(blocks)))

        gbuffer = g._replace(
            **{name: row(getattr(g, name)) for name in ("position", "normal", "face", "depth", "side")}
        )
        queries = queries_of(state, pixels._replace(gbuffer=gbuffer, ids=row(pixels.ids)), finer.edges)
        queries = [without_equal_samples(query) for query in queries]
        state.tracer.prepare_again(queries, state.clock.lap)
        return {f"edges {i}": blocks_of(each.bits) for i, each in enumerate(trace_queries(state, queries))}

    def _subpixels(self, surfaces: Surfaces, rows: slice, inner: slice) -> tuple[Surfaces, range]:
        """The sub-pixels of edges, and the range of blocks that belong to the band."""
        state, shape = self._state, (self._state.request.camera.height, self._state.request.camera.width)
        band_rows = slice(rows.start + inner.start, rows.start + inner.stop)
        if self._surfaces is None:
            edge = np.zeros(shape, np.bool_)
            visible = picture_surfaces(surfaces.gbuffer, state.tracer.view)
            edge[band_rows] = edges(visible, edge_colours(state), state.threads)[inner]
            count = np.count_nonzero(edge)
            return state.tracer.subpixels(edge) if count else surfaces, range(count)
        if self._edges is None:
            edge = edges(
                picture_surfaces(self._surfaces.gbuffer, state.tracer.view), edge_colours(state), state.threads
            )
            self._edges = edge, state.tracer.subpixels(edge)
        edge, pixels = self._edges
        before = np.count_nonzero(edge[: band_rows.start])
        return pixels, range(before, before + np.count_nonzero(edge[band_rows]))

    def _bounce(self, surfaces: Surfaces, origins: np.ndarray) -> np.ndarray:
        state, step = self._state, self._state.request.options.bounce_step
        nearest = state.tracer.closest_hits(state.clock.lap)
        return indirect_light(state, sparse_surfaces(surfaces, step), sparse_grid(origins, step), nearest)


def _rows(surfaces: Surfaces, rows: slice) -> Surfaces:
    """Copy some rows of a picture's surfaces."""
    g = surfaces.gbuffer
    gbuffer = g._replace(**{n: getattr(g, n)[rows].copy() for n in ("position", "normal", "face", "depth", "side")})
    return surfaces._replace(gbuffer=gbuffer, ids=surfaces.ids[rows].copy())
