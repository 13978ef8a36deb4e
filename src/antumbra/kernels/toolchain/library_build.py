"""Build kernel libraries: all recorded kernels, linked into one shared library for each processor level of a system.

The kernels of devices stand beside them, as PTX and SPIR-V, which are the same for all systems.

``python -m antumbra.kernels.toolchain.library_build --system linux-x86_64 --out FOLDER`` runs on any system: LLVM
compiles for all of them, and the linker of the package ``ziglang`` links for all of them. Numba's part of the work is
done once for all levels. The libraries need nothing but the C library.
"""

import argparse
import shutil
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.files import temporary_folder
from ...base.progress import report_progress
from ..machine_code import SYSTEMS, library_destination
from ..marshalling import NONE, import_object
from ..processor import LIBRARIES, library_path
from .compile_pool import KernelRequest, compile_kernels
from .device_code import DEVICE_LIBRARY, load_or_compile_forms
from .kernel_cache import KernelCode, KernelFolder, cache_folder, symbol_of
from .kernel_digest import homes_of, kernel_digest, reachable_functions
from .kernel_library import LIST, PACKAGE, LibraryKernel, LibraryList, digest_of, name_of
from .kernel_manifest import package_manifest

# --- Linking ----------------------------------------------------------------------------------------------------------


LEVEL_SOURCE = """
#include <cpuid.h>

static int all(unsigned word, unsigned needs) { return (word & needs) == needs; }

static unsigned saved_state(void) {
    unsigned low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
}

/* 1 to 3 for x86-64-v2 to -v4, and 0 below: features of the processor, and of registers that the system saves */
long long antumbra_x86_level(void) {
    unsigned a, b = 0, base = 0, d, extended = 0, unused;
    __get_cpuid(1, &a, &b, &base, &d);
    __get_cpuid(0x80000001, &a, &b, &extended, &d);
    unsigned base2 = bit_CMPXCHG16B | bit_POPCNT | bit_SSE3 | bit_SSSE3 | bit_SSE41 | bit_SSE42;
    unsigned base3 = bit_AVX | bit_F16C | bit_FMA | bit_MOVBE | bit_OSXSAVE, more3 = bit_AVX2 | bit_BMI | bit_BMI2;
    unsigned more4 = bit_AVX512F | bit_AVX512BW | bit_AVX512CD | bit_AVX512DQ | bit_AVX512VL;
    if (!all(base, base2) || !all(extended, bit_LAHF_LM)) return 0;
    if (!all(base, base3) || !all(extended, bit_LZCNT)) return 1;
    if (!__get_cpuid_count(7, 0, &a, &b, &unused, &d) || !all(b, more3) || !all(saved_state(), 6)) return 1;
    return all(b, more4) && all(saved_state(), 0xe6) ? 3 : 2;
}
"""
"""C for `processor.read_level`."""

_WINDOWS_SOURCE = "int _fltused = 0;"
"""LLVM marks objects with floating-point code by this symbol, which Microsoft's C library defines."""

_WASM_SOURCE = """
typedef unsigned long long word;

/* the product of two 128-bit numbers, which LLVM calls where WebAssembly has no instruction; by halves of 32 bits */
void __multi3(word *out, word a_low, word a_high, word b_low, word b_high) {
    word a0 = (unsigned)a_low, a1 = a_low >> 32, b0 = (unsigned)b_low, b1 = b_low >> 32;
    word low = a0 * b0, cross1 = a0 * b1, cross2 = a1 * b0;
    word middle = (low >> 32) + (unsigned)cross1 + (unsigned)cross2;
    out[0] = (unsigned)low | middle << 32;
    out[1] = a1 * b1 + (cross1 >> 32) + (cross2 >> 32) + (middle >> 32) + a_low * b_high + a_high * b_low;
}
"""


_ZIG = sys.executable, "-m", "ziglang"


def _link(command: list[str], inputs: list[str], out: Path) -> None:
    listed = out.with_suffix(".objects")  # a command line would be too long
    listed.write_text("\n".join(inputs))
    done = subprocess.run([*_ZIG, *command, "-o", str(out), f"@{listed}"], capture_output=True, text=True)
    listed.unlink()
    if done.returncode:
        raise RuntimeError(f"{out.name} was not linked: {done.stderr.strip()}")


