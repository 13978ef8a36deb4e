"""``antumbra dataset``: render a scene with many cameras and lights, with object ids, to a folder."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from ..base.option_fields import field_values
from ..datasets.dataset_options import DatasetOptions
from ..work.result_summary import Summary
from .arguments import make_camera, make_lights, parse_ambient, parse_bytes, parse_camera, parse_light, parse_size
from .console import say
from .options import (
    LISTED_LAST,
    AoOption,
    ListedBefore,
    PictureLightOption,
    SceneArgument,
    UpOption,
    writes,
    writes_folder,
)
from .scene_arguments import limit_memory
from .shards import MergeOption, RayOption, ShardOption, parse_shard
from .study_run import Scenes, StudyCommand, Writers, command_of

if TYPE_CHECKING:
    from ..datasets.dataset import Dataset
    from ..engine.scene import AnyScene
    from ..scene.lights import Light
    from ..work.executors import Executor


@dataclass(frozen=True, kw_only=True)
class DatasetCommand(StudyCommand[DatasetOptions, "Dataset"]):
    """Render images with visibility, occluders and ids.

    Without cameras or lights, those of the file are used, or defaults that suit the scene. Cameras are numbered in the
    order --camera, --orbit, --random; lights in the order --light, --ao, --random-lights. antumbra render --help
    explains CAMERA and LIGHT.

    The command writes frames/0000.exr, masks/0000.Light000.png and manifest.json to FOLDER. The manifest lists the
    settings, seeds, cameras, lights, object names, and SHA-256 digests of the scene and each file. Run the same command
    again to continue after an interruption; once the data set is complete, it changes nothing.

    \b
    Examples
      antumbra dataset room.glb -o room --random 100 --random-lights 4 --seed 7
      antumbra dataset room.glb -o room --camera 0,1.7,8:0,1,0 --light sun:1,-1,0.5 --contact-sheet room.png
      antumbra dataset city.ply -o city --up z --orbit 36 --size 640x480 --spp 1
      antumbra dataset room.glb -o room --random 1000 --shard 0/4
    """

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
    light: Annotated[PictureLightOption, ListedBefore("random_lights")] = None
    ao: Annotated[AoOption, ListedBefore("seed")] = None
    up: Annotated[UpOption, ListedBefore("plan")] = None
    shard: Annotated[ShardOption, ListedBefore("overwrite")] = None
    ray: RayOption = None
    merge: MergeOption = None
    contact_sheet: Annotated[
        Path | None,
        typer.Option(
            help="Also write a .png overview of the first frame. It shows all layers.",
            metavar="FILE",
            show_default=False,
            callback=writes(".png"),
        ),
        LISTED_LAST,
    ] = None

    files: ClassVar[str | None] = None

    def check(self) -> None:
        for text in self.camera or []:
            parse_camera(text)
        for text in self.light or []:
            parse_light(text)
        self._ambient()
        parse_shard(self.shard)

    def work(self, scenes: Scenes, executor: "Executor | None") -> "Callable[[], Dataset]":
        from ..datasets.dataset import dataset

        scene, options = scenes.bare, self.options
        options = replace(options, max_memory=limit_memory(scene, options.max_memory))
        cameras = [make_camera(parse_camera(text), scene, options.time, options.size) for text in self.camera or []]
        lights = self._lights(scene) + self._ambient()
        study = partial(
            dataset, scene, self.output, cameras or None, lights or None, **field_values(options), keep=executor
        )

        def render() -> "Dataset":
            try:
                return study()
            except KeyboardInterrupt:
                say("finished frames are kept; run the same command again to continue")
                raise

        return render

    def _ambient(self) -> "list[Light]":
        return [] if self.ao is None else [parse_ambient(self.ao)]

    def _lights(self, scene: "AnyScene") -> "list[Light]":
        """The lights that options name; those of the scene if they only add ambient light."""
        if not (self.light or (self.ao is not None and not self.options.random_lights)):
            return []
        return make_lights([parse_light(text) for text in self.light or []], scene, self.options.time)

    def writers(self, result: "Dataset", scenes: Scenes) -> Writers:
        from ..datasets.dataset_files import contact_sheet
        from ..picture.image_files import save_png

        shard = parse_shard(self.shard)
        is_first = shard is None or shard.number == 0
        return {"contact_sheet": lambda path: save_png(contact_sheet(result.folder), path)} if is_first else {}

    def summary(self, result: "Dataset", scenes: Scenes, seconds: float) -> Summary:
        return result.summary(scenes.bare, parse_shard(self.shard))


def _memory(text: str | None) -> int | None:
    return None if text is None else parse_bytes(text, "--max-memory")


dataset = command_of(DatasetCommand, DatasetOptions, {"size": parse_size, "max_memory": _memory})
