"""Bundles: the single rays of a cell, 16 at a time, as occlusion queries and tracers load them.

A *source* holds the rays of a screen: `passes.PassRays`, `camera.CameraBundles` or `segments.SegmentBundles`. Each kind
of source gives `load_bundle` and `bundles_in` a meaning in kernels.
"""

from typing import NamedTuple

from ..kernels.fields import F32Ptr
from ..kernels.jit import inlined, overloaded
from ..kernels.simd import ptr_at
from ..kernels.vec import rows
from ..trace.descent import rays_as_shafts, slabs_of

BUNDLE_FLOATS = 128


class Bundle(NamedTuple):
    """16 rays: pointers to BUNDLE_FLOATS float32 of scratch memory."""

    rays: F32Ptr  # rows ox oy oz, and the whole length of the rays along x, y and z
    lengths: F32Ptr  # this multiple of its direction takes a ray to its end
    limits: F32Ptr  # how far each ray looks, as a share of its whole length; -1: there is no ray


@inlined
def bundle_in(memory):
    """The `Bundle` in BUNDLE_FLOATS float32."""
    return Bundle(memory, ptr_at(memory, 96), ptr_at(memory, 112))


@inlined
def slabs_in(bundle, live):
    """The rays of a bundle, prepared for slab tests; `live`: bits of its rays."""
    return slabs_of(rays_as_shafts(rows(bundle.rays, 0, 16), rows(bundle.rays, 48, 16)), live)


@overloaded("ray_bundles")
def bundles_in(source):
    """In kernels: the number of bundles of each cell."""


@overloaded("ray_bundles")
def load_bundle(source, picture, y0, x0, s, k, blind, bundle):
    """In kernels: fill bundle k of a cell, in ray set s. Return bits of the rays that look.

    y0, x0 : the first receiver of the cell
    blind : also load rays that are blocked
    """
