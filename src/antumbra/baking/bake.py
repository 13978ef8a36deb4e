"""`antumbra.bake`: bake visibility or light into the textures or vertex attributes of a glTF file.

A bake into textures also needs PNG and EXR images. `Baked` is the report.
"""

import warnings
from contextlib import ExitStack
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import NDArray

from ..base import wings
from ..base.checks import choice
from ..base.files import atomic_output, checked_output
from ..base.option_fields import Given, with_keywords
from ..base.progress import PhaseClock, Progress, with_progress
from ..base.wording import counted
from ..engine.scene import Scene
from ..engine.scene_loading import SceneLike
from ..formats.format_registry import GLB
from ..formats.gltf.gltf_asset import Asset
from ..formats.gltf.gltf_writer import Json
from ..picture.png_files import SMALL, png_file
from ..work.executors import Executor, Keep, executor_of, traced_share
from ..work.result_summary import Summary, duration, speed_text
from .bake_input import BakeScene, BakeSource, bake_source, exposure_of, meter_settings, open_source
from .bake_options import BakeKeywords, BakeOptions
from .baked_textures import (
    clipping_note,
    encode_pixels,
    image_path,
    material_image,
    save_float_exr,
    set_texture,
)
from .baked_values import Texels, faces_of, image_of, replace_hidden, sheet_notes, vertex_receivers
from .base_colours import BaseColours
from .gltf_primitives import (
    NodePrimitive,
    Remapper,
    accessors_of,
    all_rows,
    change_materials,
    to_local,
    unshared_primitives,
    write_colours,
)
from .seams import seam_differences, seam_of, seam_words
from .solids import Solids
from .surface_meter import Measurement, Meter, curve_blocks
from .texture_atlas import AtlasSheet, Unwrapped, atlas, uv_set_sheets

_P = ParamSpec("_P")

# --- Report -----------------------------------------------------------------------------------------------------------


class BakedVertices(NamedTuple):
    """The values of a bake at the corners of the faces of its scene."""

    scene: Scene
    values: np.ndarray  # (v, c) float32: of all parts, as measured
    corners: np.ndarray  # (n, 3) int64: rows of `values`, of the faces of the scene; -1: the file lacks the face


class Baked(NamedTuple):
    """The report of `antumbra.bake`."""

    path: Path  # the file written
    images: list[Path]  # EXR files beside it
    what: str  # the quantity
    attribute: str | None  # vertex attribute; None for a texture
    parts: int  # primitives at nodes
    receivers: int  # vertices or texels measured
    hidden: int  # receivers inside solids
    rays: int  # shadow rays traced
    traced: int  # those of them that are not of parts found finished, as in a merge
    mean: float  # mean of all measured values, without those of hidden texels
    exposure: float  # factor on light in colours and textures, which range from 0 to 1; not in custom attributes or EXR
    seam: float | None  # 99th percentile of the difference across seams, over the mean; None: no texture, or no seams
    seconds: dict[str, float]  # per phase: read, unwrap, trace, write
    notes: tuple[str, ...] = ()  # what the file loses, and how to keep it
    vertices: BakedVertices | None = None  # what a page shows; None for a texture

    def summary(self) -> Summary:
        """What was baked, and the time of each phase."""
        where = "texels" if self.attribute is None else f"vertices ({self.attribute})"
        hidden = f", {self.hidden:,} inside solids" if self.hidden else ""
        mean, trace = f"{self.mean:.3f} on average{hidden}", max(self.seconds["trace"], 1e-9)
        lines = [("file", str(self.path)), *(("image", str(path)) for path in self.images)]
        lines.append((self.what, f"{self.receivers:,} {where} in {counted(self.parts, 'part')}, {mean}"))
        lines += [("exposure", f"{self.exposure:.4g}")] if self.exposure != 1.0 else []
        lines += [] if self.seam is None else [("seams", seam_words(self.seam))]
        lines.append(("rays", f"{self.rays:,}{speed_text(self.traced, trace)}"))
        lines.append(("time", ", ".join(f"{name} {duration(s)}" for name, s in self.seconds.items())))
        return Summary({name: each for name, each in self._asdict().items() if name != "vertices"}, lines)

    def page(self, path: str | PathLike[str] | None = None, **options: Any) -> Any:
        """Make a page of the scene, which any browser opens offline, with the values at vertices in colours.

        Of light and of bent normals, it shows the luminance and the height.

        Parameters
        ----------
        path : str or path-like, optional
            An .html file. None: the page is only returned, for a notebook.
        **options
            As in `antumbra.Scene.page`.

        Returns
        -------
        Page

        Raises
        ------
        InputError
            As `antumbra.Scene.page` does; or if a texture was baked.
        """
        return wings.named(wings.BAKED_PAGE)(self, path, options)


