"""Counts, verbs and places in messages; no message of the package writes a plural beside a number by itself."""

import ast
import re
from pathlib import Path

import pytest

import antumbra
from antumbra.base.wording import agreeing, counted, height_text, place_text, plural, some_of

PACKAGE = Path(antumbra.__file__).parent

APART = ("lab/papers", "kernels", "bvh", "store")
"""Folders whose messages are for their developers, or name damage in files."""

LARGE = re.compile(
    r"take|at once|in memory|by block|more than|around|shares|rows$|cells( and )?$|a raster|unlike|its header"
)
"""Text after numbers that are large, since they are about memory."""

THINGS = (
    "areas|axes|cells|chunks|columns|copies|cores|days|directions|edges|faces|features|files|footprints|"
    "frames|kernels|lights|lines|meshes|modules|objects|observers|pairs|parts|pictures|pixels|plans|"
    "points|polygons|rays|rows|samples|sensors|shares|stations|strings|suns|surfaces|targets|texels|"
    "textures|times|trees|triangles|turbines|values|vertices|workers"
)


@pytest.mark.parametrize(
    "noun, several",
    [
        ("point", "points"), ("view factor", "view factors"), ("mesh", "meshes"), ("box", "boxes"),
        ("copy", "copies"), ("ray", "rays"), ("vertex", "vertices"), ("leaf", "leaves"), ("axis", "axes"),
    ],
)  # fmt: skip
def test_a_noun_agrees_with_its_number(noun: str, several: str) -> None:
    assert plural(noun) == several
    assert [counted(n, noun) for n in (0, 1, 2, 1500)] == [
        f"0 {several}",
        f"1 {noun}",
        f"2 {several}",
        f"1,500 {several}",
    ]


def test_a_verb_agrees_with_the_number_of_its_subject() -> None:
    assert counted(1, "point", "lie below") == "1 point lies below"
    assert some_of(1, 1, "point", "lie below") == "1 of 1 point lies below"
    assert some_of(1, 20, "point", "have none") == "1 of 20 points has none"
    assert some_of(2, 20, "point", "are dark") == "2 of 20 points are dark"
    assert [agreeing(1, verb) for verb in ("do", "take", "lack")] == ["does", "takes", "lacks"]


def test_coordinates_have_the_digits_that_tell_points_apart() -> None:
    assert place_text((-0.000293435454864213, 12.25, -0.0)) == "-0.0003,12.25,0"
    assert place_text((84052.5, 446947.5004, 3.0)) == "84052.5,446947.5,3"
    assert place_text((0.000123456789, 0.0, -0.0001)) == "0.000123457,0,-0.0001"
    assert place_text((0.0, 0.0)) == "0,0"


@pytest.mark.parametrize(
    "height, size, text",
    [
        (-0.000293, 29.3, "0"),
        (-2.000293, 29.3, "-2"),
        (1.234567, 29.3, "1.23"),
        (12.36, 5000.0, "12"),
        (3e-5, 0.02, "3e-05"),
    ],
)
def test_a_height_has_the_digits_that_the_size_of_its_scene_shows(height: float, size: float, text: str) -> None:
    assert height_text(height, size) == text


def _sources() -> list[Path]:
    return [p for p in sorted(PACKAGE.rglob("*.py")) if not p.relative_to(PACKAGE).as_posix().startswith(APART)]


def _plurals_beside_numbers(path: Path) -> list[str]:
    """Places in a module where a text of the form ``{n} points`` is written, which would be wrong for 1."""
    things = re.compile(rf" (?:[a-z-]+ )?(?:{THINGS})\b")
    found = []
    for text in (node for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.JoinedStr)):
        for before, (value, after) in zip([None, *text.values], zip(text.values, text.values[1:])):
            product = isinstance(before, ast.Constant) and str(before.value).endswith(" x ")
            if isinstance(value, ast.FormattedValue) and isinstance(after, ast.Constant) and not product:
                number = ast.unparse(value.value)
                if things.match(str(after.value)) and _is_a_count(number) and not LARGE.search(str(after.value)):
                    found.append(f"{path}:{value.lineno}: {{{number}}}{after.value}")
    return found


def _is_a_count(expression: str) -> bool:
    name = r"(\w+\.)*(n|k|n_\w+|count|counts|total|left|missing|cells|rows|triangles|number_of_\w+)"
    return re.fullmatch(rf"len\(.*\)|int\(.*\)|.*\.(sum|size)(\(\))?|{name}", expression) is not None


def test_no_message_writes_a_plural_beside_a_number_that_may_be_one() -> None:
    assert len(_sources()) > 400
    assert [place for path in _sources() for place in _plurals_beside_numbers(path)] == []


def test_the_rule_finds_a_plural_beside_a_number(tmp_path: Path) -> None:
    path = tmp_path / "a.py"
    path.write_text('a = f"{len(rows):,} points"\nb = f"{len(rows)} x {n} points"\nc = f"{name} rows"\n')
    assert _plurals_beside_numbers(path) == [f"{path}:1: {{len(rows)}} points"]
