"""Files from outside reach each library that reads them through one door, which decides what it may open."""

import ast
from functools import cache

import pytest

from repository import ROOT

SOURCES = ROOT / "src" / "antumbra"

GIS = "city/gis"
READERS = {
    "rasterio": ({"open", "MemoryFile", "band", "vrt"}, {f"{GIS}/raster_files.py": "the door"}),
    "pyogrio": (
        {"read_dataframe", "read_arrow", "open_arrow", "read_info", "read_bounds", "read", "list_layers"},
        {f"{GIS}/vector_files.py": "the door"},
    ),
    "geopandas": ({"read_file", "read_parquet", "read_feather", "from_file"}, {f"{GIS}/vector_files.py": "the door"}),
    "pyarrow": (
        {"ParquetFile", "ParquetDataset", "read_table", "read_schema", "read_metadata", "dataset", "memory_map"},
        {f"{GIS}/vector_files.py": "the door"},
    ),
    "obstore": (
        {"get", "get_async", "get_range", "get_ranges", "head", "list", "open_reader", "from_url"},
        {"base/remote_files.py": "the door: URLs that the user gives"},
    ),
    "zarr": ({"open", "open_array", "open_group", "open_consolidated", "load"}, {}),
    "xarray": (
        {"open_dataset", "open_dataarray", "open_mfdataset", "open_zarr", "open_datatree", "load_dataset"},
        {},
    ),
    "fiona": ({"open", "listlayers"}, {}),
    "trimesh": (
        {"load", "load_mesh", "load_scene", "load_path", "load_remote"},
        {"formats/mesh_files.py": "the door: from memory, without a resolver"},
    ),
    "PIL": (
        {"open"},
        {
            "scene/materials.py": "the door: formats, and the size in the header, before pixels are decoded",
            "picture/image_files.py": "pictures that this program has written, as frames of films and for their notes",
        },
    ),
    "OpenEXR": (
        {"File", "InputFile"},
        {
            "scene/sky.py": "the door: the size in the header before pixels are read",
            "picture/image_files.py": "headers, and writing",
            "datasets/dataset_files.py": "files that this program has written, to make a contact sheet",
        },
    ),
    "xatlas": ({"Atlas", "parametrize"}, {"baking/chart_process.py": "the door: a process of its own"}),
    "DracoPy": ({"decode"}, {"formats/gltf/accessors.py": "the door"}),
    "meshopt": ({"decode_gltf_buffer"}, {"formats/gltf/gltf_file.py": "the door"}),
    "opengl_basisu": ({"open"}, {"scene/ktx2.py": "the door; the size has been compared"}),
}
"""Library -> (its functions that read files or data, the modules that call them and why)."""

WRITES = {"city/tables/result_table.py": {"MemoryFile", "open"}}
"""Modules that call these functions to write: `check_writing` looks at the arguments."""

GENERIC = {"open", "read", "load", "get", "head", "list", "File", "decode", "band", "vrt", "dataset"}
"""Names of functions that others have too, so that only calls on the library count."""


def imported(tree: ast.AST) -> dict[str, set[str]]:
    """Library -> the names in a module that are it, a part of it, or made by it."""
    names: dict[str, set[str]] = {}

    def add(library: str, name: str) -> None:
        names.setdefault(library.partition(".")[0], set()).add(name)

    for node in ast.walk(tree):
        match node:
            case ast.Import(names=aliases):
                for alias in aliases:
                    add(alias.name, alias.asname or alias.name.partition(".")[0])
            case ast.ImportFrom(module=str(module), level=0, names=aliases):
                for alias in aliases:
                    add(module, alias.asname or alias.name)
            case ast.Assign(targets=[ast.Name(id=name)], value=ast.Call() as call) if is_extra(call):
                add(call.args[0].value, name)
    return names


