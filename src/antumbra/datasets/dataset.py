"""`dataset`: render a scene from many cameras under many lights, with object, face and blocker ids."""

import json
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from time import perf_counter
from typing import NamedTuple, ParamSpec

from ..base.errors import InputError
from ..base.files import checked_folder
from ..base.option_fields import Given, deciding_fields, with_keywords
from ..base.progress import Progress, with_progress
from ..base.wording import counted
from ..engine.scene import AnyScene
from ..engine.scene_loading import SceneLike, scene_of
from ..kernels.parallel import thread_count
from ..picture.image_files import openexr
from ..picture.render_options import DIFFUSE, RenderOptions
from ..picture.renderer import Renderer
from ..scene.camera import Camera
from ..scene.lights import Light, check_lights
from ..version import VERSION
from ..work.executors import Executor, ShardIndex, checked_shard, do_missing, executor_of
from ..work.result_summary import Summary, duration
from ..work.scene_records import (
    FORMAT,
    Record,
    camera_record,
    differences,
    digest_of,
    light_record,
    object_records,
    scene_record,
)
from .dataset_files import MANIFEST, DatasetFolder, read_json, write_json
from .dataset_layers import Objects, channels, check_faces, light_blockers, light_layer, masks, objects_of
from .dataset_options import PER_FRAME, DatasetOptions
from .frame_lights import MIN_LIT, RULE, TRIES, frame_light, seen_surfaces
from .random_views import CameraSet, LightSet, SamplingRegion, camera_set, light_set, sampling_region

_P = ParamSpec("_P")


class Dataset(NamedTuple):
    """A data set on disk, and what one call of `dataset` contributed."""

    folder: Path  # with manifest.json, frames/ and masks/
    frames: int  # number of cameras
    lights: int  # number of lights; each has a layer and a mask
    rendered: int  # frames that the call rendered
    finished: int  # frames of the call's shard that were already finished
    complete: bool  # whether all frames of all shards are finished and listed in the manifest
    seconds: float  # duration of the call

    def summary(self, scene: AnyScene, shard: ShardIndex | None = None) -> Summary:
        """The frames of a scene, and what the call did; `shard`: its share."""
        values = {**self._asdict(), "folder": str(self.folder), "scene": scene.name}
        finished = f", {self.finished:,} were finished" if self.finished else ""
        part = "" if shard is None else f" (shard {shard})"
        lines = [
            ("data set", str(self.folder / "manifest.json")),
            (
                "scene",
                f"{scene.name}, {counted(scene.n_triangles, 'triangle')}, {counted(len(scene.objects), 'object')}",
            ),
            ("frames", f"{self.frames:,}, each with {self.lights} light{'s' * (self.lights != 1)}"),
            ("rendered", f"{self.rendered:,}{finished}{part}"),
        ]
        if not self.complete:
            lines.append(("", "other shards still have frames to render; the last one completes the manifest"))
        return Summary(values, [*lines, ("time", duration(self.seconds))])


@with_keywords(DatasetOptions, 4)
@with_progress
def dataset(
    given: Given[_P], scene: SceneLike, folder: str | PathLike[str], cameras: Sequence[Camera] | None = None,
    lights: Sequence[Light] | Light | None = None, shard: tuple[int, int] = (0, 1), progress: Progress = None,
    keep: Executor | None = None, *args: _P.args, **keywords: _P.kwargs,
) -> Dataset:  # fmt: skip
    """Render a data set: per camera, an EXR file with a layer for each light, and a shadow mask for each light.

    A call resumes where an earlier one stopped, and the resulting bytes are the same. If all frames are finished, the
    call changes nothing.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    folder : str or path-like
        A new folder, or one with a data set of the same settings.
    cameras : list of Camera, optional
        None: the scene's own cameras, or its default camera if it has none; no such camera if `orbit` or `random` is
        given.
    lights : list of lights, one light, or None
        None: `Scene.default_lights`; no such light if `random_lights` is given.
    shard : (i, n)
        Render only the frames k with ``k % n == i``. The call after which all frames are finished completes the
        manifest.
    progress : function of (text, done, total), or bool, optional
        Called after each frame. False: show nothing. None: terminals and notebooks show a bar after a second.
    keep : executor, optional
        Renders the frames, see `antumbra.work.executors`. None: this process.

    Returns
    -------
    Dataset

    Raises
    ------
    InputError
        If a value is out of range, no view is found for a random camera, the folder contains a data set with other
        settings or other files, or it cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> room = at.procedural("atrium", triangles=5_000)
    >>> with TemporaryDirectory() as folder:
    ...     made = at.dataset(room, folder, orbit=2, size=(32, 24), spp=4)
    >>> made.frames, made.lights, made.complete
    (2, 1, True)
    """
    start = perf_counter()
    openexr()  # before long work begins
    path, options, share = checked_folder(folder), DatasetOptions(**given(*args, **keywords)), checked_shard(shard)
    if keep is not None:
        keep = executor_of(keep)
    scene = scene_of(scene)
    picture = RenderOptions(
        spp=options.spp, sampler=options.sampler, time=scene.clamped(options.time), materials=DIFFUSE
    )
    check_faces(scene)
    region = sampling_region(scene, picture.time, thread_count(options.threads))
    views = camera_set(scene, cameras, options, region.time)
    renderer = Renderer(scene, options.plan, region.threads, max_memory=options.max_memory)
    work = _FrameUnits(region, views, light_set(region, lights, options), picture, renderer)
    work.open(path, options.overwrite)
    if keep is None:
        do_missing([(work, range(share.number, len(work), share.of))])
    elif keep.finish([work]):
        keep.end([work])
    complete, seconds = work.close(), perf_counter() - start
    return Dataset(path, views.total, work.lights.total, work.rendered, work.finished, complete, seconds)


