"""Optional packages: those that are there are imported, the others get a cure."""

import json

import pytest

from antumbra.errors import InputError
from antumbra.extras import import_extra


def test_a_package_that_is_there_is_imported():
    assert import_extra("json", "--json", "none") is json


def test_a_missing_package_is_named_with_its_extra():
    with pytest.raises(InputError, match=r"--crs needs no_such_package: pip install 'antumbra\[gis\]'"):
        import_extra("no_such_package.crs", "--crs", "gis")
