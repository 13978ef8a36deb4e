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
from ..kernels.toolchain.kernel_library import LIST, MODULE
from ..version import VERSION
from .kernel_linking import SOURCES
from .kernel_module import kernel_module

ENTRY = "antumbra.mjs"


def build_package(out: Path) -> list[Path]:
    """Write the package into a folder, which is made if it does not exist, and return its files.

    Raises
    ------
    InputError
        If the kernels have to be linked, and the linker is not installed.
    RuntimeError
        If a kernel is unknown, or cannot be compiled or linked.
    """
    module = kernel_module()
    out.mkdir(parents=True, exist_ok=True)
    (out / MODULE).write_bytes(module.wasm)
    (out / LIST).write_text(json.dumps({"version": VERSION, "kernels": module.kernels}, separators=(",", ":")))
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
