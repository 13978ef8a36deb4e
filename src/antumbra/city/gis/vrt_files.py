"""Virtual rasters (.vrt): what they may hold, and their sources, which must be rasters in their folder.

The file itself is not passed to GDAL. It is parsed, and rewritten from the supported elements and the paths of checked
sources. GDAL therefore reads only what was checked, however it parses XML.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from ...base.errors import InputError
from ...base.files import checked_file, sibling

VRT = ".vrt"
STORED = ".tif", ".tiff", ".asc"
"""Suffixes of sources that store cells. Others are .vrt files."""

_MOST_BYTES = 1 << 26
_MOST_SOURCES = 100_000  # counted as often as they are read
_MOST_LEVELS = 8  # of .vrt files that are sources of .vrt files

_SOURCES = "SimpleSource", "ComplexSource", "AveragedSource", "KernelFilteredSource"
_VALUES = (
    *("SRS", "GeoTransform", "NoDataValue", "HideNoDataValue", "UnitType", "Offset", "Scale", "SourceBand"),
    *("SourceProperties", "SrcRect", "DstRect", "NODATA", "ScaleOffset", "ScaleRatio", "UseMaskBand", "LUT"),
    *("Exponent", "SrcMin", "SrcMax", "DstMin", "DstMax", "Clamp", "Size", "Coefs"),
)  # elements without others in them
_NODES = "VRTDataset", "VRTRasterBand", "MaskBand", "Kernel", *_SOURCES
_KEPT = {name.lower(): name for name in (*_NODES, *_VALUES, "SourceFilename")}
_DROPPED = {
    *("metadata", "description", "colorinterp", "colortable", "colortablecomponent", "categorynames", "histograms"),
    *("overviewlist", "overview", "gcplist", "gdalrasterattributetable", "blockxsize", "blockysize", "openoptions"),
}  # elements that do not change heights, and the files that some of them name
_ATTRIBUTES = {
    *("rasterxsize", "rasterysize", "datatype", "band", "blockxsize", "blockysize", "resampling", "relativetovrt"),
    *("shared", "xoff", "yoff", "xsize", "ysize", "dataaxistosrsaxismapping", "coordinateepoch", "normalized"),
}
_CURE = "convert it to GeoTIFF with gdal_translate"


class RasterSource(NamedTuple):
    """A raster that stores cells, and its name in errors."""

    path: Path
    where: str


class _Expanded(NamedTuple):
    """A .vrt file as GDAL reads it."""

    text: str
    sources: frozenset[Path]  # all files, its own included
    n_read: int  # of files, as often as they are read


def read_vrt(path: Path, check: Callable[[RasterSource], object]) -> tuple[str, frozenset[Path]]:
    """A virtual raster as XML with absolute paths, and the files that it reads.

    check : raises an InputError for a source that must not be opened

    Raises
    ------
    InputError
        If the file is no virtual raster, holds elements that are not read, or names files outside its folder, itself,
        or too many sources.
    """
    expanded = _VrtReader(path.name, check).expand(path, path.name, ())
    return expanded.text, expanded.sources


class _VrtReader:
    """Reads a .vrt file and those that are sources of it, each once."""

    def __init__(self, file: str, check: Callable[[RasterSource], object]):
        self._file, self._check = file, check
        self._expanded, self._checked = dict[Path, _Expanded](), set[Path]()

    def expand(self, path: Path, where: str, above: tuple[Path, ...]) -> _Expanded:
        """The text of a .vrt file. above: the files that refer to it."""
        real = path.resolve()
        if real in above:
            raise InputError(f"{where}: is a source of itself; {_CURE}")
        if len(above) >= _MOST_LEVELS:
            raise InputError(f"{where}: .vrt files are nested more than {_MOST_LEVELS} deep; {_CURE}")
        if real not in self._expanded:
            root, files, count, size = _parsed(path, where), {real}, 1, 0
            if _KEPT.get(root.tag.lower()) != "VRTDataset":
                raise InputError(f"{where}: is no virtual raster, which begins with <VRTDataset>; is it one?")

            def name_of(source: Element) -> str:
                nonlocal count, size
                inner = self._source(source, path.parent, where, (*above, real))
                files.update(inner.sources)
                count, size = count + inner.n_read, size + len(inner.text)
                if count > _MOST_SOURCES or size > _MOST_BYTES:
                    raise InputError(f"{where}: reads more than {_MOST_SOURCES:,} sources; {_CURE}")
                return inner.text

            text = ElementTree.tostring(_copied(root, where, name_of), "unicode")
            self._expanded[real] = _Expanded(text, frozenset(files), count)
        return self._expanded[real]

    def _source(self, element: Element, folder: Path, where: str, above: tuple[Path, ...]) -> _Expanded:
        """What replaces the name of a source: an absolute path, or the text of a .vrt file."""
        path = _path_of(element, folder, where)
        inside = f"{self._file}: source {path.name[:80]!r}"
        checked_file(path, inside)
        if path.suffix.lower() == VRT:
            return self.expand(path, inside, above)
        if path.suffix.lower() not in STORED:
            raise InputError(f"{inside} is not one of {', '.join((*STORED, VRT))}; convert it with gdal_translate")
        if path not in self._checked:
            self._check(RasterSource(path, inside))
            self._checked.add(path)
        return _Expanded(str(path), frozenset({path}), 1)


def _path_of(element: Element, folder: Path, where: str) -> Path:
    """The file that an element names, which must lie in the folder of the .vrt file."""
    name, place = (element.text or "").strip(), f"{where}: SourceFilename"
    attributes = {key.lower(): value.strip() for key, value in element.attrib.items()}
    is_relative = attributes.get("relativetovrt") == "1"
    if os.path.isabs(name) and not is_relative:
        name = os.path.relpath(os.path.realpath(name), os.path.realpath(folder))
        is_relative = True
    path = sibling(folder, name.replace("%", "%25"), place)
    if not is_relative:  # GDAL would look in the current folder
        raise InputError(f"{place} is {name[:80]!r}, without relativeToVRT; write the file again with gdalbuildvrt")
    return path


def _parsed(path: Path, where: str) -> Element:
    """The root of an XML document without declarations of its own."""
    if path.stat().st_size > _MOST_BYTES:
        raise InputError(f"{where}: has {path.stat().st_size >> 20} MB of XML, more than {_MOST_BYTES >> 20}; {_CURE}")
    try:
        text = path.read_bytes().decode("utf-8-sig")
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise ValueError("it declares entities")
        return ElementTree.fromstring(text.encode())
    except (ValueError, ElementTree.ParseError, RecursionError) as error:
        raise InputError(f"{where}: cannot be read as XML ({' '.join(str(error).split())[:80]}); {_CURE}") from None


def _copied(element: Element, where: str, name_of: Callable[[Element], str]) -> Element:
    """A copy of an element, with known attributes and elements only, and with the names of sources replaced."""
    name = _KEPT.get(element.tag.lower())
    if name is None:
        raise InputError(f"{where}: has the element <{element.tag[:40]}>, which is not read; {_CURE}")
    kind = next((value for key, value in element.attrib.items() if key.lower() == "subclass"), "VRTSourcedRasterBand")
    if kind != "VRTSourcedRasterBand":
        raise InputError(f"{where}: is a {kind[:40]}, which is not read; {_CURE}")
    unknown = [key for key in element.attrib if key.lower() not in {*_ATTRIBUTES, "subclass"}]
    if unknown:
        raise InputError(f"{where}: <{name}> has the attribute {unknown[0][:40]!r}, which is not read; {_CURE}")
    copy = Element(name, {key: value for key, value in element.attrib.items() if key.lower() != "subclass"})
    if name == "SourceFilename":
        copy.text, copy.attrib = name_of(element), {"relativeToVRT": "0"}
    elif name in _NODES:
        kept = [each for each in element if isinstance(each.tag, str) and each.tag.lower() not in _DROPPED]
        copy.extend([_copied(each, where, name_of) for each in kept])
    elif len(element):
        raise InputError(f"{where}: <{name}> holds <{element[0].tag[:40]}>, which is not read; {_CURE}")
    else:
        copy.text = element.text
    return copy
