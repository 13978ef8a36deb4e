"""Loads and stores of vectors and scalars: arrays, raw pointers, memory on the stack. Bounds are not checked.

`a` is a C-contiguous array of any number of dimensions, or a pointer from `ptr`, `ptr_at`, `as_f32`, `as_i32` or
`stack_*`. `i` is the flat index of an element. A negative `i` does not wrap around, but is an address before the first
element.
"""

from math import prod
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from ..machine_code import name_of_store_compressed
from .vectors import I32, I64, Vector, call_llvm, llvm_type, reject, repeat

_STACK_ALIGNMENT = 64  # bytes: one cache line, one AVX-512 register


def _check(function: str, a: Any, i: Any = types.int64, writes: bool = False) -> None:
    """Reject arguments other than (array or pointer, integer)."""
    if isinstance(a, types.Array):
        if a.layout != "C":
            reject(function, a, cure="pass a C-contiguous array (numpy.ascontiguousarray)")
        if writes and not a.mutable:
            reject(function, a, cure="the array is read-only: pass a writeable one")
    elif not isinstance(a, types.CPointer):
        reject(function, a, cure="the first argument must be an array or a pointer")
    if not isinstance(i, types.Integer):
        reject(function, a, i, cure="the index must be an integer")


def _first(context: Any, builder: Any, a: Any, value: Any) -> Any:
    """Pointer to the first element."""
    return context.make_array(a)(context, builder, value).data if isinstance(a, types.Array) else value


def _address(context: Any, builder: Any, sig: Any, values: Any) -> Any:
    """Pointer to element `i`. The signature starts with (a, i)."""
    index = context.cast(builder, values[1], sig.args[1], types.int64)
    return builder.gep(_first(context, builder, sig.args[0], values[0]), [index])


def _vector_of(function: str, a: Any, lanes: int, *more: types.Type) -> Vector:
    """The vector type with the element type of `a`: float32, int32 or one of `more`."""
    if a.dtype not in (types.float32, types.int32, *more):
        reject(function, a, cure="elements must be float32 or int32 (as_i32 or as_f32 reads others' bits)")
    return Vector(a.dtype, lanes)


def _make_load(lanes: int) -> Any:
    @intrinsic
    def load(typingctx, a, i):
        """Elements i, i + 1, ... of `a`, one per lane; any alignment."""
        _check(f"load{lanes}", a, i)
        vector = _vector_of(f"load{lanes}", a, lanes, types.float64)

        def codegen(context, builder, sig, values):
            pointer = _address(context, builder, sig, values)
            return builder.load(builder.bitcast(pointer, llvm_type(vector).as_pointer()), align=4)

        return vector(a, i), codegen

    return load


def _make_broadcast(lanes: int) -> Any:
    @intrinsic
    def broadcast(typingctx, a, i):
        """Element i of `a` in every lane."""
        _check(f"broadcast{lanes}", a, i)
        vector = _vector_of(f"broadcast{lanes}", a, lanes, types.float64)

        def codegen(context, builder, sig, values):
            return repeat(builder, builder.load(_address(context, builder, sig, values)), lanes)

        return vector(a, i), codegen

    return broadcast


load4, load8, load16 = (_make_load(lanes) for lanes in (4, 8, 16))
broadcast4, broadcast8, broadcast16 = (_make_broadcast(lanes) for lanes in (4, 8, 16))


@intrinsic
def load16x3(typingctx, a, i):
    """Three vectors of 16 lanes from 48 elements: lane l of vector k is element i + 3 l + k of `a`; any alignment."""
    _check("load16x3", a, i)
    vector = _vector_of("load16x3", a, 16, types.float64)

    def codegen(context, builder, sig, values):
        row = ir.VectorType(context.get_data_type(a.dtype), 48)
        elements = builder.load(builder.bitcast(_address(context, builder, sig, values), row.as_pointer()), align=4)
        lanes = ir.VectorType(ir.IntType(32), 16)
        columns = [
            builder.shuffle_vector(
                elements, ir.Constant(row, ir.Undefined), ir.Constant(lanes, [3 * lane + k for lane in range(16)])
            )
            for k in range(3)
        ]
        return context.make_tuple(builder, sig.return_type, columns)

    return types.UniTuple(vector, 3)(a, i), codegen


