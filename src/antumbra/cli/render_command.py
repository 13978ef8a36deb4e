"""``antumbra render``: render a picture or an animation with exact shadows.

One `Renderer`, which keeps its state, renders an animation frame by frame; finished frames are not rendered again.
Every picture stores its settings (`PictureSpec.settings`) and exposure as JSON, and a frame is finished if its file has
the settings of this run. To avoid flicker, all frames share one exposure: unless specified, that of the first frame
that exists or succeeds. An interrupted run thus continues with the exposure of its first frame.
"""

import json
import re
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..base.errors import InputError
from ..base.files import checked_folder
from ..base.wording import some_of
from ..work.result_summary import duration
from . import arguments, console, picture_report
from .arguments import FrameSequence
from .console import BAD_INPUT, ProgressDisplay, explained, say
from .options import takes
from .picture_report import print_choices
from .picture_spec import PictureSpec, Progress, RenderArguments, Shot
from .shards import executor_for, for_node, report_shard

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..work.executors import Executor


# --- Animations -------------------------------------------------------------------------------------------------------


_HASHES = re.compile(r"#+(?=[^#]*$)")  # the last run of # in a name
STATES = "rendered", "finished", "failed"


class AnimationWork(NamedTuple):
    """An animation to render."""

    spec: PictureSpec
    scene: "AnyScene"
    load: float  # seconds to read the scene
    patterns: list[Path]  # paths of the pictures, in one folder, with # for the frame number
    overwrite: bool  # whether finished frames are rendered again
    film: Path | None = None  # film to assemble from the pictures


def film_path(outputs: list[Path], sequence: FrameSequence | None, spec: PictureSpec) -> Path | None:
    """The checked path of the film that `outputs` name; None if they name pictures."""
    from ..picture.image_files import FILM_SUFFIXES, check_film

    output = next((path for path in outputs if path.suffix.lower() in FILM_SUFFIXES), None)
    if output is None:
        return None
    if len(outputs) > 1:
        raise InputError(f"{output}: a film is the only output of its command; leave the other --output out")
    if sequence is None:
        raise InputError(f"{output}: a film has frames; add --frames FIRST:LAST, such as --frames 0:48")
    if isinstance(spec.background, str):
        raise InputError("--background transparent is for .png files; films have no alpha, use a colour")
    film = check_film(output)
    checked_folder(pictures_of(film).parent)
    return film


def pictures_of(film: Path) -> Path:
    """The path pattern of a film's frames while they are rendered."""
    return film.with_name(film.name + ".frames") / "######.png"


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be created ({error.strerror}); the film needs it for its frames") from error


def output_paths(outputs: list[Path], stem: str, sequence: FrameSequence | None) -> list[Path]:
    """The paths of the picture. For a sequence, ``#`` stands for the frame number."""
    paths = [_output_path(output, stem, sequence) for output in outputs] or [_output_path(None, stem, sequence)]
    if sequence is not None and len({path.parent for path in paths}) > 1:
        raise InputError(
            f"{paths[-1]}: is in another folder than {paths[0]}; write all files of the frames to one folder"
        )
    return paths


def _output_path(output: Path | None, stem: str, sequence: FrameSequence | None) -> Path:
    from ..picture.image_files import check_output

    if sequence is None:
        if output is not None and "#" in output.name:
            raise InputError(f"{output}: # stands for the frame number; add --frames FIRST:LAST, or leave # out")
        return check_output(Path(stem + ".png") if output is None else output)
    pattern = Path(f"{stem}.####.png") if output is None else output
    if "#" not in pattern.name:
        named = pattern.with_name(f"{pattern.stem}.####{pattern.suffix}")
        raise InputError(f"{pattern}: all frames would be one file; write #### for the frame number, such as {named}")
    check_output(numbered(pattern, sequence.numbers[0]))
    return pattern


def numbered(pattern: Path, number: int) -> Path:
    """The path of a frame: its zero-padded number replaces ``####``."""
    return pattern.with_name(_HASHES.sub(lambda hashes: f"{number:0{len(hashes[0])}d}", pattern.name))


