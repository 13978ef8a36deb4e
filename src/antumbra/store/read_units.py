"""The first stage of a build: units that read scenes into files of pieces, and what all of them have read."""

import json
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from functools import cached_property
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypedDict, cast

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..generate.generated_scene import StreamedCity
from ..scene.alpha_masks import TexelMask, masks_in
from ..scene.camera import Camera
from ..scene.crs import unit_of_crs
from ..scene.face_looks import FaceLooks
from ..scene.lights import Light
from ..scene.mesh import Piece, Source, SpannedSource
from ..scene.open_faces import NONE_OPEN, OpenFaces
from ..scene.raster import Raster
from ..scene.scene_bounds import Survey
from ..scene.scene_data import SceneData
from ..scene.streamed_data import StreamedData
from ..scene.terrain import StreamedTerrain
from ..scene.units import LengthUnit
from .build_stages import Records
from .staged_looks import UnitLooks, UnitMaterials, staged_looks
from .staging_files import MAX_RUNS, Record, StagedPieces, joined_runs, staged_pieces, surveyed
from .store_checks import MAX_TRIANGLES
from .store_format import PAGE, TILES_SUFFIX, HeightSection, StoredObjects, StoreMeta, meta_from_json, meta_to_json
from .stored_cutouts import masks_of_record, masks_to_record
from .stored_heights import write_heights
from .system_resources import check_disk_space

StreamedScene = StreamedCity | StreamedTerrain | StreamedData
"""Scenes whose pieces are never in memory all at once."""


class ReadUnit(NamedTuple):
    """What a unit reads."""

    scenes: Callable[[], Iterable[SceneData | StreamedScene]]  # opens scenes, one after the other
    span: int | None = None  # of the pieces of the only scene; None: all pieces of all scenes


def read_unit(
    unit: ReadUnit, store: Path, folder: Path, file: Path, max_faces: int, progress: Callable[[int], None]
) -> Record:
    """Write the pieces of a unit to a file, and return its record, with the descriptions of scenes that it begins.

    store : the store
    folder : the store's, whose disk must have room
    progress : called with the number of triangles of each piece
    """
    scenes, copies = list[StoreMeta](), list[bool]()
    masks, unit_looks, look_bytes = list[TexelMask](), UnitLooks(), 0
    with file.open("wb") as stream:
        staged = StagedPieces(stream, store.name, max_faces)
        for scene in unit.scenes():
            source: Source | None = getattr(scene, "source", None)  # InputError if it is in a store
            if source is None:
                raise InputError(f"a scene is {type(scene).__name__}; it must be a Scene, as returned by antumbra.load")
            begins, finder, looks = unit.span in (None, 0), scene.open_faces(), scene.looks()
            staged.first_object = _object_count(scenes)
            if begins:
                n_triangles = staged.survey.n_triangles + scene.n_triangles
                check_count(store, n_triangles)
                look_bytes += 0 if looks is None else looks.face_bytes * scene.n_triangles
                check_disk_space(folder, store.name, n_triangles, stream.tell(), look_bytes)
            first = len(masks)
            with closing(_pieces(source, unit.span)) as pieces:  # other processes may be generating them
                for piece in pieces:
                    before = staged.survey.n_triangles
                    open_faces = NONE_OPEN if finder is None else finder.of(piece).with_masks_from(first)
                    staged.add(piece, open_faces, unit_looks.of(looks, piece))
                    progress(staged.survey.n_triangles - before)
            masks += [] if finder is None else finder.masks
            if begins:
                heights = None if scenes else _write_heights_of(scene, stream)
                scenes.append(_described(scene, source)._replace(heights=heights))
                copies.append(getattr(scene, "instanced", False) or getattr(scene, "has_copies", False))
            del scene, source, looks  # free them before the next one is opened
        materials = unit_looks.write(stream)
    described = json.dumps([meta_to_json(each).decode() for each in scenes]).encode()
    of_scenes = {"scenes": np.frombuffer(described, np.uint8), "copies": np.array(copies, np.bool_)}
    return staged.record() | of_scenes | masks_to_record(masks) | materials


