"""The loops of workers over a ticket's items: iterators that Numba compiles to plain loops.

`parallel` exports them by name. This module imports Numba, so only the compiler imports it. A loop's state is two
numbers on the stack, which LLVM keeps in registers.
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.imputils import RefType, iternext_impl
from numba.extending import intrinsic, lower_builtin, register_model

from .parallel import CHUNK, NEXT, STOP, N

_I64 = ir.IntType(64)
_ORDER = "monotonic"  # as in `simd.atomic_add`: orders no other memory


class _Loop(types.SimpleIteratorType):  # type: ignore[name-defined, misc]
    """The type of a loop; `following` emits the code for its next value."""

    def __init__(self, name: str, value: types.Type, following: Callable[[Any, Any, Any, Any], None]) -> None:
        super().__init__(name, value)
        self.following = following


@register_model(_Loop)
class _LoopModel(models.StructModel):
    def __init__(self, dmm: Any, fe_type: _Loop) -> None:
        members = [
            ("ticket", types.CPointer(types.int64)),
            ("at", types.EphemeralPointer(types.int64)),  # the next item of this thread's share
            ("last", types.EphemeralPointer(types.int64)),  # the share's end
        ]
        super().__init__(dmm, fe_type, members)


@lower_builtin("iternext", _Loop)
@iternext_impl(RefType.UNTRACKED)
def _next(context, builder, sig, args, result):
    loop = context.make_helper(builder, sig.args[0], value=args[0])
    sig.args[0].following(context, builder, loop, result)


def _field(builder: Any, ticket: Any, field: int) -> Any:
    return builder.gep(ticket, [_I64(field)])


def _take(builder: Any, loop: Any) -> Any:
    """Take the next share, as `parallel.take` does, and write it to the loop's state. Return whether there was one."""
    ticket, has_share = loop.ticket, cgutils.alloca_once_value(builder, ir.IntType(1)(0))
    stop = builder.atomic_rmw("or", _field(builder, ticket, STOP), _I64(0), _ORDER)
    with builder.if_then(builder.icmp_signed("==", stop, _I64(0))):
        chunk, n = (builder.load(_field(builder, ticket, field)) for field in (CHUNK, N))
        first = builder.atomic_rmw("add", _field(builder, ticket, NEXT), chunk, _ORDER)
        last = builder.add(first, chunk)
        builder.store(first, loop.at)
        builder.store(builder.select(builder.icmp_signed("<", last, n), last, n), loop.last)
        builder.store(builder.icmp_signed("<", first, n), has_share)
    return builder.load(has_share)


def _next_share(context: Any, builder: Any, loop: Any, result: Any) -> None:
    has_share = _take(builder, loop)
    result.set_valid(has_share)
    with builder.if_then(has_share):
        share = [builder.load(loop.at), builder.load(loop.last)]
        result.yield_(context.make_tuple(builder, types.UniTuple(types.int64, 2), share))


def _next_item(context: Any, builder: Any, loop: Any, result: Any) -> None:
    is_valid = cgutils.alloca_once(builder, ir.IntType(1))
    has_item = builder.icmp_signed("<", builder.load(loop.at), builder.load(loop.last))
    builder.store(has_item, is_valid)
    with builder.if_then(builder.not_(has_item)):
        builder.store(_take(builder, loop), is_valid)
    result.set_valid(builder.load(is_valid))
    with builder.if_then(builder.load(is_valid)):
        item = builder.load(loop.at)
        builder.store(builder.add(item, _I64(1)), loop.at)
        result.yield_(item)


def _make(kind: _Loop) -> Callable[[Any, Any, Any, Any], Any]:
    def begin(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        loop = context.make_helper(builder, kind)
        loop.ticket = context.make_array(sig.args[0])(context, builder, args[0]).data
        loop.at = cgutils.alloca_once(builder, _I64)
        loop.last = cgutils.alloca_once(builder, _I64)
        for end in (loop.at, loop.last):
            builder.store(_I64(0), end)
        return loop._getvalue()

    return begin


@intrinsic
def shares(typingctx, ticket):
    """(first, last + 1) of each share of the items that this thread takes from a ticket."""
    kind = _Loop("shares of a ticket", types.UniTuple(types.int64, 2), _next_share)
    return kind(ticket), _make(kind)


@intrinsic
def items(typingctx, ticket):
    """Each item that this thread takes from a ticket."""
    kind = _Loop("items of a ticket", types.int64, _next_item)
    return kind(ticket), _make(kind)
