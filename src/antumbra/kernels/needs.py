"""The kernels that each job calls, recorded in ``needs.json``. Several processes compile them before the job runs.

The file holds the kernels, with their size, and for each job the indices of its kernels. A script writes the file
(``scripts/record_kernels.py``), and a test compares it with the kernels that jobs call. A kernel that is not recorded
is compiled at its first call.
"""

import json
from functools import cache
from pathlib import Path
from typing import NamedTuple

from .crew import Wanted

FILE = Path(__file__).parents[1] / "needs.json"


class Needs(NamedTuple):
    """The contents of the files."""

    kernels: list[Wanted]
    jobs: dict[str, list[int]]  # name of a job: indices into `kernels`


_files = [FILE]


def add(file: Path) -> None:
    """Read another file too, with kernels that another package adds, such as `antumbra.papers`."""
    if file not in _files:
        _files.append(file)
        recorded.cache_clear()


@cache
def recorded() -> Needs:
    """The contents of all files. A missing file counts as empty."""
    return read(*_files)


def read(*files: Path) -> Needs:
    """The needs that some files hold. Missing files hold none."""
    kernels: list[Wanted] = []
    jobs: dict[str, list[int]] = {}
    for file in files:
        try:
            said = json.loads(file.read_text())
        except OSError:
            continue
        jobs |= {job: [len(kernels) + place for place in places] for job, places in said["jobs"].items()}
        kernels += [Wanted(name, key, size["seconds"]) for name, key, size in said["kernels"]]
    return Needs(kernels, jobs)


def of_package() -> Needs:
    """The contents of all such files in this package, also of parts that nobody has added; each kernel once."""
    found = read(*sorted(FILE.parents[1].rglob(FILE.name)))
    return Needs(list({(each.kernel, each.key): each for each in found.kernels}.values()), {})


def of_job(name: str) -> set[Wanted] | None:
    """The kernels that a job calls; None if the job is not recorded."""
    needs = recorded()
    return {needs.kernels[i] for i in needs.jobs[name]} if name in needs.jobs else None
