"""Shadow queries by hierarchies of their rays [Olsson and Assarsson 2011, Sec. 3.1].

Receivers and lights form beams (`beams`). The receivers of a beam are sorted (`order`), and become leaves (`rays`) of a
hierarchy (`tree`). The triangles traverse the hierarchy (`traverse`), and blocked segments are returned as bits.
"""

import numpy as np

from ..bvh.lbvh import by_codes
from ..kernels.parallel import thread_count
from ..query.shadow_query import with_receivers
from ..scene.lights import FIXED, LIST
from ..trace.counters import new_counters
from .beams import AROUND, PERSPECTIVE, Beam, beams_of
from .blocks import rays_by_blocks
from .boxes import Boxes
from .memory import Empty, borrowed
from .occluders import FINISHED, occluders_first
from .options import Options
from .order import order_of
from .packed import left_of, rays_of
from .rays import finished, write_bits
from .soup import Soup
from .traverse import PAIRS, How
from .tree import tree_of
from .wide import Traced, may_be_wide, trace_wide, traverse

SEGMENTS = 1 << 22
"""Maximum number of segments with their own ends in memory at once."""


def trace_shadow(soup: Soup, query, bits, threads, counters, progress, options: Options) -> None:
    """Answer a ShadowQuery by the triangles of a soup: set bit s of ``bits[y, x]`` where sample s is occluded.

    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    progress : function of (triangles handed out, triangles), or None; only the last part of a query counts
    """
    threads = thread_count(threads)
    counters = new_counters() if counters is None else counters
    for part, of_part in _parts(query, bits):
        for beam in beams_of(part, not options.shared, threads):
            with borrowed() as empty:
                _trace_beam(soup, part, beam, of_part, threads, counters, progress, options, empty)


def _parts(query, bits):
    """Cut a query into parts whose segments fit in memory: bands of rows, or pieces of a single row."""
    (h, w), spp = query.sides.shape, query.samples.shape[1]
    most = max(SEGMENTS // spp, 1)
    if (query.light.kind in (FIXED, LIST) and spp == 1) or h * w <= most:
        return [(query, bits)]
    if h == 1:
        step = -(-most // 4) * 4  # sample sets repeat every four pixels of a row
        cuts = [(slice(None), slice(i, i + step)) for i in range(0, w, step)]
    else:
        step = max(most // (4 * w), 1) * 4
        cuts = [(slice(i, i + step), slice(None)) for i in range(0, h, step)]
    return [(with_receivers(query, lambda array, cut=cut: array[cut]), bits[cut]) for cut in cuts]


def _trace_beam(soup, query, beam: Beam, bits, threads, counters, progress, options: Options, empty: Empty) -> None:
    """Trace the segments of one beam."""
    # Boxes have a hierarchy for each face. AROUND receivers keep screen order: screen neighbours are near each other.
    coherent = beam.kind != AROUND
    sort = ((options.sorted or options.blocks) and coherent) or (options.nodes is None and beam.kind == PERSPECTIVE)
    if options.blocks and coherent and query.sides.shape[0] > 1:
        rays = rays_by_blocks(query, beam, bits, threads, counters, empty)
    else:
        order = order_of(query, beam, bits, sort, threads, counters)
        rays = rays_of(query, beam, order, 16 if options.wide or options.blocks else 4, bits, threads, empty)
    if not len(rays.blocks):
        return
    kind = (beam.kind == PERSPECTIVE and options.nodes) or Boxes
    how = How(options.spheres, options.early_accept, query.cull_faces, options.backface, PAIRS)
    passes = occluders_first(soup, beam, threads) if options.two_pass else [_picks(soup, threads, options)]
    tree = tree_of(kind, beam, rays, threads, empty)
    for k, picks in enumerate(passes):
        if k > 0 and finished(rays) >= FINISHED:
            rays = left_of(query, beam, rays, bits, threads, empty)
            tree = tree_of(kind, beam, rays, threads, empty)
        traced = Traced(soup, query, beam, how, threads, counters, progress)
        if options.shafts and may_be_wide(traced, len(picks)):
            picks = trace_wide(traced, rays, tree, picks, bits, empty)
        if len(picks):
            traverse(traced, tree, rays, picks)
        write_bits(rays, bits, threads)


def _picks(soup: Soup, threads: int, options: Options) -> np.ndarray:
    """All triangles, in traversal order."""
    if options.clustered and len(soup.corners):
        return by_codes(soup.corners, 10, threads)[1]
    return np.arange(len(soup.corners), dtype=np.int32)
