"""A copy of the package with more kernels, whose sources a test can edit. Tests of keys and of the cache use it."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import antumbra

PARTS = '''"""What kernels of `top` call."""

from typing import NamedTuple

from antumbra.kernels.jit import inlined, kernel, overloaded

SCALE = 3


class Pair(NamedTuple):
    a: int
    b: int


@inlined
def deep(x):
    """One more."""
    return x + 1  # one


@kernel
def middle(x):
    return deep(x) * 2


@overloaded("choices")
def chosen(x):
    raise NotImplementedError
'''
CHOICES = '''"""What `chosen` means."""

from antumbra.kernels.jit import overload

from .parts import chosen


def offset():
    return 5


@overload(chosen)
def _of_float(x):
    if str(x) == "float64":
        return lambda x: x + 10.0


@overload(chosen)
def _of_int(x):
    add = offset()
    return lambda x: x + add
'''
GUEST = '''"""A module that `parts` does not name gives `chosen` a meaning for a class of its own."""

from typing import NamedTuple

from antumbra.kernels.jit import overload

from .parts import chosen


class Guest(NamedTuple):
    n: int


@overload(chosen)
def _of_guest(x):
    if getattr(x, "instance_class", None) is Guest:
        return lambda x: x.n + 7
'''
TOP = '''"""Kernels that Python calls."""

import numpy as np

from antumbra.kernels.device import i64_at, thread_index
from antumbra.kernels.jit import kernel
from antumbra.kernels.toolchain.kernel_loading import events
from antumbra.kernels.parallel import items, new_ticket
from antumbra.kernels.simd import bits, load4, popcount, put, reduce_max, to_f32, as_i32

from . import choices, parts
from .guest import Guest
from .parts import SCALE, Pair, chosen, middle


@kernel
def on_a_device(a):
    put(i64_at(a), thread_index(), SCALE)


@kernel
def alone(x):
    return x + 100


@kernel
def by_call(x):
    return middle(x)


@kernel
def by_constant(x):
    return x * SCALE


@kernel
def by_module(x):
    return x * parts.SCALE


@kernel
def by_overload(x):
    return chosen(x)


@kernel
def by_guest_inside(x):
    return chosen(Guest(x + 1))


@kernel
def by_field(pair):
    return pair.a - pair.b


@kernel
def by_result(x):
    return Pair(x, x + 1)


@kernel
def by_intrinsic(xs):
    return popcount(bits(load4(xs, 0) < 2))


@kernel
def by_operator(xs):
    return reduce_max(load4(xs, 0) + load4(xs, 0))


@kernel
def by_loop(ticket):
    total = 0
    for i in items(ticket):
        total += i
    return total


def results():
    xs = np.arange(4, dtype=np.float32)
    return {
        "alone": alone(1),
        "by_call": by_call(1),
        "by_constant": by_constant(2),
        "by_module": by_module(2),
        "by_overload": by_overload(1),
        "by_guest": by_overload(Guest(1)),
        "by_guest_inside": by_guest_inside(1),
        "by_field": by_field(Pair(7, 2)),
        "by_result": by_result(1)._asdict(),
        "by_intrinsic": by_intrinsic(xs),
        "by_operator": by_operator(xs),
        "by_loop": by_loop(new_ticket(4, 2)),
    }
'''
RUN = """
import json, sys
from antumbra.sample import top
found = top.results()
name = lambda event: "by_guest" if "Guest" in event.key else event.kernel.rpartition(":")[2]
events = [(name(event), event.source) for event in top.events]
print(json.dumps([found, events, "numba" in sys.modules]))
"""


def write(folder: Path) -> Path:
    """Copy the package into a folder, with the kernels above as `antumbra.sample`; return the folder of `antumbra`."""
    package = folder / "antumbra"
    source = Path(antumbra.__file__).parent
    shutil.copytree(source, package, ignore=shutil.ignore_patterns("__pycache__", "libraries"))
    (package / "sample").mkdir()
    for name, text in {"__init__": "", "parts": PARTS, "choices": CHOICES, "guest": GUEST, "top": TOP}.items():
        (package / "sample" / f"{name}.py").write_text(text)
    return package


def edit(package: Path, file: str, old: str, new: str) -> None:
    """Replace a text that occurs once in a file of the package."""
    path = package / file
    text = path.read_text()
    assert text.count(old) == 1, (file, old)
    path.write_text(text.replace(old, new))


def environment(package: Path, cache: Path) -> dict[str, str]:
    """The environment of a process that imports a copy and keeps its kernels in the folder `cache`."""
    return dict(os.environ, PYTHONPATH=str(package.parent), ANTUMBRA_CACHE=str(cache), PYTHONDONTWRITEBYTECODE="1")


def run(package: Path, cache: Path) -> tuple[dict, dict[str, str], bool]:
    """Call all kernels in a new process; return (results, source of each kernel's code, whether Numba was imported)."""
    done = subprocess.run(
        [sys.executable, "-c", RUN], env=environment(package, cache), capture_output=True, text=True, cwd=package.parent
    )
    assert done.returncode == 0, done.stderr
    found, events, numba = json.loads(done.stdout)
    return found, dict(events), numba
