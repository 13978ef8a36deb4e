"""Traces the segments of screen tiles on a device through the trees that each tile lists, as in a `TreeList`.

The stages are those of `RayStages`. The CPU decides single tests by the corners in their records. A segment whose
undecided tests do not fit the list is traced by the CPU through all trees of the lists, which it fetches from the
device: more trees than a segment needs change no answer.
"""

from typing import Any, NamedTuple, cast
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from ...devices.device import Device, DeviceMemory
from ...query.shadow_query import ShadowQuery
from . import settling
from .device_kernels import RECORD
from .device_launches import DeviceLaunches
from .device_rays import (
    BLOCKED,
    CLEAR,
    TRACED,
    SampleBuffers,
    TileSegments,
    device_patch,
    pixel_in_tile,
    place_in_tiles,
    words_per_receiver,
)
from .device_receivers import DeviceReceivers, ReceiverUploads, needed_arrays
from .device_stages import CAPACITIES, CHUNK, LISTED, Capacities, Chunk, RayStages
from .device_traversal import Work
from .device_tree import DeviceTree
from .part_trees import part_bvh
from .tree_list_kernels import CORNERS, TEST, TREE_WORDS, TreeListBuffers

# --- Queries ----------------------------------------------------------------------------------------------------------


class TileLayout(NamedTuple):
    """How the receivers of a query are cut into screen tiles, as in `TreeList`, and which of its samples are traced."""

    pixels: int  # side of a tile
    across: int  # tiles per row
    first: int  # the first sample
    count: int  # type: ignore[assignment]  # number of samples; hides tuple.count


class _SharedInputs:
    """What the queries of the same receivers share on a device."""

    def __init__(self, query: ShadowQuery, receivers: DeviceReceivers, launches: DeviceLaunches) -> None:
        self.receivers, self.launches, self._arrays = receivers, launches, (query.ids, query.corners)
        needed, send = needed_arrays(query), launches.upload
        self.ids = send(np.ascontiguousarray(query.ids), "the receivers") if needed.ids else None
        corners = np.ascontiguousarray(query.corners)
        self.corners = send(corners, "the triangles of the receivers") if needed.corners else None

    def serve(self, query: ShadowQuery) -> bool:
        """Whether they are those of a query."""
        ids, corners = self._arrays
        return query.ids is ids and query.corners is corners and self.receivers.are_of(query)


