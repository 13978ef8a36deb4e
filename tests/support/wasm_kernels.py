"""Tests over kernels in WebAssembly: ``ANTUMBRA_TEST_KERNELS=wasm32 pytest tests/trace``.

The module that releases ship runs in wasmtime. Its memory lies at a multiple of 4 GiB in this process, and NumPy
allocates arrays in it, in all threads, so the low half of an array's address is its address in WebAssembly. Arrays
elsewhere, such as mapped files, are copied in and out; unpickled ones are copied in when they are read. Each thread has
an instance of its own over the same memory, with its own stack.

Kernels that find an array by an address alone need one that lies in this memory. Textures do not, so tests of them in
`tests/picture` fail here.
"""

import copyreg
import ctypes
import mmap
import os
import subprocess
import sys
import tempfile
import threading
import weakref
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

NAME = "wasm32"
SETTING = "ANTUMBRA_TEST_KERNELS"
FOLDER = "ANTUMBRA_TEST_KERNELS_BUILT"  # where the first process built the module for the others

_BASE, _SIZE = 1 << 37, 4 << 30  # the address of WebAssembly's memory, and its size in bytes
_RESERVED = 12 << 30  # what wasmtime's code relies on: addresses beyond the memory trap
_HEAP = 64 << 20  # where NumPy's arrays begin; constants and the first stack lie below
_WORDS = 1 << 17  # bytes for a call's arguments
_PROT_NONE, _READ_WRITE = 0, 3
_MAP = 0x02 | 0x20 | 0x4000 | 0x100000  # private, anonymous, unreserved, and nothing else is replaced


class _Array(NamedTuple):
    """Where an array is in a kernel's words."""

    word: int
    dimensions: int
    itemsize: int


@cache
def _arrays_in(key: str) -> tuple[_Array, ...]:
    from antumbra.kernels.marshalling import SCALARS, array_parts, is_array

    word, found = 0, []
    for token in key.split():
        if is_array(token):
            dtype, dimensions = array_parts(token)[:2]
            found.append(_Array(word, dimensions, np.dtype(dtype).itemsize))
            word += 1 + 2 * dimensions
        elif token in SCALARS:
            word += 1
    return tuple(found)


def _reserve() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    libc.mmap.restype = ctypes.c_void_p
    libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long]
    if libc.mmap(_BASE, _RESERVED, _PROT_NONE, _MAP, -1, 0) != _BASE:
        raise OSError("the addresses of WebAssembly's memory are taken")
    libc.mprotect(ctypes.c_void_p(_BASE), ctypes.c_size_t(_SIZE), _READ_WRITE)


class _NumpyHeap:
    """NumPy's allocator in WebAssembly's memory."""

    def __init__(self, folder: Path) -> None:
        library = folder / "heap.so"
        if not library.exists():
            source = Path(__file__).with_name("wasm_heap.c")
            part = folder / f"heap{os.getpid()}.so"
            command = [sys.executable, "-m", "ziglang", "cc", "-O2", "-shared", "-fPIC", "-o", str(part), str(source)]
            subprocess.run(command, check=True)
            part.replace(library)
        self._library = ctypes.CDLL(str(library))
        self._library.heap_start(ctypes.c_void_p(_BASE + _HEAP), ctypes.c_void_p(_BASE + _SIZE))
        api = ctypes.pythonapi
        api.PyCapsule_GetPointer.restype = ctypes.c_void_p
        api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
        api.PyCapsule_New.restype = ctypes.py_object
        api.PyCapsule_New.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
        functions = api.PyCapsule_GetPointer(np._core._multiarray_umath._ARRAY_API, None)  # type: ignore[attr-defined]
        place = ctypes.cast(functions + 8 * 304, ctypes.POINTER(ctypes.c_void_p))[0]  # PyDataMem_SetHandler
        self._set_handler = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.py_object)(place)
        handler = ctypes.addressof(ctypes.c_char.in_dll(self._library, "handler"))
        self._capsule = api.PyCapsule_New(handler, b"mem_handler", None)

    def use(self) -> None:
        """Let NumPy allocate here in this thread's context."""
        self._set_handler(self._capsule)


class _Instance(NamedTuple):
    """The module in one thread."""

    store: Any
    exports: Any
    words: np.ndarray  # bytes for arguments and results


