"""``antumbra dataset``: render a scene with many cameras and lights, with object ids, to a folder."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from ..datasets.dataset_options import DatasetOptions
from . import arguments, console
from .arguments import CameraSpec
from .console import say
from .options import (
    AoOption,
    Before,
    Json,
    PictureLightOption,
    Quiet,
    SceneArgument,
    UpOption,
    arguments_of,
    literal,
    takes,
    writes,
    writes_folder,
)
from .scene_arguments import SceneSpec, limit_memory
from .shards import MergeOption, RayOption, ShardOption, executor_for, parse_shard
from .study_run import StudyRun

if TYPE_CHECKING:
    from ..datasets.dataset import Dataset
    from ..engine.scene import AnyScene
    from ..scene.lights import Light
    from ..work.executors import ShardIndex


_Options: Any = arguments_of("dataset", DatasetOptions)


@dataclass(frozen=True, kw_only=True)
class DatasetArguments(_Options):  # type: ignore[misc] # made from the options of a data set
    """The command-line arguments and options, besides those derived from `DatasetOptions`."""

    scene: SceneArgument
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="A new folder, or one written by this command.",
            metavar="FOLDER",
            callback=writes_folder(),
        ),
    ]
    camera: Annotated[
        list[str] | None,
        typer.Option(
            help="An index, or POSITION:TARGET[:VFOV]; may be repeated.", metavar="CAMERA", show_default=False
        ),
    ] = None
    light: Annotated[PictureLightOption, Before("random_lights")] = None
    ao: Annotated[AoOption, Before("seed")] = None
    up: Annotated[UpOption, Before("plan")] = None
    shard: Annotated[ShardOption, Before("overwrite")] = None
    ray: RayOption = None
    merge: MergeOption = None
    sheet: Annotated[
        Path | None,
        typer.Option(
            help="Also write a .png contact sheet of the first frame's layers.",
            metavar="FILE",
            show_default=False,
            callback=writes(".png"),
        ),
        Before(""),
    ] = None
    json: Json = False
    quiet: Quiet = False

    def parsed(self) -> "_Parsed":
        """The arguments that need parsing, checked before a scene is read."""
        return _Parsed(
            self.spec_of(self.scene),
            arguments.parse_size(self.size),
            [arguments.parse_camera(text) for text in self.camera or []],
            [arguments.parse_light(text) for text in self.light or []],
            [] if self.ao is None else [arguments.parse_ambient(self.ao)],
            None if self.max_memory is None else arguments.parse_bytes(self.max_memory, "--max-memory"),
            parse_shard(self.shard),
        )


class _Parsed(NamedTuple):
    spec: SceneSpec
    size: tuple[int, int]  # width, height
    cameras: list[int | CameraSpec]
    lights: "list[int | Light]"  # lights, or indices of the scene's lights
    ambient: "list[Light]"  # ambient occlusion, or nothing
    memory: int | None  # bytes
    shard: "ShardIndex | None"


@takes(DatasetArguments)
def dataset(args: DatasetArguments) -> int:
    """Render a data set of SCENE: per camera, a multi-layer EXR and a shadow mask of each light.

    Without cameras or lights, those of the file are used, or defaults that suit the scene. Cameras are numbered in the
    order --camera, --orbit, --random; lights in the order --light, --ao, --random-lights. antumbra render --help
    explains CAMERA and LIGHT.

    The command writes frames/0000.exr, masks/0000.Light000.png and manifest.json to FOLDER. The manifest lists the
    settings, seeds, cameras, lights, object names, and SHA-256 digests of the scene and each file. Run the same command
    again to continue after an interruption; once the data set is complete, it changes nothing.

    \b
    Examples
      antumbra dataset room.glb -o room --random 100 --random-lights 4 --seed 7
      antumbra dataset room.glb -o room --camera 0,1.7,8:0,1,0 --light sun:1,-1,0.5 --sheet room.png
      antumbra dataset city.ply -o city --up z --orbit 36 --size 640x480 --spp 1
      antumbra dataset room.glb -o room --random 1000 --shard 0/4
    """
    parsed = args.parsed()

    with StudyRun(args) as run:
        scene, _ = run.open(parsed.spec)
        parsed = parsed._replace(memory=limit_memory(scene, parsed.memory))
        try:
            result = _dataset(args, parsed, scene, run)
        except KeyboardInterrupt:
            say("finished frames are kept; run the same command again to continue")
            raise
        if args.sheet is not None and (parsed.shard is None or parsed.shard.number == 0):
            from ..datasets.dataset_files import contact_sheet
            from ..picture.image_files import save_png

            save_png(contact_sheet(result.folder), args.sheet)
    answer = {**result._asdict(), "folder": str(result.folder), "scene": scene.name}
    return run.report(answer, _fields(result, scene, parsed.shard))


def _dataset(args: DatasetArguments, parsed: "_Parsed", scene: "AnyScene", run: StudyRun) -> "Dataset":
    from ..datasets.dataset import dataset as make_dataset

    keeps_lights = parsed.ambient and not args.random_lights  # adding only ambient light keeps the scene's lights
    lights = arguments.make_lights(parsed.lights, scene, args.time) if parsed.lights or keeps_lights else []
    return make_dataset(
        scene,
        args.output,
        [arguments.make_camera(camera, scene, args.time, parsed.size) for camera in parsed.cameras] or None,
        lights + parsed.ambient or None,
        **literal(args, DatasetOptions),
        size=parsed.size,
        max_memory=parsed.memory,
        keep=executor_for(args, args.output),
        progress=run.say,
    )


def _fields(result: "Dataset", scene: "AnyScene", shard: "ShardIndex | None") -> Iterator[tuple[str, str]]:
    yield "data set", str(result.folder / "manifest.json")
    yield "scene", f"{scene.name}, {scene.n_triangles:,} triangles, {len(scene.objects):,} objects"
    yield "frames", f"{result.frames:,}, each with {result.lights} light{'s' * (result.lights != 1)}"
    finished = f", {result.finished:,} were finished" if result.finished else ""
    part = "" if shard is None else f" (shard {shard})"
    yield "rendered", f"{result.rendered:,}{finished}{part}"
    if not result.complete:
        yield "", "other shards still have frames to render; the last one completes the manifest"
    yield "time", console.duration(result.seconds)