class Linker(NamedTuple):
    """How the libraries of a system are linked."""

    target: str  # zig's name of the system, with the oldest C library
    suffix: str

    def link(self, objects: list[Path], sources: list[Path], symbols: list[str], out: Path) -> None:
        """Link objects and C files into a shared library. Raises RuntimeError with the linker's message."""
        command = ["cc", "-target", self.target, "-O2", "-fPIC", "-shared", "-s"]
        if self.suffix == ".dylib":  # without it, the path of this folder is the library's name
            command.append(f"-Wl,-install_name,@rpath/{out.name}")
        inputs = [*objects, *sources]
        if self.suffix == ".dll":  # weak symbols, as Numba makes them, are only exported by name
            inputs.append(out.with_suffix(".def"))
            inputs[-1].write_text("\n  ".join(["EXPORTS", *symbols]) + "\n")
        _link(command, [*(f'"{path.as_posix()}"' for path in inputs), "-lm"], out)


class WasmLinker(NamedTuple):
    """How the kernels of WebAssembly are linked: into a module that imports nothing but its memory, ``env.memory``.

    It exports each kernel by its symbol, and ``__stack_pointer`` and ``__heap_base``. Its stack comes first in memory,
    so an overflow is a trap. Each thread has an instance of the module and a stack of its own.
    """

    suffix: str = ".wasm"

    def link(self, objects: list[Path], sources: list[Path], symbols: list[str], out: Path) -> None:
        """Link objects and C files into a module. Raises RuntimeError with the linker's message."""
        compiled = [path.with_suffix(".o") for path in sources]
        for source, path in zip(sources, compiled):
            _link(["cc", "-target", "wasm32-freestanding", "-O2", "-c"], [f'"{source.as_posix()}"'], path)
        layout = ["--import-memory", f"--max-memory={WASM_MEMORY}", "--stack-first", "-z", f"stack-size={WASM_STACK}"]
        exports = [f"--export={each}" for each in (*symbols, "__stack_pointer", "__heap_base")]
        inputs = [f'"{path.as_posix()}"' for path in (*objects, *compiled)]
        _link(["wasm-ld", "--no-entry", *layout, "-O2", "-s"], [*exports, *inputs], out)


WASM_MEMORY = 1 << 32
"""The most memory that WebAssembly addresses."""

WASM_STACK = 4 << 20
"""Bytes of a stack. Tracers of frusta and exact expansions keep their scratch memory there."""

LINKERS: dict[str, Linker | WasmLinker] = {
    "linux-x86_64": Linker("x86_64-linux-gnu.2.17", ".so"),
    "linux-aarch64": Linker("aarch64-linux-gnu.2.17", ".so"),
    "macos-x86_64": Linker("x86_64-macos.11.0", ".dylib"),
    "macos-arm64": Linker("aarch64-macos.11.0", ".dylib"),
    "windows-x86_64": Linker("x86_64-windows-gnu", ".dll"),
    "windows-arm64": Linker("aarch64-windows-gnu", ".dll"),
    "wasm32": WasmLinker(),
}


@cache
def source_files(requests: tuple[KernelRequest, ...]) -> list[str]:
    """The files of the package in which kernels are defined, and those that say how kernels are called."""
    modules = {"antumbra.kernels.marshalling", "antumbra.kernels.jit"}
    for request in requests:
        function = import_object(request.kernel).py_func
        modules |= {each.__module__ for each in reachable_functions(function, homes_of(request.key))}
    modules = {name for name in modules if name.partition(".")[0] == "antumbra"}
    for name in "simd", "device":
        modules |= {f"antumbra.kernels.{name}.{path.stem}" for path in (PACKAGE / "kernels" / name).glob("*.py")}
    paths = {PACKAGE.joinpath(*name.split(".")[1:]) for name in modules}
    files = {path.with_suffix(".py") if path.with_suffix(".py").exists() else path / "__init__.py" for path in paths}
    return sorted(path.relative_to(PACKAGE).as_posix() for path in files if path.exists())


def _write_inputs(system: str, level: str, codes: dict[str, KernelCode], folder: Path) -> tuple[list[Path], list[Path]]:
    """Write what a library is linked from: (objects of kernels, C files)."""
    objects, files = list[Path](), list[Path]()
    for k, code in enumerate(codes.values()):
        objects.append(folder / f"{k}.o")
        objects[-1].write_bytes(code.machine)
    sources = [LEVEL_SOURCE] if level.startswith("x86") else []
    sources += [_WINDOWS_SOURCE] if system.startswith("windows") else []
    sources += [_WASM_SOURCE] if system.startswith("wasm") else []
    for k, source in enumerate(sources):
        files.append(folder / f"source{k}.c")
        files[-1].write_text(source)
    return objects, files


def compile_for(
    systems: Sequence[str], levels: Sequence[str] | None = None, requests: Sequence[KernelRequest] | None = None
) -> None:
    """Compile kernels for some systems, as far as they are not cached.

    levels : None: all levels of each system
    requests : None: all recorded kernels

    Raises
    ------
    RuntimeError
        If a kernel cannot be compiled.
    """
    requests = package_manifest().kernels if requests is None else list(requests)
    destinations = [
        library_destination(system, each) for system in systems for each in levels or SYSTEMS[system].levels
    ]
    with report_progress(f"compiling {len(requests)} kernels for {', '.join(systems)}") as progress:
        errors = compile_kernels(requests, progress, levels=destinations)
    if errors:
        raise RuntimeError("; ".join(errors))