def render_frames(
    job: AnimationWork, sequence: FrameSequence, display: ProgressDisplay, executor: "Executor"
) -> "Animation":
    """Render all unfinished frames that the executor assigns to this process."""
    job.spec.view(job.scene, 0.0)  # report a missing camera or light once, not per frame
    if job.spec.path is not None:
        check_cameras(job, sequence)
    job.spec.direct_lights(job.scene, 0.0)
    job.spec.ground_height(job.scene, 0.0)
    if job.film is not None:
        _make_folder(job.patterns[0].parent)
    last = sequence.time(sequence.numbers[-1])
    end = job.spec.clamped(job.scene, last)
    if last > end and not job.spec.quiet:
        say(f"note: the animation ends after {end:g} s; later frames show its end")
    animation = Animation(job, sequence, display)
    try:
        animation.complete = executor.finish([animation])
    except KeyboardInterrupt:
        done = sum(len(animation.numbers[state]) for state in ("rendered", "finished"))
        say(f"{some_of(done, len(sequence.numbers), 'frame', 'are')} finished; run the same command again to continue")
        raise
    if job.film is not None and animation.is_whole:
        animation.write_film(job.film, display)
    return animation


def check_cameras(job: AnimationWork, sequence: FrameSequence) -> None:
    """Raise InputError unless the path has a camera, in the scene's coordinates, at the time of each frame."""
    from ..engine.measured_scenes import check_degrees

    cameras = [job.spec.view(job.scene, sequence.time(number)) for number in sequence.numbers]
    ends = [end for camera in cameras for end in (camera.position, camera.target)]
    check_degrees(job.scene, np.array(ends), "the keys of --path")


