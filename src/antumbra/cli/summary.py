"""Writes the pictures of ``antumbra render``, and summarises them as text or JSON."""

from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, NamedTuple

from . import report

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..plan import Plan
    from ..rendering.frame import Frame
    from .picturespec import PictureSpec, Shot


class Saved(NamedTuple):
    """A picture on disk."""

    path: Path
    exposure: float | None  # None: the file holds linear light
    seconds: float  # time of writing it


def save(frame: "Frame", path: Path, exposure: float | None, note: str | None = None, background=None) -> Saved:
    """Write the picture. Exposure None: automatic."""
    from ..picture.image_files import frame_exposure, save_frame

    start = perf_counter()
    if path.suffix.lower() == ".exr":
        exposure = None
    elif exposure is None:
        exposure = frame_exposure(frame)
    save_frame(frame, path, exposure, note, background)
    return Saved(path, exposure, perf_counter() - start)


def picture_answer(asked: "PictureSpec", scene: "AnyScene", load: float, shot: "Shot", saved: Saved) -> dict:
    """The fields of ``--json`` for a single picture."""
    return {"scene": scene_answer(asked, scene), **asked.record(shot.options), "load": load, **shot_answer(shot, saved)}


def scene_answer(asked: "PictureSpec", scene: "AnyScene") -> dict:
    """The fields of ``--json`` for the scene."""
    return {
        "source": asked.source,
        "name": scene.name,
        "triangles": scene.n_triangles,
        "duration": scene.duration,
        "up": scene.up,
        "notes": list(scene.notes),
    }


def shot_answer(shot: "Shot", saved: Saved) -> dict:
    """The fields of ``--json`` for a single picture, or for one frame of an animation."""
    frame = shot.frame
    seen = frame.mask
    return {
        "output": str(saved.path),
        "time": shot.time,
        "camera": report.camera_fields(shot.camera),
        "lights": [report.light_fields(light) for light in shot.lights],
        "ground": None if frame.ground is None else frame.ground.height,
        "exposure": saved.exposure,
        "seen": int(seen.sum()),
        "lit": [float(v[seen].mean()) if seen.any() else None for v in frame.visibility],
        "refined": None if frame.refined is None else _refined(frame),
        "rays": frame.rays,
        "mrays_per_second": _speed(frame),
        "ran": frame.plan,
        "choices": None if frame.choices is None else [choice._asdict() for choice in frame.choices],
        "timings": frame.timings,
        "save": saved.seconds,
        "counters": frame.counters,
        "scheduled": frame.scheduled,
        "paging": frame.paging,
        "uncertain_fraction": _uncertain(frame),
    }


def picture_fields(
    asked: "PictureSpec", scene: "AnyScene", load: float, shot: "Shot", saved: Saved
) -> Iterator[tuple[str, str]]:
    """The names and values that are printed for a single picture."""
    frame = shot.frame
    yield "picture", str(saved.path)
    moment = f", at {shot.time:g} of {scene.duration:g} s" if scene.animated else ""
    yield "scene", scene_text(asked, scene) + moment
    yield from shot_fields(asked, shot)
    phases = {"load": load, **frame.timings, "save": saved.seconds}
    frame_seconds = phases.pop("total")
    yield "time", phases_text(phases)
    yield "frame", f"{report.duration(frame_seconds)} without load and save"
    for name, value in (frame.counters or {}).items():
        yield name.replace("_", " "), f"{value:,}"
    if frame.counters is not None:
        yield "uncertain", f"{_uncertain(frame):.2g} of the triangle tests were left to float64"


def scene_text(asked: "PictureSpec", scene: "AnyScene") -> str:
    return f"{asked.source}, {scene.n_triangles:,} triangles"


def phases_text(seconds: dict[str, float]) -> str:
    """The seconds of each phase as text, without phases that did not happen."""
    return ", ".join(f"{name} {report.duration(s)}" for name, s in seconds.items() if s > 0.0)


def shot_fields(asked: "PictureSpec", shot: "Shot") -> Iterator[tuple[str, str]]:
    """The names and values from the camera to the plan."""
    yield from view_fields(shot, _speed(shot.frame))
    yield "plan", ran_text(asked.engine.plan, shot.frame)
    if shot.frame.paging is not None:
        paging = shot.frame.paging
        yield (
            "chunks",
            (
                f"{paging['cached']:,} of {paging['wanted']:,} were in memory when rays met them, "
                f"{paging['loaded']:,} were read ({paging['bytes'] / 1e6:,.0f} MB)"
            ),
        )


def view_fields(shot: "Shot", speed: float | None = None) -> Iterator[tuple[str, str]]:
    """The names and values from the camera to the rays; `speed`: million rays a second."""
    camera, frame, options = shot.camera, shot.frame, shot.options
    spp = options.spp
    yield "camera", f"{camera.width}x{camera.height} from {report.vector(camera.position)}"
    if frame.ground is not None:
        share = frame.ground.mask.mean()
        yield "ground", f"at height {frame.ground.height:.4g}; {share:.0%} of the picture sees it, by its shadows alone"
    yield "lights", ", ".join(_light_text(light) for light in shot.lights)
    if not frame.mask.any():
        yield "", "the camera sees no surface"
    samples = [light.samples(spp) for light in shot.lights]
    each = f"{spp} a pixel and light" if set(samples) == {spp} else f"{' + '.join(map(str, samples))} a pixel"
    finer = "" if options.adaptive is None else f", {options.adaptive} where refined"
    finer += "" if options.bounce is None else f", {options.bounce} bounces a pixel"
    yield "rays", f"{frame.rays:,} ({each}{finer})" + (f", {speed:.1f} million a second" if speed else "")
    if frame.refined is not None:
        yield "refined", f"{100.0 * _refined(frame):.3g} % of the pixels"


def _light_text(light) -> str:
    """A light's kind, and its intensity with the unit."""
    from ..scene.lights import DirectionalLight

    if light.domain == "list" or light.domain == "hemisphere":
        return type(light).__name__
    unit = "lux" if isinstance(light, DirectionalLight) else "cd"
    return f"{type(light).__name__} of {light.intensity:.4g} {unit}"


def ran_text(plan: "str | Plan | None", frame: "Frame") -> str:
    """The plan that was asked for, and the methods that ran if it chose them."""
    return frame.plan if frame.plan == str(plan) else f"{plan}: {frame.plan}"


def _speed(frame) -> float | None:
    seconds = frame.timings["trace"]
    return frame.rays / seconds / 1e6 if frame.rays and seconds > 0.0 else None


def _refined(frame) -> float:
    """The share of all pixels that were refined."""
    return float(frame.refined.mean())


def _uncertain(frame) -> float | None:
    """The share of the triangle tests that float32 left to float64; None without counters."""
    if frame.counters is None:
        return None
    return frame.counters["uncertain"] / max(1, frame.counters["triangle_tests"])
