"""Benchmarks with peers run with the installed ones, and without the others."""

import importlib
import json
import re
import shutil
import subprocess
from importlib.util import find_spec
from xml.etree import ElementTree

import pytest

import antumbra as at
import wrong_elsewhere
from antumbra.engine.method_registry import BUILDERS, own_methods

SMALL = ("--size", 24, 24, "--rounds", 1, "--threads", 1)
PLANS = ("bsah+single", "bsah+multifrusta")
OTHERS = "mitsuba,drjit,open3d"


@pytest.fixture(params=("with", "without"))
def hidden(request) -> str:
    """Modules to hide: the large peers, so that the test is the same everywhere. The second run hides Embree too."""
    if request.param == "without":
        return f"embreex,{OTHERS}"
    pytest.importorskip(
        "embreex", reason="Embree is not installed, so nothing is compared with it: pip install embreex"
    )
    return OTHERS


def check_left_out(outcome, *names):
    """Check for one line for each missing peer, however much is measured."""
    lines = outcome.skipped()
    assert [line.split()[1] for line in lines] == list(names) and all("pip install" in line for line in lines), lines


def without_embree(hidden) -> bool:
    return hidden.startswith("embreex")


def check_contenders(outcome, hidden, ours):
    """Check for a row for each of ours, without differences, and for rows of Embree. All have rates."""
    families = {row["family"] for row in outcome.rows}
    own = [row for row in outcome.rows if row["family"] == "antumbra"]
    assert sorted(row["contender"] for row in own) == sorted(ours) and {row["differs"] for row in own} == {0}
    assert all(row["contender"] in outcome.out for row in outcome.rows)
    if without_embree(hidden):
        assert families == {"antumbra"} and "embree not installed" in outcome.out
        assert not any("ratio" in row for row in own)
    else:
        assert len(families) > 1 and all(family.startswith(("antumbra", "Embree")) for family in families)
        assert all(row["ratio"] > 0 for row in own)


@pytest.mark.parametrize("fresh", [[], ["--fresh"]], ids=["settled", "fresh"])
def test_arrays(run, small, hidden, fresh):
    done = run("arrays", small, "--rays", 1024, "--rounds", 1, "--threads", 1, *fresh, without=hidden)
    check_left_out(done, *["Embree"] * without_embree(hidden), "Open3D")
    embree = [f"embree {packet} {quality}" for quality in ("medium", "high") for packet in (1, 16)]
    methods = ["occluded"] if without_embree(hidden) else ["occluded", *embree, "embreex"]
    found = [(row["kind"], row["method"]) for row in done.rows]
    assert found == [(kind, method) for kind in ("coherent", "incoherent") for method in methods]
    assert all(0 < row["hit"] < 1 and row["rays"] == 1024 for row in done.rows)
    differ = {row["differ_from_embree"] for row in done.rows}
    assert differ == {None} if without_embree(hidden) else max(differ) <= 10  # Embree rounds; ours do not
    assert ("tree optimised after" in done.out) != bool(fresh)
    assert done.out.count("\n") == 2 - len(fresh) + len(done.rows)


def test_arrays_of_closest_hits(run, small, hidden):
    sizes = "--rays", 1024, "--rounds", 1, "--threads", 1, "--fresh"
    done = run("arrays", small, "--query", "closest", "--clock", "cpu", *sizes, without=hidden)
    kinds = [row["kind"] for row in done.rows if row["method"] == "closest"]
    assert kinds == ["camera", "bounce", "random"] and all(0 < row["hit"] <= 1 for row in done.rows)
    differ = {row["differ_from_embree"] for row in done.rows}
    assert differ == {None} if without_embree(hidden) else max(differ) <= 10  # faces at the same t, and roundings


def test_build(run, small, hidden):
    done = run("build", small, "--size", 16, "--rounds", 1, "--threads", 1, without=hidden)
    check_left_out(done, *["Embree"] * without_embree(hidden))
    peers = [] if without_embree(hidden) else ["embree low", "embree medium", "embree high"]
    assert [row["method"] for row in done.rows] == [*own_methods("build"), *peers]
    assert all(row["sah"] > 1 and row["trace_single_ms"] > 0 for row in done.rows if row["method"] in BUILDERS)
    assert all((row["ratio"] is None) == without_embree(hidden) for row in done.rows)
    assert done.out.count("\n") == 1 + len(done.rows)


def test_primary(run, small, hidden):
    done = run("primary", small, *SMALL, without=hidden)
    check_left_out(done, *["Embree"] * without_embree(hidden))
    check_contenders(done, hidden, ("rays", "rasterise", "gbuffer"))
    assert all(0 < row["hit"] < 1 for row in done.rows)


def test_soft_shadows(run, small, hidden):
    done = run("soft_shadows", small, *SMALL, "--spp", 4, "--lights", "large", "--plans", *PLANS, without=hidden)
    check_left_out(done, *["Embree"] * without_embree(hidden), "Mitsuba", "Open3D")
    check_contenders(done, hidden, PLANS)
    assert all(0 < row["occluded"] < 1 for row in done.rows)


