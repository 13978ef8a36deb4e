"""Published figures in the code are those that the papers print, in tables and in sentences."""

import importlib
import pkgutil
import re
from itertools import pairwise

import pytest

from paper_tables import number_in, numbers_in, paper_text, rows_of, section_of


def constant(folder: str, name: str):
    """A constant of a paper's folder, in whichever of its modules it stands; `*_published` comes first."""
    package = importlib.import_module(f"antumbra.lab.papers.{folder}")
    names = sorted((m.name for m in pkgutil.iter_modules(package.__path__)), key=lambda n: not n.endswith("_published"))
    modules = (importlib.import_module(f"{package.__name__}.{module}") for module in names)
    return next(value for module in modules if (value := vars(module).get(name)) is not None)


def approx(value):
    """Equal but for the rounding of floats: figures are copied, not computed."""
    return pytest.approx(value, rel=1e-12)


# --- SRDH -------------------------------------------------------------------------------------------------------------


def test_srdh_table_1():
    rows = [row for row in rows_of(section_of(paper_text("srdh"), "Ray Set from 16", "**Table 1:**")) if row[1:2]]
    printed = {}
    for scene, triangles, sah, *sets in rows:
        if triangles.isdigit():
            for pixels, (rays, srdh, total) in zip((16, 32), (sets[:3], sets[3:])):
                printed[scene, pixels] = (int(triangles), float(sah), int(rays), float(srdh), numbers_in(total))
    builds = constant("srdh", "PUBLISHED_BUILDS")
    assert len(printed) == len(builds) == 10
    for row in builds:
        triangles, sah, rays, srdh, (total, ratio) = printed[row.scene, row.pixels]
        assert (row.triangles, row.sah, row.rays, row.srdh) == (triangles, sah, rays, srdh)
        assert round(row.sah + row.srdh, 1) == total
        assert abs(row.both - ratio) < 0.11  # they divided before rounding


def test_srdh_sentences():
    text = paper_text("srdh")
    assert constant("srdh", "REDUCTION") == tuple(
        n / 100 for n in numbers_in(re.search(r"between 22% and 56%", text)[0])
    )
    assert constant("srdh", "WITHIN") == number_in(re.search(r"traversal cost is within (\d+)%", text)[1]) / 100
    bedroom = re.search(r"by (\d+)% compared to randomized\s+traversal \((\d+)% and (\d+)% compared to back", text)
    assert list(constant("srdh", "BEDROOM").items()) == [
        (order, int(share) / 100) for order, share in zip(("random", "back-to-front", "rtsah"), bedroom.groups())
    ]
    assert f"at shallow depth (depth {constant('srdh', 'BLINDS_DEPTHS')['SRDH'][0]})" in text
    deep = re.search(r"subtrees\s+rooted at depths (\d+) and (\d+)", text)
    assert constant("srdh", "BLINDS_DEPTHS")["SAH"] == tuple(map(int, deep.groups()))
    assert "acceleration-structure size is at most a factor of two" in text and constant("srdh", "GROWTH") == 2
    unoccluded = re.search(r"unoccluded ray cost by (\d+)% and (\d+)% in the SPONZA and ARCADE", text)
    shares = constant("srdh", "PUBLISHED_UNOCCLUDED")
    assert shares == {"SPONZA": int(unoccluded[1]) / 100, "ARCADE": int(unoccluded[2]) / 100}


# --- Pre-BVH culling --------------------------------------------------------------------------------------------------


METHODS = {
    "LBVH": "LBVH",
    "LBVH culling": "LBVH culled",
    "TL-LBVH": "TL-LBVH",
    "TL-LBVH culling": "TL-LBVH culled",
    "BSAH BVH": "BSAH",
}


def detailed_tables():
    """Tables 1 and 2: view -> part of the table -> its times in milliseconds."""
    text, views = paper_text("pre-bvh-culling"), {}
    for start, end in (("\tFigure 3\tFigure 4", "**Table 1:**"), ("\tFigure 5\tFigure 6", "**Table 2:**")):
        (_, *names), *rows = rows_of(section_of(text, start, end))
        for k, name in enumerate(names, 1):
            part = ""
            for row in rows:
                if row[k]:
                    views.setdefault(name, {}).setdefault(part, []).append(number_in(row[k]))
                else:
                    part = row[0].rstrip(":").removeprefix("Render with ")
    return views


def test_culling_tables_1_and_2():
    views, times = detailed_tables(), constant("pre_bvh_culling", "TIME_TO_IMAGE")
    assert list(views) == list(times)
    for view, parts in views.items():
        assert tuple(parts["General"] + parts["Culling details"]) == constant("pre_bvh_culling", "DETAILS")[view][:6]
        for part, method in METHODS.items():
            *_, build, trace = parts[part]
            assert times[view][method][1:3] == (build, trace), (view, method)


def flat(value):
    """The numbers in nested dicts and tuples."""
    if isinstance(value, dict):
        value = value.values()
    return {value} if isinstance(value, float) else {number for each in value for number in flat(each)}


