"""A disk that is almost full."""

import os
import subprocess
from contextlib import contextmanager

import pytest


@contextmanager
def small_disk(folder, size: int):
    """Mount a file system of `size` bytes at a new folder; skip the test where the system does not allow it."""
    folder.mkdir()
    process = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "antumbra-test", str(folder)], capture_output=True, text=True
    )
    if process.returncode:
        pytest.skip(f"no file system can be mounted here: {process.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(folder) -> None:
    """Fill a disk to the last byte."""
    with open(os.path.join(folder, "filling"), "wb", buffering=0) as file:
        try:
            while file.write(bytes(4096)):
                pass
        except OSError:
            pass
