"""Packs of machine code for common processors, which a wheel brings along: ``python -m antumbra.kernels.pack``.

Every kernel that `needs` has recorded is compiled for each level. LLVM also compiles for levels that this machine
cannot run. The command says so, because nobody has run these packs where they were made.
"""

import argparse
import sys
from pathlib import Path

from .arguments import named
from .cache import PACKS, Folder, cache_folder, write_pack
from .closure import kernel_digest
from .crew import compile_all
from .needs import of_package
from .processor import LEVELS, level, usable
from .progress import reported


def make_packs(out: Path, levels: list[str]) -> list[Path]:
    """Compile all recorded kernels for `levels`, write one pack for each level, and return their paths.

    Raises
    ------
    RuntimeError
        If a kernel cannot be compiled. Nothing is written then.
    """
    wanted = of_package().kernels
    digests = [kernel_digest(named(each.kernel), each.key) for each in wanted]
    with reported(f"compiling {len(wanted)} kernels for {', '.join(levels)}") as progress:
        wrong = compile_all(wanted, progress, levels=levels)
    if wrong:
        raise RuntimeError("; ".join(wrong))
    paths = []
    for each in levels:
        folder = Folder(cache_folder(), each)
        paths.append(write_pack(out, each, {digest: folder.get(digest) for digest in digests}))
    return paths


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m antumbra.kernels.toolchain.kernel_manifest", description="Compile packs of all recorded kernels.")
    parser.add_argument("--level", action="append", choices=LEVELS, help="may be repeated; default: all")
    parser.add_argument("--out", type=Path, default=PACKS, help="folder; default: the package's own")
    options = parser.parse_args(arguments)
    runs = usable(level())
    for path in make_packs(options.out, options.level or list(LEVELS)):
        made = path.stem.partition("-")[2]
        note = "" if made in runs else "  (this machine cannot run it)"
        print(f"{path}  {path.stat().st_size / 1e6:.1f} MB{note}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
