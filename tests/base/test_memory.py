"""Limits on the memory that reading takes."""

import numpy as np
import pytest

import antumbra as at
import gis_bombs
from antumbra.base import memory
from antumbra.base.command_registry import COMMANDS
from antumbra.base.errors import InputError
from antumbra.base.memory import check_reading, reading_limit
from antumbra.cli.app import program
from gis_files import hills, write_raster


def test_a_file_may_take_what_is_available_and_a_multiple_of_its_size(monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: 10 << 30)
    for size, stored in ((1 << 30, 1), (10 << 30, None), (5 << 30, 1 << 28), (10 << 30, 1 << 28)):
        check_reading(size, "a", stored)
    for size, stored, words in (
        ((1 << 30) + 1, 1, "files of 1 byte need at most"),
        ((10 << 30) + 1, None, "what is available"),
        ((10 << 30) + 1, 1 << 28, "what is available"),
        (101 << 24, 1 << 24, "files of 16.8 MB need at most"),
    ):
        with pytest.raises(InputError, match=f"a takes about .* more than {words} .* raise max_memory, .*--max-memory"):
            check_reading(size, "a", stored)


def test_a_given_limit_replaces_the_others(monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: 1000)
    with reading_limit(1 << 40):
        check_reading(1 << 40, "a", 1)
        with reading_limit(None):
            check_reading(1 << 40, "a", 1)
        with reading_limit(10), pytest.raises(InputError, match="more than the limit"):
            check_reading(11, "a")
    with pytest.raises(InputError, match="more than what is available"):
        check_reading(1001, "a")


def test_systems_that_do_not_tell_their_memory_have_no_limit_for_large_files(monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: None)
    check_reading(1 << 60, "a")
    with pytest.raises(InputError, match="need at most"):
        check_reading(1 << 60, "a", 1)


def test_the_least_of_system_container_and_process_counts(monkeypatch, tmp_path):
    monkeypatch.setattr(memory, "_CGROUP", tmp_path)
    system = memory.available_memory()
    (tmp_path / "memory.max").write_text("5000\n")
    (tmp_path / "memory.current").write_text("4000\n")
    (tmp_path / "memory.stat").write_text("anon 3000\ninactive_file 500\n")
    assert memory.available_memory() == 1500
    (tmp_path / "memory.max").write_text("max\n")
    assert system is None or abs(memory.available_memory() - system) < 1 << 30


@pytest.mark.parametrize("read", [at.load, at.from_raster])
def test_max_memory_allows_what_is_refused_otherwise(tmp_path, monkeypatch, read):
    monkeypatch.setattr(memory, "LEAST_LIMIT", 1 << 20)
    path = gis_bombs.EXPANDING["a sparse raster"](tmp_path)
    with pytest.raises(at.InputError, match="of memory, more than files of"):
        read(path)
    with pytest.raises(at.InputError, match="more than the limit"):
        read(path, max_memory=1000)
    write_raster(tmp_path / "b.tif", hills())
    assert read(tmp_path / "b.tif", max_memory=1 << 20).n_triangles == 96
    with pytest.raises(at.InputError, match="max_memory is 0"):
        read(tmp_path / "b.tif", max_memory=0)


def test_max_memory_limits_footprints_and_arrays(tmp_path):
    from gis_files import write_buildings

    write_buildings(tmp_path / "a.gpkg")
    assert at.from_footprints(tmp_path / "a.gpkg", max_memory=1 << 30).n_triangles > 0
    with pytest.raises(at.InputError, match="more than the limit"):
        at.from_footprints(tmp_path / "a.gpkg", max_memory=1000)
    np.save(tmp_path / "a.npy", np.zeros((100, 3)))
    from antumbra.city.sensors.sensor_files import read_points

    with reading_limit(1000), pytest.raises(at.InputError, match="more than the limit"):
        read_points(tmp_path / "a.npy")


def test_every_command_with_a_scene_has_max_memory():
    import typer

    commands = typer.main.get_command(program()).commands
    with_scene = {name for name in COMMANDS if {"scene", "scenes"} & {each.name for each in commands[name].params}}
    assert len(with_scene) > 12
    for name in with_scene:
        assert "--max-memory" in [option for each in commands[name].params for option in each.opts], name


def test_max_memory_of_a_command_limits_reading(cli, tmp_path):
    write_raster(tmp_path / "a.tif", hills())
    cli("info", "a.tif", "--max-memory", "100").refused("more than the limit (100 bytes)", "--max-memory 1M")
    told = cli("info", "a.tif", "--max-memory", "1M")
    assert told.code == 0 and "96" in told.out
    cli("info", "a.tif", "--max-memory", "much").refused("--max-memory", "512M")
