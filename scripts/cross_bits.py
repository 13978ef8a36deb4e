#!/usr/bin/env python3
"""Compare the bits of the kernel libraries of all systems and levels.

    python scripts/cross_bits.py [--folder FOLDER] [--system NAME]...

It builds the libraries, runs `tests/support/bits_probe.py` with each of them, and compares about a hundred digests:

- x86-64 libraries natively, at every level of this processor; those for macOS and Windows as images in memory
  (`library_images.py`), so their code is tested, but neither their loader nor their Python;
- libraries for ARM under QEMU, in Debian's Python with NumPy's and Pillow's own wheels, a quarter of an hour each.

It needs an x86-64 Debian or Ubuntu machine with ``qemu-aarch64-static``, the extra ``release``, and network access to
Debian's and Python's package indexes; what it downloads stays in the folder. Exit code: 0 for equal bits, 1 for
differences, 2 if nothing was compared.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from library_images import image_of

from antumbra.kernels.machine_code import SYSTEMS
from antumbra.kernels.processor import level, usable

ROOT = Path(__file__).resolve().parents[1]
PROBE = ROOT / "tests" / "support" / "bits_probe.py"
SUITE, PYTHON = "trixie", "3.13"  # a Debian release and its Python
PACKAGES = "python3", "libstdc++6", "zlib1g"
KEYRING = "/usr/share/keyrings/debian-archive-keyring.gpg"
TOOLS = "qemu-aarch64-static", "apt-get", "dpkg-deb"
ARM = "aarch64", "arm64"  # how systems that are emulated end


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


def levels_of(system: str) -> list[str]:
    """The levels of a system that run here, natively or emulated."""
    return [each for each in SYSTEMS[system].levels if each in usable(level()) or system.endswith(ARM)]


def package(folder: Path, system: str) -> Path:
    """A folder with the package and a system's kernel libraries."""
    out = folder / system
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(ROOT / "src" / "antumbra", out / "antumbra", ignore=shutil.ignore_patterns("libraries"))
    levels = [f"--level={each}" for each in levels_of(system)]
    build = [sys.executable, "-m", "antumbra.kernels.toolchain.library_build", f"--system={system}", *levels]
    run(*build, "--out", out / "antumbra" / "kernels" / "libraries", PYTHONPATH=str(out))
    return out


def digests(output: str) -> dict[str, str]:
    """The digests that the probe has printed."""
    return dict(json.loads(line) for line in output.splitlines())


def answers_of(folder: Path, system: str) -> dict[str, dict[str, str]]:
    """System and level -> the digests with its library."""
    home, found = package(folder, system), dict[str, dict[str, str]]()
    python, path = [sys.executable], str(home)
    if system.endswith(ARM):
        root = debian_root(folder)
        python = [TOOLS[0], "-L", str(root), str(root / "usr" / "bin" / f"python{PYTHON}")]
        path = f"{home}:{wheels(folder)}"
    libraries = home / "antumbra" / "kernels" / "libraries"
    for each in levels_of(system):
        image = []
        if not system.startswith("linux"):
            (library,) = libraries.glob(f"*{each}.d*")
            image_of(library).save(libraries / f"{each}.npz")
            image = ["--image", libraries / f"{each}.npz"]
        output = run(*python, PROBE, *image, PYTHONPATH=path, ANTUMBRA_LEVEL=each)
        found[f"{system} {each}"] = digests(output)
    return found


def compare(folder: Path, systems: list[str]) -> bool:
    """Whether the libraries of systems give the same bits, at all levels that run here."""
    first: dict[str, str] = {}
    equal = True
    for system in systems:
        for name, answers in answers_of(folder, system).items():
            first = first or answers
            different = sorted(key for key in first.keys() | answers.keys() if answers.get(key) != first.get(key))
            equal &= not different
            print(f"{name}: {len(answers)} digests, {len(different)} different{': ' if different else ''}", end="")
            print(", ".join(different), flush=True)
    missing = [each for each in SYSTEMS["linux-x86_64"].levels if each not in usable(level())]
    if missing:
        print(f"NOT run, because this processor lacks it: {', '.join(missing)}")
    return equal


def main() -> int:
    """Compare, or say why not."""
    parser = argparse.ArgumentParser(description="Compare the bits of kernel libraries across processors.")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "cross-bits")
    parser.add_argument("--system", action="append", choices=list(SYSTEMS), help="repeatable; default: all")
    options = parser.parse_args()
    folder, systems = options.folder.resolve(), options.system or list(SYSTEMS)
    emulated = any(system.endswith(ARM) for system in systems)
    lacking = [tool for tool in TOOLS if emulated and shutil.which(tool) is None]
    if lacking:
        print(f"NOT COMPARED: {', '.join(lacking)} not found")
        return 2
    try:
        return 0 if compare(folder, systems) else 1
    except (RuntimeError, OSError) as error:
        print(f"NOT COMPARED: {error}")
        return 2


if __name__ == "__main__":
    sys.exit(main())
