"""Rays of a store on a device whose memory is a cache of chunks: the part `store` of benchmarks/device.py.

The scene is --store, or a city of the first of --triangles; if --store names no file, the city is built there. A card
has room for --device-memory of chunks. Cases: --frames of the walks `near` and `far` of `antumbra bench chc-rt`, with
the secondary rays of each of --kind: `shadow` and `ambient` take --spp samples, `diffuse` one ray and its shadow ray.
Each walk begins with nothing on the card.

    python benchmarks/device.py --device cuda --part store --store city.antumbra --triangles 350000000 --size 1920 1080

Times are those of camera and secondary rays of a frame, chunks read and uploaded for them included. `uploaded` and
`downloaded` are all bytes that a frame copies; those of chunks, of all its rays, are in the line below, for Table 3 of
[Mattausch et al. 2015].
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

import antumbra
from antumbra.engine.sources.paged_source import Paged
from antumbra.lab.papers.benchmark_views import scene_view
from antumbra.lab.papers.chc_rt.walkthroughs import VIEWS, Walk, place_of
from antumbra.picture.frame import Frame
from antumbra.picture.renderer import Renderer
from antumbra.scene.camera import Camera
from antumbra.scene.lights import Light
from device_build import copies_of

KINDS = "shadow", "ambient", "diffuse"


class Measures(NamedTuple):
    """How device.py makes rows, from the seconds of one call."""

    row: Callable[..., dict[str, Any]]
    timing: Callable[[Any, list[float]], Any]
    threads: int


def rows(options: argparse.Namespace, how: Measures) -> Iterator[dict[str, Any]]:
    """Rows of both walks."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "city.antumbra" if options.store is None else options.store
        if not path.exists():
            city = f"procedural:city?triangles={options.triangles[0]}"  # the command makes it piece by piece
            subprocess.run([sys.executable, "-m", "antumbra", "build", city, "-o", path], check=True)
        with antumbra.load(path).store as store:
            chunks = store.chunks
            print(f"{store.meta.n_triangles} triangles in {len(store)} chunks, {chunks.bytes.sum() / 1e6:.0f} MB")
        for kind, view in product(options.kind, VIEWS):
            yield from _walk_rows(path, kind, view, options, how)


def _walk_rows(
    path: Path, kind: str, view: str, options: argparse.Namespace, how: Measures
) -> Iterator[dict[str, Any]]:
    scenes = [antumbra.load(path) for _ in range(2)]
    plans = f"bsah+chcrt+device:{options.device}", "bsah+chcrt"
    there, here = (Renderer(scene, plan, how.threads) for scene, plan in zip(scenes, plans))
    place = place_of(scene_view("city", scenes[0], tuple(options.size)))
    cache = cast(Paged, there.source).on_device
    cache.budget = min(cache.budget, options.device_memory)
    about = {"scene": path.name, "triangles": scenes[0].n_triangles, "device_memory": cache.budget}
    walk: Walk = place.walk(view)
    light = antumbra.AmbientOcclusion(place.reach) if kind == "ambient" else place.light
    asked = {"spp": 1, "bounce": 1} if kind == "diffuse" else {"spp": options.spp}
    for k in range(options.frames):
        camera, frames = walk.camera(k, max(options.frames, 20)), list[Frame]()
        copied = copies_of(cache.device, partial(_render, there, camera, light, asked, frames))
        _render(here, camera, light, asked, frames)
        truth = _found_of(frames[1])
        for method, frame in zip(("device, host arrays", "cpu"), frames):
            timing = how.timing(_found_of(frame), [frame.timings["gbuffer"] + frame.timings["trace"]])
            queries = sum(each["queries"] for each in frame.scheduled or ())
            case = {**about, "case": f"{kind} {view} {k}", "queries": queries}
            row = how.row(case, method, timing, frame.rays, truth) | {"paging": frame.paging}
            yield row | copied if frame is frames[0] else row
    for scene in scenes:
        scene.store.close()


def _render(renderer: Renderer, camera: Camera, light: Light, asked: dict[str, Any], frames: list[Frame]) -> None:
    frames.append(renderer.render(camera, [light], **asked))


def _found_of(frame: Frame) -> np.ndarray:
    """The bits of a frame's shadow rays, the faces that it shows, and its bounced light, in one array of bytes."""
    found = [*frame.bits, frame.gbuffer.face, *(() if frame.indirect is None else (frame.indirect,))]
    return np.concatenate([np.ascontiguousarray(each).view(np.uint8).reshape(-1) for each in found])


def chunk_line(paging: dict[str, int]) -> str:
    """The chunks of a frame as a line of the table."""
    text = f"  chunks: {paging['loaded']} of {paging['wanted']} read, {paging['bytes'] / 1e6:.1f} MB"
    if "device_wanted" not in paging:
        return text
    wanted, kept, uploaded, evicted, size, nodes = (
        paging[f"device_{name}"] for name in ("wanted", "kept", "uploaded", "evicted", "bytes", "bvh_bytes")
    )
    return (
        f"{text}; on the device {kept} of {wanted} kept, {uploaded} uploaded, {size / 1e6:.1f} MB "
        f"(BVH {nodes / 1e6:.1f}, triangles {(size - nodes) / 1e6:.1f}), {evicted} evicted"
    )
