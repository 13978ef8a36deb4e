"""The package for JavaScript in headless Chromium: with one thread, and with several where the page is isolated."""

import shutil
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec

import numpy as np
import pytest

import antumbra as at

pytestmark = [
    pytest.mark.programs,
    pytest.mark.skipif(find_spec("ziglang") is None, reason="without ziglang, the package is NOT checked"),
]
ASK = """async () => {
    const { Scene } = await import("./antumbra.mjs");
    const read = async (name) => new Float32Array(await (await fetch(name)).arrayBuffer());
    const scene = await Scene.create(await read("positions"));
    await new Promise((done) => setTimeout(done, 500)); // for the threads to start
    const blocked = scene.occluded(await read("origins"), await read("directions"));
    return [self.crossOriginIsolated, [...blocked]];
}"""


class Handler(SimpleHTTPRequestHandler):
    isolated = False

    def guess_type(self, path):
        return "text/javascript" if str(path).endswith(".mjs") else super().guess_type(path)

    def end_headers(self):
        if self.isolated:
            self.send_header("Cross-Origin-Opener-Policy", "same-origin")
            self.send_header("Cross-Origin-Embedder-Policy", "require-corp")
        super().end_headers()

    def log_message(self, *words):
        pass


class Isolated(Handler):
    isolated = True


@pytest.fixture(scope="module")
def site(tmp_path_factory, package):
    """(folder of a page, a scene, origins, directions)."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copytree(package, folder, dirs_exist_ok=True)
    (folder / "index.html").write_text("<!doctype html><title>rays</title>")
    scene = at.procedural("atrium", triangles=5_000)
    vertices = scene.triangles().vertices
    generator = np.random.default_rng(5)
    origins = generator.uniform(vertices.min((0, 1)), vertices.max((0, 1)), (30_000, 3)).astype(np.float32)
    directions = generator.normal(size=origins.shape).astype(np.float32)
    for name, array in ("positions", vertices), ("origins", origins), ("directions", directions):
        array.tofile(folder / name)
    return folder, at.Scene.from_arrays(vertices), origins, directions


@pytest.mark.parametrize("handler", [Handler, Isolated])
def test_a_page_gets_the_bits_of_python(chromium, site, handler):
    folder, scene, *rays = site
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(handler, directory=folder))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    page = chromium.new_page()
    faults = []
    page.on("pageerror", lambda fault: faults.append(str(fault)))
    page.goto(f"http://127.0.0.1:{server.server_port}/index.html")
    isolated, blocked = page.evaluate(ASK)
    page.close()
    server.shutdown()
    assert (isolated, faults) == (handler.isolated, [])
    wanted = scene.occluded(*rays)
    assert 0 < wanted.sum() < len(wanted)
    np.testing.assert_array_equal(np.array(blocked, bool), wanted)