def test_culling_sums_of_tables_1_and_2():
    """The code has the sums that Tables 1 and 2 print. For Figure 5, Table 3 prints another one."""
    tables = [constant("pre_bvh_culling", name) for name in ("DETAILS", "TIME_TO_IMAGE")]
    for view, parts in detailed_tables().items():
        printed = {parts[part][0] for part in ("LBVH culling", "TL-LBVH culling")}
        assert printed <= {number for table in tables for number in flat(table[view])}, view


def test_culling_table_3():
    rows = rows_of(section_of(paper_text("pre-bvh-culling"), "\tCull\tBuild\tTrace", "**Table 3:**"))
    times, view, seen = constant("pre_bvh_culling", "TIME_TO_IMAGE"), "", 0
    for name, *cells in rows[1:]:
        if not any(cells):
            view = name
            continue
        cull, build, trace, once, _, ten, _, hundred, _ = cells
        printed = [0.0 if cull in "–-" else float(cull), *map(float, (build, trace, once, ten, hundred))]
        assert list(times[view][name]) == printed, (view, name)
        seen += 1
    assert seen == 20


def test_culling_table_4():
    rows = rows_of(section_of(paper_text("pre-bvh-culling"), "\t16 <sup>3</sup>", "**Table 4:**"))
    named = [(row[0], [number_in(cell) for cell in row[1:] if cell]) for row in rows[1:]]
    lines = [cells for _, cells in named if cells]
    names = [name for name, cells in named if cells]
    assert names[3] == "Remaining triangles" and names[6] == names[11] == "Sum culling"
    sources, mark, triangles, remaining, lbvh, lbvh_trace, sums, build, trace, tl, tl_trace, _, tl_build, tl_traced = (
        lines
    )
    grids = constant("pre_bvh_culling", "GRIDS")
    for k, grid in enumerate((16, 32, 64, 128, 256)):
        columns = (sources, mark, triangles, sums, build, trace, tl_build, tl_traced)
        assert grids[grid] == (approx(remaining[k] / 100), *(column[k] for column in columns))
    assert constant("pre_bvh_culling", "UNCULLED") == (*lbvh, *lbvh_trace, *tl, *tl_trace)


def test_culling_captions():
    text = paper_text("pre-bvh-culling")
    captions = {
        view: section_of(text, f"**{view}:**", "\n") for view in ("Figure 3", "Figure 4", "Figure 5", "Figure 6")
    }
    shares = {view: int(re.search(r"(\d+)%", caption)[1]) / 100 for view, caption in captions.items()}
    assert constant("pre_bvh_culling", "REMAINING") == shares


# --- Ray hierarchies --------------------------------------------------------------------------------------------------


def test_ray_hierarchy_tables():
    text = paper_text("ray-hierarchy")
    names = [row[0] for row in rows_of(section_of(text, "\tCone/Triangle Test", "In Figure 6")) if row[0]]
    assert sorted(names) == sorted(constant("ray_hierarchy", "VARIANTS"))
    times, nodes = section_of(text, "\tShadow compute time", "7 Future Work").split("\tNumber of nodes")
    for table, unit, part in (("MILLISECONDS", 1.0, times), ("NODES", 1.0, nodes)):
        printed = {row[0]: [unit * number_in(cell) for cell in row[1:]] for row in rows_of(part) if row[0]}
        ours = constant("ray_hierarchy", table)
        assert list(printed) == list(ours) and len(printed) == 4
        for variant, figures in ours.items():
            assert list(figures) == approx(printed[variant])


# --- Multi-frusta tracing ---------------------------------------------------------------------------------------------


def test_frusta_table_1():
    """Thousands of each counter, and millions of cycles; packets before culling have one number of triangles."""
    rows = rows_of(section_of(paper_text("multi-frusta-tracing"), "T-Rex (69K triangles)", "Table 1: Statistical"))
    printed = [row for row in rows if row[0].startswith(("P-", "S-"))]
    table = constant("multi_frusta", "TABLE1")
    assert len(printed) == len(table) == 16
    for row, (name, *cells) in zip(table, printed):
        triangles, boxes, tests, cycles = (numbers_in(cell) for cell in cells)
        assert name.startswith(row.name)
        assert [row.triangles, row.candidates] == [number / 1e3 for number in (triangles * 2)[:2]]
        assert [row.box_tests, row.triangle_tests] == [boxes[0] / 1e3, tests[0] / 1e3]
        shaded = [] if row.with_shading is None else [row.with_shading]
        assert [row.cycles, *shaded] == approx([number / 1e6 for number in cycles])


def test_frusta_table_2():
    rows = rows_of(section_of(paper_text("multi-frusta-tracing"), "\t#tris (+culling) accesses", "Table 2: Three"))
    printed = {"No Shrink.": [0.0, 0.0, 0.0, 0.0]}
    for (above, *_), (name, *cells) in pairwise(rows):
        if not name and above in ("Ray-AABB", "CR", "FS"):
            printed[above] = [number for cell in cells for number in numbers_in(cell)]
    ours = constant("multi_frusta", "TABLE2")
    assert len(printed) == len(ours) == 4
    for theirs, figures in zip(printed.values(), ours.values()):
        assert [int(figure) for figure in figures.split()] == [round(number) for number in theirs]


