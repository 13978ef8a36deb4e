"""Styles of QGIS, written beside the rasters and layers of a table: ``sun.qml`` beside ``sun.tif`` and ``sun.gpkg``.

QGIS applies a file of the same name when it opens a layer. A raster layer reads its ``pipe``, a vector layer its
``renderer-v2``, so one file serves both.
"""

import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as Xml

from ...base.files import atomic_output
from .map_scale import MapClass, MapScale

_VERSION = "3.22"  # of the QGIS that reads these styles in our tests
_MARK = "made by Antumbra"  # QGIS drops this comment from styles that the user saves
_HEAD = "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
_SHADE = 70, 72, 80  # sRGB: layers of one colour
_WIDTH = "2"  # of marks, in millimetres
_SHAPES = {"marker": "SimpleMarker", "fill": "SimpleFill", "line": "SimpleLine"}


class RasterStyle(NamedTuple):
    """How raster layers are drawn."""

    scale: MapScale
    band: int  # from 1


class VectorStyle(NamedTuple):
    """How vector layers are drawn."""

    column: str
    scale: MapScale | None  # None: in one colour
    kind: str  # "marker", "fill" or "line": points, polygons or lines


def style_beside(path: Path) -> Path:
    """The path of the style of a raster or vector file."""
    return path.with_suffix(".qml")


def write_style(path: Path, vector: VectorStyle, raster: RasterStyle | None = None) -> bool:
    """Write the style of the files of this name, unless the user saved one there, and return whether it was written.

    path : the raster or vector file
    raster : None: there is no raster
    """
    target = style_beside(path)
    if os.path.exists(target) and _MARK not in target.read_text(encoding="utf-8", errors="replace"):
        return False
    root = Xml.Element("qgis", version=_VERSION, styleCategories="Symbology")
    root.append(Xml.Comment(f" {_MARK} "))
    if raster is not None:
        Xml.SubElement(root, "pipe").append(_raster_renderer(*raster))
    root.append(_vector_renderer(*vector))
    Xml.indent(root)
    text = _HEAD + Xml.tostring(root, encoding="unicode") + "\n"
    with atomic_output(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return True


# --- Rasters ----------------------------------------------------------------------------------------------------------


def _raster_renderer(scale: MapScale, band: int) -> Xml.Element:
    kind = "paletted" if scale.classes else "singlebandpseudocolor"
    renderer = Xml.Element("rasterrenderer", type=kind, band=str(band), opacity="1", alphaBand="-1", nodataColor="")
    Xml.SubElement(renderer, "rasterTransparency")
    if scale.classes:
        palette = Xml.SubElement(renderer, "colorPalette")
        for each in scale.classes:
            Xml.SubElement(palette, "paletteEntry", {**_entry(each), "value": f"{each.value:g}"})
        return renderer
    renderer.set("classificationMin", repr(scale.low))
    renderer.set("classificationMax", repr(scale.high))
    shader = Xml.SubElement(Xml.SubElement(renderer, "rastershader"), "colorrampshader")
    shader.attrib |= {"colorRampType": "INTERPOLATED", "classificationMode": "1", "clip": "0"}
    shader.attrib |= {"minimumValue": repr(scale.low), "maximumValue": repr(scale.high)}
    for each in scale.stops():
        Xml.SubElement(shader, "item", {**_entry(each), "value": repr(each.value)})
    return renderer


def _entry(each: MapClass) -> dict[str, str]:
    return {"label": each.name, "color": "#{:02x}{:02x}{:02x}".format(*each.colour), "alpha": "255"}


# --- Vector layers ----------------------------------------------------------------------------------------------------


def _vector_renderer(column: str, scale: MapScale | None, kind: str) -> Xml.Element:
    common = {"attr": column, "enableorderby": "0", "symbollevels": "0", "forceraster": "0"}
    if scale is None:
        renderer = Xml.Element("renderer-v2", {"type": "singleSymbol", **common})
        _add_symbols(renderer, [_SHADE], kind)
        return renderer
    if scale.classes:
        renderer = Xml.Element("renderer-v2", {"type": "categorizedSymbol", **common})
        categories = Xml.SubElement(renderer, "categories")
        for k, each in enumerate(scale.classes):
            value = ("true" if each.value else "false") if scale.class_type == "bool" else f"{each.value:g}"
            entry = {"value": value, "type": scale.class_type, "symbol": str(k), "label": each.name, "render": "true"}
            Xml.SubElement(categories, "category", entry)
        _add_symbols(renderer, [each.colour for each in scale.classes], kind)
        return renderer
    renderer = Xml.Element("renderer-v2", {"type": "graduatedSymbol", "graduatedMethod": "GraduatedColor", **common})
    ranges, stops = Xml.SubElement(renderer, "ranges"), scale.stops()
    spans = list(pairwise(stops)) or [(stops[0], stops[0])]
    for k, (low, high) in enumerate(spans):
        label = f"{low.name} to {high.name}" if scale.span else low.name
        Xml.SubElement(
            ranges, "range", lower=repr(low.value), upper=repr(high.value), symbol=str(k), label=label, render="true"
        )
    _add_symbols(renderer, [_middle(*span) for span in spans], kind)
    return renderer


def _middle(low: MapClass, high: MapClass) -> tuple[int, int, int]:
    """The colour halfway between two stops."""
    red, green, blue = ((a + b) // 2 for a, b in zip(low.colour, high.colour))
    return red, green, blue


def _add_symbols(renderer: Xml.Element, colours: Sequence[tuple[int, int, int]], kind: str) -> None:
    symbols = Xml.SubElement(renderer, "symbols")
    for k, colour in enumerate(colours):
        symbol = Xml.SubElement(symbols, "symbol", name=str(k), type=kind, alpha="1", clip_to_extent="1")
        layer = Xml.SubElement(symbol, "layer", {"class": _SHAPES[kind], "enabled": "1", "locked": "0", "pass": "0"})
        rgba = ",".join(map(str, (*colour, 255)))
        for name, value in _properties(kind, rgba).items():
            Xml.SubElement(layer, "prop", k=name, v=value)


def _properties(kind: str, rgba: str) -> dict[str, str]:
    if kind == "line":
        return {"line_color": rgba, "line_width": "0.4", "line_width_unit": "MM"}
    outline = {"outline_style": "no"}
    return {"color": rgba, **outline, **({"size": _WIDTH, "size_unit": "MM"} if kind == "marker" else {})}
