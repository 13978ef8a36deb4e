"""Reports on rendered pictures: summaries as text and JSON, the choices of the plan `auto`, and HTML pages."""

import shlex
import sys
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..base.wording import counted, height_text, percent, place_text
from ..picture.picture_records import camera_fields, light_fields, plain
from ..work.result_summary import duration, speed_text
from . import console

if TYPE_CHECKING:
    from ..engine.auto.strategies import StrategyChoice
    from ..engine.plan import Plan
    from ..engine.scene import AnyScene
    from ..picture.frame import Frame
    from ..scene.instance_data import InstanceData
    from ..scene.lights import Light
    from .picture_spec import PictureSpec, Shot


# --- HTML pages with embedded pictures --------------------------------------------------------------------------------


_STYLE = """
:root { background: #1e1e22; color: #ececec; color-scheme: dark; }
body { font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 1400px; padding: 0 1.5em; }
h1 { font-size: 1.6em; } h2 { font-size: 1.15em; margin-top: 2em; }
.panels { display: flex; flex-wrap: wrap; gap: 1.2em; }
figure { flex: 1 1 300px; margin: 0; }
figcaption span { color: #a0a0a6; display: block; }
img { display: block; max-width: 100%; width: 100%; }
.bar { margin: 1.2em 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; }
th, td { border-bottom: 1px solid #8884; padding: 0.25em 1em 0.25em 0; text-align: left; vertical-align: top; }
td { overflow-wrap: anywhere; }
table.numbers td, table.numbers th + th { font-variant-numeric: tabular-nums; text-align: right; white-space: nowrap; }
small { color: #a0a0a6; display: inline-block; min-width: 4em; }
tr.sum { font-weight: bold; }
.bad { color: #f66; font-weight: bold; }
pre { overflow-x: auto; padding: 0.8em 1em; background: #8882; }
"""


def save_page(title: str, parts: Iterable[str], path: Path) -> None:
    """Write a page of HTML parts atomically."""
    from ..base.files import atomic_output

    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    head += f"<title>{escape(title)}</title><style>{_STYLE}</style>"
    body = [f"<h1>{escape(title)}</h1>", *parts]
    text = "\n".join(["<!doctype html>", f'<html lang="en"><head>{head}</head><body>', *body, "</body></html>", ""])
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def data_url(rgb: NDArray[np.uint8]) -> str:
    """A picture, (H, W, 3) uint8 sRGB, as a data URL."""
    from ..picture.image_files import png_bytes

    return "data:image/png;base64," + b64encode(png_bytes(rgb)).decode("ascii")


def html_table(headers: Sequence[str], rows: Iterable[tuple[str, Sequence[str]]]) -> str:
    """A table of numbers. Cells are HTML; row and column names are plain text."""
    head = "".join(f"<th>{escape(header)}" for header in headers)
    body = "\n".join(
        f"<tr{' class=sum' if name == 'total' else ''}><th>{escape(name)}{''.join(f'<td>{cell}' for cell in cells)}"
        for name, cells in rows
    )
    return f"<div class=scroll><table class=numbers><thead><tr>{head}</thead>\n<tbody>\n{body}\n</table></div>"


def html_pairs(rows: Iterable[tuple[str, str]]) -> str:
    """A table of names and values."""
    body = "\n".join(f"<tr><th>{escape(name)}<td>{escape(value)}" for name, value in rows)
    return f"<table>\n{body}\n</table>"


# --- Pictures of ``antumbra render``, and their summaries as text and JSON --------------------------------------------


class SavedPicture(NamedTuple):
    """A picture on disk, in one file or several."""

    paths: list[Path]
    exposure: float | None  # of .png files; None: all files hold linear light
    seconds: float  # to write the files

    @property
    def files(self) -> str:
        """The paths, as text."""
        return ", ".join(map(str, self.paths))


