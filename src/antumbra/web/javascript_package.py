"""The package for JavaScript: ES modules, the kernels that they call in WebAssembly, and what npm reads.

``python -m antumbra.web.javascript_package --out FOLDER`` builds it from the sources in ``module``. Nothing is compiled
to JavaScript, so the files in the package are those of the repository.
"""

import argparse
import json
import re
import shutil
import sys
from pathlib import Path

from ..base.errors import InputError
from ..base.extras import import_extra
from ..kernels.toolchain.compile_pool import KernelRequest
from ..kernels.toolchain.kernel_library import LibraryKernel
from ..kernels.toolchain.kernel_manifest import package_manifest
from ..kernels.toolchain.library_build import compile_for, link_library
from ..version import VERSION

SOURCES = Path(__file__).parent / "module"
ENTRY = "antumbra.mjs"
SYSTEM, LEVEL = "wasm32", "simd128"
_CALLED = re.compile(r'"(antumbra(?:\.\w+)+:\w+)"')  # names of kernels in the modules
_OTHER_WINGS = re.compile(r"antumbra\.(?:lab|city|techniques)\.")  # methods that the modules do not offer


def called_kernels(*folders: Path) -> list[KernelRequest]:
    """The recorded kernels that the modules, and those in further folders, call by name.

    Raises
    ------
    RuntimeError
        If one is not recorded.
    """
    paths = [path for folder in (SOURCES, *folders) for path in folder.glob("*.mjs")]
    names = {name for path in paths for name in _CALLED.findall(path.read_text(encoding="utf-8"))}
    found = [each for each in package_manifest().kernels if each.kernel in names and not _OTHER_WINGS.search(each.key)]
    missing = sorted(names - {each.kernel for each in found})
    if missing:
        raise RuntimeError(f"{', '.join(missing)}: not recorded; run scripts/record_kernels.py, or correct the name")
    return found


def link_kernels(path: Path, *folders: Path) -> dict[str, LibraryKernel]:
    """Compile and link the kernels that the modules call, and return the list that names them.

    path : of the module of WebAssembly; its folder is made if it does not exist
    folders : of further modules

    Raises
    ------
    InputError, RuntimeError
        As for `build_package`.
    """
    import_extra("ziglang", "linking kernels", "build")
    requests = called_kernels(*folders)
    compile_for([SYSTEM], [LEVEL], requests)
    path.parent.mkdir(parents=True, exist_ok=True)
    return link_library(SYSTEM, LEVEL, requests, path)


def build_package(out: Path) -> list[Path]:
    """Write the package into a folder, which is made if it does not exist, and return its files.

    Raises
    ------
    InputError
        If the linker is not installed.
    RuntimeError
        If a kernel is unknown, or cannot be compiled or linked.
    """
    kernels = link_kernels(out / "kernels.wasm")
    (out / "kernels.json").write_text(json.dumps({"version": VERSION, "kernels": kernels}, separators=(",", ":")))
    for path in (*SOURCES.glob("*.mjs"), SOURCES / "README.md"):
        shutil.copyfile(path, out / path.name)
    (out / "package.json").write_text(json.dumps(_package_file(), indent=2) + "\n")
    return sorted(out.iterdir())


def _package_file() -> dict[str, object]:
    """``package.json``."""
    return {
        "name": "antumbra",
        "version": re.sub(r"(a|b|rc)(\d+)", r"-\1.\2", VERSION),  # npm's spelling
        "description": "Exact and fast rays on triangles: soft shadows, sun hours, nearest hits, in browsers and node",
        "license": "Apache-2.0",
        "type": "module",
        "exports": {".": f"./{ENTRY}", "./kernels.wasm": "./kernels.wasm", "./kernels.json": "./kernels.json"},
        "engines": {"node": ">=20"},
        "sideEffects": False,
        "repository": {"type": "git", "url": "git+https://github.com/antumbra/antumbra.git"},
        "keywords": ["raycast", "bvh", "shadows", "visibility", "webassembly", "three"],
    }


def main(arguments: list[str] | None = None) -> int:
    """Build the package into a folder."""
    parser = argparse.ArgumentParser(
        prog="python -m antumbra.web.javascript_package", description="Build the package for JavaScript."
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for the files")
    options = parser.parse_args(arguments)
    try:
        for path in build_package(options.out):
            print(f"{path}  {path.stat().st_size / 1e3:.1f} kB")
    except InputError as error:
        parser.error(str(error))
    return 0


if __name__ == "__main__":
    sys.exit(main())
