"""What formats say of themselves."""

import pytest

from antumbra.base.errors import InputError
from antumbra.formats.format_registry import FORMATS, suffixes_of
from antumbra.formats.scene_format import Contents, check_z_up


def test_formats_of_maps_name_the_command_that_reprojects_them():
    commands = {each.contents: each.reproject("EPSG:28992", False) for each in FORMATS if each.reproject is not None}
    assert commands.keys() == set(Contents) - {Contents.MESHES}
    programs = {contents: command.split()[0] for contents, command in commands.items()}
    assert programs == {Contents.CITY: "cjio", Contents.HEIGHTS: "gdalwarp", Contents.FOOTPRINTS: "ogr2ogr"}
    assert all("28992" in command for command in commands.values())
    assert "crs_assign EPSG_CODE" in commands[Contents.CITY]


def test_suffixes_are_those_of_the_contents():
    assert ".tif" in suffixes_of(Contents.HEIGHTS) and ".glb" in suffixes_of(Contents.MESHES)
    every = [suffix for contents in Contents for suffix in suffixes_of(contents)]
    assert sorted(every) == sorted({suffix for each in FORMATS for suffix in each.suffixes})


def test_geographic_data_has_z_up():
    check_z_up(None, "a.tif")
    check_z_up("z", "a.tif")
    with pytest.raises(InputError, match=r"a\.tif: has z up, as all geographic data; up is 'y', leave it out"):
        check_z_up("y", "a.tif")