# --- Baking into textures ---------------------------------------------------------------------------------------------


def bake_textures(
    source: BakeScene, options: BakeOptions, output: Path, clock: PhaseClock, executor: Executor
) -> Baked | None:
    """Measure the texels of all sheets and write the files; None if the executor leaves texels to other shards."""
    scene, asset, parts, double_sided, emission, _, notes, _ = source
    accessors, size = accessors_of(asset, scene.name), options.texture
    assert size is not None
    sheets = atlas(parts, size) if options.uv is None else uv_set_sheets(parts, accessors, options.uv, size)
    clock.lap("unwrap")
    settings, count = meter_settings(options, scene), sum(len(sheet.cover.texel) for sheet in sheets)
    meter = Meter(scene, settings, count, emission)
    texels = [Texels(sheet, meter, options.denoise, executor.folder) for sheet in sheets]
    job = [each.parts for each in texels]
    if not executor.finish(job):
        return None
    solids = None if options.keep_hidden else Solids(scene, double_sided, options.time, options.threads)
    measured = [each.values(solids) for each in texels]
    if options.what == "bent-normal":
        measured = [(_local_texels(sheet, values), hidden) for sheet, (values, hidden) in zip(sheets, measured)]
    clock.lap("trace")
    all_values, hidden = (np.concatenate(arrays) for arrays in zip(*measured))
    seen = all_values if hidden.all() else all_values[~hidden]
    exposure = exposure_of(seen, options)
    originals = [dict(part.json, attributes=dict(part.json["attributes"])) for part in parts]
    primitives, seams = unshared_primitives(asset, parts), list[NDArray[np.float64]]()
    pngs, exrs = dict[Path, bytes](), dict[Path, NDArray[np.float32]]()
    remapper, base = Remapper(asset, accessors), BaseColours(asset, accessors)
    for i, (sheet, (values, _)) in enumerate(zip(sheets, measured)):
        image = image_of(sheet.cover, values)
        seams.append(seam_differences(sheet, image))
        exrs[image_path(output, i, len(sheets), ".exr")] = image
        texture_image = material_image(base, sheet, values * exposure, [originals[k] for k in sheet.members], options)
        pixels = encode_pixels(texture_image, options.bit_depth, options.unlit, dither=options.makes_lightmap)
        png = png_file(pixels, is_srgb=False, level=SMALL)  # glTF says which textures are sRGB
        pngs[image_path(output, i, len(sheets), ".png")] = png
        texture = asset.texture(png, "lightmap" if options.makes_lightmap else options.what)
        sheet_primitives = [primitives[k] for k in sheet.members]
        sets = [
            _uv_set(one, primitive, remapper, asset, options.uv)
            for one, primitive in zip(sheet.unwrapped, sheet_primitives)
        ]
        change_materials(asset, sheet_primitives, sets, partial(set_texture, asset, texture, exposure, options))
    pngs, exrs = pngs if options.png else {}, exrs if options.exr else {}
    with ExitStack() as files:  # write all of them, or none
        for path, png in pngs.items():
            files.enter_context(atomic_output(path)).write_bytes(png)
        for path, image in exrs.items():
            save_float_exr(image, files.enter_context(atomic_output(path)))
        files.enter_context(atomic_output(output)).write_bytes(asset.glb())
    executor.end(job)
    clock.lap("write")
    notes = [*notes, *sheet_notes(sheets, options.uv), *base.notes(size)]
    if options.makes_lightmap:
        notes += clipping_note(seen, exposure)
    return Baked(
        path=output,
        images=[*pngs, *exrs],
        what=options.what,
        attribute=None,
        parts=len(parts),
        receivers=len(all_values),
        hidden=int(hidden.sum()),
        rays=meter.rays,
        traced=round(traced_share(executor) * meter.rays),
        mean=float(seen.mean()),
        exposure=exposure,
        seam=seam_of(np.concatenate(seams), 1.0 if options.what == "bent-normal" else float(seen.mean())),
        seconds=clock.seconds,
        notes=tuple(notes),
    )


