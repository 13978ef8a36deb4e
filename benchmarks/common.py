"""Common helpers of the benchmarks: the folder of real scenes, the machine description, and options."""

import argparse
import os
import shlex
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import antumbra
from antumbra.cli.installation_commands import about
from peers import embree

SCENES = Path(os.environ.get("ANTUMBRA_SCENES", Path(__file__).resolve().parents[2] / "shared" / "scenes"))
"""The folder of real scenes: $ANTUMBRA_SCENES, or ../shared/scenes beside the repository."""


def machine(threads: int) -> dict:
    """The command, date, versions and hardware for the JSON file."""
    return {"command": command_line(), "date": f"{datetime.now(UTC):%Y-%m-%d}", **about(), "threads": threads}


def command_line() -> str:
    """The command of this process, without the folders of its script and of its files of results."""
    words = [f"benchmarks/{Path(sys.argv[0]).name}", *sys.argv[1:]]
    kept = [word for before, word in zip(["", *words], words) if "--json" not in (before, word)]
    return shlex.join(["python", *kept])


@cache  # print the message once
def installed(library: Callable[[], object]) -> bool:
    """Whether ``library()`` finds the peer; otherwise prints that the peer is skipped."""
    try:
        library()
    except antumbra.InputError as error:
        print(f"skipped: {error}", file=sys.stderr)
        return False
    return True


def has_embree() -> bool:
    """Whether Embree is installed; otherwise prints that it is skipped."""
    return installed(embree.library)


def arguments(description: str) -> argparse.ArgumentParser:
    """An argument parser with the common options of the benchmarks."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("scene", nargs="*", type=Path)
    parser.add_argument("--threads", type=int, default=None, help="default: all cores")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--json", type=Path, help="also write the rows to this file")
    return parser
