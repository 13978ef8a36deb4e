"""Hostile rasters and vector files: those that name other files or addresses, and small ones that expand.

Each generator writes a file into a folder and returns its path.
"""

import html
import json
from collections.abc import Callable
from pathlib import Path

from gis_files import CRS, buildings, hills, write_raster

PLACE = "<GeoTransform>100000,2,0,450000,0,-2</GeoTransform>"
NOWHERE = "127.0.0.1:9"  # an address for files that must be refused before anybody connects


def vrt(sources: str, cells: int = 9, kind: str = 'dataType="Float64" band="1"', about: str = "") -> str:
    """The text of a virtual raster with one band."""
    head = f'<VRTDataset rasterXSize="{cells}" rasterYSize="{cells}"{about}><SRS>{CRS}</SRS>{PLACE}'
    return f"{head}<VRTRasterBand {kind}>{sources}</VRTRasterBand></VRTDataset>"


def source(name: object, relative: int = 0, kind: str = "SimpleSource", more: str = "") -> str:
    """A source of a virtual raster."""
    file = f'<SourceFilename relativeToVRT="{relative}">{html.escape(str(name))}</SourceFilename>'
    return f"<{kind}{more}>{file}<SourceBand>1</SourceBand></{kind}>"


def _raw(secret: Path) -> str:
    more = "<ImageOffset>0</ImageOffset><PixelOffset>1</PixelOffset><LineOffset>3</LineOffset>"
    return vrt(
        f'<SourceFilename relativetoVRT="0">{secret}</SourceFilename>{more}', 3,
        'dataType="Byte" band="1" subClass="VRTRawRasterBand"',
    )  # fmt: skip


def _python(secret: Path) -> str:
    code = f"import os\nopen({str(secret)!r}).read()\ndef f(inputs, out, *more, **also):\n    out[:] = 1\n"
    function = "<PixelFunctionType>f</PixelFunctionType><PixelFunctionLanguage>Python</PixelFunctionLanguage>"
    return vrt(
        f"{function}<PixelFunctionCode><![CDATA[{code}]]></PixelFunctionCode>{source('a.tif', 1)}",
        kind='dataType="Float32" band="1" subClass="VRTDerivedRasterBand"',
    )


def _service(address: str) -> str:
    window = "".join(f"<{name}>{value}</{name}>" for name, value in (
        ("UpperLeftX", 0), ("UpperLeftY", 9), ("LowerRightX", 9), ("LowerRightY", 0), ("TileLevel", 0),
        ("TileCountX", 1), ("TileCountY", 1), ("YOrigin", "top"),
    ))  # fmt: skip
    server = f'<Service name="TMS"><ServerUrl>http://{address}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service>'
    sizes = "<BlockSizeX>9</BlockSizeX><BlockSizeY>9</BlockSizeY><BandsCount>1</BandsCount>"
    return f"<GDAL_WMS>{server}<DataWindow>{window}</DataWindow><Projection>{CRS}</Projection>{sizes}</GDAL_WMS>"


RASTER_TEXTS: dict[str, Callable[[str, Path], str]] = {
    "a VRT of an address": lambda address, secret: vrt(source(f"/vsicurl/http://{address}/a.tif")),
    "a VRT of a web page": lambda address, secret: vrt(source(f"http://{address}/a.tif")),
    "a VRT of an absolute path": lambda address, secret: vrt(source(secret)),
    "a VRT of a path with dots": lambda address, secret: vrt(source(f"../{secret.parent.name}/{secret.name}", 1)),
    "a VRT of a path from the current folder": lambda address, secret: vrt(source("a.tif")),
    "a VRT of raw bytes": lambda address, secret: _raw(secret),
    "a VRT with Python": lambda address, secret: _python(secret),
    "a VRT of a VRT in its text": lambda address, secret: vrt(source(vrt(source(secret)))),
    "a VRT whose source is an attribute": lambda address, secret: vrt(
        f'<SimpleSource SourceFilename="{secret}"><SourceBand>1</SourceBand></SimpleSource>'
    ),
    "a VRT in small letters": lambda address, secret: vrt(
        f"<simplesource><sourcefilename>{secret}</sourcefilename></simplesource>"
    ),
    "a VRT with an entity": lambda address, secret: (
        f'<!DOCTYPE x [<!ENTITY e SYSTEM "file://{secret}">]>{vrt(source("&e;"))}'
    ),
    "a warped VRT": lambda address, secret: vrt(source(secret), about=' subClass="VRTWarpedDataset"'),
    "a web map service": lambda address, secret: _service(address),
    "a coverage service": lambda address, secret: (
        f"<WCS_GDAL><ServiceURL>http://{address}/wcs?</ServiceURL><CoverageName>x</CoverageName></WCS_GDAL>"
    ),
    "a tile index": lambda address, secret: (
        f"<GDALTileIndexDataset><IndexDataset>http://{address}/a.gpkg</IndexDataset></GDALTileIndexDataset>"
    ),
}
"""Name -> the text of a description that reads other files, from an address and the path of a secret file."""