class WasmKernels:
    """The module of a folder, and what tests called in it."""

    def __init__(self, folder: Path) -> None:
        import wasmtime
        from wasmtime import _bindings as api

        from antumbra.kernels.processor import library_path
        from antumbra.kernels.toolchain.kernel_library import LibraryList

        _reserve()
        self.heap = _NumpyHeap(folder)
        self.heap.use()
        self.kernels = LibraryList.read(folder).kernels
        self.called, self.native = set[str](), set[str]()
        config = wasmtime.Config()
        self._callbacks = _memory_creator(api)
        api.wasmtime_config_host_memory_creator_set(config.ptr(), ctypes.byref(self._callbacks[0]))
        self._engine = wasmtime.Engine(config)
        self._module = wasmtime.Module.from_file(self._engine, str(library_path(folder, "simd128", ".wasm")))
        pages = _SIZE >> 16
        self._memory = wasmtime.Module(self._engine, f'(module (memory (export "memory") {pages} {pages}))')
        self._open: list[Any] = [self._memory, self._module, self._engine]
        self._local, self._lock = threading.local(), threading.Lock()

    def close(self) -> None:
        """Free wasmtime's objects, which cannot free themselves when the process ends."""
        for each in self._open:
            each.close()

    def _instance(self) -> _Instance:
        """This thread's instance."""
        import wasmtime

        found = getattr(self._local, "instance", None)
        if found is None:
            from antumbra.kernels.toolchain.library_build import WASM_STACK

            self.heap.use()
            store = wasmtime.Store(self._engine)
            self._open.insert(0, store)
            memory = wasmtime.Instance(store, self._memory, []).exports(store)["memory"]
            assert ctypes.addressof(memory.data_ptr(store).contents) == _BASE
            with self._lock:  # constants are written again
                exports = wasmtime.Instance(store, self._module, [memory]).exports(store)
            stack = np.empty(WASM_STACK + _WORDS, np.uint8)
            exports["__stack_pointer"].set_value(store, wasmtime.Val.i32(_signed(stack.ctypes.data + WASM_STACK)))
            found = self._local.instance = _Instance(store, exports, stack[WASM_STACK:])
        return found

    def find(self, function: Any, key: str, native: Callable[..., Any]) -> Callable[[bytes], Any]:
        """In the place of `kernel_loading.find`: a function of packed arguments."""
        from antumbra.kernels.toolchain.kernel_library import callable_of, name_of

        entry = self.kernels.get(name_of(function.name, key))
        if entry is None:
            self.native.add(function.name)
            return native(function, key)
        self.called.add(function.name)
        arrays, symbol = _arrays_in(key), entry.symbol

        def run(words: bytes, result: Any) -> int:
            return self._run(symbol, arrays, words, result)

        return callable_of(run, entry.result, function.name)

    def _run(self, symbol: str, arrays: tuple[_Array, ...], words: bytes, result: Any) -> int:
        instance = self._instance()
        area, size = instance.words, len(words)
        out = area[size : size + len(result)]
        area[:size] = np.frombuffer(words, np.uint8)
        copies = [copy for each in arrays if (copy := _copied_in(area[:size].view(np.int64), each))]
        address = area.ctypes.data
        status = instance.exports[symbol](instance.store, _signed(address), _signed(address + size))
        for copy in copies:
            copy.write_back()
        ctypes.memmove(result, out.ctypes.data, len(result))
        return int(status)


class _Copy(NamedTuple):
    """The bytes of an array that lies elsewhere, in WebAssembly's memory."""

    address: int
    inside: np.ndarray
    before: bytes

    def write_back(self) -> None:
        """Write the bytes that the kernel changed, and no others: several threads may write parts of an array."""
        changed = np.flatnonzero(self.inside != np.frombuffer(self.before, np.uint8))
        if len(changed):
            there = np.frombuffer((ctypes.c_uint8 * len(self.inside)).from_address(self.address), np.uint8)
            there[changed] = self.inside[changed]


def _copied_in(words: np.ndarray, array: _Array) -> _Copy | None:
    """Copy an array that lies elsewhere, and let its word point to the copy."""
    address = int(words[array.word])
    if _is_inside(address):
        return None
    shape, strides = np.split(words[array.word + 1 : array.word + 1 + 2 * array.dimensions], 2)
    if not shape.all():
        return None
    low = address + int(((shape - 1) * np.minimum(strides, 0)).sum())
    inside = np.empty(int(((shape - 1) * np.abs(strides)).sum()) + array.itemsize, np.uint8)
    ctypes.memmove(inside.ctypes.data, low, len(inside))
    words[array.word] += inside.ctypes.data - low
    return _Copy(low, inside, inside.tobytes())


def _is_inside(address: int) -> bool:
    return _BASE <= address < _BASE + _SIZE


def _signed(address: int) -> int:
    """The address in WebAssembly, as an i32."""
    low = address & 0xFFFFFFFF
    return low - (1 << 32) if low >> 31 else low