def check_count(store: Path, n_triangles: int) -> None:
    """Raise an InputError if a store, unlike tiles, cannot hold so many triangles."""
    if n_triangles > MAX_TRIANGLES and store.suffix.lower() != TILES_SUFFIX:
        line = f"a store holds at most {MAX_TRIANGLES}; build tiles: -o {store.stem}{TILES_SUFFIX}"
        raise InputError(f"{store.name}: {n_triangles} triangles; {line}")


def _pieces(source: Source, span: int | None) -> Generator[Piece, None, None]:
    return source.pieces(0.0) if span is None else cast(SpannedSource, source).span(span)


def _write_heights_of(scene: SceneData | StreamedScene, stream: BinaryIO) -> HeightSection | None:
    """Write the heights of a scene that is one raster of them."""
    return None if scene.terrain is None else write_heights(stream, scene.terrain, PAGE)


def _described(scene: SceneData | StreamedScene, source: Source) -> StoreMeta:
    """A scene without its size and place."""
    notes = list(getattr(scene, "read_notes", scene.notes))  # of instances, without that on their materials
    if scene.animated:
        notes.append(f"{scene.name}: is animated; the store shows its first moment")
    had_surfaces = getattr(scene, "city", None) is not None or getattr(scene, "lacks_surfaces", False)
    if had_surfaces:
        notes.append(f"{scene.name}: a store keeps objects, without their attributes and semantic surfaces")
    names, types, parents = ([getattr(each, of) for each in scene.objects] for of in ("name", "type", "parent"))
    nowhere = np.zeros((2, 3))
    return StoreMeta(
        scene.name, scene.up, 0, nowhere, nowhere[0], nowhere.astype(np.float32), source.cameras(0.0),
        source.lights(0.0), tuple(notes), {}, getattr(scene, "crs", None), getattr(scene, "raster", None),
        getattr(scene, "given_unit", None), None, StoredObjects(names, types, parents, [], [], had_surfaces),
    )  # fmt: skip


# --- What all units have read -----------------------------------------------------------------------------------------


class Description(TypedDict):
    """The fields of `StoreMeta` that the scenes supply."""

    name: str
    up: str
    crs: str | None
    unit: LengthUnit | None
    raster: Raster | None
    heights: HeightSection | None
    objects: StoredObjects | None
    cameras: list[Camera]
    lights: list[Light]
    notes: tuple[str, ...]


class StagedScenes:
    """The pieces of all scenes, in files.

    file : name in errors
    count : number of units
    files : the file of each unit
    """

    def __init__(self, file: str, count: int, files: Callable[[int], Path], records: Records):
        self.survey, self._files, self._records, self._count = Survey(file), files, records, count
        self._first_masks = [0]  # number of the first mask of each unit
        self.begin: int | None = None  # the unit with the first scene
        self.has_copies = False  # whether a scene has its triangles from copies of meshes
        scenes, numbers, sizes = list[StoreMeta](), [np.empty((0, 2), np.int64)], [np.empty(0, np.int64)]
        runs, first_object = list[NDArray[np.int64]](), 0
        for k in range(count):
            record = records(k)
            surveyed(self.survey, record)
            begun = json.loads(record["scenes"].tobytes())
            if begun:  # others go on with the scene of the unit before
                first_object = _object_count(scenes)
            self.has_copies |= bool(record["copies"].any())
            runs.append(record["runs"] + np.array([0, first_object]))
            scenes += [meta_from_json(each.encode()) for each in begun]
            if scenes and self.begin is None:
                self.begin = k
            self._first_masks.append(self._first_masks[-1] + len(record["masks_shapes"]))
            pieces = record["pieces"]
            numbers.append(np.stack([np.full(len(pieces), k), np.arange(len(pieces))], 1))
            sizes.append(pieces["copies"] * pieces["faces"])
        self._numbers = np.concatenate(numbers)  # unit of each piece, and its number in the unit
        self.sizes: NDArray[np.int64] = np.concatenate(sizes)  # triangles of each piece
        self.description = _joined(scenes)
        self.description["objects"] = _objects_of(scenes, joined_runs(np.concatenate(runs)), self.survey.n_triangles)
        n_objects = _object_count(scenes)
        if n_objects > 1 and self.description["objects"] is None:
            note = f"{file}: its {n_objects:,} objects, or the ranges of their faces, are too many; all are one object"
            self.description["notes"] += (note,)
        self.bounds = self.survey.bounds()
        self.materials = UnitMaterials(files, records, count)

    @cached_property
    def masks(self) -> list[TexelMask]:
        """The masks of all units, one after the other."""
        return [mask for k in range(self._count) for mask in masks_in(masks_of_record(self._records(k)))]

    def pieces(self, first: int, last: int) -> Iterator[tuple[Piece, OpenFaces]]:
        """Yield the pieces from `first` to `last`, exclusive, with their faces that are not solid."""
        chosen = self._numbers[first:last]
        for k in np.unique(chosen[:, 0]).tolist():
            rows = chosen[chosen[:, 0] == k, 1]
            for piece, faces in staged_pieces(self._files(k), self._records(k), int(rows[0]), int(rows[-1]) + 1):
                yield piece, faces.with_masks_from(self._first_masks[k])

    def looks(self, first: int, last: int) -> Iterator[FaceLooks]:
        """Yield the looks of the pieces from `first` to `last`, exclusive, which index `materials`."""
        chosen = self._numbers[first:last]
        for k in np.unique(chosen[:, 0]).tolist():
            rows = chosen[chosen[:, 0] == k, 1]
            for looks in staged_looks(self._files(k), self._records(k), int(rows[0]), int(rows[-1]) + 1):
                yield looks.numbered(self.materials.numbers[k])


