"""Sensors from command-line text and from point files: CSV, Parquet, NPZ, NPY and vector files."""

import re
from pathlib import Path

import numpy as np

from ...base.checks import number, quoted, spelling_hint
from ...base.errors import InputError
from ...base.files import checked_file
from ...base.memory import check_reading
from ...engine.measured_scenes import measured_scene
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike
from ...formats.array_files import mapped_array
from ...kernels.parallel import thread_count
from ...scene.crs import check_horizontal_crs, checked_crs
from ..gis.raster_files import SUFFIXES as RASTERS
from ..gis.raster_files import raster_url
from ..gis.vector_files import open_parquet
from .ground_areas import AreaLike, area_sensors
from .point_tables import FileBlocks, crs_of_table, point_table
from .sensor_blocks import DescribedSensors, RasterBlocks, SurfaceBlocks
from .sensors import Sensors, checked_lift, point_sensors, raster_of, vertex_sensors
from .table_rows import reader_errors
from .vector_points import SUFFIXES as VECTORS
from .vector_points import PointFile, read_vector_points

FORMS = (
    "face[+LIFT], vertex[+LIFT], grid:SPACING[+LIFT], raster[:SPACING][+HEIGHT|@HEIGHT], raster:FILE.tif, "
    "or a .csv, .parquet, .npy, .npz, .gpkg, .geojson, .shp or .fgb file"
)
SUFFIXES = (".csv", ".parquet", ".npy", ".npz")
"""Suffixes of tables."""
POINT_SUFFIXES = (*SUFFIXES, *VECTORS)
"""Suffixes of files of points."""
_COPIES = 2  # of an array: as stored, and as float64
_AT_ONCE = 1 << 25  # bytes of a table whose points are read at once; those of larger ones by block
_BY_BLOCK = ".csv", ".parquet", ".npy", ".gpkg"
_ROW_BYTES = 32  # of Parquet, which may compress them to a few bits

_ON_FACES = re.compile(r"(?:(face|vertex)|grid:([0-9.]+(?:[eE][+-]?[0-9]+)?|[0-9.eE-]+))(?:\+([0-9.eE+-]+))?")
_RASTER = re.compile(r"raster(?::([0-9.]+(?:[eE][0-9-]+)?|.+\.(?:tif|tiff|vrt|asc)))?(?:([+@])([0-9.eE+-]+))?", re.I)


def check_sensors(text: str, option: str = "sensors", areas: bool = False) -> None:
    """Raise an InputError, before a scene is read, unless `sensors_of` accepts the text; `areas`: for use in areas."""
    if not isinstance(text, str):
        raise InputError(f"{option} is {quoted(text)}; it must be {FORMS}")
    if areas and not _RASTER.fullmatch(text):
        forms = "raster[:SPACING][+HEIGHT|@HEIGHT] or raster:FILE.tif"
        raise InputError(f"{option} is {quoted(text)}; in areas it must be {forms}")
    if _ON_FACES.fullmatch(text):
        return
    if _RASTER.fullmatch(text):
        if (file := raster_file(text)) and raster_url(Path(file)) is None:
            checked_file(Path(file), file)
        return
    check_point_file(text, option, FORMS, POINT_SUFFIXES)


def check_point_file(text: str, option: str, forms: str, suffixes: tuple[str, ...] = SUFFIXES) -> None:
    """Raise an InputError unless an option's text names a file; `forms`: the accepted forms, for the message."""
    path = Path(text)
    if path.suffix.lower() not in suffixes:
        hint = "" if "." in text else spelling_hint(text.partition(":")[0], ("face", "vertex", "grid", "raster"))
        raise InputError(f"{option} is {quoted(text)}; {hint}it must be {forms}")
    checked_file(path, path.name)


def raster_file(text: str) -> str | None:
    """The path in a text such as ``raster:FILE.tif``; None if it names no raster file."""
    raster = _RASTER.fullmatch(text)
    return raster[1] if raster and raster[1] and Path(raster[1]).suffix.lower() in RASTERS else None


def kind_of(text: str) -> str:
    """The kind of sensors that a checked text names."""
    word = re.split("[:+@]", text, maxsplit=1)[0].lower()
    return word if word in ("face", "vertex", "grid", "raster") else "points"


def raster_height(form: str) -> float | None:
    """The height above the cells of a raster in a text of sensors such as "raster+1.6"; None: it names others."""
    if form == "raster":
        return 0.0
    start, _, rest = form.partition("+")
    try:
        return float(rest) if start == "raster" else None
    except ValueError:
        return None


