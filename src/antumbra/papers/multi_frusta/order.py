"""The order of children in multi-frusta tracing: the nearer child first [Benthin and Wald 2009, Appendix A]."""

from ...bvh.links import link_at
from ...kernels.jit import inlined
from ...kernels.simd import bits, popcount
from ...trace.descent import entered_first


@inlined
def prefers_right(near_left, near_right, both):
    """How many more lanes of `both` (bits) enter the right child's box first than do not.

    near_left, near_right : f32x16, entry t of the children's boxes
    """
    return 2 * popcount(bits(near_right < near_left) & both) - popcount(both)


@inlined
def entered_nearer(links, at, in_left, in_right, turn, stack):
    """Go to the left child first, or to the right one if `turn`, and push the other. in_...: bits of who meets each."""
    if turn:
        return entered_first(links, at, link_at(at.link, 1), in_right, in_left, stack)
    return entered_first(links, at, link_at(at.link, 0), in_left, in_right, stack)
