"""`antumbra view`."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
import webbrowser

import pytest

from city_files import CUBE, city
from command_line import TRIANGLES

SCENE = f"procedural:atrium?triangles={TRIANGLES}"


@pytest.fixture(autouse=True)
def _viser():
    pytest.importorskip("viser", reason="no viser: antumbra view is NOT tested")


def picture():
    """A stand-in for the first picture."""
    from antumbra.viewer.progressive_pictures import HAZE, Step, TracedPicture

    return TracedPicture(HAZE, Step(4, 4), 0.1, 1)


class Opened:
    """What a browser was asked to open, instead of opening one."""

    def __init__(self, monkeypatch, found=True):
        self.pages = []
        monkeypatch.setattr(webbrowser, "open", lambda url: self.pages.append(url) or found)


@pytest.fixture
def interrupted(monkeypatch):
    """Ctrl-C comes as soon as the page is open; the list has the viewers."""
    from antumbra.viewer.viewer_page import Viewer

    seen = []

    def wait(viewer):
        with urllib.request.urlopen(viewer.url, timeout=20) as answer:
            seen.append((viewer, answer.read(20000).lower()))
        raise KeyboardInterrupt

    monkeypatch.setattr(Viewer, "wait", wait)
    return seen


def test_the_page_is_opened_and_ctrl_c_ends_it(cli, interrupted, monkeypatch):
    opened = Opened(monkeypatch)
    told = cli("view", SCENE, "--port", "0", "--light", "sun:1,-1,0.2")
    assert told.code == 0 and told.err == ""
    ((viewer, page),) = interrupted
    assert b"<html" in page and opened.pages == [viewer.url] and viewer.url in told.out and "Ctrl-C" in told.out
    assert "closed" in repr(viewer)


def test_a_scene_in_degrees_is_shown_without_dates(cli, interrupted, monkeypatch, tmp_path):
    opened = Opened(monkeypatch)
    vertices = [[35.68 + 0.0002 * y, 139.76 + 0.0002 * x, 30 * z] for x, y, z in CUBE.tolist()]
    (tmp_path / "a.city.json").write_text(json.dumps(city(crs="urn:ogc:def:crs:EPSG::6697", vertices=vertices)))
    told = cli("view", "a.city.json", "--port", "0")
    assert told.code == 0 and "note: the sun follows no date; crs EPSG:6697 has no plan in metres" in told.err
    assert len(interrupted) == len(opened.pages) == 1
    cli("view", "a.city.json", "--port", "0", "--timezone", "Asia/Tokyo").refused("crs EPSG:6697 has no plan in metres")


def test_a_place_without_a_sun_is_noted(cli, interrupted, monkeypatch):
    Opened(monkeypatch)
    place = "--latitude", "52", "--longitude", "4.4"
    told = cli("view", SCENE, "--port", "0", "--no-browser", *place)
    assert told.code == 0 and "note: no sun follows the date, since there are only other lights" in told.err
    told = cli("view", SCENE, "--port", "0", "--no-browser", *place, "--light", "sun:1,-1,0.2")
    assert told.code == 0 and told.err == ""
    assert len(interrupted) == 2


def test_options_reach_the_page(cli, interrupted, monkeypatch):
    opened = Opened(monkeypatch)
    made = []
    from antumbra.viewer import viewer_page

    monkeypatch.setattr(viewer_page, "prepare", lambda model: made.append(model) or picture())
    position = "--latitude", "52", "--longitude", "4.4", "--timezone", "+01:00"
    told = cli("view", SCENE, "--port", "0", "--no-browser", "--quiet", "--sky", "white", "--plan", "bsah+wide",
               "--camera=0,2,5:0,1,0:40", *position)  # fmt: skip
    assert told.code == 0 and told.out == told.err == "" and not opened.pages
    (model,) = made
    assert model.place.latitude == 52.0 and model.place.timezone == "+01:00" and model.plan == "bsah+wide"
    assert model.first_camera(10, 10).vfov == 40.0 and "Sky" in [
        type(lamp.light).__name__ for lamp in model.editable_lights
    ]


def test_a_page_is_traced_on_a_device(cli, interrupted, monkeypatch):
    made = []
    from antumbra.viewer import viewer_page

    monkeypatch.setattr(viewer_page, "prepare", lambda model: made.append(model) or picture())
    assert cli("view", SCENE, "--port", "0", "--no-browser", "--quiet", "--device", "host").code == 0
    assert str(made[0].renderer.plan) == "bsah+device:host:0"


def test_without_a_browser_the_address_is_said(cli, interrupted, monkeypatch):
    Opened(monkeypatch, found=False)
    told = cli("view", SCENE, "--port", "0")
    assert told.code == 0 and "no browser was found; open http://127.0.0.1:" in told.err


def test_a_busy_port_is_one_line(cli):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        cli("view", SCENE, "--port", taken.getsockname()[1]).refused("is busy", "--port")


def test_bad_input_is_refused_before_the_page(cli):
    cli("view", "missing.glb", "--port", "0").refused("missing.glb")
    cli("view", SCENE, "--port", "70000").refused("port")
    cli("view", SCENE, "--port", "0", "--timezone", "UTC").refused("--timezone", "--latitude")
    cli("view", SCENE, "--port", "0", "--plan", "nothing").refused("nothing")
    cli("view", SCENE, "--host", "192.0.2.1").refused("192.0.2.1", "127.0.0.1")


def test_a_missing_package_is_named(cli, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    cli("view", SCENE).refused("antumbra view needs viser", "antumbra[view]")


def test_the_process_ends_cleanly(tmp_path):
    command = [sys.executable, "-m", "antumbra", "view", SCENE, "--port", "0", "--no-browser"]
    env = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env) as process:
        line = process.stdout.readline()
        assert "http://127.0.0.1:" in line, process.stderr.read()
        url = next(word for word in line.split() if word.startswith("http"))
        with urllib.request.urlopen(url, timeout=60) as answer:
            assert answer.status == 200
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        try:
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()  # otherwise the test would wait for a process that Ctrl-C does not end
    assert process.returncode == 0 and out == "" and "Traceback" not in err and "rror" not in err


def test_the_page_names_the_scene_as_the_command_did(cli, interrupted, monkeypatch, tmp_path):
    Opened(monkeypatch)
    (tmp_path / "a triangle.obj").write_text("v 0 0 0\nv 60 0 0\nv 0 40 10\nf 1 2 3\n")
    told = cli("view", "a triangle.obj", "--port", "0", "--no-browser", "--unit", "ft", "--up", "z")
    assert told.code == 0 and interrupted[0][0]._model.source == "'a triangle.obj' --unit=ft --up=z"
