"""The input files of some work on a node: found in the arguments, opened by path, or fetched once to the node's disk.

Arguments name files by a path, or in text such as ``city.json?lod=2.2`` or ``raster:dem.tif+1.6``.
"""

import hashlib
import os
import platform
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NamedTuple

from ..base import wings
from ..base.errors import InputError
from ..base.files import atomic_output, check_trusted, file_lock, make_folder, private_folder
from ..base.progress import LOG
from ..store.store_format import STORE_SUFFIX, TILES_SUFFIX

# --- Files on a node --------------------------------------------------------------------------------------------------


PIECE = 8 << 20  # bytes fetched at once

_HEADER = 4096  # bytes of the first page of a store, with the checksum of all chunk checksums
_REFERRING = ".gltf", ".obj", ".vrt", TILES_SUFFIX  # suffixes of files that may refer to others


def refers_to_files(path: Path) -> bool:
    """Whether a file, by its suffix, may refer to others."""
    return path.suffix.lower() in _REFERRING


class Input(NamedTuple):
    """A file that some work reads, as it is on the driver."""

    path: str  # absolute
    size: int  # bytes; -1: a folder
    sha256: str  # of the whole file
    header: str  # of a store: SHA-256 of its first page, which identifies it without reading the rest; else empty


def input_of(path: Path) -> Input:
    """The identity of a file or folder."""
    path = path.resolve()
    if path.is_dir():
        return Input(str(path), -1, "", "")
    header = _header(path) if path.suffix.lower() == STORE_SUFFIX else ""
    return Input(str(path), path.stat().st_size, _sum(path), header)


def local_path(source: Input, read: Callable[[str, int], bytes], folder: Path | None = None) -> str:
    """The path of an input on this node.

    If the same file exists at its path, it is used; otherwise it is fetched, unless earlier work did so.

    read : function of (path, offset) that returns up to `PIECE` bytes of the driver's file
    folder : folder for fetched files; None: in the folder for temporary files

    Raises
    ------
    InputError
        If a folder or a file that refers to others is missing, or if the fetched file has a different checksum.
    """
    path = Path(source.path)
    if (source.size < 0 and path.is_dir()) or _is_same(path, source):
        return source.path
    if source.size < 0 or refers_to_files(path):
        raise InputError(
            f"{path}: is not on node {platform.node()}, and names other files; share it, or use a single file, "
            "such as .glb or .tif"
        )
    folder = (folder or user_temporary_folder() / "inputs") / source.sha256
    make_folder(folder)
    target = folder / path.name
    with file_lock(folder / "fetching.lock"):  # another worker of this machine may be fetching it
        if not _is_same(target, source):
            _fetch(source, read, target)
    return str(target)


def user_temporary_folder() -> Path:
    """The user's folder for temporary files, shared by all of the user's processes.

    Anyone may have created a folder of this name. If it belongs to another user, use a folder of this process alone.
    """
    folder = Path(tempfile.gettempdir()) / f"antumbra-{getattr(os, 'getuid', int)()}"  # Windows has no ids
    try:
        make_folder(folder)
        check_trusted(folder, folder.lstat())
        if not os.access(folder, os.W_OK):
            raise PermissionError(f"{folder} is not writable")
    except OSError as error:
        LOG.warning(f"{error}: files are fetched for this process alone")
        return private_folder("inputs")
    return folder


def _fetch(source: Input, read: Callable[[str, int], bytes], target: Path) -> None:
    if shutil.disk_usage(target.parent).free < source.size:
        raise InputError(f"{target.parent}: has no room for {source.path} ({source.size >> 20} MiB); set TMPDIR")
    digest = hashlib.sha256()
    with atomic_output(target) as temporary, open(temporary, "wb") as out:
        for offset in range(0, source.size, PIECE):
            piece = read(source.path, offset)
            digest.update(piece)
            out.write(piece)
        if digest.hexdigest() != source.sha256:
            raise InputError(f"{source.path}: changed while it was fetched; run the command again")


def piece_of(path: str, offset: int) -> bytes:
    """Up to `PIECE` bytes of a file."""
    with open(path, "rb") as file:
        file.seek(offset)
        return file.read(PIECE)


def _is_same(path: Path, source: Input) -> bool:
    try:
        if path.stat().st_size != source.size:
            return False
        return _header(path) == source.header if source.header else _sum(path) == source.sha256
    except OSError:
        return False


def _header(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.sha256(file.read(_HEADER)).hexdigest()


def _sum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# --- Files in arguments -----------------------------------------------------------------------------------------------


INPUTS = (
    *("scene", "scenes", "add", "terrain", "sensors", "targets", "areas", "epw", "sky", "trees", "points", "line"),
    *("modules", "observers", "along", "pairs", "turbines", "polygon", "camera_path"),
)
"""Arguments of work, on the command line or in Python, that may name an input file or folder."""


def files_in(named: Mapping[str, Any], names: Iterable[str] = INPUTS) -> dict[str, Path]:
    """Argument -> the existing file or folder that it names; those of a list are numbered: "terrain 0".

    names : of the arguments that may name files
    """
    paths = {key: _path_in(each) for name in names for key, each in _numbered(name, named.get(name))}
    return {key: Path(path) for key, path in paths.items() if path and Path(path).exists()}


def with_files(named: Mapping[str, Any], paths: Mapping[str, str]) -> dict[str, Any]:
    """The arguments that name files, with the paths replaced.

    paths : argument, numbered as by `files_in` -> path
    """

    def moved(key: str, value: Any) -> Any:
        if key not in paths:
            return value
        return value.replace(_path_in(value), paths[key], 1) if isinstance(value, str) else Path(paths[key])

    found = dict[str, Any]()
    for name, value in named.items():
        pairs = _numbered(name, value)
        if any(key in paths for key, _ in pairs):
            values = [moved(*pair) for pair in pairs]
            found[name] = values if isinstance(value, list) else values[0]
    return found


def _numbered(name: str, value: Any) -> list[tuple[str, Any]]:
    return [(f"{name} {i}", each) for i, each in enumerate(value)] if isinstance(value, list) else [(name, value)]


def _path_in(value: Any) -> str:
    """The path in an argument; empty if it is neither a path nor a string."""
    if isinstance(value, str):
        named = (wings.named(place)(value) for place in wings.FILES_IN_TEXTS)
        return next(filter(None, named), value.partition("?")[0])
    return fspath(value) if isinstance(value, PathLike) else ""
