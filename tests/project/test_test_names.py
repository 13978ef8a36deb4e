"""Tests are where one looks for them: a file is named after a module, in the folder of the same name."""

import ast
from functools import cache
from pathlib import Path

from repository import ROOT

SOURCES, TESTS = ROOT / "src" / "antumbra", ROOT / "tests"

ACROSS = {
    "benchmarks": "the scripts in benchmarks/, small",
    "contract": "properties of all functions, plans or scenes at once",
    "project": "what surrounds the package: documents, scripts, packages, releases",
}
"""Folder of tests that mirrors no folder of the package -> what it tests."""

THROUGH = {
    "pictures, rays and points of all plans, whose bits are compared with the oracle": """
        trace/descent trace/horizon trace/frusta/bundle trace/frusta/multi_frusta
        trace/rays/interleaved_rays trace/rays/ray_packet
        techniques/chcrt/nearest_hits
    """,
    "scenes of instances, which have the bits of their flattened copies": """
        bvh/instance_trees scene/instance_bounds trace/rays/instance_batches
        trace/rays/instance_rays trace/rays/instance_traversal trace/rays/local_rays formats/instance_arrays
    """,
    "trees of all builders": """
        kernels/transposition
    """,
    "loops of kernels in threads": """
        kernels/ticket_loops
    """,
    "frames, points and rays of an engine": """
        engine/sources/paged_hits engine/sources/point_shadows engine/visibility
        engine/joined_store_tree lab/culling_picture
    """,
    "files and arrays that load, from_raster, from_footprints and from_trees read": """
        city/gis/gis_scenes city/gis/csv_rows formats/json_fields formats/ply_rows
        formats/reprojection city/gis/footprint_solids
        city/gis/height_tiles city/gis/vector_table
        city/gis/vrt_files formats/gltf/accessors
    """,
    "the records of kernels, which its calls make": """
        engine/small_scenes picture/example_calls
    """,
    "procedural scenes": """
        generate/forest generate/palette scene/palette_scene
    """,
    "the tracer of the folder": """
        trace/frusta/frusta_areas trace/terrain/terrain_sweep
    """,
    "scenes that are loaded, joined and updated": """
        base/pickles scene/map_degrees scene/moved_geometry
    """,
    "stores that are built and read": """
        store/chunk_sorting store/staged_looks store/store_directory store/store_writer
    """,
    "the study of the folder": """
        city/sight/line_points city/shadow/plane_projection city/shadow/shadow_polygons
        city/skyline/edge_projection city/tables/surface_columns city/tables/polygon_files city/pv/modules
        city/pv/pv_options city/sight/observers city/sun/route_options baking/converted_scenes
        baking/emission
        scene/height_surveys
    """,
    "commands": """
        city/sun/calendar_command city/sun/route_command picture/picture_records web/page_command
        version
    """,
    "the measurements of the paper": """
        lab/papers/chc_rt/chcrt_tables lab/papers/multi_frusta/frusta_measurements
        lab/papers/multi_frusta/frusta_plots lab/papers/multi_frusta/frusta_tables lab/papers/multi_frusta/hit_intervals
        lab/papers/multi_frusta/large_packets lab/papers/pre_bvh_culling/culling_charts
        lab/papers/scenes/cellar lab/papers/srdh/srdh_tables
    """,
}
"""Through what modules are tested that no test imports -> these modules."""

UNNAMED = {module: reason for reason, names in THROUGH.items() for module in names.split()}


@cache
def modules() -> set[str]:
    """The modules and folders of the package, as paths without a suffix."""
    paths = [path for path in SOURCES.rglob("*") if path.suffix == ".py" or path.is_dir()]
    names = {path.relative_to(SOURCES).with_suffix("").as_posix() for path in paths}
    return {name for name in names if not name.endswith(("__", "__pycache__", "libraries"))}


def files_of_tests() -> list[Path]:
    return sorted(path.relative_to(TESTS) for path in TESTS.rglob("test_*.py"))


def module_of(test: Path) -> str | None:
    """The module whose name a test file bears: ``test_MODULE.py`` or ``test_MODULE_ASPECT.py``; None: no module."""
    words = test.stem.removeprefix("test_").split("_")
    known, folder = modules(), test.parent
    names = ("_".join(words[:count]) for count in range(len(words), 0, -1))
    return next((name for name in names if (folder / name).as_posix() in known), None)


def test_each_file_bears_the_name_of_a_module_in_its_folder():
    tests = [test for test in files_of_tests() if test.parts[0] not in ACROSS]
    assert len(tests) > 250
    assert [str(test) for test in tests if module_of(test) is None] == []


def test_folders_across_the_package_are_those_with_a_reason():
    assert ACROSS.keys() <= {path.name for path in TESTS.iterdir()}
    assert not ACROSS.keys() & {path.name for path in SOURCES.iterdir()} - {"benchmarks"}


@cache
def imports_of_tests() -> list[tuple[Path, str, list[ast.alias]]]:
    """(file, module of the package as a path, names) of each import from the package in the tests."""
    found = []
    for path in TESTS.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("antumbra"):
                module = node.module.removeprefix("antumbra").strip(".").replace(".", "/")
                found.append((path.relative_to(TESTS), module, node.names))
    return found


def test_each_module_is_imported_by_a_test_or_has_a_reason():
    named = {module for _, module, _ in imports_of_tests()}
    named |= {f"{module}/{name.name}".lstrip("/") for _, module, names in imports_of_tests() for name in names}
    named |= {(test.parent / module).as_posix() for test in files_of_tests() if (module := module_of(test))}
    files = {name for name in modules() if (SOURCES / f"{name}.py").exists()}
    assert files - named == UNNAMED.keys()


def test_no_test_renames_a_module():
    """A module has one name, also in tests; beside a variable of this name, it is NAME_module."""
    renamed = [
        f"{path}: {name.name} as {name.asname}"
        for path, folder, names in imports_of_tests()
        for name in names
        if name.asname not in (None, name.name, f"{name.name}_module")
        and f"{folder}/{name.name}".lstrip("/") in modules()
    ]
    assert renamed == [] and len(imports_of_tests()) > 1000
