"""Files of other trades, which are not read: what they are, and the command or program that converts them."""

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple


class ForeignFormat(NamedTuple):
    """A format that another program converts. `{file}` and `{stem}` in its cure are those of a path."""

    name: str
    suffixes: tuple[str, ...]  # in lower case; or the end of a name
    cure: str


_BLENDER = "import it in Blender, and export {stem}.glb"
_ASSIMP = "convert it: assimp export {file} {stem}.glb"
_TRIMESH = "convert it: python -c \"import trimesh; trimesh.load('{file}').export('{stem}.glb')\""
_GDAL = "convert it: gdal_translate {file} {stem}.tif"
_OGR = "convert it: ogr2ogr {stem}.gpkg {file}"


def _export(program: str) -> str:
    return f"export {{stem}}.glb from {program}"


def _tile(tool: str) -> str:
    return f"convert it: npx 3d-tiles-tools {tool} -i {{file}} -o {{stem}}.glb"


FOREIGN_FORMATS = (
    ForeignFormat("CityGML", (".gml", ".citygml", ".xml"), "convert it: citygml-tools to-cityjson {file}"),
    ForeignFormat("IFC", (".ifc", ".ifczip"), "convert it: IfcConvert {file} {stem}.glb"),
    ForeignFormat(
        "a point cloud",
        (".las", ".laz", ".e57", ".pcd"),
        "make a raster of its heights: pdal translate {file} {stem}.tif --writers.gdal.resolution=1 "
        "--writers.gdal.output_type=max",
    ),
    ForeignFormat("CAD", (".dxf", ".dwg"), "import it in Blender or FreeCAD, and export {stem}.glb"),
    ForeignFormat("CAD", (".step", ".stp", ".iges", ".igs", ".brep", ".fcstd"), _export("FreeCAD")),
    ForeignFormat("FBX", (".fbx",), _BLENDER),
    ForeignFormat("USD", (".usd", ".usda", ".usdc", ".usdz"), _BLENDER),
    ForeignFormat("a Blender file", (".blend",), _export("Blender")),
    ForeignFormat("a 3D Studio file", (".3ds",), _ASSIMP),
    ForeignFormat("COLLADA", (".dae",), _ASSIMP),
    ForeignFormat("3MF, OFF or VRML", (".3mf", ".off", ".wrl", ".x3d"), _TRIMESH),
    ForeignFormat("a VTK mesh", (".vtk", ".vtu", ".vtp", ".msh"), "convert it: meshio convert {file} {stem}.ply"),
    ForeignFormat("SketchUp", (".skp",), _export("SketchUp")),
    ForeignFormat("Rhino", (".3dm",), _export("Rhino")),
    ForeignFormat("Revit", (".rvt", ".rfa"), "export IFC from Revit, then: IfcConvert {stem}.ifc {stem}.glb"),
    ForeignFormat("EnergyPlus", (".idf", ".epjson"), "write its zones with geomeppy: IDF.to_obj"),
    ForeignFormat(
        "a model of Ladybug Tools",
        (".hbjson", ".dfjson", ".hbpkl"),
        "pass its Face3D and Mesh3D to antumbra.integrations.ladybug in Python, or export {stem}.glb from Rhino",
    ),
    ForeignFormat("a tile of 3D Tiles", (".b3dm",), _tile("b3dmToGlb")),
    ForeignFormat("a tile of 3D Tiles", (".i3dm",), _tile("i3dmToGlb")),
    ForeignFormat("a tile of 3D Tiles", (".cmpt",), _tile("cmptToGlb")),
    ForeignFormat("KMZ", (".kmz",), "unzip {file}; for its footprints: ogr2ogr {stem}.gpkg doc.kml"),
    ForeignFormat("vector data", (".kml", ".tab", ".mif", ".gpx", ".topojson", ".osm", ".pbf", ".geojsonl"), _OGR),
    ForeignFormat(
        "netCDF or HDF5", (".nc", ".nc4", ".h5", ".hdf"), 'convert it: gdal_translate NETCDF:"{file}":NAME {stem}.tif'
    ),
    ForeignFormat(
        "a raster",
        (".hgt", ".img", ".dem", ".bil", ".flt", ".grd", ".adf",
         ".dt0", ".dt1", ".dt2", ".jp2", ".ecw", ".grib", ".xyz"),
        _GDAL,
    ),
    ForeignFormat("an archive", (".zip", ".gz", ".tgz", ".tar", ".7z", ".rar", ".bz2", ".xz"), "unpack it: {unpack}"),
)  # fmt: skip
"""Formats that people have, in the order in which suffixes are compared."""

_UNPACK = {".zip": "unzip {file}", ".gz": "gunzip {file}", ".tgz": "tar xf {file}", ".tar": "tar xf {file}"}
_UNPACK |= {".7z": "7z x {file}", ".rar": "unrar x {file}", ".bz2": "bunzip2 {file}", ".xz": "unxz {file}"}


def cure_of(path: Path) -> str | None:
    """What a file is and how to convert it: the rest of an error after its name. None if its suffix is not foreign."""
    name = path.name.lower()
    for each in FOREIGN_FORMATS:
        suffix = next((suffix for suffix in each.suffixes if name.endswith(suffix)), None)
        if suffix is not None:
            stem = path.name[: -len(suffix)].rstrip(".") or path.stem
            cure = each.cure.replace("{unpack}", _UNPACK.get(suffix, ""))
            quote = str if "'{file}'" in cure or '"{file}"' in cure else shlex.quote
            return f"is {each.name}, which is not read; {cure.format(file=quote(path.name), stem=_joined(stem))}"
    return None


_OF_JSON = {
    "FeatureCollection": "GeoJSON; rename it to {stem}.geojson",
    "Model": "a model of Ladybug Tools, which is not read; "
    + next(each.cure for each in FOREIGN_FORMATS if ".hbjson" in each.suffixes),
    "meshes": "glTF; rename it to {stem}.gltf",
    "asset": "a tileset of 3D Tiles, which is not read; name one of its tiles: .glb, or .b3dm after: "
    "npx 3d-tiles-tools b3dmToGlb -i TILE.b3dm -o TILE.glb",
}
"""Type, or name of a member, of a JSON file -> what it is, and its cure. The first one decides."""


def cure_of_json(path: Path, kind: str | None, names: Iterable[str]) -> str | None:
    """As `cure_of`, for a JSON file by its type and the names of its members."""
    present = {kind, *names}
    known = next((words for name, words in _OF_JSON.items() if name in present), None)
    return None if known is None else f"is {known.format(stem=_joined(path.stem))}"


def _joined(stem: str) -> str:
    """A stem without characters that a shell would take apart."""
    return "".join(c if c.isalnum() or c in "._-" else "-" for c in stem) or "scene"