def _uv_set(one: Unwrapped, primitive: Json, remapper: Remapper, asset: Asset, uv_set: int | None) -> int:
    """The UV set of the texture in a primitive; for an atlas, a new one is added."""
    if uv_set is not None:
        return uv_set
    number = int(sum(name.startswith("TEXCOORD_") for name in primitive["attributes"]))
    remapper.remap(primitive, one.part.rows[one.source], one.faces)
    primitive["attributes"][f"TEXCOORD_{number}"] = asset.accessor(one.uv.astype("<f4"))
    return number


def _local_texels(sheet: AtlasSheet, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """World directions of texels in the frames of their parts."""
    out, start = values.copy(), 0
    for one in sheet.unwrapped:
        inside = (sheet.cover.face >= start) & (sheet.cover.face < start + len(one.faces))
        out[inside] = to_local(values[inside], one.part)
        start += len(one.faces)
    return out


# --- Baking into vertex attributes ------------------------------------------------------------------------------------


def bake_vertices(
    source: BakeScene, options: BakeOptions, output: Path, clock: PhaseClock, executor: Executor
) -> Baked | None:
    """Measure the vertices of all parts and write the file; None if the executor leaves vertices to other shards."""
    scene, asset, parts, double_sided, emission, is_new, notes, faces = source
    meter = Meter(scene, meter_settings(options, scene), sum(len(p.positions) for p in parts), emission)
    receivers = vertex_receivers(parts)
    measurement = Measurement(meter, receivers, curve_blocks(receivers.positions), False, executor.folder)
    if not executor.finish([measurement.parts]):
        return None
    solids = None if options.keep_hidden else Solids(scene, double_sided, options.time, options.threads)
    values = measurement.result()
    hidden = replace_hidden(values, receivers, parts, meter, solids)
    clock.lap("trace")
    exposure = exposure_of(values, options)
    name, accessors = options.vertex_attribute, accessors_of(asset, scene.name)
    multiply, replaced = options.multiply or is_new, sum(name in part.json["attributes"] for part in parts)
    if replaced and not multiply:
        cure = "multiply keeps it" if name == "COLOR_0" else "choose another attribute to keep it"
        notes = [*notes, f"{scene.name}: {name} of {counted(replaced, 'part')} is replaced; {cure}"]
    primitives = unshared_primitives(asset, parts)
    for part, primitive, part_values in zip(parts, primitives, _split(values, parts)):
        if options.what == "bent-normal":
            part_values = to_local(part_values, part)
        if name == "COLOR_0":
            colours = 0.5 + 0.5 * part_values if options.what == "bent-normal" else part_values * exposure
            write_colours(asset, accessors, primitive, all_rows(part, colours), multiply)
        else:
            rows = all_rows(part, part_values)
            primitive["attributes"][name] = asset.accessor(rows[:, 0] if rows.shape[1] == 1 else rows)
    if name == "COLOR_0" and options.is_light:
        change_materials(asset, primitives, [None] * len(primitives), lambda material, _: asset.make_unlit(material))
    with atomic_output(output) as file:
        file.write_bytes(asset.glb())
    executor.end([measurement.parts])
    clock.lap("write")
    return Baked(
        path=output,
        images=[],
        what=options.what,
        attribute=name,
        parts=len(parts),
        receivers=len(values),
        hidden=hidden,
        rays=meter.rays,
        traced=round(traced_share(executor) * meter.rays),
        mean=float(values.mean()),
        exposure=exposure,
        seam=None,
        seconds=clock.seconds,
        notes=tuple(notes),
        vertices=BakedVertices(scene, values, _in_order(faces_of(parts).faces, faces, scene.n_triangles)),
    )


def _in_order(corners: NDArray[np.int64], faces: NDArray[np.integer] | None, n_triangles: int) -> NDArray[np.int64]:
    """The corners of the faces of a scene, from those of a file; faces without area are in no file of a store.

    faces : the face of the scene that each face of the file is; None: they are in order
    """
    if faces is None:
        return corners
    out = np.full((n_triangles, 3), -1, np.int64)
    out[faces] = corners
    return out


def _split(values: np.ndarray, parts: list[NodePrimitive]) -> list[np.ndarray]:
    return np.split(values, np.cumsum([len(p.positions) for p in parts])[:-1])


# --- `antumbra.bake` --------------------------------------------------------------------------------------------------


@with_keywords(BakeKeywords, 3)
@with_progress
def bake(
    given: Given[_P], scene: SceneLike, output: str | PathLike[str], what: str = "ao", up: str | None = None,
    keep: Keep = None, progress: Progress = None, *args: _P.args, **keywords: _P.kwargs,
) -> Baked:  # fmt: skip
    """Measure visibility or light on the surfaces of a scene, and write it into a copy of its glTF file.

    Everything else in the file is preserved: nodes, instances, materials, textures, animations. New data are appended
    to the buffer. Any other scene is first converted to glTF.

    Parameters
    ----------
    scene : path, Scene, or a mesh that `load` accepts
        Pass the path of a glTF file to preserve the file's contents. For any other scene, triangles and base colours
        are written.
    output : str or path-like
        A .glb file.
    what : {"ao", "shadow", "sun", "light", "bent-normal"}
        ``ao``: the cosine-weighted visible share of the sky, in [0, 1]. ``shadow``: the mean visible share of the
        lights. ``sun``: the irradiance of one sun over its intensity. ``light``: the irradiance of all lights in lux,
        linear RGB. ``bent-normal``: the mean unoccluded direction.
    up : {"y", "z"}, optional
        The axis that points up in a file, as for `load`. Default lights follow it. A glTF file created from another
        scene is rotated so that +Y points up; an existing glTF file is not.
    keep : str, path-like or executor, optional
        Folder for the finished parts of an interrupted bake, or an executor for the parts; see
        `antumbra.work.executors`.
    progress : function of (text, done, total), or bool, optional
        Called during the work. False: show nothing. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    Baked
        None if the executor leaves parts to other shards.

    Raises
    ------
    InputError
        If an argument is invalid, or the scene cannot be read or written. No file is left behind.

    Warns
    -----
    UserWarning
        Once for each of `Baked.notes`, such as textures that lose detail.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> room = at.procedural("atrium", triangles=5_000)
    >>> with TemporaryDirectory() as folder:
    ...     baked = at.bake(room, f"{folder}/room.glb", "ao", spp=16)
    >>> baked.what, baked.attribute
    ('ao', 'COLOR_0')
    """
    path, executor = checked_output(output, GLB.suffixes), executor_of(keep)
    choice(up, "up", (None, "y", "z"))
    options = BakeOptions(what=what, **given(*args, **keywords))
    clock = PhaseClock()
    report = bake_file(bake_source(scene, up), options, path, clock, executor)
    for note in () if report is None else report.notes:
        warnings.warn(note, UserWarning, stacklevel=4)
    return report  # type: ignore[return-value]  # None: a shard, of a command


def bake_file(
    source: BakeSource, options: BakeOptions, output: Path, clock: PhaseClock, executor: Executor
) -> Baked | None:
    """Bake into a file; None if the executor leaves parts to other shards."""
    scene = open_source(source, options.time, emits=options.what == "light")
    if not options.bounces and scene.emission is not None:
        scene.notes.append(f"{scene.scene.name}: its materials emit light, which bounces gathers, 1 or more")
    clock.lap("read")
    job = bake_textures if options.texture else bake_vertices
    return job(scene, options, output, clock, executor)
