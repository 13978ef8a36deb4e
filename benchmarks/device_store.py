"""Rays of a store on a device whose memory is a cache of chunks: the part `store` of benchmarks/device.py.

The scene is --store, or a city of the first of --triangles; if --store names no file, the city is built there. A card
has room for --device-memory of chunks. Cases: --frames of each --walk of `antumbra bench chc-rt`, `near` or `far`, with
the secondary rays of each --kind: `shadow` and `ambient` take --spp samples, `diffuse` one ray and its shadow ray. Each
walk begins with nothing on the card.

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
from antumbra.engine.device_tracers import device_tracer
from antumbra.engine.plan import parse_plan
from antumbra.engine.sources.paged_source import Paged
from antumbra.lab.papers.benchmark_views import scene_view
from antumbra.lab.papers.chc_rt.walkthroughs import VIEWS, WalkPlace, place_of
from antumbra.picture.frame import Frame
from antumbra.picture.renderer import Renderer
from antumbra.scene.camera import Camera
from antumbra.store.system_resources import MAX_MEMORY
from device_build import copies_of

KINDS, WALKS = ("shadow", "ambient", "diffuse"), VIEWS


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
        scene = antumbra.load(path)
        with scene.store as store:
            chunks = store.chunks
            print(f"{store.meta.n_triangles} triangles in {len(store)} chunks, {chunks.bytes.sum() / 1e6:.0f} MB")
            place = place_of(scene_view("city", scene, tuple(options.size)))
        for kind, view in product(options.kind, options.walk):
            yield from _walk_rows(path, place, kind, view, options, how)


def _walk_rows(
    path: Path, place: WalkPlace, kind: str, view: str, options: argparse.Namespace, how: Measures
) -> Iterator[dict[str, Any]]:
    walk, length = place.walk(view), max(options.frames, 20)
    light = antumbra.AmbientOcclusion(place.reach) if kind == "ambient" else place.light
    asked = {"lights": [light], "spp": 1, "bounce": 1} if kind == "diffuse" else {"lights": [light], "spp": options.spp}
    cameras = [walk.camera(k, length) for k in range(options.frames)]
    plans = {"device, host arrays": f"bsah+chcrt+device:{options.device}", "cpu": "bsah+chcrt"}
    walks = {method: list(_frames(path, plan, cameras, asked, options, how)) for method, plan in plans.items()}
    for k in range(options.frames):
        for method, frames in walks.items():
            frame, truth = frames[k], walks["cpu"][k].found
            about = {"scene": path.name, "triangles": place.scene.n_triangles}
            about |= {"case": f"{kind} {view} {k}", "queries": frame.queries}
            yield how.row(about, method, how.timing(frame.found, [frame.seconds]), frame.rays, truth) | frame.copied


class _Seen(NamedTuple):
    """A frame of a walk."""

    found: np.ndarray  # (n,) uint8: the bits of its shadow rays, the faces that it shows, and its bounced light
    seconds: float
    rays: int
    queries: int
    copied: dict[str, Any]  # counts of chunks; of a device, its room for them, and bytes copied to it and from it


def _frames(
    path: Path, plan: str, cameras: list[Camera], asked: dict[str, Any], options: argparse.Namespace, how: Measures
) -> Iterator[_Seen]:
    """The frames of a walk, which begins with nothing in memory; and none of it stays there for the next one."""
    parsed, limit, scene = parse_plan(plan), MAX_MEMORY, antumbra.load(path)
    device = None if parsed.device is None else device_tracer(str(parsed.device)).device
    if device is not None and device.in_host_memory:  # the host has as much as beside a card
        limit += options.device_memory
    renderer = Renderer(scene, parsed, how.threads, max_memory=limit)
    source = cast(Paged, renderer.source)
    if device is not None:
        there = source.on_device
        there.budget = options.device_memory if device.in_host_memory else min(there.budget, options.device_memory)
    for camera in cameras:
        frames, copied = list[Frame](), dict[str, Any]()
        render = partial(_render, renderer, camera, asked, frames)
        if device is None:
            render()
        else:
            copied |= copies_of(source.on_device.device, render) | {"device_memory": source.on_device.budget}
        (frame,) = frames
        queries = sum(int(each["queries"]) for each in frame.scheduled or ())
        seconds = frame.timings["gbuffer"] + frame.timings["trace"]
        yield _Seen(_found_of(frame), seconds, frame.rays, queries, copied | {"paging": frame.paging})
    if device is not None:
        source.on_device.close()
    scene.store.close()


def _render(renderer: Renderer, camera: Camera, asked: dict[str, Any], frames: list[Frame]) -> None:
    frames.append(renderer.render(camera, **asked))


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
