"""The benchmark of viewsheds over rasters of heights."""

import shutil

import pytest


def test_every_method_has_a_row(run):
    pytest.importorskip("rasterio")
    found = run("terrain", "--sizes", 40, "--rounds", 1, "--threads", 1, "--step", 120)
    rows = {row["method"]: row for row in found.rows}
    assert {"viewshed", "least height", "sun hours"} <= set(rows) and "1,600" in found.out
    assert all(row["cpu_seconds"] > 0 and row["cells"] == 1600 for row in rows.values())
    if shutil.which("gdal_viewshed"):
        assert rows["gdal_viewshed"]["equal"] > 0.9
    else:
        assert any("gdal_viewshed" in line for line in found.skipped())
