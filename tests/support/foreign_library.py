"""Run the kernels of a library for Windows or macOS in this process of Linux, from an image of its memory.

`scripts/library_images.py` makes the images. Kernels get two pointers and return a number; on x86-64, Windows passes
them in other registers, which a few instructions around each call translate.
"""

import ctypes
import json
import mmap
import struct

import numpy as np

from antumbra.kernels.toolchain import kernel_library, kernel_loading

_TO_WINDOWS = (
    b"\x55\x48\x89\xe5"  # push rbp; mov rbp, rsp
    b"\x48\x83\xec\x20"  # sub rsp, 32: the space that a callee may use
    b"\x48\x89\xf9\x48\x89\xf2"  # mov rcx, rdi; mov rdx, rsi
    b"\x48\xb8%s\xff\xd0"  # mov rax, ADDRESS; call rax
    b"\xc9\xc3"  # leave; ret
)
_FROM_WINDOWS = {  # memory functions with the arguments in rcx, rdx and r8, which keep rdi and rsi
    "memcpy": (
        b"\x57\x56\x48\x89\xc8\x48\x89\xcf"  # push rdi; push rsi; mov rax, rcx; mov rdi, rcx
        b"\x48\x89\xd6\x4c\x89\xc1\xf3\xa4"  # mov rsi, rdx; mov rcx, r8; rep movsb
        b"\x5e\x5f\xc3"  # pop rsi; pop rdi; ret
    ),
    "memset": (
        b"\x57\x49\x89\xc9\x48\x89\xcf\x89\xd0"  # push rdi; mov r9, rcx; mov rdi, rcx; mov eax, edx
        b"\x4c\x89\xc1\xf3\xaa\x4c\x89\xc8"  # mov rcx, r8; rep stosb; mov rax, r9
        b"\x5f\xc3"  # pop rdi; ret
    ),
}


@ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_size_t)
def _zero(start, n):
    ctypes.memset(start, 0, n)


@ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)
def _repeat(start, pattern, n):
    ctypes.memmove(start, ctypes.string_at(pattern, 16) * (n // 16) + ctypes.string_at(pattern, n % 16), n)


_OF_MACOS = {"bzero": _zero, "__bzero": _zero, "memset_pattern16": _repeat}


def _address(function):
    return ctypes.cast(function, ctypes.c_void_p).value


class _Code:
    """Executable memory."""

    def __init__(self, size):
        self._map = mmap.mmap(-1, size, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
        self.bytes = np.frombuffer(self._map, np.uint8)
        self.address = self.bytes.ctypes.data
        self._end = 0

    def put(self, data):
        """The address at which bytes are appended."""
        start = self._end
        self.bytes[start : start + len(data)] = np.frombuffer(data, np.uint8)
        self._end = start + (len(data) + 15) // 16 * 16
        return self.address + start


class ForeignLibrary:
    """A library from an image, in place of `KernelLibrary`."""

    def __init__(self, image, list_folder):
        with np.load(image) as file:
            memory, rest = file["memory"], json.loads(str(file["rest"]))
        self.kernels = kernel_library.LibraryList.read(list_folder).kernels
        self._image = _Code(len(memory))
        self._image.put(memory.tobytes())
        self._windows = rest["convention"] == "windows"
        self._small = _Code(64 * (len(self.kernels) + len(_FROM_WINDOWS)))
        for at in rest["pointers"]:
            self._write(at, self._read(at) - rest["base"] + self._image.address)
        for name, places in rest["imports"].items():
            for at in places:
                self._write(at, self._memory_function(name))
        self._exports = rest["exports"]

    def _read(self, at):
        return struct.unpack("<Q", self._image.bytes[at : at + 8].tobytes())[0]

    def _write(self, at, address):
        self._image.bytes[at : at + 8] = np.frombuffer(struct.pack("<Q", address), np.uint8)

    def _memory_function(self, name):
        """The address of a function that kernels import; 0 for those that only loading calls."""
        if name in _FROM_WINDOWS and self._windows:
            return self._small.put(_FROM_WINDOWS[name])
        if name in ("memcpy", "memmove", "memset"):
            return _address(getattr(ctypes.CDLL(None), name))
        return _address(_OF_MACOS[name]) if name in _OF_MACOS else 0

    def function(self, kernel, key):
        """A function of packed arguments that runs a kernel."""
        entry = self.kernels[kernel_library.name_of(kernel, key)]
        address = self._image.address + self._exports[entry.symbol]
        if self._windows:
            before, after = _TO_WINDOWS.split(b"%s")
            address = self._small.put(before + struct.pack("<Q", address) + after)
        return kernel_library.callable_at(address, entry.result, kernel)


def install(image, list_folder):
    """Let this process run all kernels from an image, and fail if one is missing."""
    library = ForeignLibrary(image, list_folder)
    kernel_loading.installed_library = lambda: library
    return library
