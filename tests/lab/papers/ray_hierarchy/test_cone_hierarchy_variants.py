"""Names of the tracer `cones`: the report's variants, and free combinations."""

from itertools import combinations

import pytest

from antumbra.base.errors import InputError
from antumbra.engine.method_registry import find_method
from antumbra.engine.plan import parse_plan
from antumbra.lab.papers.ray_hierarchy.cone_hierarchy import CONES, TABLE_1, Cones, combination
from antumbra.techniques.tracer_options import RayHierarchyOptions

WORDS = ["spheres", "precise", "boxes", *(field.replace("_", "-") for field in RayHierarchyOptions._fields[2:])]
EXCLUDED = {("spheres", "precise"), ("spheres", "boxes"), ("precise", "boxes"), ("spheres", "early-accept")}


def test_the_variants_of_table_1():
    columns = {  # test, sorting, early accept, two passes
        "Precise": ("precise", False, False, False),
        "PreciseSorted": ("precise", True, False, False),
        "Spheres": ("spheres", False, False, False),
        "SpheresSorted": ("spheres", True, False, False),
        "PreciseSEA": ("precise", True, True, False),
        "PreciseEATP": ("precise", False, True, True),
        "PreciseSEATP": ("precise", True, True, True),
    }
    assert TABLE_1.keys() == columns.keys()
    for name, options in TABLE_1.items():
        test = "spheres" if options.spheres else "precise"
        assert (test, options.sorted, options.early_accept, options.two_pass) == columns[name]
        assert options.nodes is Cones
        assert not (options.wide or options.blocks or options.shared or options.clustered)


def options_of(*words):
    """The options of words, by another formula."""
    flags = {word.replace("-", "_"): True for word in words} | {"nodes": None if "boxes" in words else Cones}
    return RayHierarchyOptions(**{name: flag for name, flag in flags.items() if name not in ("boxes", "precise")})


def test_each_option_has_a_word_and_each_name_options_of_its_own():
    for word in WORDS:
        assert CONES[f"cones:{word}"][0] == options_of(word) == combination(f"cones:{word}")
    for name, options in TABLE_1.items():
        assert CONES[f"cones:{name}"][0] == options
    assert len(CONES) == len(WORDS) + len(TABLE_1)
    assert len({text for _, text in CONES.values()}) == len(CONES)
    assert not any(find_method("trace", name)[1].builds for name in CONES)


def test_pairs_of_options_combine_unless_they_exclude_each_other():
    for one, other in combinations(WORDS, 2):
        for name in (f"cones:{one}:{other}", f"cones:{other}:{one}"):
            if (one, other) in EXCLUDED:
                with pytest.raises(InputError, match=f"'{one}' and '{other}' exclude each other; omit one of them"):
                    parse_plan(name)
            else:
                assert combination(name) == options_of(one, other)
                assert find_method("trace", name)[0] == f"cones:{one}:{other}" and parse_plan(name).build is None


@pytest.mark.parametrize(
    "name", ["cones", "cones:", "cones:magic", "cones:sorted:sorted", "cones:sorted:", "spheres", "cone:sorted",
             "cones:early_accept", "cones:Precise:sorted", "cones:SORTED", "single:sorted"],
)  # fmt: skip
def test_other_names_are_no_combinations(name):
    assert combination(name) is None