def save_picture(
    frame: "Frame",
    paths: list[Path],
    exposure: float | None,
    notes: "Callable[[Path], str | None]",
    background: "str | NDArray[np.float64] | None" = None,
) -> SavedPicture:
    """Save the picture to files of any format, each with its note. Exposure None: automatic."""
    from ..picture.image_files import frame_exposure, is_linear, save_frame

    start = perf_counter()
    if all(map(is_linear, paths)):
        exposure = None
    elif exposure is None:
        exposure = frame_exposure(frame)
    for path in paths:
        save_frame(frame, path, exposure, notes(path), background)
    return SavedPicture(paths, exposure, perf_counter() - start)


def picture_answer(
    spec: "PictureSpec", scene: "AnyScene", load: float, shot: "Shot", saved: SavedPicture
) -> dict[str, Any]:
    """The fields of ``--json`` for a single picture."""
    return {"scene": scene_answer(spec, scene), **spec.record(shot.options), "load": load, **shot_answer(shot, saved)}


def scene_answer(spec: "PictureSpec", scene: "AnyScene") -> dict[str, Any]:
    """The fields of ``--json`` for the scene."""
    from ..engine.measured_scenes import notes_of

    return {
        "source": spec.source,
        "name": scene.name,
        "triangles": scene.n_triangles,
        "duration": scene.duration,
        "up": scene.up,
        "notes": notes_of(scene),
    }


def shot_answer(shot: "Shot", saved: SavedPicture) -> dict[str, Any]:
    """The fields of ``--json`` for a single picture, or for one frame of an animation."""
    frame = shot.frame
    mask = frame.mask
    return {
        "output": str(saved.paths[0]),
        "outputs": [str(path) for path in saved.paths],
        "time": shot.time,
        "camera": camera_fields(shot.camera),
        "lights": [light_fields(light) for light in shot.lights],
        "ground": None if frame.ground is None else frame.ground.height,
        "exposure": saved.exposure,
        "seen": int(mask.sum()),
        "lit": [float(v[mask].mean()) if mask.any() else None for v in frame.visibility],
        "refined": None if frame.refined is None else _refined(frame),
        "rays": frame.rays,
        "mrays_per_second": _speed(frame),
        "ran": frame.plan,
        "tree": None if frame.tree is None else frame.tree._asdict(),
        "choices": None if frame.choices is None else [choice._asdict() for choice in frame.choices],
        "timings": frame.timings,
        "save": saved.seconds,
        "counters": frame.counters,
        "scheduled": frame.scheduled,
        "paging": frame.paging,
        "uncertain_fraction": _uncertain(frame),
    }


def picture_fields(
    spec: "PictureSpec", scene: "AnyScene", load: float, shot: "Shot", saved: SavedPicture
) -> Iterator[tuple[str, str]]:
    """The names and values printed for a single picture."""
    from ..engine.measured_scenes import notes_of
    from ..scene.scene_data import group_notes

    frame = shot.frame
    yield "picture", saved.files
    moment = f", at {shot.time:g} of {scene.duration:g} s" if scene.animated else ""
    yield "scene", scene_text(spec, scene) + moment
    for note in group_notes(notes_of(scene), "antumbra info has all"):
        yield "note", note
    yield from shot_fields(spec, scene, shot)
    phases = {"load": load, **frame.timings, "save": saved.seconds}
    frame_seconds = phases.pop("total")
    yield "time", phases_text(phases)
    yield "frame", f"{duration(frame_seconds)} without load and save"
    for name, value in (frame.counters or {}).items():
        yield name.replace("_", " "), f"{value:,}"
    if frame.counters is not None:
        yield "uncertain", f"{_uncertain(frame):.2g} of the triangle tests were repeated in float64"


def scene_text(spec: "PictureSpec", scene: "AnyScene") -> str:
    """The source of a scene and its number of triangles."""
    return f"{spec.source}, {counted(scene.n_triangles, 'triangle')}"


def phases_text(seconds: dict[str, float]) -> str:
    """The seconds of each phase as text, without phases that did not run."""
    return ", ".join(f"{name} {duration(s)}" for name, s in seconds.items() if s > 0.0)