def sensors_of(text: str, scene: SceneLike, threads: int | None = None, areas: AreaLike | None = None) -> Sensors:
    """Make the sensors that a text describes.

    With `areas`, in any form that `area_sensors` accepts, the text must start with ``raster``; heights are then above
    the ground of the areas.

    - ``face``, ``vertex``: one for each face, or for each distinct corner position
    - ``grid:1.5``: a grid on every surface
    - ``face+0.01``, ``vertex+0.01``, ``grid:1.5+0.01``: the same, lifted 0.01 off the surfaces along their normals
    - ``raster:2``, ``raster:2+1.6``, ``raster:2@30``: a horizontal raster on the highest surfaces, 1.6 above them,
      or at the coordinate 30; its cells begin at multiples of 2
    - ``raster``, ``raster+1.6``: the cells of the raster of heights that is the scene or its ground
    - ``raster:dem.tif``, ``raster:dem.tif+1.6``: the cells of a raster file
    - a point file: see `read_point_file`; points in another CRS than the scene's are reprojected

    Examples
    --------
    >>> temple = at.examples.temple()
    >>> at.sensors_of("raster:2+1.6", temple)
    Sensors(96 of kind 'raster')
    """
    if areas is None:
        check_sensors(text)
        if kind_of(text) == "points":
            return read_point_file(Path(text)).within(measured_scene(scene))
        found = sensor_blocks(text, scene, threads)
        return found if isinstance(found, Sensors) else found.whole()
    check_sensors(text, areas=True)
    scene, threads = measured_scene(scene), thread_count(threads)
    cells, height, follow = _cells_of(text)
    return area_sensors(scene, areas, cells, height, follow=follow, threads=threads)


def sensor_blocks(text: str, scene: SceneLike, threads: int | None = None) -> Sensors | DescribedSensors:
    """The sensors of `sensors_of`, described if they can be made by block: those on faces, rasters and large files."""
    check_sensors(text)
    scene, threads = measured_scene(scene), thread_count(threads)
    if on := _ON_FACES.fullmatch(text):
        lift = checked_lift(_number(on[3], text) if on[3] else 0.0)
        if on[1] == "vertex":
            return vertex_sensors(scene, lift=lift)
        spacing = number(_number(on[2], text), "the spacing of sensors", 0.0, np.inf) if on[2] else None
        return SurfaceBlocks(scene, spacing, lift)
    if _RASTER.fullmatch(text):
        cells, height, follow = _cells_of(text)
        return RasterBlocks(scene, raster_of(scene, cells), height, follow, cells is None, threads)
    path = Path(text)
    if path.suffix.lower() in _BY_BLOCK and _size(path) > _AT_ONCE and (table := point_table(path)) is not None:
        return FileBlocks.of(table, scene)
    return read_point_file(path).within(scene)


def _size(path: Path) -> int:
    """About how many bytes the rows of a table take."""
    if path.suffix.lower() != ".parquet":
        return path.stat().st_size
    with reader_errors(path), open_parquet(path, whole=False) as file:
        return _ROW_BYTES * int(file.metadata.num_rows)


def _cells_of(text: str) -> tuple[str | float | None, float, bool]:
    """The file or the spacing of the cells that a text names, None: the scene's own; their height; `follow`."""
    raster = _RASTER.fullmatch(text)
    assert raster is not None  # checked before
    height = _number(raster[3], text) if raster[3] else 0.0
    return raster_file(text) or (_number(raster[1], text) if raster[1] else None), height, raster[2] != "@"


def check_file_crs(scene: AnyScene, *paths: Path | None) -> None:
    """Raise an InputError if a table names a CRS whose horizontal coordinates differ from the scene's."""
    for path in paths:
        if scene.crs and path is not None and path.suffix.lower() == ".parquet":
            with reader_errors(path):
                crs = crs_of_table(path)
                check_horizontal_crs(path.name, None if crs is None else checked_crs(crs), scene.crs)


def _number(text: str, sensors: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"sensors are {sensors!r}; {text!r} is not a number")
    return value


def points_or_file(
    texts: list[str] | None, file: Path | None, one: str, many: str, flat: bool = False
) -> PointFile | None:
    """The points of a repeated option X,Y,Z or of a file; None without either. `flat`: as in `read_point_file`."""
    from ...cli.arguments import parse_point

    if texts and file is not None:
        raise InputError(f"{one} and {many} exclude each other; give one of them")
    if texts:
        return PointFile(point_sensors([parse_point(text, one) for text in texts]), one)
    if file is None:
        return None
    if file.suffix.lower() not in POINT_SUFFIXES:
        raise InputError(f"{many} is {str(file)!r}; it must be a {', '.join(POINT_SUFFIXES)} file")
    return read_point_file(file, flat)


def read_points(path: Path) -> Sensors:
    """The points of `read_point_file`, in the CRS of the file."""
    return read_point_file(path).sensors


def read_point_file(path: Path, flat: bool = False) -> PointFile:
    """Read points from a file.

    - CSV with a header, Parquet, NPZ: columns or arrays x, y, z, and optionally nx, ny, nz, and area; others become
      `Sensors.attributes`, which come through to the results. The columns longitude and latitude, or lon and lat, in
      degrees of WGS 84, may stand for x and y; GeoParquet without x and y has its points in its geometry
    - NPY: (n, 3) points, or (n, 6) points and normals
    - vector files: a layer of points

    flat : whether the heights of points may be missing, and are then 0

    Raises
    ------
    InputError
        If the file cannot be read, or a column is missing or holds anything but numbers.
    """
    checked_file(path, path.name)
    if path.suffix.lower() in VECTORS or (table := point_table(path, flat)) is None or table.is_geometry:
        return read_vector_points(path, flat)
    return table.whole()


def read_array(path: Path) -> np.ndarray:
    """The array in a .npy file. Raises InputError if it cannot be read."""
    with reader_errors(path):
        array = mapped_array(path, path.name)
        check_reading(_COPIES * array.nbytes, path.name)
        return np.array(array)
