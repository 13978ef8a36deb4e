#!/usr/bin/env python3
"""Compare the bits of the aarch64 kernel library, under QEMU, with those of the x86-64 libraries.

    python scripts/cross_bits.py [--folder FOLDER]

It builds the libraries of both systems, runs `tests/support/bits_probe.py` natively at every level of this processor
and, for aarch64, in Debian's Python with NumPy's and Pillow's own wheels, and compares about a hundred digests. It
needs an x86-64 Debian or Ubuntu machine with ``qemu-aarch64-static``, the extra ``build``, and network access to
Debian's and Python's package indexes; what it downloads stays in the folder. Exit code: 0 for equal bits, 1 for
differences, 2 if nothing was compared. QEMU takes a quarter of an hour or more.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from antumbra.kernels.processor import level, usable

ROOT = Path(__file__).resolve().parents[1]
PROBE = ROOT / "tests" / "support" / "bits_probe.py"
SUITE, PYTHON = "trixie", "3.13"  # a Debian release and its Python
PACKAGES = "python3", "libstdc++6", "zlib1g"
KEYRING = "/usr/share/keyrings/debian-archive-keyring.gpg"
TOOLS = "qemu-aarch64-static", "apt-get", "dpkg-deb"


def run(*command: object, **more: str) -> str:
    """The output of a command, with additional environment variables. Raises RuntimeError if it fails."""
    done = subprocess.run([str(word) for word in command], env={**os.environ, **more}, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{command[0]} failed: {done.stderr.strip() or done.stdout.strip()}")
    return done.stdout


def debian_root(folder: Path) -> Path:
    """A folder with the arm64 packages that Python needs, unpacked but not installed."""
    root, state = folder / "root", folder / "apt"
    if (root / "usr" / "bin" / f"python{PYTHON}").exists():
        return root
    for path in (root / "usr" / "lib", state / "lists" / "partial", state / "archives" / "partial"):
        path.mkdir(parents=True, exist_ok=True)
    (state / "status").touch()
    (state / "sources").write_text(f"deb [signed-by={KEYRING}] http://deb.debian.org/debian {SUITE} main\n")
    options = {
        "APT::Architecture": "arm64", "APT::Architectures": "arm64", "APT::Install-Recommends": "false",
        "APT::Sandbox::User": "root", "Acquire::Languages": "none", "Debug::NoLocking": "true",
        "Dir::Etc::SourceList": state / "sources", "Dir::Etc::SourceParts": "-", "Dir::State": state,
        "Dir::State::status": state / "status", "Dir::Cache": state,
    }  # fmt: skip
    apt = ["apt-get", "-q=2", *(f"-o{name}={value}" for name, value in options.items())]
    run(*apt, "update")
    run(*apt, "--yes", "--download-only", "install", *PACKAGES)
    for package in (state / "archives").glob("*.deb"):
        run("dpkg-deb", "-x", package, root)
    if not (root / "lib").exists():
        (root / "lib").symlink_to("usr/lib")
    return root


def wheels(folder: Path) -> Path:
    """A folder with NumPy and Pillow for the emulated Python."""
    site = folder / "site"
    if not site.exists():
        platforms = [f"--platform=manylinux_2_{n}_aarch64" for n in (17, 27, 28, 31)]
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--only-binary=:all:"]
        run(*command, *platforms, f"--python-version={PYTHON}", f"--target={site}", "numpy", "pillow")
    return site


def package(folder: Path, system: str) -> Path:
    """A folder with the package and a system's kernel libraries."""
    out = folder / system
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(ROOT / "src" / "antumbra", out / "antumbra", ignore=shutil.ignore_patterns("libraries"))
    levels = [f"--level={each}" for each in usable(level())] if system == "linux-x86_64" else []
    build = [sys.executable, "-m", "antumbra.kernels.toolchain.library_build", f"--system={system}", *levels]
    run(*build, "--out", out / "antumbra" / "kernels" / "libraries", PYTHONPATH=str(out))
    return out


def digests(output: str) -> dict[str, str]:
    """The digests that the probe has printed."""
    return dict(json.loads(line) for line in output.splitlines())


def compare(folder: Path) -> bool:
    """Whether all levels of this processor and the emulated one give the same bits."""
    root, site = debian_root(folder), wheels(folder)
    native, foreign = package(folder, "linux-x86_64"), package(folder, "linux-aarch64")
    found = {}
    for each in usable(level()):
        found[each] = digests(run(sys.executable, PROBE, PYTHONPATH=str(native), ANTUMBRA_LEVEL=each))
    python = root / "usr" / "bin" / f"python{PYTHON}"
    emulated = run(TOOLS[0], "-L", root, python, PROBE, PYTHONPATH=f"{foreign}:{site}", ANTUMBRA_LEVEL="aarch64")
    found["aarch64"] = digests(emulated)
    first = next(iter(found.values()))
    for name, answers in found.items():
        different = sorted(key for key in first.keys() | answers.keys() if answers.get(key) != first.get(key))
        print(f"{name}: {len(answers)} digests, {len(different)} different{': ' if different else ''}{different or ''}")
    missing = [each for each in ("x86-64-v2", "x86-64-v3", "x86-64-v4") if each not in found]
    if missing:
        print(f"NOT run, because this processor lacks it: {', '.join(missing)}")
    return all(answers == first for answers in found.values())


def main() -> int:
    """Compare, or say why not."""
    parser = argparse.ArgumentParser(description="Compare the bits of kernel libraries across processors.")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "cross-bits")
    folder = parser.parse_args().folder.resolve()
    lacking = [tool for tool in TOOLS if shutil.which(tool) is None]
    if lacking:
        print(f"NOT COMPARED: {', '.join(lacking)} not found")
        return 2
    try:
        return 0 if compare(folder) else 1
    except (RuntimeError, OSError) as error:
        print(f"NOT COMPARED: {error}")
        return 2


if __name__ == "__main__":
    sys.exit(main())
