"""The tracer of devices: ray lists, shadow queries and camera rays, through trees that are built there or uploaded."""

from collections.abc import Callable, Iterator
from math import prod
from typing import Any, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ...base.progress import ProgressCallback
from ...bvh.nodes import Bvh
from ...bvh.triangle_bounds import trivial_bvh
from ...devices.arrays import DeviceArray
from ...devices.device import Device, DeviceMemory
from ...query.ray_list import HitArrays, RayArguments, RayArrays, hit_arrays
from ...query.shadow_query import ResidentQuery, ShadowQuery
from ...scene.lights import AMBIENT
from ..alpha_cutouts import CutoutTree
from . import settling
from .build_kernels import Source
from .device_cutouts import DeviceCutouts
from .device_kernels import HIT_BYTES, RECORD, HitBuffers
from .device_launches import DeviceLaunches
from .device_rays import RayBuffers, SampleBuffers, device_patch
from .device_receivers import DeviceReceivers, ReceiverUploads, needed_arrays
from .device_stages import ANY, CAPACITIES, CHUNK, NEAREST, SAMPLES, SHAFTS, Capacities, Chunk, RayStages
from .device_traversal import REST, Work
from .device_tree import DeviceTree, UploadedTree
from .ploc_build import PlocTree
from .resident_rays import ResidentRays
from .shaft_parts import suits_shafts, whole_squares
from .tree_build import BuiltTree, LbvhTree, source_of

BUILDERS: dict[str, Callable[[Source, DeviceLaunches], BuiltTree]] = {"lbvh": LbvhTree, "ploc": PlocTree}
"""Name of a builder -> the tree that it builds on a device."""

_SUMS_AT_ONCE = 1 << 22
"""Largest number of segments whose depths are kept together, 16 bytes each."""