@intrinsic
def load8x3_pair(typingctx, a, i, j):
    """Three vectors of 16 lanes from two runs of 24 elements, which begin at elements i and j of `a`; any alignment.

    Lane l of vector k is element i + 3 l + k for the first eight lanes, and element j + 3 (l - 8) + k for the others.
    """
    _check("load8x3_pair", a, i)
    _check("load8x3_pair", a, j)
    vector = _vector_of("load8x3_pair", a, 16, types.float64)

    def codegen(context, builder, sig, values):
        eight = ir.VectorType(context.get_data_type(a.dtype), 8)

        def eight_of(run, n):  # elements 8 n to 8 n + 7 of a run
            address = _address(context, builder, types.void(a, sig.args[run]), (values[0], values[run]))
            pointer = builder.bitcast(builder.gep(address, [I64(8 * n)]), eight.as_pointer())
            return builder.load(pointer, align=4)

        def shuffled(v, w, lanes):  # the lanes of the first run; those of the second are eight further
            order = ir.Constant(ir.VectorType(I32, 16), [*lanes, *(lane + 8 for lane in lanes)])
            return builder.shuffle_vector(v, w, order)

        parts = [shuffled(eight_of(1, n), eight_of(2, n), range(8)) for n in range(3)]
        columns = []
        for k in range(3):
            places = [3 * lane + k for lane in range(8)]  # in a run, from which a third shuffle takes those from 16 on
            first = shuffled(parts[0], parts[1], [place % 8 + 16 * (place // 8 % 2) for place in places])
            lanes = [lane if place < 16 else 16 + place % 8 for lane, place in enumerate(places)]
            columns.append(shuffled(first, parts[2], lanes))
        return context.make_tuple(builder, sig.return_type, columns)

    return types.UniTuple(vector, 3)(a, i, j), codegen


@intrinsic
def gather(typingctx, a, i):
    """Elements of `a` at the i32 indices `i`, one per lane. All lanes are loaded."""
    _check("gather", a)
    if not (isinstance(i, Vector) and i.element == types.int32):
        reject("gather", a, i, cure="the indices must be a vector of int32")
    vector = _vector_of("gather", a, i.lanes)

    def codegen(context, builder, sig, values):
        element = context.get_data_type(a.dtype)
        wide = ir.VectorType(ir.IntType(64), i.lanes)
        base = builder.ptrtoint(_first(context, builder, a, values[0]), ir.IntType(64))
        step = builder.mul(builder.sext(values[1], wide), ir.Constant(wide, [4] * i.lanes))
        pointers = builder.inttoptr(
            builder.add(repeat(builder, base, i.lanes), step), ir.VectorType(element.as_pointer(), i.lanes)
        )
        everyone = ir.Constant(ir.VectorType(ir.IntType(1), i.lanes), [1] * i.lanes)
        args = [pointers, I32(4), everyone, ir.Constant(llvm_type(vector), ir.Undefined)]
        return call_llvm(builder, f"llvm.masked.gather.{vector.suffix}.v{i.lanes}p0", llvm_type(vector), args)

    return vector(a, i), codegen


@intrinsic
def store(typingctx, a, i, v):
    """Write the lanes of `v` to elements i, i + 1, ... of `a`; any alignment."""
    _check("store", a, i, writes=True)
    if not isinstance(v, Vector) or v.element != a.dtype:
        reject("store", a, i, v, cure="the value must be a vector of the array's own element type, f32 or i32")

    def codegen(context, builder, sig, values):
        pointer = _address(context, builder, sig, values)
        builder.store(values[2], builder.bitcast(pointer, llvm_type(v).as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(a, i, v), codegen


@intrinsic
def store_compressed(typingctx, a, i, mask, v):
    """Write the lanes of `v` where the mask is set to elements i, i + 1, ... of `a`, in order; any alignment.

    The elements after them, up to as many as `v` has lanes, are unspecified.
    """
    _check("store_compressed", a, i, writes=True)
    if not isinstance(v, Vector) or v.element != a.dtype or mask != Vector(types.boolean, v.lanes):
        reject("store_compressed", a, i, mask, v, cure="needs a mask, and a vector of the array's own element type")
    if v.lanes == 4:
        reject("store_compressed", a, i, mask, v, cure="needs 8 or 16 lanes")
    lanes, name = ir.VectorType(I32, v.lanes), name_of_store_compressed(v.lanes)

    def codegen(context, builder, sig, values):
        pointer = builder.bitcast(_address(context, builder, sig, values), lanes.as_pointer())
        args = [pointer, values[2], builder.bitcast(values[3], lanes)]
        call_llvm(builder, name, ir.VoidType(), args)
        return context.get_dummy_value()

    return types.void(a, i, mask, v), codegen


@intrinsic
def get(typingctx, p, i):
    """Element i of `p`, a scalar; a signed integer as int64. Unlike ``p[i]``, it does not test for a negative index."""
    _check("get", p, i)
    result = types.int64 if isinstance(p.dtype, types.Integer) and p.dtype.signed else p.dtype

    def codegen(context, builder, sig, values):
        value = context.unpack_value(builder, p.dtype, _address(context, builder, sig, values))
        return context.cast(builder, value, p.dtype, result)

    return result(p, i), codegen


@intrinsic
def put(typingctx, p, i, x):
    """Write the scalar `x`, converted to the element type, to element i of `p`."""
    _check("put", p, i, writes=True)
    if not isinstance(x, (types.Number, types.Boolean)):
        reject("put", p, i, x, cure="the value must be a number")

    def codegen(context, builder, sig, values):
        value = context.cast(builder, values[2], x, p.dtype)
        context.pack_value(builder, p.dtype, value, _address(context, builder, sig, values))
        return context.get_dummy_value()

    return types.void(p, i, x), codegen


@intrinsic
def ptr(typingctx, array):
    """Pointer to the first element; does not keep the array alive."""
    _check("ptr", array)

    def codegen(context, builder, sig, values):
        return _first(context, builder, array, values[0])

    return types.CPointer(array.dtype)(array), codegen


@intrinsic
def ptr_at(typingctx, a, i):
    """Pointer to element i; does not keep the array alive."""
    _check("ptr_at", a, i)
    return types.CPointer(a.dtype)(a, i), _address


def _make_cast(name: str, element: types.Type) -> Any:
    @intrinsic
    def cast(typingctx, p):
        """The same address as a pointer to another element type."""
        _check(name, p)

        def codegen(context, builder, sig, values):
            pointer = context.get_data_type(element).as_pointer()
            return builder.bitcast(_first(context, builder, p, values[0]), pointer)

        return types.CPointer(element)(p), codegen

    return cast


def _make_address(name: str, element: types.Type) -> Any:
    @intrinsic
    def at_address(typingctx, address):
        """Pointer to an address, which is an integer such as ``array.ctypes.data``."""
        if not isinstance(address, types.Integer):
            reject(name, address, cure="needs an integer")

        def codegen(context, builder, sig, values):
            wide = context.cast(builder, values[0], address, types.int64)
            return builder.inttoptr(wide, context.get_data_type(element).as_pointer())

        return types.CPointer(element)(address), codegen

    return at_address


f32_at = _make_address("f32_at", types.float32)
f64_at = _make_address("f64_at", types.float64)
i32_at = _make_address("i32_at", types.int32)
as_f32 = _make_cast("as_f32", types.float32)
as_i32 = _make_cast("as_i32", types.int32)


def _make_stack(name: str, element: types.Type) -> Any:
    @intrinsic(prefer_literal=True)
    def stack(typingctx, n):
        """`n` elements (a literal or a module constant) on this function's stack, aligned to 64 bytes."""
        if not isinstance(n, types.IntegerLiteral) or n.literal_value < 1:
            reject(name, n, cure="the size must be a positive literal or a module-level constant")

        def codegen(context, builder, sig, values):
            # Not cgutils.alloca_once, which clears the memory on every entry to the function.
            with builder.goto_entry_block():
                memory = builder.alloca(ir.ArrayType(context.get_data_type(element), n.literal_value), name=name)
            memory.align = _STACK_ALIGNMENT
            return builder.bitcast(memory, context.get_data_type(element).as_pointer())

        return types.CPointer(element)(n), codegen

    return stack


stack_f32 = _make_stack("stack_f32", types.float32)
stack_f64 = _make_stack("stack_f64", types.float64)
stack_i32 = _make_stack("stack_i32", types.int32)
stack_i64 = _make_stack("stack_i64", types.int64)


@intrinsic(prefer_literal=True)
def stack_array(typingctx, dtype, n, m=None):
    """An array of shape (n,) or (n, m) on this function's stack, aligned to 64 bytes, not cleared.

    `dtype` is a NumPy scalar type such as ``np.int64``; `n` and `m` are literals or module constants.
    """
    shape = (n,) if m is None else (n, m)
    if not isinstance(dtype, types.NumberClass) or not all(isinstance(k, types.IntegerLiteral) for k in shape):
        reject("stack_array", dtype, *shape, cure="needs a NumPy scalar type and literals or module constants")
    array = types.Array(dtype.instance_type, len(shape), "C")

    def codegen(context, builder, sig, values):
        element = context.get_data_type(array.dtype)
        sizes = [k.literal_value for k in shape]
        with builder.goto_entry_block():
            memory = builder.alloca(ir.ArrayType(element, prod(sizes)), name="stack_array")
        memory.align = _STACK_ALIGNMENT
        itemsize = context.get_abi_sizeof(element)
        result = context.make_array(array)(context, builder)
        populate_array(
            result,
            data=builder.bitcast(memory, element.as_pointer()),
            shape=[I64(k) for k in sizes],
            strides=[I64(itemsize * prod(sizes[i + 1 :])) for i in range(len(sizes))],
            itemsize=I64(itemsize),
            meminfo=None,
        )
        return result._getvalue()

    return array(dtype, n, types.Omitted(None) if m is None else m), codegen


@intrinsic
def prefetch(typingctx, p, i):
    """Prefetch the cache line of element i. Any address is allowed, even outside the array."""
    _check("prefetch", p, i)

    def codegen(context, builder, sig, values):
        pointer = builder.bitcast(_address(context, builder, sig, values), ir.IntType(8).as_pointer())
        read, keep_in_all_levels, data = I32(0), I32(3), I32(1)
        call_llvm(builder, "llvm.prefetch.p0", ir.VoidType(), [pointer, read, keep_in_all_levels, data])
        return context.get_dummy_value()

    return types.void(p, i), codegen


def _make_atomic(name: str, operation: str, element: Any) -> Any:
    @intrinsic
    def atomic(typingctx, a, i, x):
        _check(name, a, i, writes=True)
        if a.dtype != element or not isinstance(x, types.Integer):
            reject(name, a, i, x, cure=f"needs an {element} array or pointer, an index and an integer")

        def codegen(context, builder, sig, values):
            amount = context.cast(builder, values[2], x, element)
            return builder.atomic_rmw(operation, _address(context, builder, sig, values), amount, "monotonic")

        return element(a, i, x), codegen

    return atomic


atomic_add = _make_atomic("atomic_add", "add", types.int64)
atomic_or = _make_atomic("atomic_or", "or", types.int32)
atomic_and = _make_atomic("atomic_and", "and", types.int32)
"""Atomic update of element i by `x`: `atomic_add` of an int64 array, `atomic_or` and `atomic_and` of an int32 array.

They return the element's old value. They order no other memory accesses: other threads may see earlier writes late.
"""
