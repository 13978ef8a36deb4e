"""Checks of the packages of a release. Each raises a ReleaseError that names the file and the problem."""

import base64
import csv
import hashlib
import io
import json
import re
import sys
import zipfile
from email.parser import Parser
from pathlib import Path

from release_build import Package, ReleaseError, build_hook, run
from release_libraries import header_fault

MAX_MEGABYTES = {"sdist": 40, "pure": 4, "platform": 20}
"""Largest size of each kind of package. PyPI refuses files above 100 MB."""

_LIBRARIES, _DEVICES = "antumbra/kernels/libraries/", "devices/"
_PAGES = "antumbra/web/kernels/"


def check_package(package: Package, version: str) -> None:
    """Check a package's name and size and, of a wheel, its contents."""
    path, system = package
    tag = "any" if system is None else build_hook().TAGS[system]
    wheel = path.suffix == ".whl"
    expected = f"antumbra-{version}-py3-none-{tag}.whl" if wheel else f"antumbra-{version}.tar.gz"
    if path.name != expected:
        raise ReleaseError(f"{path.name}: should be named {expected}")
    kind = "sdist" if not wheel else "pure" if system is None else "platform"
    if path.stat().st_size > 1e6 * MAX_MEGABYTES[kind]:
        raise ReleaseError(f"{path.name}: has {path.stat().st_size / 1e6:.1f} MB, more than {MAX_MEGABYTES[kind]}")
    if wheel:
        with zipfile.ZipFile(path) as archive:
            check_record(archive, path.name)
            _check_tag(archive, path.name, tag)
            _check_libraries(archive, path.name, system, tag)


def check_record(archive: zipfile.ZipFile, name: str) -> None:
    """Check that RECORD lists all files of a wheel, each once, with its size and SHA-256."""
    (record,) = [each for each in archive.namelist() if each.endswith(".dist-info/RECORD")]
    rows = list(csv.reader(io.StringIO(archive.read(record).decode())))
    listed = [row[0] for row in rows]
    if sorted(listed) != sorted(archive.namelist()):
        different = sorted(set(listed) ^ set(archive.namelist())) or ["a file twice"]
        raise ReleaseError(f"{name}: RECORD and the archive differ in {different[0]}")
    for file, digest, size in rows:
        data = archive.read(file)
        sha256 = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
        if file != record and (digest, size) != (f"sha256={sha256}", str(len(data))):
            raise ReleaseError(f"{name}: RECORD has another size or digest of {file}")


def _check_tag(archive: zipfile.ZipFile, name: str, tag: str) -> None:
    """Check that the metadata have the tag of the file's name."""
    (file,) = [each for each in archive.namelist() if each.endswith(".dist-info/WHEEL")]
    fields = Parser().parsestr(archive.read(file).decode())
    found = fields.get_all("Tag"), fields["Root-Is-Purelib"]
    if found != ([f"py3-none-{tag}"], str(tag == "any").lower()):
        raise ReleaseError(f"{name}: its metadata have the tags {found[0]}, and Root-Is-Purelib {found[1]}")


def _check_libraries(archive: zipfile.ZipFile, name: str, system: str | None, tag: str) -> None:
    """Check that there is a library for each level of the system, for its machines, of the sources in the wheel."""
    from antumbra.kernels.machine_code import SYSTEMS
    from antumbra.kernels.toolchain.kernel_library import LIST
    from antumbra.kernels.toolchain.kernel_manifest import package_manifest
    from antumbra.kernels.toolchain.library_build import LINKERS

    found = {each.removeprefix(_LIBRARIES) for each in archive.namelist() if each.startswith(_LIBRARIES)}
    devices = {each.removeprefix(_DEVICES) for each in found if each.startswith(_DEVICES)}
    found = {each for each in found if not each.startswith(_DEVICES)}
    levels = () if system is None else SYSTEMS[system].levels
    expected = {f"libantumbra-{level}{LINKERS[system].suffix}" for level in levels}
    if found != (expected | {LIST} if expected else set()):
        raise ReleaseError(f"{name}: has the libraries {sorted(found)}, not {sorted(expected)}")
    if not expected:
        return
    for library in expected:
        data = archive.read(_LIBRARIES + library)
        if fault := header_fault(data, tag):
            raise ReleaseError(f"{name}: {library} cannot be released: {fault}")
        _check_paths(data, name, library)
    contents = json.loads(archive.read(_LIBRARIES + LIST))
    if contents["digest"] != _digest_inside(archive, contents["files"]):
        raise ReleaseError(f"{name}: its libraries are of other sources than those beside them")
    if len(contents["kernels"]) != len(package_manifest().kernels):
        raise ReleaseError(f"{name}: has {len(contents['kernels'])} kernels, not {len(package_manifest().kernels)}")
    _check_devices(archive, name, devices)
    _check_pages(archive, name)