def test_frusta_sentences():
    text = paper_text("multi-frusta-tracing")
    fewer = re.search(r"\((\d)-(\d)% less #AABB tests", text)
    most = re.search(r"reaches at most (\d+)% of the performance", text)
    assert constant("multi_frusta", "PACKET256") == (
        f"-{fewer[1]} to -{fewer[2]} %", f"at most {int(most[1]) / 100:g}"
    )  # fmt: skip
    edges = re.search(r"roughly ([\d.]+)% of all pixels are marked", text)
    assert constant("multi_frusta", "EDGES") == approx(float(edges[1]) / 100)


# --- CHC+RT -----------------------------------------------------------------------------------------------------------


SCENES = ("City-10", "Powerplant", "777-Section", "City-200", "Powerplant x 16", "777")


def chcrt_rows(start: str, end: str) -> list[list[str]]:
    return rows_of(section_of(paper_text("chc-rt"), start, end))


def test_chcrt_table_1():
    heads, *rows = chcrt_rows("\tCity-10\tPowerplant", "Table 1:")
    assert [head.replace("×", "x") for head in heads[1:]] == list(SCENES)
    columns = list(zip(*rows))[1:]
    for scene, (triangles, size, resident, parts) in zip(SCENES, columns):
        bvh, geometry = (number_in(part) for part in parts.split("/"))
        megabytes = 1000.0 if parts.endswith("GB") else 1.0
        total = number_in(size) * (1000.0 if size.endswith("GB") else 1.0)
        expected = number_in(triangles), total, megabytes * bvh, megabytes * geometry, number_in(resident)
        assert constant("chc_rt", "MODELS")[scene] == approx(expected), scene


def test_chcrt_table_2():
    times, paged, scene, seen = constant("chc_rt", "TIMES"), constant("chc_rt", "PAGED_TIMES"), "", 0
    for name, method, *cells in chcrt_rows("Scene\tRay type\tNear-View (ms)", "Table 2:"):
        if method not in ("GLSL", "CHC+RT", "CUDA"):
            continue
        scene = re.sub(r"\s*×\s*", " x ", name) or scene
        figures = [number_in(cell) for cell in cells[::2]]
        ours = paged[scene] if scene in paged else times[scene][method]
        assert [*ours[0], *ours[1]] == figures, (scene, method)
        seen += 1
    assert seen == 12 == sum(map(len, times.values())) + len(paged)


MISPRINTS = {("777", "Queries"): {3: 6310.0}}
"""(scene, row) -> column -> the value that Table 3 should have: it prints 6.31, without the K of the others."""


def test_chcrt_table_3():
    statistics, moved, scene, seen = constant("chc_rt", "STATISTICS"), constant("chc_rt", "MOVED"), "", 0
    for name, what, *cells in chcrt_rows("Scene\tRay type\tNear-View\t", "Table 3:"):
        scene = {"PP×16": "Powerplant x 16"}.get(name, name) or scene
        place = {"Mrays/sec": (statistics, 0), "Queries": (statistics, 1), "Trans. MB": (statistics, 2),
                 "BVH": (moved, 0), "Geom": (moved, 1)}.get(what)  # fmt: skip
        if place:
            near, far = place[0][scene][place[1]]
            wrong = MISPRINTS.get((scene, what), {})
            printed = [wrong.get(k, number_in(cell)) for k, cell in enumerate(cells)]
            assert [*near, *far] == approx(printed), (scene, what)
            seen += 1
    assert seen == 15


def test_chcrt_tables_4_and_5():
    aggressive, seen = constant("chc_rt", "AGGRESSIVE"), 0
    for pixels, _, *cells in chcrt_rows("Pixels\t%Tile", "**Table 4:**")[1:]:
        figures = [number_in(cell) for cell in cells]
        for scene, pair in zip(("City-200", "Powerplant x 16", "777"), zip(figures[::2], figures[1::2])):
            assert aggressive[scene][int(pixels)] == pair
            seen += 1
    assert seen == 12
    rotated, kind = {}, ""
    for row in chcrt_rows("\tNone\t18", "**Table 5:**")[1:] or chcrt_rows("Randomization", "**Table 5:**"):
        kind = row[0] or kind
        if "Near" in row[1]:
            rotated[row[1].split()[0], {"Diffuse": "diffuse"}.get(kind, kind)] = tuple(map(number_in, row[2:]))
    assert rotated == constant("chc_rt", "RANDOMISATION") and len(rotated) == 4


def test_chcrt_sentences():
    text = paper_text("chc-rt")
    assert constant("chc_rt", "BEST") == float(re.search(r"up to\s+\$?([\d.]+)\\times", text)[1])
    assert constant("chc_rt", "ERROR") == float(re.search(r"mean absolute pixel error of ([\d.]+)\.", text)[1])
    factor = re.search(r"Powerplant scene it results in a speedup by a factor of (\d+) for Full-HD", text)
    assert constant("chc_rt", "SCREEN_HIERARCHY") == int(factor[1])
