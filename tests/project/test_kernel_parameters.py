"""Kernels have few parameters and say what each is. Older ones that do not are counted, and the counts only shrink."""

import ast
import re
from collections import Counter
from functools import cache
from pathlib import Path

from repository import ROOT

MOST = 7
"""Parameters of a kernel, at most; more belong together in a NamedTuple."""

EVERYWHERE = {"ticket", "counters"}
"""Parameters that mean the same in all kernels."""

KINDS = {"kernel", "inlined", "formula"}


def counts(text: str) -> Counter[str]:
    """Module -> number, from words ``module:number``. Modules are named without their folders, which may change."""
    return Counter({name: int(number) for name, _, number in (word.partition(":") for word in text.split())})


LONG = counts("""
    block_tree:1 box_nodes:2 bundle:3 cell_marking:1 child_order:1 cone_hierarchy:1 discontinuity_filter:1 filters:2
    instance_batches:1 large_packets:1 lbvh:1 light_list_irradiance:1 moeller_trumbore:1 multi_frusta:1
    occlusion_queries:2 packet16:1 pixel_blocks:1 pixel_hits:3 pixel_tests:1 predicate:1 published_frusta:4
    raster_bins:1 rasteriser:2 ray_bundles:1 ray_hits:1 ray_leaves:2 ray_packet:1 ray_split:1 ray_traversal:1
    receiver_order:1 reverse_frusta:5 sample_frusta:3 shaft_culling:3 shaft_hierarchy:4 single_rays:1 srdh_builder:1
    sweep_sah:1 tile_group:1 tile_lanes:1 top_down:2 transmission:1 transposition:1 tree_layout:1 tree_list:1
    triangle_setup:1 triangle_tests:1 triangle_traversal:7 wide_traversal:1
""")
"""Module -> functions in kernels with more than `MOST` parameters. Those of `exact`, `shafts` and the frusta stay."""

UNDESCRIBED = counts("""
    all_hits:5 alpha_cutouts:5 binned_split:7 bit_matrices:1 block_tree:2 box_nodes:5 bundle:2 cell_marking:2
    child_order:2 cone_hierarchy:3 counters:2 culling_grid:3 discontinuity_filter:2 edge_projection:2 filters:7
    frusta_areas:6 gbuffer:1 hit_intervals:2 horizon:1 instance_batches:1 instance_rays:3 instance_traversal:3
    irradiance:3 large_packets:4 lbvh:5 leaf_packing:5 least_heights:2 light_beams:7 light_list_irradiance:1
    light_samples:1 light_table:4 light_visibility:2 moeller_trumbore:6 morphological_antialiasing:4 morton_sort:3
    multi_frusta:1 mutual_horizons:1 nearest_hits:5 occlusion_queries:3 packet16:3 paged_hits:1
    paged_source:1 pixel_appearance:2 pixel_hits:4 pixel_refinement:3 pixel_tests:3 pre_bvh_culling:3 predicate:17
    primary_frusta:8 primary_rays:5 published_frusta:7 query_bounds:1 raster_bins:5 raster_setup:1 rasteriser:5
    ray_batches:1 ray_bundles:9 ray_hits:2 ray_leaves:6 ray_passes:2 ray_split:5 ray_tile:4 ray_traversal:6
    ray_tree:1 receiver_order:3 receivers:1 refit:3 reinsertion:7 reverse_frusta:2 sample_frusta:5 shading:1
    shadow_query:4 shaft_culling:5 shaft_hierarchy:10 shafts:1 single_rays:3 sky_background:1 srdh_builder:9
    sun_tally:1 surface_crossing:5 surface_links:1 terrain_lanes:3 terrain_ray_lists:1 terrain_rays:1 tile:7
    tile_clusters:6 tile_group:4 tl_lbvh:13 top_down:5 top_levels:12 transmission:1 tree_layout:7 tree_parts:2
    tree_quality:8 triangle_bounds:4 triangle_setup:4 triangle_tests:2 triangle_traversal:11 walkthroughs:1
    wide_bvh:2 wide_traversal:1
""")
"""Module -> kernels of which a parameter has neither an annotation, nor is it named in the docstring or a comment."""


@cache
def functions() -> list[tuple[Path, ast.FunctionDef, set[str]]]:
    """The functions that kernels are made of, with their decorators."""
    found = []
    for path in sorted((ROOT / "src" / "antumbra").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                kinds = KINDS & {each.id for each in node.decorator_list if isinstance(each, ast.Name)}
                if kinds:
                    found.append((path, node, kinds))
    return found


def undescribed(function: ast.FunctionDef, lines: list[str]) -> list[str]:
    """The parameters of a kernel that it does not describe."""
    own = [line.partition("#")[2] for line in lines[function.lineno - 1 : function.end_lineno]]
    text = "\n".join([ast.get_docstring(function) or "", *own])
    names = [each.arg for each in function.args.args if each.annotation is None and each.arg not in EVERYWHERE]
    return [name for name in names if not re.search(rf"\b{name}\b", text)]


def test_kernels_have_few_parameters():
    found = Counter(path.stem for path, function, _ in functions() if len(function.args.args) > MOST)
    assert not found - LONG, f"more than {MOST} parameters: bundle those that belong together in a NamedTuple"


def test_kernels_describe_their_parameters():
    found = Counter(
        path.stem
        for path, function, kinds in functions()
        if "kernel" in kinds and undescribed(function, path.read_text().split("\n"))
    )
    assert not found - UNDESCRIBED, "annotate the parameters, or describe them in comments: # In: ... # Out: ..."


def test_a_parameter_without_a_word_is_found():
    source = "def f(a, b, ticket, c: int):\n    # In: a, (n,) float32\n    return a\n"
    (function,) = ast.parse(source).body
    assert undescribed(function, source.split("\n")) == ["b"]


def test_the_counts_are_of_modules_that_exist():
    known = {path.stem for path, *_ in functions()}
    assert LONG.keys() <= known and UNDESCRIBED.keys() <= known and all((LONG + UNDESCRIBED).values())