def _memory_creator(api: Any) -> tuple[Any, ...]:
    """wasmtime's functions that create memory; all memories are the one at `_BASE`."""

    @api.wasmtime_memory_get_callback_t
    def get(environment, size, maximum):
        size[0] = maximum[0] = _SIZE
        return _BASE

    @api.wasmtime_memory_grow_callback_t
    def grow(environment, size):
        return 1

    nothing = ctypes.CFUNCTYPE(None, ctypes.c_void_p)()

    @api.wasmtime_new_memory_callback_t
    def create(environment, kind, minimum, maximum, reserved, guard, out):
        if reserved + guard > _RESERVED:
            return 1
        out[0].env, out[0].get_memory, out[0].grow_memory, out[0].finalizer = None, get, grow, nothing
        return 0

    return api.wasmtime_memory_creator_t(None, create, nothing), get, grow, nothing, create


# --- pytest -----------------------------------------------------------------------------------------------------------


_installed: list[WasmKernels] = []


def wanted() -> bool:
    """Whether this run is over WebAssembly."""
    name = os.environ.get(SETTING, "")
    if name not in ("", NAME):
        raise pytest.UsageError(f"{SETTING} is {name}: it must be {NAME}, or not set")
    return name == NAME


def install() -> None:
    """Build the module if no process of this run has built it, and let kernels run in it."""
    from antumbra.formats import array_files
    from antumbra.kernels import jit
    from antumbra.kernels.toolchain.library_build import build_libraries
    from antumbra.query import ray_list
    from antumbra.store import system_resources
    from antumbra.trace.rays import all_hits

    if FOLDER not in os.environ:
        os.environ[FOLDER] = tempfile.mkdtemp(prefix="antumbra-wasm-")
        build_libraries(NAME, Path(os.environ[FOLDER]))
    kernels, native = WasmKernels(Path(os.environ[FOLDER])), jit.hooks.find
    jit.hooks = jit.hooks._replace(find=lambda function, key: kernels.find(function, key, native))
    _installed.append(kernels)
    _allocate_inside(kernels.heap)
    # what kernels find by addresses alone: arrays of rays, mapped files, buffers of a store's chunks
    for module in ray_list, all_hits:
        module.address_of = _address_inside
    array_files.np = SimpleNamespace(**vars(np) | {"memmap": _read_file})
    system_resources.mmap = SimpleNamespace(mmap=lambda _, size: np.empty(size, np.uint8), PAGESIZE=mmap.PAGESIZE)


def _allocate_inside(heap: _NumpyHeap) -> None:
    """Let NumPy allocate in WebAssembly's memory in all threads, and for arrays that are unpickled."""
    start = threading.Thread.start

    def start_inside(thread: threading.Thread) -> None:
        run = thread.run

        def run_inside() -> None:
            heap.use()
            run()

        thread.run = run_inside  # type: ignore[method-assign]
        start(thread)

    threading.Thread.start = start_inside  # type: ignore[method-assign]
    copyreg.pickle(np.ndarray, lambda array: (_unpickled, array.__reduce__()))


def _unpickled(make: Callable[..., np.ndarray], arguments: tuple[Any, ...], state: Any) -> np.ndarray:
    """An array of its own, since NumPy's would lie in the bytes of the pickle."""
    array = make(*arguments)
    array.__setstate__(state)
    return array.copy(order="K")


_inside: dict[int, np.ndarray] = {}  # copies of arrays that lie elsewhere, by the arrays' ids


def _read_file(*arguments: Any) -> np.ndarray:
    """In the place of `np.memmap`: a file's array, read into memory."""
    return np.array(np.memmap(*arguments), order="K")


def _address_inside(array: np.ndarray) -> int:
    """The address of an array of rays, or of a copy that lives as long."""
    if _is_inside(array.ctypes.data):
        return array.ctypes.data
    if id(array) not in _inside:
        weakref.finalize(array, _inside.pop, id(array))
    copy = _inside[id(array)] = np.empty(array.shape, array.dtype)
    copy[...] = array
    assert copy.strides == array.strides, "an array of rays that lies elsewhere must be contiguous"
    return copy.ctypes.data


@pytest.hookimpl(tryfirst=True)
def pytest_configure():
    if wanted():
        install()


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node, error):
    """Collect what the processes of this run called."""
    for kernels in _installed:
        kernels.called |= set(getattr(node, "workeroutput", {}).get(NAME, ()))


def pytest_sessionfinish(session):
    """Report what was called to the first process. There, a run that called nothing fails, since it proved nothing."""
    for kernels in _installed:
        if hasattr(session.config, "workeroutput"):
            session.config.workeroutput[NAME] = sorted(kernels.called)
        elif not kernels.called and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.NO_TESTS_COLLECTED


def pytest_unconfigure():
    for kernels in _installed:
        kernels.close()


def pytest_terminal_summary(terminalreporter):
    for kernels in _installed:
        terminalreporter.write_line(f"{len(kernels.called)} kernels were called in WebAssembly")
        if kernels.native:
            terminalreporter.write_line(f"not in the module, so run natively: {', '.join(sorted(kernels.native))}")