class Animation:
    """The frames of a run, as units of work."""

    what = ""

    def __init__(self, job: AnimationWork, sequence: FrameSequence, display: ProgressDisplay):
        self.job, self.sequence, self._display = job, sequence, display
        self.complete = False  # whether no frames remain for other processes
        self.numbers: dict[str, list[int]] = {state: [] for state in STATES}
        self.exposure = None if self._linear else job.spec.exposure
        self.seconds: list[float] = []  # per rendered frame, with saving, without compilation
        self.timings: dict[str, float] = {}  # sums over these frames
        self.unforeseen: Exception | None = None  # the first error not caused by the input
        self.start = perf_counter()
        self._digest = job.spec.scene_digest()
        self._renderer = job.spec.renderer(job.scene)
        self._noted_replacement = False  # whether a note about replaced pictures was printed
        self._again = set(sequence.numbers) if job.overwrite else set[int]()  # frames to render even if finished
        if self.exposure is None and not self._linear and not job.overwrite:
            self.exposure = self._first_exposure()

    @property
    def is_whole(self) -> bool:
        """Whether all frames exist."""
        return self.complete and not self.numbers["failed"]

    @property
    def root(self) -> Path:
        return self.job.patterns[0].parent

    def root_of(self, folder: Path) -> Path:
        return folder.parent

    def __len__(self) -> int:
        return len(self.sequence.numbers)

    def files(self, k: int) -> list[str]:
        return [path.name for path in self._paths(self.sequence.numbers[k])]

    def done(self, k: int, root: Path | None = None) -> bool:
        number = self.sequence.numbers[k]
        if root is None and number in self._again:
            return False
        paths = [(root or self.root) / name for name in self.files(k)]
        time = self.sequence.time(number)
        return all(self._is_finished(path, self._settings(path, time), root is None) for path in paths)

    def found(self, k: int) -> None:
        self._record_outcome(k, {"state": "finished", "exposure": self.exposure})

    def estimate(self, left: int) -> None:
        """None: a frame must be done first."""

    def clear(self) -> None:
        """No-op: all files are results."""

    def _settings(self, path: Path, time: float) -> dict[str, Any]:
        """The settings that determine the picture at a time."""
        from ..picture.image_files import is_linear

        settings = self.job.spec.settings(self.job.scene, self._digest, time)
        return {**settings, "exposure": None if is_linear(path) else self.job.spec.exposure or "automatic"}

    def _first_exposure(self) -> float | None:
        """The exposure of the first finished frame; None without one.

        An earlier frame that failed in a previous run thus does not change the exposure of the others.
        """
        from ..picture.image_files import is_linear

        pattern = next(pattern for pattern in self.job.patterns if not is_linear(pattern))
        for number in self.sequence.numbers:
            path = numbered(pattern, number)
            note = _stored_settings(path) if path.exists() else {}
            if note.get("exposed") and self._settings(path, self.sequence.time(number)).items() <= note.items():
                exposure: float = note["exposed"]
                return exposure
        return None

    def do(self, k: int) -> None:
        """Render a frame. Errors are printed, not raised."""
        number, count = self.sequence.numbers[k], len(self)
        text = f"frame {number}{self._forecast(count - k)}"
        self._display.say(text, k, count)
        self._renderer.expect(count - k)
        progress = lambda _, runs: self._display.parts(text, runs, k, count)
        try:
            if self.exposure is None and not self._linear:
                self._find_exposure(k, progress)
            outcome = self._picture(number, progress)
        except Exception as error:
            reason, code = explained(error)
            say(f"frame {number}: {reason}")
            if code != BAD_INPUT:
                self.unforeseen = self.unforeseen or error
            outcome = {"state": "failed", "reason": reason}
        self._again.discard(number)
        self._record_outcome(k, outcome)

    def _record_outcome(self, k: int, outcome: dict[str, Any]) -> None:
        """Count the outcome of a frame, and print its fields for ``--json``."""
        number = self.sequence.numbers[k]
        self.numbers[outcome["state"]].append(number)
        if self.job.spec.json:
            time = self.job.spec.clamped(self.job.scene, self.sequence.time(number))
            answer = {"frame": number, **self._named(number), "time": time, **outcome}
            console.print_json(answer | {"time": time})  # the time of a path goes beyond that of a still scene

    @property
    def _linear(self) -> bool:
        """Whether no picture has an exposure."""
        from ..picture.image_files import is_linear

        return all(map(is_linear, self.job.patterns))

    @property
    def _layers(self) -> bool:
        from ..picture.image_files import is_linear

        return any(map(is_linear, self.job.patterns))

    def _paths(self, number: int) -> list[Path]:
        return [numbered(pattern, number) for pattern in self.job.patterns]

    def _named(self, number: int) -> dict[str, Any]:
        """The fields of ``--json`` that name the files of a frame."""
        paths = [str(path) for path in self._paths(number)]
        return {"output": paths[0], "outputs": paths}

    def _find_exposure(self, k: int, progress: Progress) -> None:
        """Use the exposure of the first frame before k that renders.

        Other processes save these frames. A process that renders all frames has already tried each of them.
        """
        from ..picture.image_files import frame_exposure

        for number in self.sequence.numbers[:k]:
            if number not in self.numbers["failed"]:
                with suppress(Exception):  # the process that saves this frame reports the error
                    self.exposure = frame_exposure(self._shot(number, progress).frame)
                    return

    def _shot(self, number: int, progress: Progress) -> Shot:
        return self.job.spec.shot(self.job.scene, self._renderer, self.sequence.time(number), progress, self._layers)

    def _picture(self, number: int, progress: Progress) -> dict[str, Any]:
        from ..picture.image_files import frame_exposure, is_linear

        time = self.sequence.time(number)
        shot = self._shot(number, progress)
        if self.exposure is None and not self._linear:
            self.exposure = frame_exposure(shot.frame)

        def note(path: Path) -> str:
            return json.dumps({**self._settings(path, time), "exposed": None if is_linear(path) else self.exposure})

        saved = picture_report.save_picture(
            shot.frame, self._paths(number), self.exposure, note, self.job.spec.background
        )
        self.seconds.append(shot.frame.timings["total"] + saved.seconds)
        for name, seconds in {**shot.frame.timings, "save": saved.seconds}.items():
            self.timings[name] = self.timings.get(name, 0.0) + seconds
        return {"state": "rendered", **picture_report.shot_answer(shot, saved)}

    def _is_finished(self, path: Path, settings: dict[str, Any], replaces: bool) -> bool:
        """Whether the file exists with these settings and the exposure of the other frames.

        If no exposure is fixed yet, the file's exposure becomes that of all frames. `replaces`: a picture that does not
        match will be overwritten.
        """
        if not path.exists():
            return False
        note = _stored_settings(path)
        differ = [name for name, value in settings.items() if note.get(name) != value]
        if not differ and self.exposure is not None and note["exposed"] not in (None, self.exposure):
            differ = ["exposure"]
        if differ and replaces and not self._noted_replacement:
            self._noted_replacement = True
            how = f"with other settings ({', '.join(differ)})" if note else "not from an animation"
            if not self.job.spec.quiet:
                say(f"note: {path} exists, {how}; such pictures are rendered again")
        if not differ and note["exposed"] is not None:
            self.exposure = note["exposed"]
        return not differ

    def _forecast(self, remaining: int) -> str:
        """The time of the last frame and an estimate for the remaining frames, as text."""
        if not self.seconds:
            return ""
        each = sum(self.seconds) / len(self.seconds)
        return f" (last: {duration(self.seconds[-1])}; about {duration(each * remaining)} left)"

    def write_film(self, film: Path, display: ProgressDisplay) -> None:
        """Write the film, and remove its frames."""
        from ..picture.image_files import write_film

        numbers = self.sequence.numbers
        pictures = [numbered(self.job.patterns[0], number) for number in numbers]
        progress = lambda done, count: display.say("writing the film", done, count)
        write_film(pictures, film, self.sequence.fps / numbers.step, progress)
        folder = self.root
        for picture in folder.glob("[0-9]*.png"):
            picture.unlink()
        with suppress(OSError):  # it contains other files
            folder.rmdir()

    def print_summary(self) -> int:
        """Print a summary of all frames and return the exit code."""
        if self.job.spec.json:
            console.print_json(self._answer())
        elif not self.job.spec.quiet:
            console.print_fields(self._fields())
        if self.unforeseen is not None:
            raise self.unforeseen
        return BAD_INPUT if self.numbers["failed"] else 0

    def _answer(self) -> dict[str, Any]:
        spec, numbers, n = self.job.spec, self.sequence.numbers, max(1, len(self.seconds))
        first = spec.options(self.job.scene, self.sequence.time(numbers[0]), self._layers)
        return {
            "frames": {"first": numbers[0], "last": numbers[-1], "step": numbers.step, "fps": self.sequence.fps},
            "output": str(self.job.film or self.job.patterns[0]),
            "outputs": [str(path) for path in ([self.job.film] if self.job.film else self.job.patterns)],
            "scene": picture_report.scene_answer(spec, self.job.scene),
            **{name: value for name, value in spec.record(first).items() if name != "time"},
            "exposure": self.exposure,
            **self.numbers,
            "load": self.job.load,
            "timings": {name: seconds / n for name, seconds in self.timings.items()},
            "seconds": perf_counter() - self.start,
        }

    def _fields(self) -> Iterator[tuple[str, str]]:
        spec, numbers = self.job.spec, self.sequence.numbers
        ends = [(numbered(pattern, numbers[0]), numbered(pattern, numbers[-1])) for pattern in self.job.patterns]
        failed, film = self.numbers["failed"], self.job.film
        if film is not None and self.is_whole:
            yield "film", f"{film}, {len(numbers) * numbers.step / self.sequence.fps:.3g} s"
        else:
            names = ", ".join(f"{first} to {last.name}" for first, last in ends)
            yield "pictures", names + (f"; {film} is not written" if film else "")
        counts = [f"{len(self.numbers['rendered'])} rendered"]
        counts += [f"{len(self.numbers['finished'])} were finished"] if self.numbers["finished"] else []
        counts += [f"{len(failed)} failed ({', '.join(map(str, failed))})"] if failed else []
        yield "frames", ", ".join(counts)
        yield "scene", picture_report.scene_text(spec, self.job.scene)
        yield "plan", str(spec.engine.plan)
        if self.exposure is not None:
            yield "exposure", f"{self.exposure:.6g}"
        if self.seconds:
            phases = {name: seconds / len(self.seconds) for name, seconds in self.timings.items() if name != "total"}
            yield "time", f"{picture_report.phases_text(phases)} (mean of a frame)"
            ordered = sorted(self.seconds)
            middle, slowest = duration(ordered[len(ordered) // 2]), duration(ordered[-1])
            yield "frame", f"{middle}, at most {slowest}, with saving"
        yield "all", duration(self.job.load + perf_counter() - self.start)


def _stored_settings(path: Path) -> dict[str, Any]:
    """The settings stored in a picture; {} without any."""
    from ..picture.image_files import note_of

    try:
        note = json.loads(note_of(path) or "{}")
    except ValueError:
        return {}
    return note if isinstance(note, dict) and "exposed" in note else {}


# --- The command ------------------------------------------------------------------------------------------------------


class RenderedPicture(NamedTuple):
    """A single picture, traced."""

    spec: PictureSpec
    scene: "AnyScene"
    digest: str  # of the scene, if it is needed
    load: float  # seconds to read the scene
    shot: Shot | None  # None: other processes trace parts of it
    seconds: float  # of tracing


class Rendering(NamedTuple):
    """The checked request that the command's arguments define."""

    spec: PictureSpec
    sequence: FrameSequence | None  # None: a single picture, at `time`
    time: float
    paths: list[Path]  # of the picture, or the patterns of the frames
    film: Path | None
    overwrite: bool

    @classmethod
    def of(cls, args: RenderArguments) -> "Rendering":
        """Parse and check the arguments. Raises InputError."""
        args.check()
        spec = args.options()
        sequence = None if args.frames is None else arguments.parse_frames(args.frames, args.time, args.fps)
        outputs = args.output or []
        film = film_path(outputs, sequence, spec)
        paths = [pictures_of(film)] if film else output_paths(outputs, spec.scene_spec.stem, sequence)
        spec.check()
        return cls(spec, sequence, args.time or 0.0, paths, film, args.overwrite)

    @property
    def layers(self) -> bool:
        """Whether the picture has layers: those of an EXR file."""
        from ..picture.image_files import is_linear

        return any(map(is_linear, self.paths))

    def trace(self, display: ProgressDisplay, executor: "Executor | None") -> "Animation | RenderedPicture":
        """Open the scene, and trace the picture, or the frames of an animation, which are also saved."""
        from ..engine.plan_records import one_picture
        from ..work.executors import LocalExecutor

        display.say("reading the scene")
        start = perf_counter()
        scene = self.spec.open()
        spec = self.spec.about(scene)
        load = perf_counter() - start
        display.say("preparing")
        if self.sequence is not None:
            job = AnimationWork(spec, scene, load, self.paths, self.overwrite, self.film)
            return render_frames(job, self.sequence, display, executor or LocalExecutor())
        digest = spec.scene_digest() if self.layers or executor else ""
        start = perf_counter()
        shot: Shot | None
        if executor is None:
            with nullcontext() if spec.ambient else one_picture():  # whose tracer traces no ambient occlusion
                shot = spec.shot(scene, spec.renderer(scene), self.time, display.parts, self.layers)
        else:
            shot = spec.shot_in_bands(scene, self.time, executor, digest, self.layers)
        return RenderedPicture(spec, scene, digest, load, shot, perf_counter() - start)

    def save(self, traced: RenderedPicture, page: Path | None) -> picture_report.SavedPicture:
        """Write the picture, and a page about it."""
        from ..picture.image_files import is_linear

        spec, scene, shot = traced.spec, traced.scene, traced.shot
        assert shot is not None

        def note(path: Path) -> str | None:
            return json.dumps(spec.settings(scene, traced.digest, shot.time)) if is_linear(path) else None

        saved = picture_report.save_picture(shot.frame, self.paths, spec.exposure, note, spec.background)
        if page is not None:
            picture_report.save_render_page(spec, scene, traced.load, shot, saved, page)
        return saved


def start_on_node(args: RenderArguments, paths: dict[str, str], threads: int, executor: "Executor") -> None:
    """Start a picture on a node of a cluster: its units go to the executor. As `cluster.ray_workers.Prepare`."""
    given: Any = for_node(args, paths)
    there = replace(given, json=False, quiet=True, html=None, threads=given.threads or threads)
    Rendering.of(there).trace(ProgressDisplay(quiet=True), executor)


@takes(RenderArguments)
def render(args: RenderArguments) -> int:
    """Render SCENE with exact shadows.

    Without arguments, it renders the built-in atrium to antumbra.png. Cameras and lights come from the file, at the
    time of --time. A scene without a camera is shown from slightly above, and a hall or room from inside. A scene
    without lights gets sun and sky, and a closed room a lamp.

    \b
    CAMERA
      1                         the second camera of the file
      0,1.7,8:0,1,0             position 0,1.7,8, target 0,1,0
      0,1.7,8:0,1,0:45          ... with a vertical field of view of 45 degrees instead of 60
      ortho                     an orthographic view of the scene; top: from straight above
      ortho:9,9,9:0,0,0:4       ... from a position to a target, 4 units high
      panorama                  all directions, from the default camera's position or the middle of a room
      panorama:0,1.7,8:0,1,0    ... from a position, centred on the heading of a target

    \b
    LIGHT
      0                                    the first light of the file
      point:X,Y,Z                          shines in all directions
      quad:CX,CY,CZ:UX,UY,UZ:VX,VY,VZ      a parallelogram around C with the edges U and V
      disk:CX,CY,CZ:NX,NY,NZ:RADIUS        a disk around C that faces N
      sphere:CX,CY,CZ:RADIUS               a lamp with soft shadows, seen from all sides
      sun:DX,DY,DZ[:ANGULAR_DIAMETER]      shines along D; 0.53 degrees by default, as the real sun
      ...@INTENSITY                        candela (sun: lux), 1 by default

    Frame k of --frames shows the time k / fps; frames past the end of the animation show its end. Frames whose file
    already exists, from the same scene and options, are not rendered again: repeat an interrupted command to continue.
    All frames share the exposure of the first one unless --exposure is given. If a frame fails, its error is printed,
    the others continue, and the exit code is 2. Name a .mp4, .webm or .gif file to get a film of the frames.

    \b
    Examples
      antumbra render
      antumbra render sponza.glb --size 1920x1080 --spp 64 -o sponza.exr -o sponza.png
      antumbra render city.ply --up z --light sun:1,0.5,-1 --camera=-90,-60,40:0,0,5
      antumbra render city.city.json --trees "trees.gpkg?height=h&radius=r&transmittance=0.2"
      antumbra render hall.glb --light point:0,3,0@50 --light sphere:2,1,2:0.2@10 --counters
      antumbra render hall.glb --ao 2 --spp 64 --counters --html hall.html
      antumbra render hall.glb --vpl 1000
      antumbra render hall.glb --bounce 20 --sampler halton --filter
      antumbra render robot.glb --time 1.5 --filter --adaptive
      antumbra render robot.glb --time 1.5 --json
      antumbra render robot.glb --frames 0:240 -o f.####.png
      antumbra render robot.glb --frames 0:48 --fps 24 -o robot.mp4
      antumbra render robot.glb --frames 0:240 --plan srdh+single --srdh-rays last-frame
      antumbra render "procedural:city?triangles=500k&seed=3"
      antumbra render city.antumbra --max-memory 2G
      antumbra render sponza.glb --ao 2 --explain-plan
    """
    picture = Rendering.of(args)
    spec = picture.spec
    start = partial(start_on_node, args)
    executor = executor_for(args, picture.paths[0], start, vars(args), args.plan)
    with ProgressDisplay(spec.quiet) as display:
        traced = picture.trace(display, executor)
        if isinstance(traced, Animation):
            animation = traced
        elif traced.shot is None:  # a shard
            return report_shard(executor, args, traced.seconds)
        else:
            display.say("writing the picture")
            saved = picture.save(traced, args.html)
    if isinstance(traced, Animation):
        return animation.print_summary()
    assert traced.shot is not None
    if spec.json:
        console.print_json(picture_report.picture_answer(traced.spec, traced.scene, traced.load, traced.shot, saved))
    elif not spec.quiet:
        console.print_fields(picture_report.picture_fields(traced.spec, traced.scene, traced.load, traced.shot, saved))
        if args.explain_plan:
            print_choices(traced.shot, traced.scene)
    return 0
