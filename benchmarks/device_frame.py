"""Frames of moving triangles, from new vertices on a device to a picture: the part `frame` of benchmarks/device.py.

The scene is that of device_build.py: waves that move, with the shadows of a lamp that is low above them. Every frame
has new vertices, which are on the device already. Cases, for each of --triangles:

- `bits`: the visibility bits of the picture. The device recentres and surveys the vertices, rasterises them, culls (for
  `grid32`), builds or refits a tree, and traces the shadow rays. The G-buffer and its receivers stay there.
- `picture`: the same with the picture, which the CPU shades from a copy of the G-buffer

Methods: `device` with a new tree in every frame, `device, refit`, `device, culled`, and `cpu`, which gets the vertices
as an array on the host. `by rays` traces the pixels through a tree of all triangles instead of rasterising. `differs`
counts receivers with other bits than the CPU's in the last frame, or values of the image. After each row are the median
milliseconds of its steps, and the bytes that a frame copies to the device and from it.
"""

import argparse
import statistics
from collections import defaultdict
from collections.abc import Callable, Iterator
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

import antumbra
from antumbra.devices.arrays import DeviceArray
from antumbra.engine.engine import Engine
from antumbra.engine.sources.source_protocols import FrameMemory
from antumbra.picture.renderer import Renderer
from antumbra.query.light_samples import light_samples
from antumbra.query.shadow_query import surface_queries
from antumbra.scene.camera import Camera
from antumbra.scene.lights import QuadLight
from antumbra.trace.device.device_tracer import DeviceTracer
from device_build import Timings, copies_of, waves

LIGHT = QuadLight((-14.0, 3.0, -3.0), (0.0, 2.0, 0.0), (0.0, 0.0, 2.0))


class Method(NamedTuple):
    """How frames are computed."""

    plan: str
    renew: bool = False  # whether each frame builds a new tree, instead of refitting the last one
    gbuffer: str = "auto"


class MovingScene:
    """A scene whose next frame has other vertices.

    arrays : the vertices of two frames, which alternate: on a device, or on the host
    renew : whether each frame builds a new tree, instead of refitting the last one
    """

    def __init__(self, renderer: Renderer, arrays: list[Any], options: argparse.Namespace, renew: bool) -> None:
        self.renderer, self.engine, self._arrays, self._renew = renderer, renderer.engine, arrays, renew
        self._camera = Camera((0.0, 7.0, 14.0), (0.0, -1.0, 0.0), width=options.size[0], height=options.size[1])
        self._spp, self._samples = options.spp, [light_samples(LIGHT, options.spp)]
        self._frame = 0
        self.laps: dict[str, list[float]] = defaultdict(list)

    def show(self, frame: int) -> None:
        """Let the next frame be one of the two."""
        self._frame = frame

    def _update(self, lap: Callable[[str], None]) -> None:
        self.engine.update(self._arrays[self._frame])
        self._frame = 1 - self._frame
        if self._renew:
            self.engine.accelerator.memory.own = None
        lap("update")

    def bits(self) -> np.ndarray:
        """The bits of the next frame."""
        last = [perf_counter()]

        def lap(step: str) -> None:
            now = perf_counter()
            self.laps[step].append(now - last[0])
            last[0] = now

        engine, rows = self.engine, slice(0, self._camera.height)
        with engine.lock:
            self._update(lap)
            frame = engine.frame_tracer()
            frame.begin(FrameMemory(0, 0, 0), self._camera.width * self._camera.height * self._spp, 0, 0.0)
            frame.build_for_camera(self._camera)
            lap("build")
            surfaces = frame.surfaces(self._camera, rows)
            queries = surface_queries(surfaces, [LIGHT], self._samples, 0, engine.threads)
            lap("gbuffer")
            frame.prepare(queries, lambda step: lap(step) if step == "cull" else None)
            lap("build")
            bits = frame.accelerator.answer_all(frame.tree, queries)[0]
            lap("trace")
        return bits

    def picture(self) -> np.ndarray:
        """The image of the next frame."""
        self._update(lambda step: None)
        frame = self.renderer.render(self._camera, LIGHT, spp=self._spp)
        for step, seconds in frame.timings.items():
            self.laps[step].append(seconds)
        image: np.ndarray = frame.image
        return image


def stages_of(laps: dict[str, list[float]], frames: int) -> dict[str, float]:
    """Median seconds of each step in all frames but the first one; a step may have several laps in each frame."""
    of_frames = {step: np.reshape(seconds, (frames, -1)).sum(1)[1:].tolist() for step, seconds in laps.items()}
    return {step: statistics.median(seconds) for step, seconds in of_frames.items()}


def moving_scene(method: Method, arrays: list[np.ndarray], options: argparse.Namespace, how: Timings) -> MovingScene:
    """The scene by a method; arrays: the vertices of both frames on the host."""
    scene = antumbra.Scene.from_arrays(arrays[0])
    renderer = Renderer(scene, method.plan, how.threads, gbuffer=method.gbuffer)
    there: list[Any] = arrays
    if renderer.plan.device is not None:
        device = _tracer_of(renderer.engine).device
        there = [DeviceArray(device.upload(each), each.shape, each.dtype, device.queue) for each in arrays]
    return MovingScene(renderer, there, options, method.renew)


def _tracer_of(engine: Engine) -> DeviceTracer:
    tracer: DeviceTracer = engine.accelerated().prepared.tracer
    return tracer


def rows(tracer: DeviceTracer, n: int, options: argparse.Namespace, how: Timings) -> Iterator[dict[str, Any]]:
    """Rows of both cases."""
    name, arrays = tracer.device.name, [waves(n, time) for time in (0.0, 0.4)]
    plan, culled = f"lbvh+device:{name}", f"grid32+lbvh+device:{name}"
    methods = {
        "cpu": Method("lbvh+multifrusta"),
        "device": Method(plan, True),
        "device by rays": Method(plan, True, "rays"),
        "device, refit": Method(plan),
        "device, culled": Method(culled, True),
        "device, culled, by rays": Method(culled, True, "rays"),
    }
    rays, truth = options.size[0] * options.size[1] * options.spp, dict[str, np.ndarray]()
    for label, method in methods.items():
        scene = moving_scene(method, arrays, options, how)
        for case, call in ("bits", scene.bits), ("picture", scene.picture):
            scene.laps.clear()
            scene.show(how.rounds % 2)  # so that the last frame is the same for all rounds
            timing = how.timed(call, how.rounds)
            about = {"scene": "waves", "triangles": n, "case": case}
            row = how.row(about, label, timing, rays, truth.setdefault(case, timing.answers))
            row["stages"] = stages_of(scene.laps, how.rounds + 1)
            yield row | (copies_of(tracer.device, call) if label != "cpu" else {})


def stage_line(row: dict[str, Any]) -> str:
    """The steps of a row, as a line."""
    steps = {step: seconds for step, seconds in row["stages"].items() if step != "total"}
    return "  " + ", ".join(f"{step} {1000 * seconds:.2f} ms" for step, seconds in steps.items())