class TiledQuery:
    """A shadow query on a device, to be traced in several calls of `TiledTracer.trace_tiles`.

    Attributes
    ----------
    fresh : bool
        Whether no segment has been traced yet.
    """

    def __init__(self, query: ShadowQuery, layout: TileLayout, inputs: _SharedInputs) -> None:
        launches, kept = inputs.launches, inputs.receivers
        (h, w), spp = query.sides.shape, query.samples.shape[1]
        self.query, self.layout, self.fresh, self._inputs = query, layout, True, inputs
        self.rows = min(layout.pixels, h)
        normals = kept.normals
        if normals is None and needed_arrays(query).normals:
            normals = launches.upload(np.ascontiguousarray(query.normals), "the receivers' normals")
        samples = launches.upload(np.ascontiguousarray(query.samples), "the samples of a light")
        self._blocked = launches.allocate(4 * h * w * -(-layout.count // 32), "the bits of the answers")
        self._blocked.fill()
        self._memory = normals, samples  # freed with this query
        self._buffers = SampleBuffers(
            kept.memory.address, _address(inputs.ids), _address(normals), _address(inputs.corners), samples.address,
            device_patch(query.light), w, spp,
        )  # fmt: skip

    @property
    def per_row(self) -> int:
        """The number of segments in a row of pixels of a tile."""
        return self.layout.pixels * self.layout.count

    @property
    def rows_at_once(self) -> int:
        """The number of rows of pixels that are traced together."""
        return max(CHUNK // self.per_row, 1)

    def segments(self, tiles: int) -> TileSegments:
        """The segments of tiles; tiles: the address of their numbers, int32."""
        layout, h = self.layout, self.query.sides.shape[0]
        return TileSegments(
            self._buffers, tiles, self._blocked.address, layout.pixels, self.rows, layout.across, h, layout.first,
            layout.count, int(self.fresh),
        )  # fmt: skip


def _address(memory: DeviceMemory | None) -> int:
    return 0 if memory is None else memory.address


def set_bits(bits: NDArray[np.uint64], layout: TileLayout, tiles: NDArray[np.int32], words: NDArray[np.uint32]) -> None:
    """Set bits of a query where the segments of some tiles are blocked; words: as from `TiledTracer.trace_tiles`.

    bits : (h, w, ceil(spp / 64)) uint64
    """
    pixels, across, first, _ = layout
    rows, per_receiver = words.shape[1], words.shape[3]
    at, shift = first >> 5, np.uint32(first & 31)
    assert shift == 0 or layout.count + shift <= 32  # the samples of a stratum share a word with others
    known = bits.view("<u4")[..., at : at + per_receiver]
    for tile, found in zip(tiles.tolist(), words):
        y, x = tile // across * pixels, tile % across * pixels
        part = known[y : y + rows, x : x + pixels]
        part |= found[: part.shape[0], : part.shape[1]] << shift


class RecordBuffers(NamedTuple):
    """A list of tests for the CPU: addresses on the device."""

    rest: int  # the records, see `device_kernels`
    corners: int  # float32, CORNERS per record
    capacity: int  # in records


# --- The tracer -------------------------------------------------------------------------------------------------------


class TreeLists(NamedTuple):
    """Lists of trees for tiles and their ray sets, on the host."""

    table: NDArray[np.int64]  # (k, TREE_WORDS): rows of trees on the device
    starts: NDArray[np.int32]  # (tiles * sets + 1,): where in `items` each list begins
    items: NDArray[np.int32]  # (m,): rows of the table
    sets: int  # lists per tile: 1, or one per sample


class _SentLists(NamedTuple):
    """`TreeLists` on the device."""

    buffers: TreeListBuffers
    table: NDArray[np.int64]
    tiles: NDArray[np.int32]  # (n,): the tiles that are traced


class TiledTracer(RayStages):
    """Traces the segments of screen tiles through lists of trees, by the stages of `RayStages`."""

    def __init__(self, device: Device, capacities: Capacities = CAPACITIES) -> None:
        super().__init__(device, capacities)
        self._uploads = ReceiverUploads(self.launches)
        self._latest: ref[_SharedInputs] | None = None

    def query(self, query: ShadowQuery, layout: TileLayout, threads: int) -> TiledQuery:
        """A query, uploaded. Receivers are uploaded once for all queries that have the same arrays and are alive.

        Memory for its answers is reserved, too, so that `trace_tiles` needs hardly any more.

        Raises
        ------
        OutOfDeviceMemory
            If it does not fit.
        """
        with self.lock:
            inputs = None if self._latest is None else self._latest()
            if inputs is None or not inputs.serve(query):
                inputs = _SharedInputs(query, self._uploads.new(query, threads), self.launches)
                self._latest = ref(inputs)
            tiled, (h, _) = TiledQuery(query, layout, inputs), query.sides.shape
            rows = min(tiled.rows * layout.across * -(-h // layout.pixels), tiled.rows_at_once)
            self._work(0, rows * tiled.per_row, 0)
            self._words(rows, tiled)
            return tiled

    def trace_tiles(
        self, tiled: TiledQuery, tiles: NDArray[np.int32], lists: TreeLists, threads: int
    ) -> tuple[NDArray[np.uint32], NDArray[np.int32]]:
        """Trace the segments of some tiles that are not known to be blocked.

        tiles : (n,) numbers of tiles; the first call for a query must have all, for what receivers' surfaces block

        Returns
        -------
        words : (n, rows, pixels, k) uint32
            Bits of the segments that have now been found to be blocked, those of 32 samples in each word.
        blockers : (m,) int32
            1 for the items of the lists whose trees block a segment, or were left to exact tests.
        """
        row, at_once, send = tiled.per_row, tiled.rows_at_once, self.launches.sent
        rows = len(tiles) * tiled.rows
        with self.lock:
            segments = tiled.segments(send("tiles", tiles, "the lists of tiles"))
            per_receiver = words_per_receiver(segments)
            words = np.zeros((rows, tiled.layout.pixels, per_receiver), np.uint32)
            blockers = self.launches.block("blockers", 4 * len(lists.items) + 4, "the lists of tiles")
            blockers.fill()
            sent = _SentLists(self.sent_lists(lists, blockers.address), lists.table, tiles)
            for first in range(0, rows, at_once):
                n = min(at_once, rows - first)
                work = self._work(first * row, n * row, tiled.query.cull_faces)
                self._trace(cast(DeviceTree, sent), Chunk(LISTED, segments, work, tiled.query), threads)
                here = words[first : first + n]
                out = self._words(n, tiled)
                self.launches.launch("pack_listed", (segments, work, out.address, here.size), here.size)
                out.read(here)
            tiled.fresh = False
            found = blockers.read(np.empty(len(lists.items), np.int32))
        return words.reshape(len(tiles), tiled.rows, tiled.layout.pixels, per_receiver), found

    def _words(self, rows: int, tiled: TiledQuery) -> DeviceMemory:
        """The block for the bits of some rows of pixels."""
        words = rows * tiled.layout.pixels * -(-tiled.layout.count // 32)
        return self.launches.block("words", 4 * words, "the bits of the answers")

    def sent_lists(self, lists: TreeLists, blockers: int) -> TreeListBuffers:
        """Lists, uploaded until the next call; blockers: see `TreeListBuffers`."""
        send, what = self.launches.sent, "the lists of tiles"
        return TreeListBuffers(
            send("trees", np.ascontiguousarray(lists.table.reshape(-1, TREE_WORDS)), what),
            send("starts", lists.starts, what),
            send("items", lists.items, what),
            lists.sets,
            blockers,
            self.records().corners,
        )

    def records(self) -> "RecordBuffers":
        """The list of tests for the CPU."""
        what, capacity = "the list of tests for the CPU", self._capacities.records
        corners = self.launches.block("corners", 4 * CORNERS * capacity, what)
        return RecordBuffers(
            self.launches.block("rest", 8 * RECORD * capacity, what).address, corners.address, capacity
        )

    def widen_records(self, capacity: int) -> None:
        """Make room for more tests for the CPU."""
        self._capacities = self._capacities._replace(records=max(self._capacities.records, capacity))

    def _work(self, first: int, n: int, cull_faces: int) -> Work:
        tests = self.launches.block("pairs", 4 * TEST * self._capacities.pairs, "the list of undecided tests")
        return super()._work(first, n, cull_faces)._replace(pairs=tests.address)

    # --- What the CPU decides -----------------------------------------------------------------------------------------

    def _decide(self, tree: Any, chunk: Chunk, records: settling.Records, threads: int) -> None:
        heads = settling.heads_of(records)
        corners = self._read("corners", (len(records), CORNERS), np.float32)
        blocked = settling.are_hits(records, corners, chunk.work.cull_faces, threads)
        own = heads[:, settling.SLOT] < 0
        blocked[own] = _below_horizon(tree, chunk, heads[own, settling.RAY], threads)
        rays = np.unique(heads[blocked, settling.RAY])
        self._mark(rays, np.full(len(rays), BLOCKED, np.int32))

    def _answers(self, tree: Any, chunk: Chunk, records: settling.Records, threads: int) -> NDArray[np.int32]:
        heads, cull_faces = settling.heads_of(records), chunk.work.cull_faces
        states = heads[:, settling.STATE]
        blocked = (states == BLOCKED) | _below_horizon(tree, chunk, heads[:, settling.RAY], threads)
        for row in tree.table:
            left = np.flatnonzero((states == TRACED) & ~blocked)
            if not len(left):
                break
            bvh = part_bvh(row, self.device)
            blocked[left] = settling.traced_rays(records[left], bvh, cull_faces, True, threads) >= 0
        return np.where(blocked, BLOCKED, CLEAR).astype(np.int32)


def _below_horizon(sent: _SentLists, chunk: Chunk, rays: NDArray[np.int32], threads: int) -> NDArray[np.bool_]:
    """(m,) bool: whether the receivers' own surfaces block some segments of a chunk."""
    query, segments = cast(ShadowQuery, chunk.query), cast(TileSegments, chunk.rays)
    place = place_in_tiles(segments, chunk.work.first + rays.astype(np.int64))
    y, x = pixel_in_tile(segments, sent.tiles[place.at].astype(np.int64), place)
    numbers = (y * segments.query.w + x) * segments.query.spp + segments.first + place.sample
    return settling.below_horizon(numbers, query, threads)