def test_dynamic(run, moving, hidden):
    done = run("dynamic", moving, *SMALL, "--frames", 2, "--spp", 4, "--plans", *PLANS, without=hidden)
    check_left_out(done, *["Embree"] * without_embree(hidden))
    check_contenders(done, hidden, PLANS)
    assert all(len(row["totals"]) == 2 for row in done.rows)


@pytest.mark.parametrize("module, family", [("mitsuba", "Mitsuba"), ("open3d", "Open3D")])
def test_soft_shadows_beside_others(run, small, module, family):
    reason = f"no comparison with {family}, as it is not installed: pip install {module}"
    pytest.importorskip(module, reason=reason, exc_type=ImportError)
    hidden = ",".join({"embreex", "mitsuba", "open3d"} - {module})
    done = run("soft_shadows", small, *SMALL, "--lights", "large", "--plans", *PLANS, without=hidden)
    assert {row["family"] for row in done.rows} == {"antumbra", family}


def test_rebuild(run, small, hidden):
    sizes = ("--size", 24, 24, "--sizes", "1k,2k", "--frames", 1, "--rounds", 1, "--threads", 1)
    done = run("rebuild", small, *sizes, without=hidden)
    ours = [row for row in done.rows if not row["method"].startswith("Embree")]
    assert len(ours) == 5 * 5 and {row["differs"] for row in ours} == {0}
    assert all((row["ratio"] is None) == without_embree(hidden) for row in done.rows)


def test_sun(run, small, hidden):
    done = run("sun", small, "--sensors", 200, "--slice", 50, "--threads", 1, without=hidden)
    methods = {row["method"] for row in done.rows}
    assert methods == ({"sun_hours"} if without_embree(hidden) else {"sun_hours", "embree numpy", "embree bare"})
    assert all(row["million_pairs_per_second"] > 0 for row in done.rows)
    check_left_out(done, *(["Embree"] if without_embree(hidden) else []))


