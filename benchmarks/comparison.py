"""Common helpers of the comparisons with peers: options, a header with versions and hardware, JSON, and a summary."""

import argparse
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

from antumbra.base.errors import InputError
from antumbra.kernels.parallel import thread_count
from common import machine
from peers.contenders import describe_embree
from peers.ray_contest import CLOCKS, OURS, summary
from views import VIEWS, views

AVX2 = {"ANTUMBRA_LEVEL": "x86-64-v3"}
"""Environment that restricts our kernels to AVX2."""


def options_of(parser: argparse.ArgumentParser, scenes=VIEWS) -> argparse.Namespace:
    """Parse the options of a script and the common options of all comparisons.

    With --isa avx2, the script restarts itself with `AVX2` in its environment, unless it is already set.

    scenes : accepted scene names
    """
    threads = lambda text: thread_count(None if text == "all" else int(text))
    parser.add_argument("scene", nargs="*", help=f"{', '.join(scenes)}, or files; default: all of these")
    parser.add_argument("--threads", nargs="+", type=threads, default=[1, thread_count(None)], help="numbers or 'all'")
    parser.add_argument("--size", type=int, nargs=2, default=(1024, 1024), metavar=("W", "H"))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--clock", choices=CLOCKS, default="wall", help="cpu: for one thread on a busy machine")
    parser.add_argument("--isa", choices=("avx2",), help="restrict ours and Embree to AVX2")
    parser.add_argument("--json", type=Path, help="also write the rows to this file")
    options = parser.parse_args()
    if options.clock == "cpu" and set(options.threads) != {1}:
        parser.error("--clock cpu adds up all threads; use it with --threads 1")
    options.threads = list(dict.fromkeys(options.threads))
    if options.isa == "avx2" and any(os.environ.get(k) != v for k, v in AVX2.items()):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **AVX2})
    return options


HEAD = f"{'contender':44s} {'Mrays/s':>8s} {'best':>8s} {'ratio':>6s} {'differs':>9s}"


def line(row: dict) -> str:
    """A row as a line of the table. A rate in brackets is from a single run."""
    median = f"{row['mrays']:.2f}" if row["rounds"] else f"({row['mrays']:.2f})"
    best = f"{row['best_mrays']:.2f}" if row["rounds"] else ""
    ratio = f"{row['ratio']:.2f}" if "ratio" in row else ""
    return f"{row['contender']:44s} {median:>8s} {best:>8s} {ratio:>6s} {row['differs']:9d}"


def progress(text: str) -> None:
    """Show a line on a terminal, overwriting the previous one."""
    if sys.stderr.isatty():
        print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


def start(main: Callable[[], None]) -> None:
    """Run a script's main function, and print an InputError as one line."""
    try:
        main()
    except InputError as error:
        sys.exit(f"error: {error}")


def compare(options: argparse.Namespace, measure: Callable, views_of: Callable = views) -> None:
    """Call ``measure(view, options)`` for each view of ``views_of``; print and write the returned rows."""
    about = {**machine(max(options.threads)), "isa": options.isa or "native"}
    about["embree"] = describe_embree(options.isa)
    print(", ".join(f"{k} {v}" for k, v in about.items()), flush=True)
    rows = []
    for view in views_of(options.scene, options.size):
        rows += measure(view, options)
        if options.json:  # after each scene, because a run takes long
            options.json.write_text(json.dumps({"machine": about, "rows": rows}, indent=1))
    print("\n" + "\n".join(summary(rows)))
    wrong = [row for row in rows if row["family"] == OURS and row["differs"]]
    if wrong:
        sys.exit(f"ours do not all give the same answers: {wrong}")
