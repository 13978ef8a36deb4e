"""``antumbra bake``: bake ambient occlusion, shadows or light of a scene into a glTF file."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from ..baking.bake_options import BakeOptions
from ..base.errors import InputError
from ..work.result_summary import Summary
from . import console
from .arguments import make_lights, parse_light
from .options import LISTED_LAST, ListedBefore, PictureLightOption, SceneArgument, UpOption, writes
from .scene_arguments import quietly
from .shards import MergeOption, RayOption, ShardOption
from .study_run import Scenes, StudyCommand, StudyRun, Writers, command_of

if TYPE_CHECKING:
    from ..baking.bake import Baked
    from ..engine.scene import AnyScene
    from ..scene.lights import Light
    from ..work.executors import Executor


@dataclass(frozen=True, kw_only=True)
class BakeCommand(StudyCommand[BakeOptions, "Baked"]):
    """Bake occlusion, shadows or light into a glTF file.

    Everything else in the file is kept: nodes, instances, materials, textures, animations. Other scenes are first
    converted to glTF, with their triangles and base colours.

    \b
    WHAT
      ao           visible share of the sky, weighted by the cosine
      shadow       mean visible share of the lights
      sun          irradiance of one sun, divided by its intensity
      light        light of all lights and the sky, linear RGB
      bent-normal  mean unoccluded direction

    An ao texture becomes the occlusion texture of the materials, which viewers apply to ambient light. Textures of
    shadow, sun and light become lightmaps (MOZ_lightmap), with UV sets of their own, and materials stay as they are;
    with --unlit, light is multiplied by the base colours and replaces them in unlit materials (KHR_materials_unlit).
    COLOR_0 multiplies the base colour; for shadow, sun and light it also makes the materials unlit. A mesh used by
    several nodes is duplicated, because each node receives different light.

    Points inside solids are dark but never visible; they get the values of visible points nearby. The front of a face
    is the side on which its corners run counter-clockwise, as in glTF.

    \b
    LIGHT
      As in antumbra render.  [default: the lights of SCENE, or daylight]

    \b
    Examples
      antumbra bake temple.glb -o temple_ao.glb
      antumbra bake temple.glb -o temple_ao.glb --texture 2048 --bit-depth 16
      antumbra bake hall.glb -o hall_lit.glb --what light --open-sky 0.5 --bounces 3 --texture 2048 --exr
      antumbra bake city.ply --up z -o city.glb --what sun --light sun:1,0.5,-1
      antumbra bake robot.glb -o robot.glb --attribute _AO --radius 0.5
    """

    scene: SceneArgument
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The .glb file to write.", metavar="FILE", callback=writes(".glb"))
    ]
    page: Annotated[
        Path | None,
        typer.Option(
            help="Write a page (.html) of the values at vertices. Any browser opens it offline.",
            metavar="FILE",
            callback=writes(".html"),
        ),
    ] = None
    vertex: Annotated[
        bool, typer.Option("--vertex", help="Bake values at vertices (the default)."), ListedBefore("attribute")
    ] = False
    light: Annotated[PictureLightOption, ListedBefore("exposure")] = None
    open_sky: Annotated[
        float | None,
        typer.Option(help="For light: add the irradiance of an open sky.", metavar="LUX", show_default=False),
    ] = None
    up: Annotated[UpOption, ListedBefore("plan")] = None
    shard: Annotated[ShardOption, LISTED_LAST] = None
    ray: RayOption = None
    merge: MergeOption = None

    files: ClassVar[str | None] = None

    def check(self) -> None:
        self.refuse_changes("a bake keeps everything else in the file; change the file itself")
        if self.vertex and self.options.texture is not None:
            raise InputError("--vertex and --texture exclude each other; leave one of them out")
        if self.page is not None and self.options.texture is not None:
            raise InputError("--page shows values at vertices; leave --texture out")
        if self.open_sky is not None and self.options.what != "light":
            raise InputError("--open-sky belongs to --what light; leave it out")
        replace(self.options, lights=[light for light in self._lights() if not isinstance(light, int)] or None)

    def work(self, scenes: Scenes, executor: "Executor | None") -> "Callable[[], Baked | None]":
        from ..baking.bake import bake_file
        from ..baking.bake_input import BakeSource, is_gltf
        from ..base.progress import PhaseClock
        from ..work.executors import executor_of

        path = self.spec.path
        source = BakeSource(scenes.bare, path if path is not None and is_gltf(path) else None)
        options = replace(self.options, lights=self._lights_of(scenes.bare))
        keep = executor_of(executor or self.output.with_suffix(".parts"))

        def bake() -> "Baked | None":
            with quietly():
                return bake_file(source, options, self.output, PhaseClock(), keep)

        return bake

    def _lights(self) -> "list[int | Light]":
        return [parse_light(text) for text in self.light or []]

    def _lights_of(self, scene: "AnyScene") -> "list[Light] | None":
        """The lights of the arguments; None: the bake chooses."""
        from ..scene.lights import AmbientOcclusion
        from ..scene.sky import Sky

        sky = [] if self.open_sky is None else [AmbientOcclusion(intensity=self.open_sky)]
        if not self.light and not sky:
            return None
        lights = make_lights(self._lights(), scene, self.options.time) if self.light or scene.lights else []
        return [light for light in lights if not isinstance(light, Sky)] + sky

    def writers(self, result: "Baked", scenes: Scenes) -> Writers:
        return {"page": result.page}  # the study has written the other files

    def summary(self, result: "Baked", scenes: Scenes, seconds: float) -> Summary:
        return result.summary()

    def report(self, run: StudyRun, result: "Baked", scenes: Scenes) -> int:
        code = super().report(run, result, scenes)
        for note in () if self.json or self.quiet else result.notes:
            console.say(f"note: {note}")
        return code


bake = command_of(BakeCommand, BakeOptions)
