"""What the headers of shared libraries say: their system, processor and oldest supported version of the system."""

import re
import struct
from typing import NamedTuple


class LibraryHeader(NamedTuple):
    """The facts of a shared library that decide where it can be loaded."""

    system: str  # as in wheel tags: manylinux, macosx, win
    machine: str  # x86_64 or aarch64
    oldest: tuple[int, int] | None  # glibc or macOS that it needs; None: not recorded
    signed: bool  # whether a Mach-O file has a signature, which Apple silicon requires


_ELF = {62: "x86_64", 183: "aarch64"}
_MACH_O = {0x01000007: "x86_64", 0x0100000C: "aarch64"}
_PE = {0x8664: "x86_64", 0xAA64: "aarch64"}
_CODE_SIGNATURE, _VERSION_MIN_MACOS, _BUILD_VERSION = 0x1D, 0x24, 0x32


def read_header(data: bytes) -> LibraryHeader:
    """The header of an ELF, Mach-O or PE file of 64 bits. Raises ValueError for other data."""
    try:
        if data.startswith(b"\x7fELF\x02\x01"):
            return _elf(data)
        if data.startswith(b"\xcf\xfa\xed\xfe"):
            return _mach_o(data)
        if data.startswith(b"MZ"):
            return _pe(data)
    except (struct.error, KeyError):
        raise ValueError("its header is damaged, or of another processor") from None
    raise ValueError("it is not a shared library")


def _elf(data: bytes) -> LibraryHeader:
    (machine,) = struct.unpack_from("<H", data, 18)
    versions = [(int(a), int(b)) for a, b in re.findall(rb"GLIBC_(\d+)\.(\d+)", data)]
    return LibraryHeader("manylinux", _ELF[machine], max(versions, default=None), False)


def _mach_o(data: bytes) -> LibraryHeader:
    processor, n_commands = struct.unpack_from("<4xI8xI", data)
    oldest, signed, at = None, False, 32
    for _ in range(n_commands):
        command, size = struct.unpack_from("<II", data, at)
        signed |= command == _CODE_SIGNATURE
        if command in (_VERSION_MIN_MACOS, _BUILD_VERSION):
            (version,) = struct.unpack_from("<I", data, at + (12 if command == _BUILD_VERSION else 8))
            oldest = version >> 16, version >> 8 & 0xFF
        at += size
    return LibraryHeader("macosx", _MACH_O[processor], oldest, signed)


def _pe(data: bytes) -> LibraryHeader:
    (at,) = struct.unpack_from("<I", data, 0x3C)
    signature, machine = struct.unpack_from("<4sH", data, at)
    if signature != b"PE\0\0":
        raise KeyError(signature)
    return LibraryHeader("win", _PE[machine], None, False)


_TAG = re.compile(r"(manylinux|macosx|win)_?(?:(\d+)_(\d+)_)?(\w+)")
_PROCESSORS = {"amd64": "x86_64", "arm64": "aarch64"}


def header_fault(data: bytes, tag: str) -> str | None:
    """Why a library does not run on every machine that a platform tag names; None if it does."""
    try:
        header = read_header(data)
    except ValueError as error:
        return str(error)
    match = _TAG.fullmatch(tag)
    if match is None:
        return f"the tag {tag} is unknown"
    system, major, minor, processor = match.groups()
    processor = _PROCESSORS.get(processor, processor)
    if (header.system, header.machine) != (system, processor):
        return f"it is for {header.system} {header.machine}, not {system} {processor}"
    if header.oldest and major and header.oldest > (int(major), int(minor)):
        return f"it needs {system} {header.oldest[0]}.{header.oldest[1]}, not {major}.{minor}"
    if (system, processor) == ("macosx", "aarch64") and not header.signed:
        return "it has no signature, so Apple silicon does not load it"
    return None