def link_library(system: str, level: str, requests: Sequence[KernelRequest], out: Path) -> dict[str, LibraryKernel]:
    """Link compiled kernels into a library at a path, and return what its list says of them."""
    codes = _cached(requests, library_destination(system, level))
    symbols = [symbol_of(digest) for digest in codes] + ["antumbra_x86_level"] * level.startswith("x86")
    with temporary_folder() as work:
        LINKERS[system].link(*_write_inputs(system, level, codes, work), symbols, out)
    return {
        name_of(each.kernel, each.key): LibraryKernel(symbol_of(digest), each.result) for digest, each in codes.items()
    }


def build_libraries(system: str, out: Path, levels: Sequence[str] | None = None) -> list[Path]:
    """Build the libraries of a system and their list into a folder, and return the paths of the libraries.

    levels : None: all levels of the system

    Raises
    ------
    InputError
        If the linker is not installed.
    RuntimeError
        If a kernel cannot be compiled or a library cannot be linked. The folder is unchanged then.
    """
    import_extra("ziglang", "linking kernel libraries", "build")
    compile_for([system], levels)
    requests, levels = package_manifest().kernels, levels or SYSTEMS[system].levels
    files, linker = source_files(tuple(requests)), LINKERS[system]
    with temporary_folder() as work:
        contents, libraries = LibraryList(files, digest_of(PACKAGE, files), {}), list[Path]()
        for level in levels:
            libraries.append(library_path(work, level, linker.suffix))
            contents.kernels.update(link_library(system, level, requests, libraries[-1]))
        contents.write(work)
        with_devices = not isinstance(linker, WasmLinker)
        if with_devices:
            write_devices(work / DEVICE_LIBRARY.name)
        out.mkdir(parents=True, exist_ok=True)
        for path in (*libraries, work / LIST):
            shutil.copy(path, out / path.name)
        if with_devices:
            shutil.rmtree(out / DEVICE_LIBRARY.name, ignore_errors=True)
            shutil.copytree(work / DEVICE_LIBRARY.name, out / DEVICE_LIBRARY.name)
    return [out / path.name for path in libraries]


def write_devices(folder: Path) -> None:
    """Write the code of all recorded kernels of devices, and their list, into a folder."""
    requests = package_manifest().devices
    files = source_files(tuple(requests))
    contents = LibraryList(files, digest_of(PACKAGE, files), {})
    folder.mkdir()
    for each in requests:
        for form, code in load_or_compile_forms(import_object(each.kernel), each.key).items():
            (folder / f"{code.entry}.{form}").write_bytes(code.code)
            contents.kernels[name_of(each.kernel, each.key)] = LibraryKernel(code.entry, NONE)
    contents.write(folder)


def _cached(requests: Sequence[KernelRequest], destination: str) -> dict[str, KernelCode]:
    """Digest -> the compiled code of kernels for a destination."""
    folder, codes = KernelFolder(cache_folder(), destination), dict[str, KernelCode]()
    for each in requests:
        digest = kernel_digest(import_object(each.kernel), each.key)
        code = folder.get(digest)
        if code is None:
            raise RuntimeError(f"{each.kernel} has disappeared from {folder.path}; run the command again")
        codes[digest] = code
    return codes


def main(arguments: list[str] | None = None) -> int:
    """Build libraries of all recorded kernels."""
    parser = argparse.ArgumentParser(
        prog="python -m antumbra.kernels.toolchain.library_build",
        description="Build shared libraries of all recorded kernels.",
    )
    parser.add_argument("--system", action="append", choices=list(SYSTEMS), required=True, help="may be repeated")
    parser.add_argument("--level", action="append", help="may be repeated; default: all of the system")
    parser.add_argument("--out", type=Path, default=LIBRARIES, help="folder; of several systems, each gets one in it")
    options = parser.parse_args(arguments)
    systems: list[str] = options.system
    for system in systems:
        wrong = [level for level in options.level or () if level not in SYSTEMS[system].levels]
        if wrong:
            parser.error(f"{system} has the levels {', '.join(SYSTEMS[system].levels)}, not {wrong[0]}")
    try:
        compile_for(systems, options.level)
        for system in systems:
            out = options.out / system if len(systems) > 1 else options.out
            for path in build_libraries(system, out, options.level):
                print(f"{path}  {path.stat().st_size / 1e6:.1f} MB")
    except InputError as error:
        parser.error(str(error))
    return 0


if __name__ == "__main__":
    sys.exit(main())
