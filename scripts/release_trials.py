"""Trials of `scripts/release`: packages installed in bare environments, whose pictures must be those of the sources."""

import json
import os
import shutil
import sys
from contextlib import suppress
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

from release_build import ReleaseError, Source, run

_OF_EXTRAS = """
import importlib.metadata as metadata, re
name_of = lambda text: re.match(r"[\\w.-]+", text)[0].lower().replace("_", "-")
lines = metadata.requires("antumbra")
hard = {name_of(line) for line in lines if "extra ==" not in line}
installed = {name_of(each.name) for each in metadata.distributions()}
print(*sorted(({name_of(line) for line in lines} - hard - {"antumbra"}) & installed))
"""


class Environment(NamedTuple):
    """A virtual environment without pip."""

    folder: Path
    python: Path

    def packages_of_extras(self) -> list[str]:
        """The installed packages that only extras require, such as the compiler."""
        return run([self.python, "-c", _OF_EXTRAS], "listing packages", env=clean_environment()).split()

    def megabytes(self) -> float:
        """The size of the environment."""
        return sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file()) / 1e6


class Trial(NamedTuple):
    """A package that was installed and has rendered the default picture."""

    package: str  # file, and extra
    environment: Environment
    version: str  # of Python
    seconds: float  # from the start of the process to the picture

    def __str__(self) -> str:
        size = f"{self.environment.megabytes():.0f} MB"
        return f"{self.package} in Python {self.version}: picture in {self.seconds:.1f} s, environment of {size}"


def clean_environment(**settings: str) -> dict[str, str]:
    """This process's variables without Python's and Antumbra's, and with settings."""
    env = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "ANTUMBRA_", "VIRTUAL_"))
    }
    return env | settings


def make_environment(folder: Path, python: Path | str, requirement: str) -> Environment:
    """Create an environment for an interpreter, and install a package with its dependencies in it."""
    run([python, "-m", "venv", "--without-pip", folder], f"{python} -m venv", env=clean_environment())
    windows = sys.platform == "win32"
    environment = Environment(folder, folder / ("Scripts/python.exe" if windows else "bin/python"))
    pip = [sys.executable, "-m", "pip", "--python", environment.python, "install", "--quiet", requirement]
    run(pip, f"pip install {Path(requirement).name}", env=clean_environment())
    return environment


def default_picture(python: Path | str, folder: Path, **settings: str) -> bytes:
    """The PNG file of ``antumbra render``, in a new folder."""
    folder.mkdir()
    words = [python, "-m", "antumbra", "render", "--quiet", "--output", "picture.png"]
    run(words, f"{python} -m antumbra render", folder, clean_environment(**settings))
    return (folder / "picture.png").read_bytes()


def picture_of_sources(source: Source, folder: Path) -> bytes:
    """The default picture by the sources of the release, in this process's interpreter."""
    return default_picture(sys.executable, folder, PYTHONPATH=str(source.root / "src"))


def try_package(package: Path, extra: str, python: Path | str, work: Path, expected: bytes) -> Trial:
    """Install a package in a bare environment in `work`, and render the default picture; it must be the expected one.

    A wheel with kernels must also write a page.

    extra : "" for a wheel with kernels: it must do without the packages of extras and without the user's cache
    """
    work.mkdir()
    name = f"{package.name}[{extra}]" if extra else package.name
    environment = make_environment(work / "environment", python, f"{package}[{extra}]" if extra else str(package))
    if not extra and (more := environment.packages_of_extras()):
        raise ReleaseError(f"{name}: installing it also installs {more[0]}, which only an extra should")
    cache = work / "cache"
    start = perf_counter()
    picture = default_picture(environment.python, work / "picture", **({} if extra else {"ANTUMBRA_CACHE": str(cache)}))
    seconds = perf_counter() - start
    if picture != expected:
        raise ReleaseError(f"{name}: its picture differs from that of the sources")
    if list(cache.rglob("*.kernel")):
        raise ReleaseError(f"{name}: lacks kernels of the default picture")
    if not extra:
        words = [
            environment.python,
            "-m",
            "antumbra",
            "page",
            "procedural:atrium?triangles=100",
            "-q",
            "-o",
            "page.html",
        ]
        run(words, f"{name}: antumbra page", work, clean_environment(ANTUMBRA_CACHE=str(cache)))
    return Trial(name, environment, version_of(environment.python), seconds)


_VERSION = """
import sys, sysconfig
print("%d.%d.%d" % sys.version_info[:3] + "t" * bool(sysconfig.get_config_var("Py_GIL_DISABLED")))
"""


def version_of(python: Path) -> str:
    """The version of an interpreter, with a t if it is free-threaded."""
    return run([python, "-c", _VERSION], str(python), env=clean_environment()).strip()


def find_pythons(named: list[str]) -> list[Path]:
    """Interpreters to try: this one and those that are named, or else one of each minor version that is found.

    Searched are python3.11 to python3.14t on the PATH, and those that uv has installed. Raises ReleaseError if a named
    one is missing.
    """
    if missing := [name for name in named if not shutil.which(name)]:
        raise ReleaseError(f"{missing[0]}: no such Python; give a path, or a name on the PATH")
    names = named or [f"python3.{minor}{thread}" for minor in range(11, 15) for thread in ("", "t")]
    paths = [Path(sys.executable), *(Path(path) for name in names if (path := shutil.which(name)))]
    if not named and shutil.which("uv"):
        command = ["uv", "python", "list", "--only-installed", "--output-format", "json"]
        paths += [Path(each["path"]) for each in json.loads(run(command, "uv python list"))]
    pythons: dict[tuple[object, ...], Path] = {}
    for path in paths:
        with suppress(ReleaseError):  # a shim of a version that is not installed
            version = version_of(path)
            minor = tuple(int(part) for part in version.rstrip("t").split(".")[:2])
            if minor >= (3, 11):
                pythons.setdefault((version,) if named else (minor, version.endswith("t")), path)
    return list(pythons.values())
