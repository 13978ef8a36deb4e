"""Checked access to GDAL's rasters: which files rasterio opens, with which driver, and what they may refer to.

GDAL chooses a driver by the content of a file, not by its suffix. Several drivers read descriptions that name other
files or addresses, and so do the files that GDAL reads beside a raster. A raster is therefore opened only if it starts
as its suffix says, with the driver of that suffix; a .vrt file as `vrt_files` rewrites it; and masks and overviews
beside it only if they are TIFF files.

A TIFF file that the user names by a URL is read by window. GDAL then opens nothing beside it.
"""

import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.files import checked_file
from ...base.memory import check_reading
from ...base.remote_files import gdal_name, unreachable, url_of
from ...formats.text_numbers import parsed_numbers
from .vrt_files import VRT, RasterSource, read_vrt

_TIFF = b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"
_ESRI = re.compile(
    rb"\s*(?:(?:ncols|nrows|[xy]ll(?:corner|center)|cellsize|dx|dy|nodata_value)\s+\S+\s+)+", re.IGNORECASE
)
_GRASS = re.compile(rb"\s*(?:(?:north|south|east|west|rows|cols|null|type|multiplier):[ \t]*\S+\s+)+", re.IGNORECASE)
_COUNTS = re.compile(rb"(?:ncols|nrows|rows:|cols:)\s*(\d+)", re.IGNORECASE)

SUFFIXES = (".tif", ".tiff", VRT, ".asc")
"""Suffixes of raster files."""

DESCRIPTIONS = re.compile(
    rb"<(?:VRTDataset|GDALTileIndexDataset|GDAL_WM|WCS_GDAL|OGRVRTDataSource|OGRWFSDataSource)", re.IGNORECASE
)
"""The starts of descriptions that name other files; GDAL finds some of them anywhere in the head of a file."""

_REMOTE = {
    "CPL_VSIL_CURL_NON_CACHED": "/vsicurl/:/vsis3/:/vsigs/:/vsiaz/",  # what was read is forgotten when a file is closed
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",  # no file beside it is looked for
    "GDAL_HTTP_CONNECTTIMEOUT": "10",
    "GDAL_HTTP_MAX_RETRY": "3",
    "GDAL_HTTP_RETRY_DELAY": "1",
    "GDAL_INGESTED_BYTES_AT_OPEN": str(1 << 15),  # the header of a large file, in one request
}
"""Options of GDAL while a file at a URL is open."""

HEAD = 1 << 16  # bytes, more than GDAL reads to choose a driver
_BESIDE = ".msk", ".ovr", ".aux"  # files beside a raster that GDAL opens with any driver
_TEXT = 1 << 24  # bytes of an .asc file that are parsed at once
_COPIES = 3  # a block as stored, decompressed and as it is returned


class RasterFile:
    """A raster file that has been checked, to be opened as often as its rows are needed.

    Attributes
    ----------
    stored : int or None
        Bytes of the file and its sources; None: unknown, of a URL.

    Raises
    ------
    InputError
        If the file is missing or is not what its suffix says, or refers to files outside its folder.
    """

    def __init__(self, path: Path):
        self.path, self._url = path, raster_url(path)
        self.stored: int | None = None
        if self._url is None:
            checked_file(path, path.name)
        import_extra("rasterio", path.suffix, "gis")
        if self._url is not None:
            self._name, self._driver = gdal_name(self._url), "GTiff"
            with self.open() as file:
                _check_overviews(file, path.name)
        elif path.suffix.lower() == VRT:
            self._name, sources = read_vrt(path, check_stored)
            self._driver, self.stored = "VRT", sum(each.stat().st_size for each in {path, *sources})
        else:
            self._name, self.stored = os.path.abspath(path), path.stat().st_size
            self._driver = check_stored(RasterSource(path, path.name))

    @property
    def is_virtual(self) -> bool:
        """Whether other windows of the file may give other values, as those of a virtual raster that averages."""
        return self._driver == "VRT"

    @contextmanager
    def open(self) -> Iterator[Any]:
        """The data set of rasterio. Errors of the library become an InputError."""
        with _opened(self._name, self._driver, self.path.name, self._url) as file:
            check_blocks(file, self.path.name, self.stored)
            yield file


def raster_url(path: Path) -> str | None:
    """The URL of a TIFF file that a path names; None for local paths, and for other files, which are read whole."""
    return url_of(path) if path.suffix.lower() in (".tif", ".tiff") else None


@contextmanager
def _opened(name: str, driver: str, where: str, url: str | None = None) -> Iterator[Any]:
    import rasterio

    remote = nullcontext() if url is None else rasterio.Env(**_REMOTE)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with remote, rasterio.open(name, driver=driver) as file:
                yield file
    except rasterio.errors.RasterioError as error:
        if url is not None:
            raise unreachable(where, url, str(error.__cause__ or error).replace(name, where)) from None
        reason = " ".join(str(error.__cause__ or error).split()).replace(name, where)[:120]
        raise InputError(f"{where}: cannot be read ({reason}); is it a raster?") from None


