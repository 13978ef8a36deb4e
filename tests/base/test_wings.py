"""The boundary between the core and its wings: what is named is there, and loads when it is used."""

import configparser
import subprocess
import sys

import pytest

from antumbra.base import wings
from repository import ROOT

PLACES = [
    place
    for name, value in vars(wings).items()
    if name.isupper()
    for place in ((value,) if isinstance(value, str) else value)
]
FOLDERS = {path.parent.name for path in (ROOT / "src" / "antumbra").glob("*/__init__.py")}


@pytest.mark.parametrize("place", PLACES)
def test_places_name_what_is_there(place):
    assert wings.named(place) is not None


def test_functions_are_imported_when_they_are_called():
    assert wings.later("antumbra.base.checks:quoted")("a") == "'a'"
    broken = wings.later("antumbra.base.checks:no_such_function")
    with pytest.raises(AttributeError):
        broken()


def loaded(code: str) -> set[str]:
    """The wings that a program loads."""
    code += "\nimport sys\nprint(*{name.split('.')[1] for name in sys.modules if name.startswith('antumbra.')})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split()) & {"city", "integrations", "lab"}


def test_the_list_of_commands_loads_no_wing():
    assert loaded("from antumbra.cli import main\nmain(['--help'])") == set()


QUERY = """
import antumbra as at
scene = at.procedural("atrium", triangles=1000)
scene.occluded((0.0, 1.0, 0.0), (0.0, 1.0, 0.0))
"""


def test_queries_load_no_wing_but_the_formats_of_files():
    assert loaded(QUERY) <= {"city"}
    assert loaded("import antumbra as at\nat.sun_hours") == {"city"}


def test_contracts_name_all_folders():
    contracts = configparser.ConfigParser()
    contracts.read(ROOT / ".importlinter")
    outside = {f"antumbra.{name}" for name in ("city", "integrations", "lab", "web")}
    folders = {f"antumbra.{name}" for name in FOLDERS}
    boundary = contracts["importlinter:contract:wings"]
    assert set(boundary["source_modules"].split()) == folders - outside
    assert set(boundary["forbidden_modules"].split()) == outside
    layers = contracts["importlinter:contract:floors"]["layers"].replace("|", " ").split()
    assert set(layers) == folders | {"antumbra.version"}