def test_wrong_elsewhere(run, hidden, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{wrong_elsewhere.BEGIN}old\n{wrong_elsewhere.END}after\n")
    done = run("wrong_elsewhere", "--rays", 30, "--write", page, without=f"{hidden},warp,rtree")
    names = {row["case"]: row["wrong"] for row in done.rows}
    assert len(names) == len(done.rows) == 13
    assert all(wrong["Antumbra"] == 0 for wrong in names.values())
    assert all(("Embree" in wrong) != without_embree(hidden) for wrong in names.values())
    assert sum(row["blocked"] < row["rays"] for row in done.rows) > 0 and all(row["blocked"] for row in done.rows)
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "old" not in text
    assert text.count("\n| ") == 14 and "python benchmarks/wrong_elsewhere.py --rays 30" in text


def test_drop_in(run, small, hidden):
    sizes = "--rays", 1, 200, "--small", 30, "--rounds", 1
    done = run("drop_in", small, *sizes, without=f"{hidden},rtree")
    check_left_out(done, *(["trimesh"] if without_embree(hidden) else []), "Open3D", "trimesh")
    names = [(row["peer"], row["query"], row["queries"]) for row in done.rows]
    assert len(set(names)) == len(names) == 28 and {peer for peer, _, _ in names} == {"trimesh, Embree", "Open3D"}
    timed = [row for row in done.rows if row["ratio"] is not None]
    assert all(row["ours"] > 0.0 for row in done.rows) and len(timed) == (0 if without_embree(hidden) else 11)
    lines = [line for line in done.out.splitlines() if line.endswith(" wrong")]
    ours = [line for line in lines if "Antumbra as " in line]
    assert len(ours) == 16 and all(" 0 of 30 wrong" in line for line in ours)
    assert len(lines) == 16 + (0 if without_embree(hidden) else 8)


def test_open3d_suite(run, tmp_path):
    """On a small stand-in for the file of Open3D's tests."""
    try:
        importlib.import_module("open3d")
    except (ImportError, OSError):
        pytest.skip("Open3D cannot be imported: the command that runs its tests is NOT checked")
    tests = tmp_path / "python" / "test" / "t" / "geometry" / "test_raycasting_scene.py"
    tests.parent.mkdir(parents=True)
    tests.write_text(
        "import open3d as o3d\n"
        "def test_misses():\n"
        "    scene = o3d.t.geometry.RaycastingScene()\n"
        "    rays = o3d.core.Tensor([[0, 0, 0, 0, 0, 1]], dtype=o3d.core.float32)\n"
        "    assert not scene.test_occlusions(rays).numpy().any()\n"
        "def test_fails():\n"
        "    assert False\n"
    )
    done = run("open3d_suite", tmp_path, rows=False)
    for name in "Open3D", "Antumbra":
        assert re.search(rf"^{name} +1 of 2 tests pass; fails: test_fails$", done.out, re.MULTILINE)


def test_javascript(run):
    npm = shutil.which("npm")
    if (
        npm is None
        or find_spec("ziglang") is None
        or subprocess.run([npm, "view", "three"], capture_output=True).returncode
    ):
        pytest.skip("no npm or its registry, or no ziglang: the benchmark of the package for JavaScript is NOT run")
    done = run("javascript", at.examples.file_of("temple"), "--rays", 100, "--rounds", 1)
    assert {row["query"] for row in done.rows} >= {"build", "any hit", "closest hit"}
    assert all(row["wrong"] == 0 and row["ours"] > 0.0 for row in done.rows)


def test_peer_chart(run, tmp_path):
    case = {"scene": "forest", "light": "small", "threads": 1, "rounds": 1}
    rates = {"antumbra": 3.0, "Embree": 2.0}
    rows = [{**case, "family": family, "mrays": rate} for family, rate in rates.items()]
    (tmp_path / "in.json").write_text(json.dumps({"machine": {"processor": "some"}, "rows": rows}))
    run("peer_chart", tmp_path / "in.json", "-o", tmp_path / "chart.svg", rows=False)
    chart = ElementTree.parse(tmp_path / "chart.svg").getroot()
    words = [element.text for element in chart.iter() if element.tag.endswith("text")]
    assert {"Forest", "1.5", "Embree = 1"} <= set(words)
    assert sum(element.tag.endswith("rect") for element in chart.iter()) == 1


def row_of(family, mrays, light="small", threads=1):
    return {
        "scene": "forest", "light": light, "threads": threads, "rounds": 1, "family": family, "mrays": mrays
    }  # fmt: skip


def test_peer_chart_compares_rows_of_one_number_of_threads_and_needs_both():
    ratios = importlib.import_module("peer_chart").ratios
    rows = [row_of("antumbra", 4.0), row_of("Embree", 1.0), row_of("antumbra", 9.0, threads=2)]
    assert ratios(rows) == {"forest": 4.0}
    assert ratios([*rows, row_of("Embree packet", 9.0, threads=2)]) == {"forest": 2.0}
    assert ratios([row_of("antumbra", 3.0)]) == {}


def test_view_factors(run):
    sizes = "--divisions", 1, "--samples", 512, "--rounds", 1
    done = run("view_factors", *sizes, without="pyviewfactor,raystrack")
    check_left_out(done, "pyViewFactor", "raystrack")
    assert [row["case"] for row in done.rows] == ["rectangles", "edge", "room", "obstructed room"]
    assert all(0.0 < row["error"] < 0.05 and row["seconds"] >= 0.0 for row in done.rows)
    assert [row["row_sum_error"] for row in done.rows] == [None, None, 0.0, 0.0]


def test_view_factors_beside_pyviewfactor(run):
    reason = "no comparison with pyViewFactor, as it is not installed: pip install pyviewfactor"
    pytest.importorskip("pyviewfactor", reason=reason, exc_type=ImportError)
    done = run("view_factors", "--divisions", 1, "--samples", 512, "--rounds", 1, without="raystrack")
    peer = {row["case"]: row["error"] for row in done.rows if row["contender"] == "pyViewFactor"}
    assert peer["rectangles"] < 1e-6 and peer["room"] < 1e-6 and peer["obstructed room"] > 1e-3


def test_ladybug_matrix(run):
    sizes = "--boxes", 5, "--sensors", 100, "--vectors", 20, "--rounds", 1
    done = run("ladybug_matrix", *sizes, without="ladybug_geometry,ladybug_radiance")
    check_left_out(done, "Ladybug")
    (row,) = done.rows
    assert row["vectors"] == 20 and row["sensors"] >= 100 and 0.1 < row["seen"] < 0.9 and "ratio" not in row


def test_ladybug_matrix_beside_ladybug(run):
    for module in ("pyradiance", "ladybug_geometry", "ladybug_radiance"):
        reason = f"no comparison with Ladybug, as {module} is not installed: pip install pyradiance ladybug-radiance"
        pytest.importorskip(module, reason=reason, exc_type=ImportError)
    done = run("ladybug_matrix", "--boxes", 5, "--sensors", 200, "--vectors", 40, "--rounds", 1)
    (row,) = done.rows
    assert row["ratio"] > 0.0 and row["differ"] <= 2


def test_update(run, hidden):
    done = run("update", "forest", "--triangles", 3000, "--rays", 2000, "--rounds", 2, without=hidden)
    assert [row["kind"] for row in done.rows] == sorted(row["kind"] for row in done.rows)
    ours = [row for row in done.rows if row["method"] == "update + occluded"]
    assert [(row["kind"], row["wrong"], row["we_are_faster"]) for row in ours] == [
        ("coherent", 0, 1.0),
        ("incoherent", 0, 1.0),
    ]
    assert all(0.0 < row["blocked"] < 1.0 and row["update_ms"] > 0.0 < row["trace_ms"] for row in done.rows)
    others = [row for row in done.rows if row["method"] != "update + occluded"]
    assert len(others) == (0 if without_embree(hidden) else 12)
    assert all(row["differs"] < 20 for row in others)