def _check_paths(data: bytes, name: str, file: str) -> None:
    """Check that a file contains no path of the machine that built it."""
    if paths := re.findall(rb"/(?:home|root|tmp|work|Users)/[\w./-]+", data):
        raise ReleaseError(f"{name}: {file} contains the path {paths[0].decode()}")


def _check_pages(archive: zipfile.ZipFile, name: str) -> None:
    """Check that there is the module of pages, of the sources in the wheel."""
    from antumbra.kernels.toolchain.kernel_library import LIST, MODULE

    files = (each.filename for each in archive.filelist)  # `namelist` has folders, too, after `zipfile.Path`
    found = {each.removeprefix(_PAGES) for each in files if each.startswith(_PAGES)}
    if found != {MODULE, LIST}:
        raise ReleaseError(f"{name}: has {sorted(found)} for pages, not {sorted((MODULE, LIST))}")
    _check_paths(archive.read(_PAGES + MODULE), name, MODULE)
    contents = json.loads(archive.read(_PAGES + LIST))
    if contents["digest"] != _digest_inside(archive, contents["files"]):
        raise ReleaseError(f"{name}: its kernels of pages are of other sources than those beside them")


def _check_devices(archive: zipfile.ZipFile, name: str, found: set[str]) -> None:
    """Check that there is PTX and SPIR-V of each kernel of devices, of the sources in the wheel."""
    from antumbra.kernels.toolchain.device_code import FORMS
    from antumbra.kernels.toolchain.kernel_library import LIST
    from antumbra.kernels.toolchain.kernel_manifest import package_manifest

    if LIST not in found:
        raise ReleaseError(f"{name}: has no list of the kernels of devices")
    contents = json.loads(archive.read(_LIBRARIES + _DEVICES + LIST))
    expected = {f"{symbol}.{form}" for symbol, _ in contents["kernels"].values() for form in FORMS}
    if found != expected | {LIST}:
        raise ReleaseError(f"{name}: has the device code {sorted(found)}, not {sorted(expected)}")
    if contents["digest"] != _digest_inside(archive, contents["files"]):
        raise ReleaseError(f"{name}: its device code is of other sources than those beside it")
    if len(contents["kernels"]) != len(package_manifest().devices):
        found_kernels, recorded = len(contents["kernels"]), len(package_manifest().devices)
        raise ReleaseError(f"{name}: has {found_kernels} kernels of devices, not {recorded}")


def _digest_inside(archive: zipfile.ZipFile, files: list[str]) -> str:
    """`kernel_library.digest_of` for files in a wheel."""
    from antumbra.kernels.toolchain.kernel_library import digest_of

    return digest_of(zipfile.Path(archive, "antumbra/"), files)


def check_same_sources(wheels: list[Path]) -> None:
    """Check that all wheels have the same files, except for libraries and what names the tag."""
    contents = []
    for path in wheels:
        with zipfile.ZipFile(path) as archive:
            own = _LIBRARIES, _PAGES, ".dist-info/RECORD", ".dist-info/WHEEL"
            names = [name for name in archive.namelist() if not any(part in name for part in own)]
            contents.append({name: archive.getinfo(name).CRC for name in names})
    for path, each in zip(wheels, contents):
        if different := sorted(name for name in each.keys() | contents[0] if each.get(name) != contents[0].get(name)):
            raise ReleaseError(f"{path.name}: its {different[0]} differs from the one in {wheels[0].name}")


def check_same_bytes(first: Path, second: Path) -> None:
    """Check that two builds of a package have the same bytes."""
    if first.read_bytes() != second.read_bytes():
        raise ReleaseError(
            f"{first.name}: two builds of it differ; something in them depends on the time or the folder"
        )


def check_with_tools(packages: list[Package]) -> None:
    """Check packages with twine, and wheels with check-wheel-contents."""
    run([sys.executable, "-m", "twine", "check", "--strict", *(each.path for each in packages)], "twine check")
    for package in packages:
        if package.path.suffix == ".whl":  # W004: kernel libraries are no modules, and have hyphens in their names
            ignored = [] if package.system is None else ["--ignore", "W004"]
            command = [sys.executable, "-m", "check_wheel_contents", *ignored, package.path]
            run(command, f"check-wheel-contents of {package.path.name}")