class _FrameUnits:
    """A data set being rendered: the `Units` of an executor, one per frame."""

    what = "frames"
    folder: DatasetFolder

    def __init__(
        self, region: SamplingRegion, views: CameraSet, lights: LightSet, options: RenderOptions, renderer: Renderer
    ):
        self.region, self.views, self.lights, self.options = region, views, lights, options
        self.rendered = self.finished = 0  # frames
        self._renderer, self._again = renderer, set[int]()  # frames to render even if finished
        self._objects: Objects | None = None
        plan = renderer.plan
        settings = {
            "version": VERSION,
            "scene": scene_record(region.scene, region.time, region.threads),
            "seed": views.seed,
            "cameras": views.record(),
            "lights": [{"layer": light_layer(k), **light_record(light)} for k, light in enumerate(lights.fixed)]
            + [{"layer": light_layer(len(lights.fixed) + k), "drawn": PER_FRAME} for k in range(lights.drawn)],
            **({"drawn": {"rule": RULE, "tries": TRIES, "lit": MIN_LIT}} if lights.drawn else {}),
            "options": deciding_fields(options),
            **({} if plan.tracer.exact else {"plan": str(plan)}),  # an exact plan changes no bit
        }
        self.settings = json.loads(json.dumps(settings))

    def __len__(self) -> int:
        return self.views.total

    @property
    def root(self) -> Path:
        return self.folder.path.parent

    def root_of(self, folder: Path) -> Path:
        return folder.parent

    def files(self, k: int) -> list[str]:
        return [f"{self.folder.path.name}/{file}" for file in self.folder.files(k)]

    def done(self, k: int, root: Path | None = None) -> bool:
        folder = self.folder if root is None else self.folder.at(root / self.folder.path.name)
        return not (root is None and k in self._again) and folder.record(k) is not None

    def found(self, k: int) -> None:
        self.finished += 1

    def estimate(self, left: int) -> None:
        """None: a frame must be done first."""

    def do(self, k: int) -> None:
        self._render(k)
        self._again.discard(k)
        self.rendered += 1

    def clear(self) -> None:
        """No-op: all files are results."""

    def open(self, path: Path, overwrite: bool) -> None:
        """Open the folder, and write a manifest with these settings if needed."""
        self.folder = folder = DatasetFolder(path, digest_of(self.settings), self.views.total, self.lights.total)
        manifest = read_json(path / MANIFEST) or {}
        if (number := manifest.get("format", FORMAT)) != FORMAT:
            known = f"holds a data set of format {number}, and this antumbra writes format {FORMAT}"
            raise InputError(f"{path}: {known}; name another folder")
        old_settings = manifest.get("settings")
        old_settings = old_settings if isinstance(old_settings, dict) else None
        if old_settings is None and path.exists() and not all(p.name.startswith(".") for p in path.iterdir()):
            raise InputError(f"{path}: has files, but no data set's {MANIFEST}; name a new folder")
        other = [] if old_settings is None else differences(old_settings, self.settings)
        if other and not overwrite:
            raise InputError(
                f"{path}: holds a data set of other settings ({'; '.join(other)}); "
                "name another folder, or replace it (--overwrite, overwrite=True)"
            )
        folder.prepare()
        if old_settings is None or overwrite:
            folder.drop_others()
            write_json(self._manifest([]), path / MANIFEST)
        folder.prepare("frames", "masks")
        if overwrite:
            self._again.update(range(len(self)))

    def _render(self, k: int) -> None:
        """Render and write frame k."""
        scene, time, threads = self.region[:3]
        kind, camera = self.views.camera(self.region, k)
        drawn = self._drawn_lights(camera, k)
        lights = self.lights.fixed + drawn
        self._renderer.expect(len(self) - k)
        frame = self._renderer.render(camera, lights, options=self.options)
        self._objects = self._objects or objects_of(scene)
        blocked = light_blockers(scene, frame, lights, time, threads)
        covered = frame.mask
        about = {
            "made": kind,
            "camera": camera_record(camera),
            "origin": scene.origin.tolist(),
            "seen": float(covered.mean()),
            **({"lights": [light_record(light) for light in drawn]} if drawn else {}),
            "lit": [float(v[covered].mean(dtype=float)) if covered.any() else None for v in frame.visibility],
        }
        self.folder.write(k, channels(frame, self._objects, blocked), masks(frame), about)

    def _drawn_lights(self, camera: Camera, k: int) -> list[Light]:
        """The random lights of frame k."""
        if not self.lights.drawn:
            return []
        seen, seed = seen_surfaces(self.region, camera), self.views.seed
        lights = [frame_light(self.region, seen, seed, i, k) for i in range(self.lights.drawn)]
        return check_lights(lights, self.region.scene.up)

    def close(self) -> bool:
        """Complete the manifest if all frames are finished; return whether they are."""
        frames = []
        for k in range(self.views.total):
            record = self.folder.record(k)
            if record is None:
                return False
            frames.append(record)
        write_json(self._manifest(frames), self.folder.path / MANIFEST)
        return True

    def _manifest(self, frames: list[Record]) -> Record:
        return {
            "format": FORMAT,
            "complete": len(frames) == self.views.total,
            "settings": self.settings,
            "settings_sha256": digest_of(self.settings),
            "objects": object_records(self.region.scene),
            "frames": frames,
        }
