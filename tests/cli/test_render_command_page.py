"""The page of ``antumbra render --html``."""

import base64
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image


def test_the_page_holds_the_picture_and_everything_about_it(render):
    assert render("--html", "a.html", "-o", "a.png", "--counters").code == 0
    text = Path("a.html").read_text()
    (picture,) = re.findall(r"data:image/png;base64,([^\"]+)", text)
    assert base64.b64decode(picture) == Path("a.png").read_bytes()
    for word in (
        "rectangular light of ",
        "share lit",
        "triangle tests",
        "larcher-pillichshammer",
        "processor",
        "trace",
        "exposure",
    ):
        assert word in text, word
    assert not re.findall(r"(?:src|href)=\"(?!data:)", text)  # it needs no other file


def test_bad_pages_are_refused_before_work(render, tmp_path):
    render("--html", "a.txt").refused("a.txt", "use .html")
    render("--html", "a.html", "--frames", "0:1", "-o", "f.##.png").refused("--html is for a single picture")
    assert not list(tmp_path.iterdir())


def test_a_browser_shows_the_picture(render, tmp_path):
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no chromium: the page is NOT looked at in a browser")
    assert render("--html", "a.html", "-o", "a.png", size="200x200").code == 0
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    command += ["--window-size=900,1200", f"--screenshot={tmp_path / 'shot.png'}", f"file://{tmp_path / 'a.html'}"]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    with Image.open(tmp_path / "shot.png") as shot, Image.open("a.png") as picture:
        pixels, wanted = np.asarray(shot.convert("RGB")).astype(int), np.asarray(picture).astype(int)
    found = [
        (y, x)
        for y in range(40, 160)
        for x in range(0, 80)
        if (abs(pixels[y : y + 200 : 37, x : x + 200 : 37] - wanted[::37, ::37]) <= 2).all()
    ]
    assert found, "the picture is not on the screen"
