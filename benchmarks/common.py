"""Helpers of all benchmarks: the folder of real scenes, the description of the machine, and common options."""

import argparse
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import antumbra
from antumbra.cli.installation_commands import about
from antumbra.papers.peers import embree

SCENES = Path(os.environ.get("ANTUMBRA_SCENES", Path(__file__).resolve().parents[2] / "shared" / "scenes"))
"""The folder of real scenes: $ANTUMBRA_SCENES, or ../shared/scenes beside the repository."""


def machine(threads: int) -> dict:
    """Versions and hardware for the JSON file."""
    return {**about(), "threads": threads}


@cache  # so that the line is printed once
def installed(library: Callable) -> bool:
    """Whether ``library()`` finds the peer. If it does not, a line says that the peer is left out."""
    try:
        library()
    except antumbra.InputError as error:
        print(f"left out: {error}", file=sys.stderr)
        return False
    return True


def has_embree() -> bool:
    """Whether Embree is installed. If it is not, a line says that it is left out."""
    return installed(embree.library)


def arguments(description: str) -> argparse.ArgumentParser:
    """An argument parser with the options of every comparison."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("scene", nargs="*", type=Path)
    parser.add_argument("--threads", type=int, default=None, help="default: all cores")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--json", type=Path, help="write the rows here too")
    return parser