def _object_count(scenes: Sequence[StoreMeta]) -> int:
    return sum(len(each.objects.names) for each in scenes if each.objects is not None)


def _objects_of(scenes: Sequence[StoreMeta], runs: NDArray[np.int64], n_triangles: int) -> StoredObjects | None:
    """The objects of all scenes; None if there is one that has only the scene's name, or too many.

    runs : (r, 2), of their faces, as from `joined_runs`
    """
    each = [scene.objects for scene in scenes if scene.objects is not None]
    names, types, parents = ([text for texts in of for text in texts] for of in zip(*(one[:3] for one in each)))
    surfaces = any(one.had_surfaces for one in each)
    plain = names == [" + ".join(scene.name for scene in scenes)] and not (types[0] or parents[0] or surfaces)
    too_many = max(len(names), len(runs)) > MAX_RUNS or (len(names) > 1 and n_triangles > MAX_TRIANGLES)
    known = int(runs[:, 0].sum()) == n_triangles and runs[:, 1].max(initial=-1) < len(names)
    if plain or too_many or not known:
        return None
    faces, of = runs.T.tolist()
    return StoredObjects(names, types, parents, faces, of, surfaces)


def _joined(scenes: Sequence[StoreMeta]) -> Description:
    """The description of scenes that are merged."""
    if not scenes:
        raise InputError("no scenes; give at least one")
    names = ", ".join(scene.name for scene in scenes)
    if len({scene.up for scene in scenes}) > 1:
        raise InputError(f"{names}: some have +Y up and some +Z; give them the same up axis")
    systems = {scene.crs for scene in scenes if scene.crs is not None}
    if len(systems) > 1:
        raise InputError(f"{names}: have the CRS {', '.join(sorted(systems))}; reproject them to one")
    units = {unit_of_crs(scene.crs, scene.unit) for scene in scenes}
    if len(units) > 1:
        symbols = ", ".join(sorted(unit.name for unit in units))
        raise InputError(f"{names}: have coordinates in {symbols}; scale them to one unit")
    given = {scene.unit for scene in scenes if scene.unit is not None}
    rasters = {scene.raster for scene in scenes if scene.raster is not None}
    return Description(
        name=" + ".join(scene.name for scene in scenes), up=scenes[0].up, crs=systems.pop() if systems else None,
        unit=given.pop() if given else None, raster=rasters.pop() if len(rasters) == 1 else None,
        heights=scenes[0].heights if len(scenes) == 1 else None, objects=None,
        cameras=[camera for scene in scenes for camera in scene.cameras],
        lights=[light for scene in scenes for light in scene.lights],
        notes=tuple(note for scene in scenes for note in scene.notes),
    )  # fmt: skip
