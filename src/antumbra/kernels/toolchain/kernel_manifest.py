"""The manifest of the kernels that each job calls, ``needs.json``, and packs of their machine code for wheels.

The manifest has the kernels with their sizes and, for each job, the indices of its kernels, which several processes
compile before the job runs. ``scripts/record_kernels.py`` writes it, and a test compares it with the kernels that jobs
call. Kernels that are not recorded are compiled on their first call.

``python -m antumbra.kernels.toolchain.kernel_manifest`` compiles all recorded kernels to one pack per processor level.
LLVM can also compile for levels that this machine cannot run. The command marks such packs, since they are untested.
"""

import argparse
import json
import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple

from ...progress import report_progress
from ..machine_code import LEVELS, level, usable
from ..marshalling import import_object
from .compile_pool import KernelRequest, compile_kernels
from .kernel_cache import PACKS, KernelFolder, cache_folder, write_pack
from .kernel_digest import kernel_digest

# --- The manifest -----------------------------------------------------------------------------------------------------


MANIFEST = Path(__file__).parents[1] / "needs.json"


class KernelManifest(NamedTuple):
    """The contents of manifest files."""

    kernels: list[KernelRequest]
    jobs: dict[str, list[int]]  # name of a job: indices into `kernels`


_files = [MANIFEST]


def add_manifest(file: Path) -> None:
    """Add a manifest file, with the kernels of another package such as `antumbra.papers`."""
    if file not in _files:
        _files.append(file)
        recorded_kernels.cache_clear()


@cache
def recorded_kernels() -> KernelManifest:
    """The contents of all added files. A missing file counts as empty."""
    return read_manifests(*_files)


def read_manifests(*files: Path) -> KernelManifest:
    """The joint contents of manifest files. A missing file counts as empty."""
    kernels: list[KernelRequest] = []
    jobs: dict[str, list[int]] = {}
    for file in files:
        try:
            contents = json.loads(file.read_text())
        except OSError:
            continue
        jobs |= {job: [len(kernels) + place for place in places] for job, places in contents["jobs"].items()}
        kernels += [KernelRequest(name, key, size["seconds"]) for name, key, size in contents["kernels"]]
    return KernelManifest(kernels, jobs)


def package_manifest() -> KernelManifest:
    """The kernels of all manifest files in this package, even of those not added; each kernel once."""
    manifest = read_manifests(*sorted(MANIFEST.parents[1].rglob(MANIFEST.name)))
    return KernelManifest(list({(each.kernel, each.key): each for each in manifest.kernels}.values()), {})


def kernels_of_job(name: str) -> set[KernelRequest] | None:
    """The kernels that a job calls; None if the job is not recorded."""
    needs = recorded_kernels()
    return {needs.kernels[i] for i in needs.jobs[name]} if name in needs.jobs else None


# --- Packs ------------------------------------------------------------------------------------------------------------


def make_packs(out: Path, levels: list[str]) -> list[Path]:
    """Compile all recorded kernels for `levels`, write one pack per level, and return their paths.

    Raises
    ------
    RuntimeError
        If a kernel cannot be compiled. No pack is written in that case.
    """
    requests = package_manifest().kernels
    digests = [kernel_digest(import_object(each.kernel), each.key) for each in requests]
    with report_progress(f"compiling {len(requests)} kernels for {', '.join(levels)}") as progress:
        errors = compile_kernels(requests, progress, levels=levels)
    if errors:
        raise RuntimeError("; ".join(errors))
    paths = []
    for each in levels:
        folder = KernelFolder(cache_folder(), each)
        paths.append(write_pack(out, each, {digest: folder.get(digest) for digest in digests}))  # type: ignore[misc]
    return paths


def main(arguments: list[str] | None = None) -> int:
    """Compile packs of all recorded kernels."""
    parser = argparse.ArgumentParser(
        prog="python -m antumbra.kernels.toolchain.kernel_manifest",
        description="Compile packs of all recorded kernels.",
    )
    parser.add_argument("--level", action="append", choices=LEVELS, help="may be repeated; default: all")
    parser.add_argument("--out", type=Path, default=PACKS, help="folder; default: the package's own")
    options = parser.parse_args(arguments)
    runs = usable(level())
    for path in make_packs(options.out, options.level or list(LEVELS)):
        pack_level = path.stem.partition("-")[2]
        note = "" if pack_level in runs else "  (this machine cannot run it)"
        print(f"{path}  {path.stat().st_size / 1e6:.1f} MB{note}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