def shot_fields(spec: "PictureSpec", scene: "AnyScene", shot: "Shot") -> Iterator[tuple[str, str]]:
    """The names and values from the camera to the plan."""
    yield from view_fields(scene, shot, shot.frame.timings["trace"])
    yield "plan", ran_text(spec.engine.plan, shot.frame)
    if shot.frame.paging is not None:
        paging = shot.frame.paging
        yield (
            "chunks",
            (
                f"{paging['cached']:,} of {paging['wanted']:,} were in memory when needed, "
                f"{paging['loaded']:,} were read ({paging['bytes'] / 1e6:,.0f} MB)"
            ),
        )
        if "device_wanted" in paging:
            yield (
                "on the device",
                (
                    f"{paging['device_kept']:,} of {paging['device_wanted']:,} chunks were there when needed, "
                    f"{paging['device_uploaded']:,} were uploaded ({paging['device_bytes'] / 1e6:,.0f} MB)"
                ),
            )


def view_fields(scene: "AnyScene", shot: "Shot", seconds: float | None = None) -> Iterator[tuple[str, str]]:
    """The names and values from the camera to the rays; `seconds`: in which they were traced, for their speed."""
    from ..query.equal_samples import traced_samples
    from ..query.light_samples import light_samples

    camera, frame, options = shot.camera, shot.frame, shot.options
    spp = options.spp
    yield "camera", f"{camera.width}x{camera.height} from {place_text(camera.position)}"
    if frame.ground is not None:
        share = frame.ground.mask.mean()
        height = height_text(frame.ground.height, float(np.linalg.norm(np.ptp(scene.bounds, axis=0))))
        yield (
            "ground",
            f"at height {height}; {percent(share, 0)} of the picture shows its shadows",
        )
    yield "lights", ", ".join(light_text(light) for light in shot.lights)
    if not frame.mask.any():
        yield "", "the camera sees no surface"
    samples = [traced_samples(light, light_samples(light, spp, options.sampler, options.seed)) for light in shot.lights]
    each = f"{spp} per pixel and light" if set(samples) == {spp} else f"{' + '.join(map(str, samples))} per pixel"
    finer = "" if options.adaptive is None else f", {options.adaptive} where refined"
    if options.bounce is not None:
        paths = f"paths of {options.bounces} " if options.bounces > 1 else ""
        finer += f", {options.bounce} {paths}bounces per pixel"
    yield "rays", f"{frame.rays:,} ({each}{finer}){speed_text(frame.rays, seconds) if seconds else ''}"
    if frame.refined is not None:
        yield "refined", f"{100.0 * _refined(frame):.3g} % of the pixels"


def light_text(light: "Light") -> str:
    """A light in words, with its sizes in world units and its intensity, such as ``square light of 2 x 2 (1 cd)``."""
    from ..scene import lights as kinds
    from ..scene.light_lists import DirectionalLights, LightList
    from ..scene.sky import Sky

    match light:
        case Sky():
            return "sky"
        case kinds.AmbientOcclusion():
            within = light.radius is not None and np.isfinite(light.radius)
            return "ambient occlusion" + (f" within {light.radius:.4g}" if within else "")
        case kinds.DirectionalLight():
            return f"sun of {light.angular_diameter:.4g} degrees ({light.intensity:.4g} lux)"
        case kinds.QuadLight():
            kind = f"{_quad_text(light.u, light.v)} light of {_length(light.u):.4g} x {_length(light.v):.4g}"
        case kinds.DiskLight():
            kind = f"disk light of radius {light.radius:.4g}"
        case kinds.SphereLight():
            kind = f"sphere light of radius {light.radius:.4g}"
        case kinds.PointLight():
            kind = "point light"
        case LightList():
            return counted(
                len(light.points), "distant light" if isinstance(light, DirectionalLights) else "point light"
            )
        case _:
            kind = type(light).__name__
    return f"{kind} ({light.intensity:.4g} cd)"


def _length(edge: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(edge))


def _quad_text(u: NDArray[np.float64], v: NDArray[np.float64]) -> str:
    """The shape of a parallelogram with these edges."""
    if abs(u @ v) > 1e-6 * _length(u) * _length(v):
        return "parallelogram"
    return "square" if np.isclose(_length(u), _length(v), rtol=1e-6) else "rectangular"


