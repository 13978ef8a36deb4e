"""Benchmarks of devices: every row of a small run has the CPU's bits."""

import json
import sys

import pytest

import antumbra as at
import device
import device_build
import device_surfaces
from antumbra.devices.host.host_device import HostDevice
from antumbra.engine.sources import paged_source
from antumbra.trace.device.build_kernels import BUILD_KERNELS
from antumbra.trace.device.device_kernels import KERNELS
from antumbra.trace.device.raster_kernels import RASTER_KERNELS


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.device(name)) for name in ("host", "opencl")])
def test_builds_refits_and_frames_of_a_device_are_those_of_the_cpu(name, monkeypatch, tmp_path, capsys):
    path = tmp_path / "rows.json"
    words = f"device.py --device {name} --part build --triangles 3000 --size 16 12 --spp 4 --rounds 1 --json {path}"
    monkeypatch.setattr(sys, "argv", words.split())
    device.main()
    rows = json.loads(path.read_text())["rows"]
    timed = [(row["case"], row["method"]) for row in rows if "method" in row]
    assert timed == [
        *(("build", method) for method in ("device", "device, host arrays", "cpu")),
        *((case, method) for case in ("ploc", "refit", "update", "raster", "cull") for method in ("device", "cpu")),
        ("culled", "device"),
        *(("frame", method) for method in ("device, host arrays", "cpu")),
    ]
    assert all(row["differs"] == 0 for row in rows if "method" in row)
    steps = {row["kernel"]: row for row in rows if row["case"].endswith(" step")}
    at_times = {"begin_roots", "copy_links"}  # of ploc: several roots, and refits
    at_times |= {"draw_parts", "settle_nearest", "mark_rays", "gather_points", "write_numbers"}  # in some pictures
    assert set(device_build.MOVED) - at_times <= set(steps) <= set(device_build.MOVED)
    assert all(row["bytes"] > 0 < row["launches"] for row in steps.values())
    assert {row["case"] for row in rows if row.get("kernel") == "draw_triangles"} == {"raster step"}
    assert "scatter_keys" in capsys.readouterr().out


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.device(name)) for name in ("host", "opencl")])
def test_shafts_are_compared_with_single_rays_and_the_cpu(name, monkeypatch, tmp_path):
    path = tmp_path / "rows.json"
    words = f"device.py forest --device {name} --part shafts --size 16 12 --spp 4 --rounds 1 --json {path}"
    monkeypatch.setattr(sys, "argv", words.split())
    device.main()
    rows = json.loads(path.read_text())["rows"]
    assert {row["method"] for row in rows} == {"device, host arrays", "device, shafts", "cpu"}
    assert {row["case"] for row in rows} == {f"{light} {spp}" for light in ("small", "large") for spp in (1, 4)}
    assert all(row["differs"] == 0 for row in rows)
    assert all(row["visits"] > 0 for row in rows if row["method"] == "device, host arrays")
    by_shafts = {row["case"]: row["visits"] > 0 for row in rows if row["method"] == "device, shafts"}
    assert by_shafts == {
        "small 1": True,
        "small 4": True,
        "large 1": False,
        "large 4": False,
    }  # single rays: huge lamps


@pytest.mark.parametrize("part", device_surfaces.SCENES)
def test_faces_that_let_light_pass_and_copies_have_the_bits_of_the_cpu(part, monkeypatch, tmp_path):
    path = tmp_path / "rows.json"
    words = f"device.py --device host --part {part} --triangles 4000 --rays 400 --spp 4 --rounds 1 --json {path}"
    monkeypatch.setattr(sys, "argv", words.split())
    device.main()
    rows = json.loads(path.read_text())["rows"]
    methods = "device, host arrays", "cpu"
    assert [(row["case"], row["method"]) for row in rows] == [
        (case, method) for case in ("random", "closest", "light") for method in methods
    ]
    assert all(row["differs"] == 0 and row["rays"] == 400 for row in rows)


def test_bytes_are_stated_for_kernels_that_exist():
    assert {*BUILD_KERNELS, *RASTER_KERNELS} < set(device_build.MOVED) <= set(KERNELS)


def test_waves_move_all_triangles_of_a_scene_of_any_size():
    first, second = (device_build.waves(101, time) for time in (0.0, 0.4))
    assert first.shape == second.shape == (101, 3, 3) and (first != second).any(axis=(1, 2)).all()


def test_chunks_of_a_store_are_cached_on_a_device(monkeypatch, tmp_path, capsys):
    path, store = tmp_path / "rows.json", tmp_path / "city.antumbra"
    at.build_store(at.procedural("city", triangles=30_000), store, chunk=512)
    words = f"device.py --device host --part store --store {store} --device-memory 2M --frames 2 "
    monkeypatch.setattr(sys, "argv", (words + f"--size 24 16 --spp 4 --json {path}").split())
    device.main()
    rows = json.loads(path.read_text())["rows"]
    assert [(row["case"], row["method"]) for row in rows] == [
        (f"shadow {view} {k}", method)
        for view in ("near", "far")
        for k in range(2)
        for method in ("device, host arrays", "cpu")
    ]
    assert all(row["differs"] == 0 < row["rays"] and row["queries"] > 0 for row in rows)
    there = rows[::2]
    assert all(0 < row["paging"]["device_bytes"] < row["uploaded"] for row in there[::2])
    assert all(row["paging"]["device_uploaded"] < row["paging"]["device_wanted"] for row in there[1::2])
    assert "on the device" in capsys.readouterr().out
    assert [row.get("device_memory") for row in rows] == 4 * [2 << 20, None]


def test_rows_of_a_store_state_the_room_that_a_card_has(monkeypatch, tmp_path):
    path, store = tmp_path / "rows.json", tmp_path / "city.antumbra"
    at.build_store(at.procedural("city", triangles=5000), store, chunk=512)
    monkeypatch.setattr(HostDevice, "in_host_memory", False)
    monkeypatch.setattr(paged_source, "DEVICE_CHUNKS", 1 << 20)
    words = f"device.py --device host --part store --store {store} --device-memory 2M --frames 1 --walk near "
    monkeypatch.setattr(sys, "argv", (words + f"--size 24 16 --spp 1 --json {path}").split())
    device.main()
    there, _ = json.loads(path.read_text())["rows"]
    assert there["device_memory"] == 1 << 20
