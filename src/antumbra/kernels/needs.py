"""Which kernels a job calls, recorded beforehand in ``needs.json``: so they are compiled at once, by several processes.

The file holds the kernels, with their size, and for each job the numbers of its kernels. A script writes it
(``scripts/record_kernels.py``), and a test compares it with what jobs call. A kernel that is not recorded is compiled
when it is first called.
"""

import json
from functools import cache
from pathlib import Path
from typing import NamedTuple

from .crew import Wanted

FILE = Path(__file__).with_name("needs.json")


class Needs(NamedTuple):
    """What is in the file."""

    kernels: list[Wanted]
    jobs: dict[str, list[int]]  # name of a job: places in `kernels`


_files = [FILE]


def add(file: Path) -> None:
    """Look into another file too: of kernels that a package adds to the instrument's."""
    if file not in _files:
        _files.append(file)
        recorded.cache_clear()


@cache
def recorded() -> Needs:
    """What the files say; nothing of files that are not there."""
    kernels: list[Wanted] = []
    jobs: dict[str, list[int]] = {}
    for file in _files:
        try:
            said = json.loads(file.read_text())
        except OSError:
            continue
        jobs |= {job: [len(kernels) + place for place in places] for job, places in said["jobs"].items()}
        kernels += [Wanted(name, key, size["seconds"]) for name, key, size in said["kernels"]]
    return Needs(kernels, jobs)


def of_job(name: str) -> set[Wanted] | None:
    """The kernels that a job calls; None if nothing is recorded of it."""
    needs = recorded()
    return {needs.kernels[i] for i in needs.jobs[name]} if name in needs.jobs else None