def ran_text(plan: "str | Plan | None", frame: "Frame") -> str:
    """The plan; for one that chooses its methods, also the methods that ran."""
    return frame.plan if frame.plan == str(plan) else f"{plan}: {frame.plan}"


def _speed(frame: "Frame") -> float | None:
    seconds = frame.timings["trace"]
    return frame.rays / seconds / 1e6 if frame.rays and seconds > 0.0 else None


def _refined(frame: "Frame") -> float:
    """The share of pixels that were refined."""
    assert frame.refined is not None
    return float(frame.refined.mean())


def _uncertain(frame: "Frame") -> float | None:
    """The share of triangle tests that were uncertain in float32; None without counters."""
    if frame.counters is None:
        return None
    return frame.counters["uncertain"] / max(1, frame.counters["triangle_tests"])


# --- Choices of the plan `auto`, their reasons and predictions --------------------------------------------------------


_WIDTH = 110  # characters of a line
_REASONS = {"prediction": "predicted", "earlier query": "as in an earlier query", "few rays": "few rays"}


def print_choices(shot: "Shot", scene: "AnyScene") -> None:
    """Print a row for the tree and one per query; for a plan that chooses nothing, its name. Instances come first."""
    from ..engine.auto.cost_model import build_seconds, machine_rates

    frame, triangles = shot.frame, scene.n_triangles
    _print_instances(scene, frame.plan)
    _print_device(scene, shot)
    if frame.choices is None or frame.tree is None:
        print(f"The plan {frame.plan} specifies its methods; nothing was chosen.")
        return
    tree, predicted = frame.tree, ""
    if tree.tree in machine_rates().builds and not (tree.culler or tree.updater):
        predicted = duration(build_seconds(tree.tree, triangles))
    methods, measured = str(tree._replace(tracer="")) or "none", duration(frame.timings["build"])
    rows = [("tree", f"{triangles:,}", methods, tree.why, predicted, measured)]
    names = frame.names
    for i, choice in enumerate(frame.choices):
        times = duration(choice.predicted) if choice.predicted else "", duration(choice.seconds)
        strategy = choice.strategy + ", sorted" * choice.sorted
        rows.append(
            (names[i] if i < len(names) else "more rays", f"{choice.rays:,}", strategy, _reason(choice), *times)
        )
    head = ("query", "rays", "method", "why", "predicted", "measured")
    console.print_table(head, rows, right=(1, 4, 5), width=_WIDTH)


def _print_device(scene: "AnyScene", shot: "Shot") -> None:
    """Print what a device traced, and what the CPU did for it."""
    from ..devices.device_list import CPU, default_device, parse_device
    from ..engine.device_plans import traces_on_device
    from ..engine.plan import parse_plan

    frame = shot.frame
    device = parse_plan(frame.plan).device
    if device is not None:
        there = frame.seen_on is not None and not traces_on_device(scene.data)  # a store: all nearest hits
        rest = {
            "found what the camera sees": frame.seen_on is None,
            "found the sub-pixels of edges": frame.seen_on is not None and frame.refined is not None and not there,
            "traced bounced rays": frame.indirect is not None and not there,
            "decided the few tests that need exact arithmetic": True,
        }
        done = [each for each in rest if rest[each]]
        work = f"{', '.join(done)}{',' if len(done) > 1 else ''} and shaded"
        found = "" if frame.seen_on is None else "found what the camera sees and "
        print(f"The device {device} {found}traced the shadow rays; the CPU {work}.")
    elif default_device() not in (None, CPU) and not traces_on_device(scene.data):
        full = ":".join(map(str, parse_device(default_device() or CPU)))
        plan = f"bsah+chcrt+device:{full}"
        print(f"The CPU traced everything; by the plan {plan}, the device traces camera and shadow rays.")


