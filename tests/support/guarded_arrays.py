"""Arrays that end at a page which cannot be read: a kernel that reads or writes past one ends the process.

`install` makes NumPy allocate so, and fills new arrays, so that results which depend on uninitialised memory change.
Linux only. An array's end is aligned to 16 bytes, and its beginning is not guarded.
"""

import ctypes
import mmap
import threading

_ALIGNMENT = 16  # bytes; NumPy's own
_SET_HANDLER = 304  # place of PyDataMem_SetHandler in NumPy's table of C functions, part of its stable ABI
_FILL = 0xA5

_libc = ctypes.CDLL(None, use_errno=True)
_libc.mmap.restype = ctypes.c_void_p
_libc.mmap.argtypes = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long
_libc.munmap.argtypes = ctypes.c_void_p, ctypes.c_size_t
_libc.mprotect.argtypes = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int

_blocks: dict[int, tuple[int, int, int]] = {}  # address of an array -> its mapping, the mapping's bytes, its own bytes


def _map(size: int) -> int:
    room = -(-max(size, 1) // _ALIGNMENT) * _ALIGNMENT
    whole = -(-room // mmap.PAGESIZE) * mmap.PAGESIZE
    mapping = _libc.mmap(None, whole + mmap.PAGESIZE, 3, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS, -1, 0)
    if mapping in (None, ctypes.c_void_p(-1).value):
        return 0
    _libc.mprotect(mapping + whole, mmap.PAGESIZE, 0)
    address = mapping + whole - room
    _blocks[address] = mapping, whole + mmap.PAGESIZE, size
    return address


def _malloc(context: int | None, size: int) -> int:
    address = _map(size)
    if address:
        ctypes.memset(address, _FILL, size)
    return address


def _calloc(context: int | None, n: int, size: int) -> int:
    return _map(n * size)


def _free(context: int | None, address: int | None, size: int) -> None:
    if address:
        mapping, whole, _ = _blocks.pop(address)
        _libc.munmap(mapping, whole)


def _realloc(context: int | None, address: int | None, size: int) -> int:
    new = _malloc(context, size)
    if new and address:
        ctypes.memmove(new, address, min(size, _blocks[address][2]))
        _free(context, address, 0)
    return new


_P, _N = ctypes.c_void_p, ctypes.c_size_t
_FUNCTIONS = (
    ctypes.CFUNCTYPE(_P, _P, _N)(_malloc),
    ctypes.CFUNCTYPE(_P, _P, _N, _N)(_calloc),
    ctypes.CFUNCTYPE(_P, _P, _P, _N)(_realloc),
    ctypes.CFUNCTYPE(None, _P, _P, _N)(_free),
)


class _Handler(ctypes.Structure):
    """NumPy's PyDataMem_Handler."""

    _fields_ = [
        ("name", ctypes.c_char * 127), ("version", ctypes.c_uint8), ("context", _P),
        *((f"function{k}", _P) for k in range(4)),
    ]  # fmt: skip


_handler = _Handler(b"guarded", 1, None, *(ctypes.cast(each, _P) for each in _FUNCTIONS))


def _use() -> None:
    """Use the handler in this thread. NumPy's handler is a context variable, so new threads begin without it."""
    from numpy._core import _multiarray_umath

    capsule_pointer = ctypes.pythonapi.PyCapsule_GetPointer
    capsule_pointer.restype, capsule_pointer.argtypes = _P, (ctypes.py_object, ctypes.c_char_p)
    new_capsule = ctypes.pythonapi.PyCapsule_New
    new_capsule.restype, new_capsule.argtypes = ctypes.py_object, (_P, ctypes.c_char_p, _P)
    table = ctypes.cast(capsule_pointer(_multiarray_umath._ARRAY_API, None), ctypes.POINTER(_P))
    set_handler = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.py_object)(table[_SET_HANDLER])
    set_handler(new_capsule(ctypes.addressof(_handler), b"mem_handler", None))


def install() -> None:
    """Let all threads of this process allocate so."""
    run = threading.Thread.run

    def guarded(self: threading.Thread) -> None:
        _use()
        run(self)

    threading.Thread.run = guarded  # type: ignore[method-assign]
    _use()