VECTOR_TEXTS: dict[str, Callable[[str, Path], str]] = {
    "a virtual layer of a file": lambda address, secret: _layer(secret),
    "a virtual layer of an address": lambda address, secret: _layer(f"/vsicurl/http://{address}/s.geojson"),
    "a feature service": lambda address, secret: (
        f"<OGRWFSDataSource><URL>http://{address}/wfs</URL></OGRWFSDataSource>"
    ),
}
"""The same for vector files."""


def _layer(name: object) -> str:
    about = f"<SrcDataSource>{name}</SrcDataSource><SrcLayer>s</SrcLayer><GeometryType>wkbPolygon</GeometryType>"
    return f'<OGRVRTDataSource><OGRVRTLayer name="s">{about}</OGRVRTLayer></OGRVRTDataSource>'


def geojson(crs: object = None, **more: object) -> str:
    """The text of a GeoJSON file of one footprint."""
    ring = [[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]
    feature = {"type": "Feature", "properties": {"height": 5}, "geometry": {"type": "Polygon", "coordinates": [ring]}}
    about = {} if crs is None else {"crs": crs}
    return json.dumps({"type": "FeatureCollection", **about, **more, "features": [feature]})


def crs_links(address: str) -> dict[str, str]:
    """Texts of GeoJSON files whose CRS is a link, in the spellings that GDAL accepts."""
    link = {"type": "link", "properties": {"href": f"http://{address}/x.prj", "type": "ogcwkt"}}
    plain = geojson(link)
    return {
        "link": plain,
        "url": geojson({"type": "url", "properties": {"url": f"http://{address}/x.prj"}}),
        "escaped": plain.replace('"crs"', '"\\u0063r\\u0073"'),
        "capitals": plain.replace('"crs"', '"CRS"'),
        "quotes": plain.replace('"crs"', "'crs'"),
        "comment": plain.replace('"crs":', '"crs" /* */ :'),
        "twice": plain.replace('"type": "link"', '"type": "link", "type": "name"'),
    }


# --- Files that expand ------------------------------------------------------------------------------------------------


def _sparse(path: Path, side: int, **options: object) -> Path:
    import rasterio

    place = rasterio.Affine(2.0, 0.0, 100000.0, 0.0, -2.0, 450000.0)
    options = {"tiled": True, "blockxsize": 4096, "blockysize": 4096, "SPARSE_OK": "TRUE"} | options
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        height=side,
        width=side,
        count=1,
        dtype="float32",
        crs=CRS,
        transform=place,
        **options,
    ):
        pass
    return path


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def _one_block(folder: Path) -> Path:
    """A raster of few cells in a block of two billion."""
    return _sparse(folder / "block.tif", 20, blockxsize=32768, blockysize=32768)


def _chain(folder: Path, count: int, times: int) -> Path:
    """Virtual rasters, each of which names the next one several times."""
    write_raster(folder / "v.tif", hills(9, 9))
    for k in range(count):
        name = "v.tif" if k == count - 1 else f"c{k + 1}.vrt"
        (folder / f"c{k}.vrt").write_text(vrt(source(name, 1) * times))
    return folder / "c0.vrt"


def _mutual(folder: Path) -> Path:
    (folder / "b.vrt").write_text(vrt(source("a.vrt", 1)))
    return _written(folder / "a.vrt", vrt(source("b.vrt", 1)))


def _repeated_shapes(folder: Path) -> Path:
    """A shapefile whose index lists its first record a thousand times."""
    buildings().to_file(folder / "a.shp")
    index = (folder / "a.shx").read_bytes()
    (folder / "a.shx").write_bytes(index[:100] + index[100:108] * 1000)
    return folder / "a.shp"


def _repeated_texts(folder: Path) -> Path:
    """A table that repeats a text of a megabyte, which its dictionary stores once."""
    import pyarrow.parquet

    path, n = folder / "a.parquet", 2000
    buildings(use=["x" * (1 << 20)] * 3).to_parquet(path)
    table = pyarrow.parquet.read_table(path)
    table = table.set_column(table.column_names.index("use"), "use", table["use"].dictionary_encode())
    pyarrow.parquet.write_table(table.take([0] * n), path, store_schema=False)
    return path


EXPANDING: dict[str, Callable[[Path], Path]] = {
    "a sparse raster": lambda folder: _sparse(folder / "sparse.tif", 20_000),
    "a block larger than its raster": _one_block,
    "a VRT without sources": lambda folder: _written(folder / "empty.vrt", vrt("", 30_000)),
    "a VRT of itself": lambda folder: _written(folder / "self.vrt", vrt(source("self.vrt", 1))),
    "two VRTs of each other": _mutual,
    "a chain of 400 VRTs": lambda folder: _chain(folder, 400, 1),
    "thirty VRTs that each name the next twice": lambda folder: _chain(folder, 30, 2),
    "seven VRTs that each name the next 100 times": lambda folder: _chain(folder, 7, 100),
    "an ASCII grid of a million million cells": lambda folder: _written(
        folder / "a.asc", "ncols 1000000\nnrows 1000000\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n"
    ),
    "a shapefile that repeats a record": _repeated_shapes,
    "a table that repeats a text": _repeated_texts,
}
"""Name -> generator of a small file that would take gigabytes or would not end."""