def is_extra(call: ast.Call) -> bool:
    """Whether a call is ``import_extra("library", ...)``, or ``openexr()``."""
    return isinstance(call.func, ast.Name) and call.func.id == "import_extra" and isinstance(call.args[0], ast.Constant)


def calls(tree: ast.AST):
    """(root of the called object, name of the function, node): ``rasterio.open(...)`` -> ("rasterio", "open", ...)."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            root = node.func.value
            while isinstance(root, ast.Attribute):
                root = root.value
            if isinstance(root, ast.Call) and is_extra(root):
                yield f"import_extra {root.args[0].value}", node.func.attr, node
            elif isinstance(root, ast.Call) and isinstance(root.func, ast.Name) and root.func.id == "openexr":
                yield "openexr()", node.func.attr, node
            elif isinstance(root, ast.Name):
                yield root.id, node.func.attr, node
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            yield node.func.id, node.func.id, node


@cache
def modules() -> list[tuple[str, dict[str, set[str]], list[tuple[str, str, ast.Call]]]]:
    """Modules that mention a library of `READERS`: their names, what they import, and their calls."""
    out = []
    for path in sorted(SOURCES.rglob("*.py")):
        text = path.read_text()
        if any(library in text for library in (*READERS, "openexr")):
            tree = ast.parse(text)
            out.append((path.relative_to(SOURCES).as_posix(), imported(tree), list(calls(tree))))
    return out


def reading(library: str) -> dict[str, set[str]]:
    """Module -> the functions of a library that it calls to read."""
    functions, found = READERS[library][0], dict[str, set[str]]()
    for module, imports, called in modules():
        own = imports.get(library, set()) | ({"openexr()"} if library == "OpenEXR" else set())
        for root, name, node in called:
            on_library = root in own or root.removeprefix("import_extra ").partition(".")[0] == library != root
            if name in functions and (on_library or (name not in GENERIC and own)):
                if module in WRITES and name in WRITES[module] and is_writing(name, node):
                    continue
                found.setdefault(module, set()).add(name)
    return found


def is_writing(name: str, node: ast.Call) -> bool:
    if name == "open":
        return len(node.args) > 1 and isinstance(node.args[1], ast.Constant) and node.args[1].value == "w"
    return name == "MemoryFile" and not node.args


@pytest.mark.parametrize("library", READERS)
def test_a_library_reads_files_in_its_door_only(library):
    assert reading(library).keys() == READERS[library][1].keys()


def test_no_module_reads_through_names_that_the_list_misses():
    """Libraries that read files are imported as modules, so that each call names its library."""
    for path in SOURCES.rglob("*.py"):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if any(library in text for library in READERS) else ():
            if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                library = node.module.partition(".")[0]
                names = {alias.name for alias in node.names}
                assert library not in READERS or not names & READERS[library][0], (path, names)


def test_no_other_library_that_reads_files_is_imported():
    """Those that are known to read files; a new one needs a door."""
    others = {"imageio", "cv2", "meshio", "netCDF4", "h5py", "rioxarray", "fsspec", "requests",
              "urllib3", "httpx", "osgeo", "shapefile", "laspy", "pandas.io", "pygltflib", "usd", "pxr"}  # fmt: skip
    for path in SOURCES.rglob("*.py"):
        text = path.read_text()
        if any(library in text for library in others):
            assert not imported(ast.parse(text)).keys() & others, path


def test_the_list_finds_calls():
    lines = 'rasterio = import_extra("rasterio", "a", "gis")', "rasterio.open(a)", "from PIL import Image"
    lines += 'import_extra("pyogrio", "a", "b").read_info(a)', "Image.open(a)", "open(a)"
    tree = ast.parse("\n".join(lines))
    assert imported(tree) == {"rasterio": {"rasterio"}, "PIL": {"Image"}}
    found = [(root, name) for root, name, _ in calls(tree)]
    assert {("rasterio", "open"), ("import_extra pyogrio", "read_info"), ("Image", "open"), ("open", "open")} <= {
        *found
    }