def _print_instances(scene: "AnyScene", plan: str) -> None:
    """Print whether the plan traced a scene's instances or their flattened copies."""
    from ..engine.plan import parse_plan
    from ..engine.sources.instanced_source import Instanced, traces_instances

    if not scene.data.instanced:
        return
    instances = cast("InstanceData", scene.data).instances
    copies = f"{counted(len(instances.mesh), 'copy')} of {counted(len(instances.meshes), 'mesh')}"
    if traces_instances(parse_plan(plan)):
        print(f"The plan {plan} traced {copies} as instances.")
    else:
        print(f"The plan {plan} cannot trace instances, so {copies} were flattened; {Instanced.default_plan} can.")


def _reason(choice: "StrategyChoice") -> str:
    if choice.reason != "sample":
        return _REASONS[choice.reason]
    of_ray = ", ".join(
        f"{strategy} {ns:.3g}" for strategy, ns in sorted(choice.tried.items(), key=lambda item: item[1])
    )
    return f"sampled: {of_ray} ns per ray"


# --- The page of ``antumbra render --html`` ---------------------------------------------------------------------------


def save_render_page(
    spec: "PictureSpec", scene: "AnyScene", load: float, shot: "Shot", saved: SavedPicture, path: Path
) -> None:
    """Write the page atomically: the picture, its settings, times and counters."""
    from ..picture.image_files import frame_exposure, screen_picture
    from .installation_commands import about

    frame = shot.frame
    exposure = spec.exposure if spec.exposure is not None else frame_exposure(frame)
    width = frame.image.shape[1]
    picture = data_url(screen_picture(frame, exposure, spec.background))
    parts = [
        f'<img style="max-width: {width}px" alt="{escape(scene.name)}" src="{picture}">',
        "<h2>Picture</h2>",
        html_pairs(_facts(spec, scene, shot, saved, exposure)),
        "<h2>Lights</h2>",
        html_table(["", "light", "share lit"], _lights(shot)),
        "<h2>Milliseconds</h2>",
        html_table(["", ""], _times(load, shot, saved)),
    ]
    if frame.counters is not None:
        rows = [(name.replace("_", " "), [f"{value:,}"]) for name, value in frame.counters.items()]
        parts += ["<h2>Counters of shadow rays</h2>", html_table(["", ""], rows)]
    parts += [
        "<h2>Settings</h2>",
        html_pairs((name, str(v)) for name, v in plain(spec.record(shot.options)).items()),
    ]
    parts += ["<h2>Machine</h2>", html_pairs((name, str(value)) for name, value in about().items())]
    parts += ["<h2>Command</h2>", f"<pre>{escape(shlex.join(['antumbra', *sys.argv[1:]]))}</pre>"]
    save_page(f"{scene.name}: {width}x{frame.image.shape[0]}", parts, path)


def _facts(
    spec: "PictureSpec", scene: "AnyScene", shot: "Shot", saved: SavedPicture, exposure: float
) -> Iterator[tuple[str, str]]:
    from ..engine.measured_scenes import notes_of

    yield "scene", scene_text(spec, scene)
    yield "file", saved.files
    yield "exposure", f"{exposure:.4g}"
    if scene.animated:
        yield "time", f"{shot.time:g} of {scene.duration:g} s"
    yield from shot_fields(spec, scene, shot)
    for note in notes_of(scene):
        yield "note", note


def _lights(shot: "Shot") -> Iterator[tuple[str, list[str]]]:
    """One row per light: the mean share that the visible surfaces see."""
    frame = shot.frame
    for name, light, share in zip(frame.names, shot.lights, frame.visibility):
        lit = f"{100.0 * float(share[frame.mask].mean()):.1f} %" if frame.mask.any() else ""
        yield name, [light_text(light), lit]


def _times(load: float, shot: "Shot", saved: SavedPicture) -> Iterator[tuple[str, list[str]]]:
    phases = dict(shot.frame.timings)
    total = phases.pop("total")
    for name, each in phases.items():
        if each > 0.0:
            yield name, [f"{1000.0 * each:.1f}"]
    yield "total", [f"{1000.0 * total:.1f}"]
    yield "load the scene", [f"{1000.0 * load:.1f}"]
    yield "save the picture", [f"{1000.0 * saved.seconds:.1f}"]
