"""Small rasters of heights and tables of footprints, as arrays and files."""

import numpy as np

CRS = "EPSG:28992"
PLACE = (2.0, 0.0, 100000.0, 0.0, -2.0, 450000.0)  # affine transform: cells 2 m wide


def write_raster(path, heights, place=PLACE, crs=CRS, nodata=None, **more):
    """Write heights, (rows, columns), as a raster file."""
    import rasterio

    drivers = {".asc": "AAIGrid", ".vrt": "VRT"}
    driver = drivers.get(path.suffix.lower(), "GTiff")
    options = {"height": heights.shape[0], "width": heights.shape[1], "count": 1, "dtype": heights.dtype, "crs": crs}
    if driver == "VRT":
        source = write_raster(path.with_suffix(".source.tif"), heights, place, crs, nodata, **more)
        lines = [f'<VRTDataset rasterXSize="{heights.shape[1]}" rasterYSize="{heights.shape[0]}">']
        lines += [f"<SRS>{crs}</SRS><GeoTransform>{place[2]},{place[0]},0,{place[5]},0,{place[4]}</GeoTransform>"]
        lines += ['<VRTRasterBand dataType="Float64" band="1"><SimpleSource><SourceFilename relativeToVRT="1">']
        lines += [f"{source.name}</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand>"]
        path.write_text("\n".join([*lines, "</VRTDataset>"]))
        return path
    if driver == "AAIGrid":
        options |= {"dtype": np.float32} if heights.dtype == np.float64 else {}
    with rasterio.open(path, "w", driver=driver, transform=rasterio.Affine(*place), nodata=nodata, **options) as file:
        file.write(heights.astype(options["dtype"]), 1)
        for name, value in more.items():
            setattr(file, name, value)
    return path


def hills(rows=7, columns=9, seed=0):
    """(rows, columns) float64: multiples of 1/4 from 0 to 16."""
    return np.random.default_rng(seed).integers(0, 64, (rows, columns)) / 4.0


def buildings(crs=CRS, **columns):
    """A table of three footprints: a square with a hole, an L, and two parts."""
    import geopandas
    import shapely

    shapes = [
        shapely.box(100004, 449988, 100010, 449994) - shapely.box(100006, 449990, 100008, 449992),
        shapely.Polygon([(100011, 449995), (100015, 449995), (100015, 449997), (100013, 449997), (100013, 449999),
                         (100011, 449999)]),
        shapely.MultiPolygon([shapely.box(x, 449997, x + 1, 449999) for x in (100001, 100003)]),
    ]  # fmt: skip
    columns = {"height": [3.0, 5.0, 8.0], "id": ["a", "b", "c"], "use": ["home", "shop", "shed"]} | columns
    return geopandas.GeoDataFrame(columns, geometry=shapes, crs=crs)


AREAS = np.array([36.0 - 4.0, 8.0 + 4.0, 4.0])
"""Areas of the footprints of `buildings`."""


def write_buildings(path, table=None):
    """Write a table of footprints to a file of any format."""
    table = buildings() if table is None else table
    if path.suffix == ".parquet":
        table.to_parquet(path)
    elif path.suffix == ".geojson":
        table.to_file(path, driver="GeoJSON", engine="pyogrio", RFC7946="NO")
    else:
        drivers = {".gpkg": "GPKG", ".shp": "ESRI Shapefile", ".fgb": "FlatGeobuf"}
        table.to_file(path, driver=drivers[path.suffix], engine="pyogrio")
    return path
