"""Takes the viewer screenshot of the docs: python scripts/viewer_picture.py SCENE X,Y FILE.png

It opens SCENE in headless Chromium, clicks at X,Y (pixels of the 1280 x 800 page), and saves the page once refined.
Requires antumbra[view,view-test] and Chromium.
"""

import shutil
import sys
import time

from playwright.sync_api import sync_playwright

import antumbra as at
from antumbra.cli.scene_arguments import open_scene, parse_scene

SIZE = {"width": 1280, "height": 800}
SOFTWARE_GL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]


def settle(page, viewer) -> None:
    """Wait until the page shows the fully refined picture."""
    time.sleep(2.0)
    viewer._page.worker.wait(600.0)
    page.wait_for_timeout(2000)


def main(scene: str, click: str, file: str) -> None:
    x, y = (int(part) for part in click.split(","))
    with at.view(open_scene(parse_scene(scene)), port=0, browser=False) as viewer, sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=shutil.which("chromium"), args=SOFTWARE_GL)
        page = chromium.new_page(viewport=SIZE)
        page.goto(viewer.url)
        page.wait_for_selector("canvas")
        settle(page, viewer)
        page.locator(".mantine-Notification-closeButton").first.click()  # the notice about software WebGL
        page.mouse.click(x, y)
        settle(page, viewer)
        page.screenshot(path=file)
        chromium.close()


if __name__ == "__main__":
    main(*sys.argv[1:4])
