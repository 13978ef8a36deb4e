"""`antumbra.bake`: bake visibility or light into the textures or vertex attributes of a glTF file.

PNG and EXR images, base colours under baked light, and the report.
"""

import io
import struct
import zlib
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ...checks import choice
from ...engine.scene_loading import SceneLike
from ...files import atomic_output
from ...formats.gltf.accessors import Accessors
from ...formats.gltf.gltf_file import data_uri_bytes, is_data_uri
from ...picture.image_files import linear_to_srgb, write_exr
from ...progress import Progress, with_progress
from ...scene.lights import Light
from ...scene.materials import BYTE_TO_LINEAR
from ..executors import Executor, executor_of
from .bake_input import (
    BakeOptions,
    BakeScene,
    BakeSource,
    bake_source,
    check_options,
    check_output,
    exposure_of,
    open_source,
    own_lights,
)
from .baked_values import Solids, Texels, image_of, replace_hidden, sample_bilinear, seam_differences, vertex_receivers
from .gltf_asset import Asset
from .gltf_primitives import (
    NodePrimitive,
    Remapper,
    accessors_of,
    all_rows,
    change_materials,
    make_unlit,
    own_primitives,
    to_local,
    write_colours,
)
from .surface_meter import Measurement, Meter, curve_blocks
from .texture_atlas import Sheet, atlas, corners_of, uv_set_sheets

# --- The report of a bake ---------------------------------------------------------------------------------------------


class Baked(NamedTuple):
    """The report of `antumbra.bake`."""

    path: Path  # the file written
    images: list[Path]  # EXR files beside it
    what: str  # the quantity
    attribute: str | None  # of the vertices; None for a texture
    parts: int  # primitives at nodes
    receivers: int  # vertices or texels measured
    hidden: int  # of them inside solids
    rays: int  # shadow rays traced
    mean: float  # of all measured values; NaN of hidden texels left out
    exposure: float  # factor on light in colours and textures, which hold 0 to 1; not in own attributes and EXR
    seam: float | None  # 99th percentile of the difference of two sides of a seam; None: no texture, or no seams
    seconds: dict[str, float]  # of each phase: read, unwrap, trace, write


class PhaseClock:
    """Adds up the seconds of phases that follow one another."""

    def __init__(self):
        self._last, self.seconds = perf_counter(), {}

    def lap(self, name: str) -> None:
        """The phase `name` ends now."""
        now = perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._last
        self._last = now


# --- Image files of a bake: PNG with 8 or 16 bits a channel, and EXR --------------------------------------------------


_COLOUR_TYPES = {1: 0, 3: 2, 4: 6}  # of PNG: grey, RGB, RGBA


def encode_pixels(image: np.ndarray, bits: int, srgb: bool) -> np.ndarray:
    """An image (h, w, c) float in [0, 1] as uint8 or uint16; `srgb`: its first three channels are linear light."""
    image = np.clip(image, 0.0, 1.0).astype(np.float64)
    if srgb:
        image[..., :3] = linear_to_srgb(image[..., :3])
    top = (1 << bits) - 1
    return np.round(top * image).astype(np.uint8 if bits == 8 else np.uint16)


def png_file(image: np.ndarray) -> bytes:
    """The PNG file of an image (h, w, 1, 3 or 4) uint8 or uint16. Pillow writes no RGB of 16 bits."""
    h, w, channels = image.shape
    rows = image.astype(image.dtype.newbyteorder(">")).reshape(h, -1).view(np.uint8)
    up = np.diff(rows, axis=0, prepend=np.zeros((1, rows.shape[1]), np.uint8))  # filter 2: less the row above
    data = np.concatenate([np.full((h, 1), 2, np.uint8), up], 1).tobytes()
    head = struct.pack(">IIBBBBB", w, h, 8 * image.itemsize, _COLOUR_TYPES[channels], 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(data, 6)), (b"IEND", b"")]
    body = b"".join(struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks)
    return b"\x89PNG\r\n\x1a\n" + body


