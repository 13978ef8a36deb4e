"""The module of kernels, compiled and linked where no wheel contains it.

It is kept in the kernel cache, indexed by the digests of its kernels and of the linker's code.

``python -m antumbra.web.kernel_linking --out FOLDER`` writes what a wheel contains.
"""

import argparse
import json
import re
import sys
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from typing import TypeAlias

from ..base.errors import InputError
from ..base.extras import import_extra
from ..base.files import atomic_output, make_folder, read_trusted, temporary_folder
from ..base.progress import report_progress
from ..kernels.machine_code import library_destination
from ..kernels.marshalling import import_object
from ..kernels.toolchain.compile_pool import KernelRequest
from ..kernels.toolchain.kernel_cache import KernelFolder, cache_folder
from ..kernels.toolchain.kernel_digest import kernel_digest, module_digest
from ..kernels.toolchain.kernel_library import MODULE, PACKAGE, LibraryKernel, LibraryList, digest_of
from ..kernels.toolchain.kernel_manifest import package_manifest
from ..kernels.toolchain.library_build import compile_for, link_library, source_files
from .page_source import PAGE

SOURCES = Path(__file__).parent / "module"
SYSTEM, LEVEL = "wasm32", "simd128"

Linked: TypeAlias = tuple[bytes, dict[str, LibraryKernel]]
"""A module, and its kernels by `kernel_library.name_of`."""

_CALLED = re.compile(r'"(antumbra(?:\.\w+)+:\w+)"')  # names of kernels in the modules
_OTHER_WINGS = re.compile(r"antumbra\.(?:lab|city|techniques)\.")  # methods that the modules do not offer


def called_kernels() -> list[KernelRequest]:
    """The recorded kernels that the modules and those of pages call by name.

    Raises
    ------
    RuntimeError
        If one is not recorded.
    """
    paths = [path for folder in (SOURCES, PAGE) for path in folder.glob("*.mjs")]
    names = {name for path in paths for name in _CALLED.findall(path.read_text(encoding="utf-8"))}
    found = [each for each in package_manifest().kernels if each.kernel in names and not _OTHER_WINGS.search(each.key)]
    missing = sorted(names - {each.kernel for each in found})
    if missing:
        raise RuntimeError(f"{', '.join(missing)}: not recorded; run scripts/record_kernels.py, or correct the name")
    return found


def linked_module() -> Linked:
    """The module of the cache, or one linked now.

    Raises
    ------
    RuntimeError
        If a kernel is unknown, or cannot be compiled or linked.
    """
    requests = called_kernels()
    file = _cached_file(requests)
    with suppress(OSError, ValueError, TypeError):
        return _unpacked(read_trusted(file))
    linked = _link(requests)
    with suppress(OSError, InputError):  # of a cache that is full or cannot be written
        make_folder(file.parent)
        with atomic_output(file) as temporary:
            temporary.write_bytes(_packed(linked))
    return linked


def _cached_file(requests: list[KernelRequest]) -> Path:
    """The file of the module of some kernels in the kernel cache."""
    digests = [kernel_digest(import_object(each.kernel), each.key) for each in requests]
    linker = module_digest("antumbra.kernels.toolchain.library_build")
    name = blake2b(" ".join([*digests, linker]).encode(), digest_size=16).hexdigest()
    return KernelFolder(cache_folder(), library_destination(SYSTEM, LEVEL)).path / f"{name}.module"


def _packed(linked: Linked) -> bytes:
    """A digest of the rest; the list; the module."""
    wasm, kernels = linked
    body = json.dumps(kernels).encode() + b"\n" + wasm
    return blake2b(body, digest_size=16).digest() + body


def _unpacked(data: bytes) -> Linked:
    """Raises ValueError if the file is damaged."""
    body = data[16:]
    if blake2b(body, digest_size=16).digest() != data[:16]:
        raise ValueError("damaged")
    kernels, _, wasm = body.partition(b"\n")
    return wasm, {name: LibraryKernel(*each) for name, each in json.loads(kernels).items()}


def _link(requests: list[KernelRequest]) -> Linked:
    """Compile and link kernels."""
    compile_for([SYSTEM], [LEVEL], requests)
    with temporary_folder() as folder, report_progress("linking the kernels"):
        kernels = link_library(SYSTEM, LEVEL, requests, folder / MODULE)
        return (folder / MODULE).read_bytes(), kernels


def write_module(out: Path) -> None:
    """Write the module and its list into a folder, as a wheel contains them.

    Raises
    ------
    InputError, RuntimeError
        As for `linked_module`; InputError if the linker is not installed.
    """
    import_extra("ziglang", "linking kernels", "build")
    wasm, kernels = linked_module()
    files = source_files(tuple(called_kernels()))
    out.mkdir(parents=True, exist_ok=True)
    (out / MODULE).write_bytes(wasm)
    LibraryList(files, digest_of(PACKAGE, files), kernels).write(out)


def main(arguments: list[str] | None = None) -> int:
    """Write the module of kernels and its list."""
    parser = argparse.ArgumentParser(
        prog="python -m antumbra.web.kernel_linking", description="Write the kernels of pages and their list."
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for the files")
    options = parser.parse_args(arguments)
    try:
        write_module(options.out)
    except InputError as error:
        parser.error(str(error))
    return 0


if __name__ == "__main__":
    sys.exit(main())
