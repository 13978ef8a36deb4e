"""The manifest of the kernels that each job calls, ``needs.json``.

The manifest has the kernels with their sizes and, for each job, the indices of its kernels, which several processes
compile before the job runs. ``scripts/record_kernels.py`` writes it, and a test compares it with the kernels that jobs
call. Kernels that are not recorded are compiled on their first call.
"""

import json
from functools import cache
from pathlib import Path
from typing import NamedTuple

from .compile_pool import KernelRequest

MANIFEST = Path(__file__).parents[1] / "needs.json"


class KernelManifest(NamedTuple):
    """The contents of manifest files."""

    kernels: list[KernelRequest]
    jobs: dict[str, list[int]]  # name of a job: indices into `kernels`


_files = [MANIFEST]


def add_manifest(file: Path) -> None:
    """Add a manifest file, with the kernels of another package such as `antumbra.lab.papers`."""
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


def kernels_of_warm_up(name: str) -> set[KernelRequest] | None:
    """The kernels that a job calls; None if the job is not recorded."""
    needs = recorded_kernels()
    return {needs.kernels[i] for i in needs.jobs[name]} if name in needs.jobs else None