def save_float_exr(image: np.ndarray, path: Path) -> None:
    """Write an image (h, w, 1 or 3) to an EXR file of float32: channel Y, or R, G, B."""
    image = np.ascontiguousarray(image, np.float32)
    channels = {"Y": np.ascontiguousarray(image[..., 0])} if image.shape[-1] == 1 else {"RGB": image}
    write_exr(channels, path, None)


# --- The base colour textures of materials, at the texels of a sheet --------------------------------------------------


_TRANSFORM = "KHR_texture_transform"


def base_texels(asset: Asset, accessors: Accessors, sheet: Sheet, primitives: Sequence[dict]) -> np.ndarray:
    """(n, 4) float32: linear base colour and alpha of the texels of the cover, without the materials' factors.

    primitives : JSON of each member of the sheet, as it was in the file
    """
    cover, out, start = sheet.cover, np.ones((len(sheet.cover.texel), 4), np.float32), 0
    images: dict[int, np.ndarray | None] = {}
    for one, primitive in zip(sheet.unwrapped, primitives):
        here = (cover.face >= start) & (cover.face < start + len(one.faces))
        start += len(one.faces)
        used = _base_texture(asset, primitive)
        if used is None or not here.any():
            continue
        source = asset.json["textures"][used["index"]].get("source")
        if source not in images:
            images[source] = None if source is None else _decode_image(asset, asset.json["images"][source])
        name = f"TEXCOORD_{used.get('extensions', {}).get(_TRANSFORM, {}).get('texCoord', used.get('texCoord', 0))}"
        image = images[source]
        if image is None or name not in primitive["attributes"]:
            continue
        uv = accessors.finite(primitive["attributes"][name], "VEC2")[one.part.rows]
        corners = corners_of([one], [uv])[cover.face[here] - (start - len(one.faces))]
        points = np.einsum("nk,nki->ni", cover.weights[here], corners)
        out[here] = _sample_repeated(image, _transform_uv(points, used))
    return out


def _base_texture(asset: Asset, primitive: dict) -> dict | None:
    if "material" not in primitive:
        return None
    material = asset.json["materials"][primitive["material"]]
    return material.get("pbrMetallicRoughness", {}).get("baseColorTexture")


def _decode_image(asset: Asset, image: dict) -> np.ndarray | None:
    """(h, w, 4) float32, linear; None if the image cannot be read."""
    from PIL import Image

    try:
        if "bufferView" in image:
            view = asset.json["bufferViews"][image["bufferView"]]
            start = view.get("byteOffset", 0)
            data = bytes(asset.binary[start : start + view["byteLength"]])
        elif is_data_uri(image.get("uri", "")):
            data = data_uri_bytes(image["uri"], "image")
        else:
            return None
        rgba = np.asarray(Image.open(io.BytesIO(data)).convert("RGBA"))
    except (OSError, ValueError):
        return None
    return np.concatenate([BYTE_TO_LINEAR[rgba[..., :3]], rgba[..., 3:] / 255.0], -1).astype(np.float32)


def _transform_uv(uv: np.ndarray, used: dict) -> np.ndarray:
    """Texture coordinates under KHR_texture_transform."""
    transform = used.get("extensions", {}).get(_TRANSFORM, {})
    angle, scale, offset = (
        transform.get("rotation", 0.0),
        transform.get("scale", (1, 1)),
        transform.get("offset", (0, 0)),
    )
    x, y = uv[:, 0] * scale[0], uv[:, 1] * scale[1]
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * x + s * y + offset[0], -s * x + c * y + offset[1]], 1)