def check_stored(source: RasterSource) -> str:
    """The driver of a raster that stores its own cells; InputError if it is not what its suffix says."""
    path, where = source
    with path.open("rb") as stream:
        head = stream.read(HEAD)
    _check_beside(path, where)
    if path.suffix.lower() == ".asc":
        driver = "GRASSASCIIGrid" if _GRASS.match(head) else "AAIGrid"
        if DESCRIPTIONS.search(head) or not (_ESRI.match(head) or _GRASS.match(head)):
            raise InputError(f"{where}: does not begin as an ASCII grid does, with ncols or north; is it one?")
        _check_numbers(path, where, path.stat().st_mtime_ns)
        return driver
    if not head.startswith(_TIFF) or DESCRIPTIONS.search(head):
        raise InputError(f"{where}: is not a TIFF file; name it as what it is, or convert it with gdal_translate")
    with _opened(os.path.abspath(path), "GTiff", where) as file:
        check_blocks(file, where, path.stat().st_size)
        _check_overviews(file, where)
    return "GTiff"


def _check_overviews(file: Any, where: str) -> None:
    """Raise an InputError if a raster names another file, which GDAL would open with any driver."""
    if "OVERVIEW_FILE" in file.tags(ns="OVERVIEWS"):
        raise InputError(f"{where}: names a file of overviews; copy the raster alone with gdal_translate")


def check_blocks(file: Any, where: str, stored: int | None) -> None:
    """Raise an InputError if a single block of a raster, which is decompressed as a whole, takes too much memory."""
    together = file.count if file.profile.get("interleave") == "pixel" else 1
    for (rows, columns), kind in zip(file.block_shapes[:1], file.dtypes[:1]):
        size = _COPIES * together * float(rows) * columns * _item_size(kind)
        check_reading(size, f"{where}: a block of {columns} x {rows} cells", stored)


def _item_size(kind: str) -> int:
    try:
        return np.dtype(kind).itemsize
    except TypeError:  # complex integers
        return 8


def _check_beside(path: Path, where: str) -> None:
    """Raise an InputError if a mask or overviews beside a raster are not stored in a TIFF file."""
    for name in _files_beside(path.parent, path.parent.stat().st_mtime_ns):
        lower, suffix = name.lower(), Path(name).suffix.lower()
        if lower not in (path.name.lower() + suffix, path.stem.lower() + suffix):
            continue
        with checked_file(path.parent / name, f"{where}: {name}").open("rb") as stream:
            head = stream.read(HEAD)
        starts = (b"EHFA_HEADER_TAG",) if suffix == ".aux" else _TIFF
        if not head.startswith(starts) or DESCRIPTIONS.search(head):
            raise InputError(f"{where}: {name} beside it is not a TIFF file; remove it, or make it anew with gdaladdo")


@lru_cache(maxsize=8)
def _files_beside(folder: Path, changed: int) -> list[str]:
    """The files of a folder that hold masks and overviews. changed: when the folder was, so that the list is new."""
    with os.scandir(folder) as entries:
        return [entry.name for entry in entries if entry.name.lower().endswith(_BESIDE)]


@lru_cache(maxsize=8)
def _check_numbers(path: Path, where: str, changed: int) -> None:
    """Raise an InputError if a cell of an ASCII grid is not a number, which GDAL reads as 0; or if cells are missing.

    changed: when the file was, so that it is checked once
    """
    with path.open("rb") as stream:
        head = stream.read(HEAD)
        match = _GRASS.match(head) or _ESRI.match(head)
        assert match is not None
        declared = [int(each) for each in _COUNTS.findall(match[0])]
        stream.seek(match.end())
        count, rest = 0, b""
        while data := stream.read(_TEXT):
            whole, rest = _at_last_space(rest + data)
            count += _count(whole, where)
            if len(rest) > HEAD:
                raise InputError(f"{where}: {rest[:20]!r} in its cells is not a number; export it again")
        count += _count(rest, where)
    if len(declared) == 2 and count != declared[0] * declared[1]:
        raise InputError(
            f"{where}: has {count} cells, and its header says {declared[0]} x {declared[1]}; copy or export it again"
        )


def _at_last_space(text: bytes) -> tuple[bytes, bytes]:
    """A text up to its last white space, and the rest."""
    at = 1 + max(text.rfind(space) for space in (b" ", b"\n", b"\t", b"\r"))
    return text[:at], text[at:]


def _count(text: bytes, where: str) -> int:
    """How many numbers a text holds; InputError if it holds anything else."""
    text = text.replace(b",", b".")  # decimal commas, as GDAL reads them
    values = parsed_numbers(re.sub(rb"(?<!\S)\*(?!\S)", b"nan", text) if b"*" in text else text, np.float64)
    if values is not None:
        return len(values)
    word = next((word for word in text.split() if parsed_numbers(word, np.float64) is None), b"")
    shown = word[:20].decode("utf-8", "replace")
    raise InputError(f"{where}: {shown!r} in its cells is not a number; write NODATA_value where there is no height")