class DeviceTracer(RayStages):
    """Builds trees, and traces rays and shadow queries through them, by the stages of `RayStages`."""

    def __init__(self, device: Device, capacities: Capacities = CAPACITIES) -> None:
        super().__init__(device, capacities)
        self.cutouts, self._uploads = DeviceCutouts(self.launches), ReceiverUploads(self.launches)

    def tree(self, bvh: Bvh) -> UploadedTree:
        """A tree, uploaded.

        Raises
        ------
        OutOfDeviceMemory
            If it does not fit.
        """
        with self.lock:
            return UploadedTree(bvh, self.launches)

    def build(
        self,
        vertices: NDArray[np.float32] | DeviceMemory,
        faces: NDArray[np.int32] | None = None,
        builder: str = "lbvh",
    ) -> DeviceTree:
        """The tree of a builder on the CPU, built on the device.

        vertices : as for `source_of`
        faces : (k,) int32, ascending: those in the tree; None: all
        builder : a name from BUILDERS

        Raises
        ------
        OutOfDeviceMemory
            If it does not fit.
        """
        with self.lock:
            source = source_of(vertices, faces, self.launches)
            if source.n < 2:
                if isinstance(vertices, DeviceMemory):
                    vertices = vertices.read(np.empty((vertices.size // 36, 3, 3), np.float32))
                bvh = trivial_bvh((vertices if faces is None else vertices[faces]).reshape(-1, 9))
                return UploadedTree(bvh if faces is None else bvh._replace(prim_ids=faces), self.launches)
            return BUILDERS[builder](source, self.launches)

    def refit(self, tree: DeviceTree, vertices: NDArray[np.float32] | DeviceMemory, limit: float) -> DeviceTree | None:
        """A tree from `build` with moved triangles, which leaves that one unchanged; None: build another one.

        limit : the maximum SAH cost, relative to that of the tree when it was built
        """
        with self.lock:
            if not isinstance(tree, BuiltTree):
                return None
            moved = tree.refitted(vertices)
            assert moved.built_cost is not None
            return moved if moved.cost() <= limit * moved.built_cost else None

    def receivers(self, query: ShadowQuery, threads: int) -> DeviceReceivers:
        """The receivers of a query, there or uploaded to memory of their own: see `DeviceTree.receivers`."""
        with self.lock:
            surfaces = self._surfaces_of(query)
            return self._uploads.new(query, threads) if surfaces is None else DeviceReceivers(query, surfaces.receivers)

    def _surfaces_of(self, query: ShadowQuery) -> Any:
        """The `device_surfaces.DeviceSurfaces` of a query's receivers on this device; None: they are elsewhere."""
        here = isinstance(query, ResidentQuery) and query.there.device is self.device
        return cast(ResidentQuery, query).there if here else None

    def move(self, tree: UploadedTree, bvh: Bvh, vertices: NDArray[np.float32]) -> None:
        """Move the triangles of a tree, see `UploadedTree.move`."""
        with self.lock:
            tree.move(bvh, vertices)

    # --- Queries ------------------------------------------------------------------------------------------------------

    def trace_rays(
        self,
        tree: DeviceTree,
        rays: RayArguments,
        any_hit: bool,
        threads: int,
        cutouts: CutoutTree | None = None,
    ) -> HitArrays:
        """The hits of valid rays.

        cutouts : of the scene, which are not in `tree`; None: there are none
        """
        arrays, out = rays.arrays(), hit_arrays(rays.n, any_hit)
        with self.lock:
            for first in range(0, rays.n, CHUNK):
                part = slice(first, min(first + CHUNK, rays.n))
                n = part.stop - first
                chunk = self.chunk_of(arrays.part(part), rays, any_hit)
                self._trace(tree, chunk, threads)
                if any_hit:
                    self._block(chunk, cutouts, threads)
                    out.blocked[part] = np.unpackbits(self.bits(chunk, n), count=n, bitorder="little")
                else:
                    here = HitArrays(*(a[part] if len(a) else a for a in out))
                    self._report_here(tree, chunk, cutouts, here, threads)
        return out

    def trace_resident(
        self,
        tree: DeviceTree,
        rays: ResidentRays,
        any_hit: bool,
        threads: int,
        cutouts: CutoutTree | None = None,
    ) -> tuple[DeviceArray, ...]:
        """The hits of rays on the device, there: blocked, or face, t, u and v, as in `HitArrays`.

        Raises
        ------
        InputError
            If a ray is invalid: NaN, infinity or a zero direction.
        """
        with self.lock:
            buffers, n = rays.in_frame(self.launches), rays.n
            chunk = self.traced(tree, buffers, n, rays.cull_faces, any_hit, threads)
            if any_hit:
                self._block(chunk, cutouts, threads)
                blocked = self._new("the answers", rays.shape, np.bool_)
                self.launches.launch("write_blocked", (chunk.work.out, n, blocked.memory.address), n)
                return (blocked,)
            kinds = np.int32, np.float64, np.float32, np.float32
            hits = tuple(self._new("the hits", rays.shape, kind) for kind in kinds)
            self._report(tree, chunk, cutouts, HitBuffers(*(each.memory.address for each in hits)), threads)
            return hits

    def _new(self, what: str, shape: tuple[int, ...], dtype: DTypeLike) -> DeviceArray:
        memory = self.device.allocate(max(prod(shape), 1) * np.dtype(dtype).itemsize, what)
        return DeviceArray(memory, shape, dtype, self.device.queue)

    def traced(
        self, tree: DeviceTree, rays: RayBuffers, n: int, cull_faces: int, any_hit: bool, threads: int
    ) -> "Chunk":
        """Trace n rays of buffers on the device. Their states or slots are at `out` of the work."""
        chunk = self.chunk_in(rays, n, cull_faces, any_hit)
        self._trace(tree, chunk, threads)
        return chunk

    def chunk_in(self, rays: RayBuffers, n: int, cull_faces: int, any_hit: bool) -> "Chunk":
        """A chunk of n rays of buffers; nothing is traced."""
        return Chunk(ANY if any_hit else NEAREST, rays, self._work(0, n, cull_faces), None)

    def nearest_hits(
        self, tree: DeviceTree, rays: RayBuffers, n: int, cutouts: CutoutTree | None, threads: int
    ) -> tuple[Work, HitBuffers]:
        """The nearest hits of n rays of a picture, on the device until the next call; `lock` is held.

        On solid triangles, t is that of the CPU's pictures (`filters.hit_t`).

        cutouts : as for `trace_rays`
        """
        return self.hits_of(tree, self.traced(tree, rays, n, 0, False, threads), cutouts, threads)

    def hits_of(
        self, tree: DeviceTree, chunk: Chunk, cutouts: CutoutTree | None, threads: int
    ) -> tuple[Work, HitBuffers]:
        """As `nearest_hits`, of a chunk of rays whose nearest hits in the tree are known."""
        sizes = zip(HitBuffers._fields, HIT_BYTES)
        hits = HitBuffers(*(self.launches.block(name, size * chunk.work.n, "the hits").address for name, size in sizes))
        self._report(tree, chunk, cutouts, hits, threads, of_picture=True)
        return chunk.work, hits

    def trace_shadow(
        self,
        tree: DeviceTree,
        query: ShadowQuery,
        bits: NDArray[np.uint64],
        threads: int,
        progress: ProgressCallback | None = None,
        shafts: bool = False,
    ) -> None:
        """Set bit s of ``bits[y, x]`` where sample s of a `ShadowQuery` is occluded.

        bits : (h, w, ceil(spp / 64)) uint64
        shafts : whether shafts trace the query, if they suit it, instead of single rays
        """
        spp, words = query.samples.shape[1], bits.reshape(-1, bits.shape[-1])
        shafts = shafts and suits_shafts(tree.reach, query)
        at_once = whole_squares(max(CHUNK // spp, 1), query) if shafts else max(CHUNK // spp, 1)
        with self.lock:
            for chunk, rows in self.parts(query, at_once, threads, tree, shafts):
                self._trace(tree, chunk, threads)
                words[rows] |= words_of(self.bits(chunk, chunk.work.n), len(words[rows]), spp)
                if progress is not None:
                    progress(rows.stop, len(words))

    def add_shadows(self, cutouts: CutoutTree, query: ShadowQuery, bits: NDArray[np.uint64], threads: int) -> None:
        """Set bit s of ``bits[y, x]`` where cut-outs block the light of sample s, as `alpha_cutouts.add_shadows`."""
        spp, words = query.samples.shape[1], bits.reshape(-1, bits.shape[-1])
        with self.lock:
            for chunk, rows in self.parts(query, max(CHUNK // spp, 1), threads):
                self.cutouts.sum_depths(cutouts, _samples_of(chunk), chunk.work, words[rows], False, threads)
                words[rows] |= words_of(self.bits(chunk, chunk.work.n), len(words[rows]), spp)

    def shares(
        self, cutouts: CutoutTree, query: ShadowQuery, bits: NDArray[np.uint64], threads: int
    ) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
        """The transmittances of receivers to which light comes through cut-outs, for `transmission.transmission`.

        bits : (h, w, ceil(spp / 64)) uint64, the answer to the query, in which cut-outs are included

        Returns
        -------
        receivers : (k,) int64, ascending
        values : (k, spp, channels) float32
        """
        spp, words = query.samples.shape[1], bits.reshape(-1, bits.shape[-1])
        receivers, values = [np.empty(0, np.intp)], [np.empty((0, spp, cutouts.channels), np.float32)]
        with self.lock:
            for chunk, rows in self.parts(query, max(_SUMS_AT_ONCE // spp, 1), threads):
                depths = self.cutouts.sum_depths(cutouts, _samples_of(chunk), chunk.work, words[rows], True, threads)
                lit = np.flatnonzero(words_of(self.bits(chunk, chunk.work.n), len(words[rows]), spp).any(1))
                if len(lit):
                    receivers.append(rows.start + lit)
                    values.append(self.cutouts.shares(depths, lit, cutouts.channels))
        return np.concatenate(receivers), np.concatenate(values)

    def chunk_of(self, arrays: RayArrays, rays: RayArguments, any_hit: bool) -> Chunk:
        """A part of a ray list, sent to the device; nothing is traced."""
        return self.chunk_in(self._sent(arrays, rays), len(arrays.origins), rays.cull_faces, any_hit)

    def parts(
        self, query: ShadowQuery, at_once: int, threads: int, tree: DeviceTree | None = None, shafts: bool = False
    ) -> Iterator[tuple[Chunk, slice]]:
        """The segments of a query, some receivers at a time; nothing is traced.

        tree : one that may have been built for these receivers
        """
        buffers, spp, receivers = self._sample_buffers(tree, query, threads), query.samples.shape[1], query.n
        for first in range(0, receivers, at_once):
            n = min(at_once, receivers - first)
            work = self._work(first * spp, n * spp, query.cull_faces)
            yield Chunk(SHAFTS if shafts else SAMPLES, buffers, work, query), slice(first, first + n)

    # --- Uploads ------------------------------------------------------------------------------------------------------

    def _sent(self, arrays: RayArrays, rays: RayArguments) -> RayBuffers:
        (origins, ends), send = arrays.local(), self.launches.sent

        def number(name: str, value: np.ndarray | float, column: NDArray[np.float64]) -> tuple[int, float]:
            if not isinstance(value, np.ndarray) or value.ndim == 0:
                return 0, float(value)
            return send(name, np.ascontiguousarray(column[:, 0], np.float64), "the rays"), 0.0

        (tmin, shared_tmin), (tmax, shared_tmax) = (
            number("tmin", rays.tmin, arrays.tmin),
            number("tmax", rays.tmax, arrays.tmax),
        )
        skip = 0
        if isinstance(rays.skip, np.ndarray) and rays.skip.ndim:
            skip = send("skip", np.ascontiguousarray(arrays.skip[:, 0], np.int32), "the rays")
        return RayBuffers(
            send("origins", np.ascontiguousarray(origins), "the rays"),
            send("ends", np.ascontiguousarray(ends), "the rays"),
            tmin,
            tmax,
            skip,
            int(rays.segments),
            shared_tmin,
            shared_tmax,
            -1 if skip else int(rays.skip),
        )

    def _receivers_of(self, tree: DeviceTree | None, query: ShadowQuery, threads: int) -> tuple[int, int]:
        """The addresses of receivers and normals: those that the tree was built for, or copies until the next call."""
        for kept in () if tree is None else tree.receivers:
            if kept.are_of(query):
                return kept.memory.address, 0 if kept.normals is None else kept.normals.address
        block = self.launches.block("receivers", 16 * query.n, "the receivers")
        self._uploads.write(query, block, threads)
        return block.address, 0

    def _sample_buffers(self, tree: DeviceTree | None, query: ShadowQuery, threads: int) -> SampleBuffers:
        return SampleBuffers(
            *self._receiver_buffers(tree, query, threads),
            self.launches.sent("samples", query.samples, "the samples of a light"),
            device_patch(query.light),
            query.shape[1],
            query.samples.shape[1],
        )

    def _receiver_buffers(self, tree: DeviceTree | None, query: ShadowQuery, threads: int) -> tuple[int, int, int, int]:
        """The addresses of receivers, of their ids, normals and corners, as in `SampleBuffers`."""
        send, surfaces = self.launches.sent, self._surfaces_of(query)
        if surfaces is not None:
            normals = surfaces.wide_normals() if query.light.kind == AMBIENT else 0
            return surfaces.receivers.address, 0, normals, self.launches.address_of(surfaces.triangles)
        needed = needed_arrays(query)
        receivers, normals = self._receivers_of(tree, query, threads)
        if needed.normals and not normals:
            normals = send("normals", np.ascontiguousarray(query.normals), "the receivers' normals")
        ids = send("ids", np.ascontiguousarray(query.ids), "the receivers") if needed.ids else 0
        return receivers, ids, normals, self.launches.kept_triangles(query.corners) if needed.corners else 0

    # --- Reports ------------------------------------------------------------------------------------------------------

    def _block(self, chunk: Chunk, cutouts: CutoutTree | None, threads: int) -> None:
        """Mark the rays of a traced chunk that cut-outs block."""
        if cutouts is not None:
            assert isinstance(chunk.rays, RayBuffers)
            self.cutouts.block(cutouts, chunk.rays, chunk.work, threads)

    def _report_here(
        self, tree: DeviceTree, chunk: Chunk, cutouts: CutoutTree | None, out: HitArrays, threads: int
    ) -> None:
        """Write the numbers of a chunk's nearest hits to arrays on the host."""
        arrays = dict(zip(HitBuffers._fields, out[1:]))
        blocks = {name: self.launches.block(name, each.nbytes, "the hits") for name, each in arrays.items()}
        hits = HitBuffers(*(each.address for each in blocks.values()))
        self._report(tree, chunk, cutouts, hits, threads)
        for name, block in blocks.items():
            block.read(arrays[name])

    def _report(
        self,
        tree: DeviceTree,
        chunk: Chunk,
        cutouts: CutoutTree | None,
        hits: HitBuffers,
        threads: int,
        of_picture: bool = False,
    ) -> None:
        """Write the numbers of a chunk's nearest hits on the device."""
        self._write_numbers(tree, chunk, hits, threads)
        if of_picture:
            self.launches.launch("use_picture_t", (tree.buffers, chunk.rays, chunk.work, hits), chunk.work.n)
        if cutouts is not None:
            assert isinstance(chunk.rays, RayBuffers)
            work = self.cutouts.nearest(cutouts, tree, chunk.rays, chunk.work, hits, threads)
            self._write_numbers(self.cutouts.tree(cutouts), chunk._replace(work=work), hits, threads)

    def _write_numbers(self, tree: DeviceTree, chunk: Chunk, hits: HitBuffers, threads: int) -> None:
        """Write the numbers of hits in one tree, those that the CPU must compute included."""
        work, counts, n = chunk.work, self.launches.block("counts", 0, ""), chunk.work.n
        begin, at_once = 0, n
        while begin < n:
            k = min(at_once, n - begin)
            counts.fill()
            self.launches.launch("report_hits", (tree.buffers, chunk.rays, work, hits, begin, k), k)
            left = int(self._counts()[REST])
            if left > work.rest_capacity:
                at_once = work.rest_capacity
                continue
            if left:
                records = self._read("rest", (left, RECORD), np.float64)
                few = tree.some(settling.renumber(records))
                numbers = settling.heads_of(records)[:, settling.RAY], *settling.numbers_of(records, few, threads)
                sent = [
                    self.launches.sent(f"number {i}", np.ascontiguousarray(each), "the CPU's answers")
                    for i, each in enumerate(numbers)
                ]
                self.launches.launch("write_numbers", (hits, *sent, left), left)
            begin += k


def _samples_of(chunk: Chunk) -> SampleBuffers:
    return cast(SampleBuffers, chunk.rays)


def words_of(bits: NDArray[np.uint8], n: int, spp: int) -> NDArray[Any]:
    """(n, ceil(spp / 64)) unsigned: the bits of n receivers, spp each, that follow each other without gaps."""
    if spp in (8, 16, 32):
        return bits[: n * spp // 8].view(f"<u{spp // 8}")[:, None]
    if spp % 64 == 0:
        return bits[: n * spp // 8].view("<u8").reshape(n, -1)
    padded = np.zeros((n, 64 * -(-spp // 64)), np.uint8)
    padded[:, :spp] = np.unpackbits(bits, count=n * spp, bitorder="little").reshape(n, spp)
    return np.packbits(padded, axis=1, bitorder="little").view("<u8")
