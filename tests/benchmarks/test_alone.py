"""Benchmarks that compare our own methods run. Some test runs every benchmark."""

import json
import re
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from devices import opened

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def test_every_benchmark_is_tried():
    scripts = {path.stem for path in BENCHMARKS.glob("*.py") if "__main__" in path.read_text()}
    tests = "\n".join(path.read_text() for path in Path(__file__).parent.glob("test_*.py"))
    tried = set(re.findall(r'\brun\(\s*"(\w+)"', tests))
    assert len(scripts) > 5 and tried <= scripts
    assert scripts == tried, "a benchmark without a test in tests/benchmarks"


def test_startup(run):
    """Only the case that makes no new environment."""
    done = run("startup", "--only", "here", "--rounds", 1)
    assert len(done.rows) == 5 and all(len(times) == 1 and times[0] > 0.0 for times in done.rows.values())
    assert set(done.rows) <= set(re.findall(r"^(.+?) +[\d.]+ +[\d.]+ +1$", done.out, re.MULTILINE))


def test_filter_quality(run, small):
    done = run("filter_quality", small.parent, "--size", 16, "--rounds", 1, "--threads", 1)
    rows = {row["method"]: row for row in done.rows}
    assert len(rows) == len(done.rows) == 8 and done.out.count("\n") == 9
    assert rows["256"]["visibility_rms_256"] == 0 < rows["64"]["visibility_rms_256"]
    assert 0 < rows["256"]["visibility_rms_1024"] < rows["16"]["visibility_rms_1024"]
    assert 0 < rows["16 adaptive 64"]["refined"] <= 1 and rows["64"]["rays"] == 4 * rows["16"]["rays"] > 0


def test_skyline(run, small):
    done = run("skyline", small, "--points", 40, "--slice", 20, "--step", 15, "--rounds", 1, "--threads", 1)
    assert [row["method"] for row in done.rows] == ["skyline", "rays", "brute force"]
    assert all(row["seconds_for_all"] > 0.0 and row["compared"] > 0 for row in done.rows)
    rows = {row["method"]: row for row in done.rows}
    assert rows["brute force"]["greatest_difference"] < 1e-6 and rows["rays"]["median_difference"] < 0.02


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="it reads /proc, which only Linux has")
def test_memory(run, small):
    done = run("memory", small, rows=False)
    head, *arrays, last = done.out.splitlines()
    assert re.fullmatch(rf"{re.escape(str(small))}: \d+ triangles", head)
    sizes = dict(re.fullmatch(r"  (\w+) +([\d.]+) bytes per triangle", line).groups() for line in arrays)
    assert float(sizes["vertices"]) == 36 and float(sizes["nodes"]) > 0 and last.startswith("process grew by ")


def test_device_code(run):
    if not (shutil.which("ptxas") or find_spec("nvidia")):
        pytest.skip("ptxas is not installed: registers of device kernels are NOT counted")
    done = run("device_code", "--arch", "sm_90")
    assert len(done.rows) > 5 and done.out.count("\n") == len(done.rows) + 1
    assert all(0 < row["registers"] <= 255 and row["spill_bytes"] == 0 < row["ptx_bytes"] for row in done.rows)


def test_auto(run, small):
    done = run("auto", "--scenes", small, "--size", 24, 16, "--cases", 8, "--rounds", 1)
    assert [row["job"] for row in done.rows] == [*["first"] * 3, *["kept"] * 2, "moving", "points", "surface"]
    assert all(row["seconds"]["auto"] > 0.0 and len(row["seconds"]) > 3 for row in done.rows)
    assert "geometric mean" in done.out and "(8 cases)" in done.out


def test_auto_walks(run):
    scene, size = "procedural:atrium?triangles=2000", ("--size", 24, 16)
    words = "--scenes", scene, *size, "--cases", 2, "--rounds", 1, "--walk", 3, "--lights", "daylight"
    done = run("auto", *words, "--plans", "bsah+packet16", "bsah+multifrusta:by-sample")
    assert [(row["job"], row["frames"], row["light"]) for row in done.rows] == [("walk", 3, "daylight")] * 2
    assert all(len(row["seconds"]) == 3 and min(row["seconds"].values()) > 0.0 for row in done.rows)


def test_fit_auto(run, small, tmp_path):
    rows, rates = tmp_path / "rows.jsonl", tmp_path / "rates.json"
    run("fit_auto", "measure", rows, "--scenes", small, "--size", 24, 16, "--cases", 8, rows=False)
    done = run("fit_auto", "fit", rows, "--output", rates, rows=False)
    fitted = json.loads(rates.read_text())
    assert set(fitted["weights"]) == set(fitted["reference"]) and "predictions alone lose" in done.out


def test_jobs(run, small):
    few = ("--points", 60, "--spp", 4, "--size", 64, 40, "--rounds", 1)
    done = run("jobs", small, *few, "--only", "matrix", "bake", "viewer")
    rows = {what: [row for row in done.rows if row["what"] == what] for what in ("matrix", "bake", "viewer")}
    assert len(rows["matrix"]) == len(rows["bake"]) == 1 and len(rows["viewer"]) == 6
    assert all(row["seconds"] > 0.0 for row in done.rows) and rows["bake"][0]["rays"] > rows["bake"][0]["points"]


def test_jobs_of_a_store(run):
    (row,) = run("jobs", "--only", "store", "--store", 20_000, "--size", 48, 32).rows
    assert row["bytes"] > 20_000 * 36 and min(row["build"], row["first"], row["later"]) > 0.0


def test_viewshed(run):
    """Peers only where they are installed."""
    pytest.importorskip("rasterio")
    done = run("viewshed", "--size", 64, "--rounds", 1, "--threads", 1)
    first, *peers = done.rows
    assert first["method"] == "antumbra" and first["same"] == 1.0 and 0.0 < first["visible"] < 1.0
    assert all(row["same"] > 0.9 and row["seconds"] > 0.0 for row in peers)


@pytest.mark.parametrize("device", ["host", "opencl"])
def test_device(run, small, device):
    opened(device)
    small_part = "--part", "rays", "--rays", 800, "--size", 12, 8, "--spp", 4, "--rounds", 1
    done = run("device", small, "--device", device, *small_part)
    rows = {(row["case"], row["method"]): row for row in done.rows}
    cases = "coherent", "random", "hostile", "closest"
    methods = "device", "device, host arrays", "cpu"
    assert rows.keys() == {(case, m) for case in cases for m in methods} | {("soft", m) for m in methods[1:]}
    assert all(row["differs"] == 0 and row["mrays"] > 0.0 for row in done.rows)
    assert rows["hostile", "device"]["undecided"] > rows["random", "device"]["undecided"]