def _sample_repeated(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(n, 4): bilinear, with the image repeated beyond its edges, as most textures are."""
    ring = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="wrap")
    h, w = image.shape[:2]
    inside = uv - np.floor(uv)
    return sample_bilinear(ring, (inside * (w, h) + 1.0) / (w + 2, h + 2))


# --- A bake into textures ---------------------------------------------------------------------------------------------


def bake_textures(
    source: BakeScene, options: BakeOptions, output: Path, clock: PhaseClock, engine: Executor
) -> Baked | None:
    """Measure the texels of all sheets, and write the files; None if the engine leaves texels to others."""
    scene, asset, parts = source
    accessors, size = accessors_of(asset, scene.name), options.texture
    assert size is not None
    sheets = atlas(parts, size) if options.uv is None else uv_set_sheets(parts, accessors, options.uv, size)
    clock.lap("unwrap")
    meter = Meter(scene, options.settings, sum(len(sheet.cover.texel) for sheet in sheets))
    texels = [Texels(sheet, meter, options.denoise, engine.folder) for sheet in sheets]
    job = [each.parts for each in texels]
    if not engine.finish(job):
        return None
    solids = None if options.keep_hidden else Solids(scene, options.settings.time, options.settings.threads)
    measured = [each.values(solids) for each in texels]
    if options.settings.what == "bent-normal":
        measured = [(_local_texels(sheet, values), hidden) for sheet, (values, hidden) in zip(sheets, measured)]
    clock.lap("trace")
    everything = np.concatenate([values for values, _ in measured])
    exposure = exposure_of(everything, options)
    originals = [dict(part.json, attributes=dict(part.json["attributes"])) for part in parts]
    primitives, images, seams = own_primitives(asset, parts), [], []
    remapper = Remapper(asset, accessors)
    for i, (sheet, (values, _)) in enumerate(zip(sheets, measured)):
        image = image_of(sheet.cover, values)
        images.append((_exr_path(output, i, len(sheets)), image))
        seams.append(seam_differences(sheet, image))
        texture_image = _material_image(
            asset, accessors, sheet, values * exposure, [originals[k] for k in sheet.members], options
        )
        is_light = options.settings.what in ("shadow", "sun", "light")
        texture = asset.texture(png_file(encode_pixels(texture_image, options.bits, is_light)),
                                options.settings.what)  # fmt: skip
        sheet_primitives = [primitives[k] for k in sheet.members]
        sets = [
            _uv_set(one, primitive, remapper, asset, options.uv)
            for one, primitive in zip(sheet.unwrapped, sheet_primitives)
        ]
        change_materials(asset, sheet_primitives, sets, partial(_set_texture, asset, texture, options))
    images = images if options.exr else []
    with ExitStack() as files:  # all of them, or none
        for path, image in images:
            save_float_exr(image, files.enter_context(atomic_output(path)))
        files.enter_context(atomic_output(output)).write_bytes(asset.glb())
    engine.end(job)
    clock.lap("write")
    seam = np.concatenate(seams)
    return Baked(
        output,
        [path for path, _ in images],
        options.settings.what,
        None,
        len(parts),
        len(everything),
        sum(hidden for _, hidden in measured),
        meter.rays,
        float(np.nanmean(everything)),
        exposure,
        float(np.percentile(seam, 99)) if len(seam) else None,
        clock.seconds,
    )


def _uv_set(one, primitive: dict, remapper: Remapper, asset: Asset, uv_set: int | None) -> int:
    """The UV set of a texture in a primitive. That of an atlas is new."""
    if uv_set is not None:
        return uv_set
    number = sum(name.startswith("TEXCOORD_") for name in primitive["attributes"])
    remapper.remap(primitive, one.part.rows[one.source], one.faces)
    primitive["attributes"][f"TEXCOORD_{number}"] = asset.accessor(one.uv.astype("<f4"))
    return number


def _material_image(
    asset: Asset, accessors, sheet: Sheet, values: np.ndarray, originals: list[dict], options: BakeOptions
):
    """The image that the material shows, (size, size, c) float32: ambient occlusion, or light times the base colour."""
    what = options.settings.what
    if what == "ao":
        return image_of(sheet.cover, values)
    if what == "bent-normal":
        return 0.5 + 0.5 * image_of(sheet.cover, values)
    base = base_texels(asset, accessors, sheet, originals)
    base[:, :3] *= np.clip(values, 0.0, 1.0)
    image = image_of(sheet.cover, np.where(np.isnan(values[:, :1]), np.nan, base))
    return image[..., :3] if (base[:, 3] == 1.0).all() else image


def _set_texture(asset: Asset, texture: int, options: BakeOptions, material: dict, uv_set: int) -> None:
    """Put a baked texture into a material."""
    used = {"index": texture, "texCoord": uv_set}
    if options.settings.what == "ao":
        material["occlusionTexture"] = used
    elif options.settings.what == "bent-normal":
        material.setdefault("extras", {})["bentNormalTexture"] = used
    else:
        material.setdefault("pbrMetallicRoughness", {})["baseColorTexture"] = used
        make_unlit(asset, material)


def _local_texels(sheet: Sheet, values: np.ndarray) -> np.ndarray:
    out, start = values.copy(), 0
    for one in sheet.unwrapped:
        here = (sheet.cover.face >= start) & (sheet.cover.face < start + len(one.faces))
        out[here] = to_local(values[here], one.part)
        start += len(one.faces)
    return out


def _exr_path(output: Path, number: int, of: int) -> Path:
    return output.with_name(f"{output.stem}{f'-{number}' if of > 1 else ''}.exr")


# --- A bake into attributes of vertices -------------------------------------------------------------------------------


def bake_vertices(
    source: BakeScene, options: BakeOptions, output: Path, clock: PhaseClock, engine: Executor
) -> Baked | None:
    """Measure the vertices of all parts, and write the file; None if the engine leaves vertices to others."""
    scene, asset, parts = source
    meter = Meter(scene, options.settings, sum(len(p.positions) for p in parts))
    receivers = vertex_receivers(parts)
    measured = Measurement(meter, receivers, curve_blocks(receivers.positions), False, engine.folder)
    if not engine.finish([measured.parts]):
        return None
    solids = None if options.keep_hidden else Solids(scene, options.settings.time, options.settings.threads)
    values = measured.result()
    hidden = replace_hidden(values, receivers, parts, meter, solids)
    clock.lap("trace")
    exposure = exposure_of(values, options)
    accessors, primitives = accessors_of(asset, scene.name), own_primitives(asset, parts)
    for part, primitive, part_values in zip(parts, primitives, _split(values, parts)):
        if options.settings.what == "bent-normal":
            part_values = to_local(part_values, part)
        if options.attribute == "COLOR_0":
            colours = 0.5 + 0.5 * part_values if options.settings.what == "bent-normal" else part_values * exposure
            write_colours(asset, accessors, primitive, all_rows(part, colours), options.multiply)
        else:
            rows = all_rows(part, part_values)
            primitive["attributes"][options.attribute] = asset.accessor(rows[:, 0] if rows.shape[1] == 1 else rows)
    if options.attribute == "COLOR_0" and options.settings.what in ("shadow", "sun", "light"):
        change_materials(asset, primitives, [None] * len(primitives), lambda material, _: make_unlit(asset, material))
    with atomic_output(output) as file:
        file.write_bytes(asset.glb())
    engine.end([measured.parts])
    clock.lap("write")
    return Baked(output, [], options.settings.what, options.attribute, len(parts), len(values), hidden, meter.rays,
                 float(values.mean()), exposure, None, clock.seconds)  # fmt: skip


def _split(values: np.ndarray, parts: list[NodePrimitive]) -> list[np.ndarray]:
    return np.split(values, np.cumsum([len(p.positions) for p in parts])[:-1])


# --- `antumbra.bake`: what surfaces receive, written into a glTF file -------------------------------------------------


@with_progress
def bake(
    scene: SceneLike, output, what: str = "ao", *, lights: Sequence[Light] | Light | None = None,
    radius: float | None = None, spp: int = 256, attribute: str | None = None, multiply: bool = False,
    texture: int | None = None, uv: int | None = None, bits: int = 8, exr: bool = False, denoise: bool = False,
    exposure: float | None = None, keep_hidden: bool = False, time: float = 0.0, up: str | None = None,
    plan: str | None = None,
    sampler: str = "hammersley", threads: int | None = None, keep=None, progress: Progress = None,
) -> Baked:  # fmt: skip
    """Measure what the surfaces of a scene receive, and write it into a copy of its glTF file.

    Everything else in the file stays: nodes, instances, materials, textures, animations. New data follow the old ones
    in the buffer. Any other scene is written as a glTF file first.

    Parameters
    ----------
    scene : path, Scene, or a mesh as `load` takes it
        Pass the path of a glTF file to keep the file's contents. Of any other scene, triangles and base colours are
        written.
    output : str or path-like
        A .glb file.
    what : {"ao", "shadow", "sun", "light", "bent-normal"}
        ``ao``: the share of the sky that is open, weighted by the cosine, in [0, 1]. ``shadow``: the mean share of the
        lights that is visible. ``sun``: the irradiance of one sun over its intensity. ``light``: the irradiance of all
        lights in lux, linear RGB. ``bent-normal``: the mean open direction.
    lights : lights, optional
        For shadow, sun and light, in the scene's own coordinates, whichever axis points up. None:
        `Scene.default_lights`. `AmbientOcclusion` among the lights of ``light`` is a sky.
    radius : float, optional
        For ao and bent-normal: blockers farther away do not count, in world units. None: all count.
    spp : int
        Rays of each receiver and light, 1 to 1024.
    attribute : str, optional
        Of vertices: ``COLOR_0``, or a name that begins with an underscore. None: ``COLOR_0``; ``_BENT_NORMAL`` of bent
        normals.
    multiply : bool
        Multiply an existing ``COLOR_0`` instead of replacing it.
    texture : int, optional
        Side of a square texture in texels, 16 to 16384, instead of values at vertices.
    uv : int, optional
        The UV set of the file that the texture uses. None: a new atlas (needs ``antumbra[bake]``).
    bits : {8, 16}
        Bits of a channel of the texture.
    exr : bool
        Write the texture as float32 beside `output` too.
    denoise : bool
        Filter a texture of ao or shadow over 4 x 4 texels, within penumbrae and surfaces.
    exposure : float, optional
        Factor on light before it is cut off at 1. None: automatic for ``light``, else 1.
    keep_hidden : bool
        Keep the values of points inside solids. Otherwise visible points nearby replace them.
    time : float
        Seconds into the animation.
    up : {"y", "z"}, optional
        The axis that points up in a file, as for `load`. Default lights follow it. The glTF file that is made of
        another scene is turned so that +Y points up; a glTF file stays as it is.
    plan, sampler, threads
        As in `render`. On a hemisphere ``hammersley`` has half the error of the default of pictures.
    keep : str, path-like or engine, optional
        Folder in which an interrupted bake keeps its finished parts; or who does them, see `antumbra.jobs.executors`.
    progress : function of (text, done, total), or bool, optional
        Called while the job works. False: nothing is shown. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    Baked
        None if the engine leaves parts to others.

    Raises
    ------
    InputError
        If an argument is wrong, or the scene cannot be read or written. No file is left behind.
    """
    output, engine = check_output(output), executor_of(keep)
    choice(up, "up", (None, "y", "z"))
    options = check_options(
        what, lights=lights, radius=radius, spp=spp, attribute=attribute, multiply=multiply, texture=texture, uv=uv,
        bits=bits, exr=exr, denoise=denoise, exposure=exposure, keep_hidden=keep_hidden, time=time, plan=plan,
        sampler=sampler, threads=threads,
    )  # fmt: skip
    clock = PhaseClock()
    source = open_source(scene if isinstance(scene, BakeSource) else bake_source(scene, up), time)
    if not options.settings.lights:
        default_lights = own_lights(source.scene, what, time)
        options = options._replace(settings=options.settings._replace(lights=default_lights))
    clock.lap("read")
    job = bake_textures if options.texture else bake_vertices
    report = job(source, options, output, clock, engine)
    return report  # type: ignore[return-value]  # None: a shard, of a command
