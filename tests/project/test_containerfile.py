"""The container's image: its file is checked without building it, since few machines of tests have an engine."""

import re
import tomllib
from pathlib import Path

import pytest

requirements = pytest.importorskip("packaging.requirements", reason="pins need packaging: pip install packaging")
ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "Containerfile").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PINS = dict(re.findall(r"^([a-z0-9-]+)==(\S+)$", (ROOT / "recipe" / "constraints.txt").read_text(), re.M))


def needed(extras):
    """The requirements of the package with these extras."""
    found = list(PROJECT["dependencies"])
    for extra in extras:
        found += PROJECT["optional-dependencies"][extra]
    parsed = map(requirements.Requirement, found)
    return [each for each in parsed if each.marker is None or each.marker.evaluate({"extra": ""})]


def test_each_package_of_the_extras_has_one_pin_that_fits():
    (extras,) = re.findall(r"^ARG EXTRAS=(\S+)$", TEXT, re.M)
    found = needed(extras.split(","))
    assert {"numpy", "numba", "ray"} <= {each.name for each in found}
    for each in found:
        name = re.sub(r"[-_.]+", "-", each.name).lower()
        assert each.specifier.contains(PINS[name], prereleases=True), each


def test_the_image_has_a_python_of_the_package_and_the_wheel_of_this_source():
    (python,) = re.findall(r"^FROM python:(\d+\.\d+)-slim$", TEXT, re.M)
    assert f"Programming Language :: Python :: {python}" in PROJECT["classifiers"]
    assert "COPY dist/antumbra-*.whl recipe/constraints.txt /tmp/antumbra/" in TEXT
    assert "--no-index --no-deps --pre --find-links /tmp/antumbra antumbra" in TEXT
    assert '--constraint /tmp/antumbra/constraints.txt "antumbra[$EXTRAS]"' in TEXT
    assert (ROOT / ".containerignore").read_text().split() == ["*", "!dist/*.whl", "!recipe/constraints.txt"]
