"""Trees of `bvh.ploc` that a device builds, node by node, from vertices on the device (`ploc_kernels`)."""

import numpy as np

from ...bvh.nodes import MAX_DEPTH
from ...bvh.ploc import TOP_ROUNDS
from ...bvh.top_down import largest_subtree
from ...bvh.triangle_bounds import area_scale_for
from ...devices.device import DeviceMemory
from .build_kernels import Source
from .device_launches import DeviceLaunches
from .ploc_kernels import CLUSTER, NODES, ActiveBuffers, ClusterBuffers
from .tree_build import MAX_LEAF, BuiltTree, add_up, join_all, refuse_faults, sort_by_codes, strips_of

_WHAT = "the clusters of triangles"
_ROUNDS = MAX_DEPTH - TOP_ROUNDS  # of a range


class PlocTree(BuiltTree):
    """The tree of `bvh.ploc`, of two triangles or more, built on the device. The parameters are those of `LbvhTree`."""

    def __init__(self, source: Source, launches: DeviceLaunches, max_leaf: int = MAX_LEAF) -> None:
        n, launch, block = source.n, launches.launch, launches.block
        codes, faces, _ = sort_by_codes(launches, source, max_leaf)
        refuse_faults(launches)
        self._numbers = launches.device.allocate(8 * n, "the numbers of the nodes")
        clusters = _clusters_of(source, faces, self._numbers, min(max_leaf, n - 1), launches)
        self._rounds: list[tuple[int, int]] = []  # the first of each round's new clusters, and the end
        ranges, firsts = _ranges_of(codes, n, launches)
        spare = _active(launches, "spare", n, ranges.n_ranges)
        roots, spare = self._cluster(clusters, ranges, spare, _ROUNDS, launches)
        launch("seat_roots", (roots, firsts, clusters), roots.n)
        in_ranges = len(self._rounds)
        if roots.n > 1:
            roots = roots._replace(n_ranges=1)
            launch("begin_roots", (roots,), roots.n)
            self._cluster(clusters._replace(max_leaf=0), roots, spare._replace(n_ranges=1), TOP_ROUNDS, launches)
        words = block("words of clusters", 0, "")
        n_nodes = int(words.read(np.empty(1, np.int32), offset=4 * (CLUSTER * (2 * n - 2) + NODES))[0])
        self._allocate(launches, n, n_nodes)
        self._numbers.fill(0xFF)
        self._numbers.fill(0, 4 * (2 * n - 2), 4)
        for k in range(len(self._rounds) - 1, -1, -1):
            first, end = self._rounds[k]
            of_round = clusters if k < in_ranges else clusters._replace(max_leaf=0)
            launch("place_children", (of_round, first, end - first, self.nodes.address), end - first)
        seated = block("seated faces", 4 * n, _WHAT).address
        launch("seat_triangles", (clusters, faces, seated), n)
        self._fill((seated, 1), source.vertices)

    def _cluster(
        self,
        clusters: ClusterBuffers,
        active: ActiveBuffers,
        spare: ActiveBuffers,
        rounds: int,
        launches: DeviceLaunches,
    ) -> tuple[ActiveBuffers, ActiveBuffers]:
        """Merge the active clusters of each range, in at most `rounds` rounds.

        spare : memory for as many others

        Return the roots of the ranges, and the other memory.
        """
        launch, next_id = launches.launch, self._rounds[-1][1] if self._rounds else clusters.n
        merges, stays = (launches.block(name, 4 * (active.n + 1), _WHAT) for name in ("merges", "stays"))
        for further in range(rounds - 1, -1, -1):
            m = active.n
            if m == active.n_ranges:
                break
            launch("find_nearest", (active, clusters, further), m)
            launch("tag_merges", (active, merges.address, stays.address), m + 1)
            add_up(launches, merges.address, m + 1)
            add_up(launches, stays.address, m + 1)
            launch("merge_pairs", (active, clusters, merges.address, stays.address, next_id, spare), m + 1)
            merged = int(merges.read(np.empty(1, np.int32), offset=4 * m)[0])
            self._rounds.append((next_id, next_id + merged))
            next_id += merged
            active, spare = spare._replace(n=m - merged), active
        return active, spare

    def _refit(self, source: "BuiltTree", vertices: int) -> None:
        self.launches.launch("copy_links", (source.nodes.address, self.n_nodes, self.nodes.address), self.n_nodes)
        self._fill(source.faces, vertices)

    def _fill(self, faces: tuple[int, int], vertices: int) -> None:
        """Write the triangles, and the boxes of all nodes, whose links are there."""
        launch, tree = self.launches.launch, self.buffers
        launch("write_triangles", (tree, *faces, vertices, self.n), self.n)
        for first, end in self._rounds:
            launch("refit_nodes", (tree, self._numbers.address, first, end - first), end - first)
        self._filled()


def _active(launches: DeviceLaunches, name: str, n: int, n_ranges: int) -> ActiveBuffers:
    """Memory for n active clusters."""
    ids, ranges, begins, offsets = (
        launches.block(f"{name} {field}", 4 * size, _WHAT).address
        for field, size in (("ids", n), ("ranges", n), ("begins", n_ranges + 1), ("offsets", n))
    )
    return ActiveBuffers(ids, ranges, begins, offsets, n, n_ranges)


def _ranges_of(codes: int, n: int, launches: DeviceLaunches) -> tuple[ActiveBuffers, int]:
    """(a cluster for each triangle, in the ranges that the CPU clusters, the address of their first slots)."""
    tags = launches.block("stays", 4 * (n + 1), _WHAT)
    tags.fill(0, 0, 4 * (n + 1))
    launches.launch("cut_ranges", (codes, n, largest_subtree(n), tags.address), n)
    add_up(launches, tags.address, n + 1)
    count = int(tags.read(np.empty(1, np.int32), offset=4 * n)[0])
    active = _active(launches, "active", n, count)
    firsts = launches.block("firsts", 4 * (count + 1), _WHAT).address
    for begins in firsts, active.begins:
        launches.launch("begin_ranges", (tags.address, active._replace(begins=begins)), n + 1)
    return active, firsts


def _clusters_of(
    source: Source, faces: int, numbers: DeviceMemory, max_leaf: int, launches: DeviceLaunches
) -> ClusterBuffers:
    """A cluster for each triangle, and memory for all others. The host sees the box of all triangles."""
    n, block = source.n, launches.block
    boxes, words, costs, slots = (
        block(f"{name} of clusters", 2 * size * n, _WHAT).address
        for name, size in (("boxes", 32), ("words", 4 * CLUSTER), ("costs", 4), ("slots", 4))
    )
    clusters = ClusterBuffers(boxes, words, costs, slots, numbers.address, n, max_leaf, np.float32(1.0))
    launches.launch("begin_clusters", (source.vertices, faces, clusters), n)
    strips, joined = strips_of(n, launches)
    launches.launch("join_strips", (boxes, n, joined, strips), strips)
    return clusters._replace(scale=area_scale_for(join_all(joined, strips, launches)))
