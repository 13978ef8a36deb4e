"""`antumbra.bake`: what surfaces receive, written into a glTF file."""

import os
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ...checks import number, whole_number
from ...errors import InputError
from ...extras import needed
from ...image.tonemap import automatic_exposure
from ...loading import GLTF_SUFFIXES
from ...output import checked_output, replacing
from ...plan import DEFAULT_PLAN, parse_plan
from ...query.sampling import sample_sets
from ...scene.lights import DirectionalLight, Light, check_lights
from ...scene.scene import Scene
from .asset import Asset
from .base import base_texels
from .charts import Sheet, atlas, existing
from .edit import Remapper, all_rows, change_materials, make_unlit, own_primitives, write_colours
from .hidden import Solids
from .images import encoded, png_of, save_exr
from .measure import QUANTITIES, Asked, Meter, ambient
from .parts import Part, accessors_of, read_parts
from .sources import opened
from .textures import image_of, seam_differences, texel_values
from .vertices import vertex_values

MAX_TEXTURE = 16384
_OWN_NAMES = {"ao": "_AO", "shadow": "_SHADOW", "sun": "_SUN", "light": "_LIGHT", "bent-normal": "_BENT_NORMAL"}
_SKY = ("ao", "bent-normal")  # what asks the sky, and no lights


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


class Options(NamedTuple):
    """Checked arguments of `bake`."""

    asked: Asked
    attribute: str
    multiply: bool
    texture: int | None
    uv: int | None
    bits: int
    exr: bool
    denoise: bool
    exposure: float | None
    keep_hidden: bool
    up: str


def bake(
    scene, output, what: str = "ao", *, lights: Sequence[Light] | Light | None = None, radius: float | None = None,
    spp: int = 256, attribute: str | None = None, multiply: bool = False, texture: int | None = None,
    uv: int | None = None, bits: int = 8, exr: bool = False, denoise: bool = False, exposure: float | None = None,
    keep_hidden: bool = False, time: float = 0.0, up: str = "y", plan: str | None = None,
    sampler: str = "hammersley", threads: int | None = None,
) -> Baked:  # fmt: skip
    """Measure what the surfaces of a scene receive, and write it into a copy of its glTF file.

    Everything else in the file stays: nodes, instances, materials, textures, animations. New data follow the old ones
    in the buffer. Any other scene is written as a glTF file first.

    Parameters
    ----------
    scene : path, or Scene
        A `Scene` from `load` has its triangles and colours; pass the path of a glTF file to keep the file's contents.
    output : str or path-like
        A .glb file.
    what : {"ao", "shadow", "sun", "light", "bent-normal"}
        ``ao``: the share of the sky that is open, weighted by the cosine, in [0, 1]. ``shadow``: the mean share of the
        lights that is visible. ``sun``: the same of one sun, times the cosine. ``light``: the irradiance of all
        lights, linear RGB. ``bent-normal``: the mean open direction.
    lights : lights, optional
        For shadow, sun and light. None: the scene's own lights, or one above the scene. `AmbientOcclusion` among the
        lights of ``light`` is a sky.
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
    up : {"y", "z"}
        The axis that points up in a file that is not glTF.
    plan, sampler, threads
        As in `render`. On a hemisphere ``hammersley`` has half the error of the default of pictures.

    Returns
    -------
    Baked

    Raises
    ------
    InputError
        If an argument is wrong, or the scene cannot be read or written. No file is left behind.
    """
    output = check_output(output)
    options = check(
        what, lights=lights, radius=radius, spp=spp, attribute=attribute, multiply=multiply, texture=texture, uv=uv,
        bits=bits, exr=exr, denoise=denoise, exposure=exposure, keep_hidden=keep_hidden, time=time, up=up, plan=plan,
        sampler=sampler, threads=threads,
    )  # fmt: skip
    clock = _Clock()
    with opened(scene, time, up) as (found, asset):
        asked = options.asked if options.asked.lights else options.asked._replace(lights=_own_lights(found, what, time))
        options = options._replace(asked=asked)
        parts = read_parts(found, asset, time)
        clock.lap("read")
        job = _texture_bake if options.texture else _vertex_bake
        return job(found, asset, parts, options, output, clock)


class _Clock:
    def __init__(self):
        self._last, self.seconds = perf_counter(), {}

    def lap(self, name: str) -> None:
        now = perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._last
        self._last = now


def _vertex_bake(scene: Scene, asset: Asset, parts: list[Part], options: Options, output: Path, clock) -> Baked:
    meter = Meter(scene, options.asked, sum(len(p.positions) for p in parts))
    solids = None if options.keep_hidden else Solids(scene, options.asked.time, options.asked.threads)
    values, hidden = vertex_values(parts, meter, solids)
    clock.lap("trace")
    exposure = _exposure(values, options)
    accessors, primitives = accessors_of(asset, scene.name), own_primitives(asset, parts)
    for part, primitive, own in zip(parts, primitives, _split(values, parts)):
        if options.asked.what == "bent-normal":
            own = _local(own, part)
        if options.attribute == "COLOR_0":
            shown = 0.5 + 0.5 * own if options.asked.what == "bent-normal" else own * exposure
            write_colours(asset, accessors, primitive, all_rows(part, shown), options.multiply)
        else:
            rows = all_rows(part, own)
            primitive["attributes"][options.attribute] = asset.accessor(rows[:, 0] if rows.shape[1] == 1 else rows)
    if options.attribute == "COLOR_0" and options.asked.what in ("shadow", "sun", "light"):
        change_materials(asset, primitives, [None] * len(primitives), lambda material, _: make_unlit(asset, material))
    with replacing(output) as file:
        file.write_bytes(asset.glb())
    clock.lap("write")
    return Baked(output, [], options.asked.what, options.attribute, len(parts), len(values), hidden, meter.rays,
                 float(values.mean()), exposure, None, clock.seconds)  # fmt: skip


def _texture_bake(scene: Scene, asset: Asset, parts: list[Part], options: Options, output: Path, clock) -> Baked:
    accessors, size = accessors_of(asset, scene.name), options.texture
    sheets = atlas(parts, size) if options.uv is None else existing(parts, accessors, options.uv, size)
    clock.lap("unwrap")
    meter = Meter(scene, options.asked, sum(len(sheet.cover.texel) for sheet in sheets))
    solids = None if options.keep_hidden else Solids(scene, options.asked.time, options.asked.threads)
    measured = [texel_values(sheet, meter, solids, options.denoise) for sheet in sheets]
    if options.asked.what == "bent-normal":
        measured = [(_local_texels(sheet, values), hidden) for sheet, (values, hidden) in zip(sheets, measured)]
    clock.lap("trace")
    everything = np.concatenate([values for values, _ in measured])
    exposure = _exposure(everything, options)
    originals = [dict(part.json, attributes=dict(part.json["attributes"])) for part in parts]
    primitives, images, seams = own_primitives(asset, parts), [], []
    remapper = Remapper(asset, accessors)
    for number, (sheet, (values, _)) in enumerate(zip(sheets, measured)):
        image = image_of(sheet.cover, values)
        images.append((_beside(output, number, len(sheets)), image))
        seams.append(seam_differences(sheet, image))
        shown = _shown(asset, accessors, sheet, values * exposure, [originals[i] for i in sheet.members], options)
        texture = asset.texture(png_of(encoded(shown, options.bits, options.asked.what in ("shadow", "sun", "light"))),
                                options.asked.what)  # fmt: skip
        own = [primitives[i] for i in sheet.members]
        sets = [_uv_set(one, primitive, remapper, asset, options.uv) for one, primitive in zip(sheet.unwrapped, own)]
        change_materials(asset, own, sets, lambda material, uv: _give(asset, material, texture, uv, options))
    images = images if options.exr else []
    with ExitStack() as files:  # all of them, or none
        for path, image in images:
            save_exr(image, files.enter_context(replacing(path)))
        files.enter_context(replacing(output)).write_bytes(asset.glb())
    clock.lap("write")
    seam = np.concatenate(seams)
    return Baked(output, [path for path, _ in images], options.asked.what, None, len(parts), len(everything), sum(h for _, h in measured),
                 meter.rays, float(np.nanmean(everything)), exposure, float(np.percentile(seam, 99)) if len(seam) else None,
                 clock.seconds)  # fmt: skip


def _uv_set(one, primitive: dict, remapper: Remapper, asset: Asset, uv_set: int | None) -> int:
    """The UV set of a texture in a primitive. That of an atlas is new."""
    if uv_set is not None:
        return uv_set
    number = sum(name.startswith("TEXCOORD_") for name in primitive["attributes"])
    remapper.remap(primitive, one.part.rows[one.source], one.faces)
    primitive["attributes"][f"TEXCOORD_{number}"] = asset.accessor(one.uv.astype("<f4"))
    return number


def _shown(asset: Asset, accessors, sheet: Sheet, values: np.ndarray, originals: list[dict], options: Options):
    """The image that the material shows, (size, size, c) float32: ambient occlusion, or light times the base colour."""
    what = options.asked.what
    if what == "ao":
        return image_of(sheet.cover, values)
    if what == "bent-normal":
        return 0.5 + 0.5 * image_of(sheet.cover, values)
    base = base_texels(asset, accessors, sheet, originals)
    base[:, :3] *= np.clip(values, 0.0, 1.0)
    image = image_of(sheet.cover, np.where(np.isnan(values[:, :1]), np.nan, base))
    return image[..., :3] if (base[:, 3] == 1.0).all() else image


def _give(asset: Asset, material: dict, texture: int, uv_set: int, options: Options) -> None:
    """Put a baked texture into a material."""
    used = {"index": texture, "texCoord": uv_set}
    if options.asked.what == "ao":
        material["occlusionTexture"] = used
    elif options.asked.what == "bent-normal":
        material.setdefault("extras", {})["bentNormalTexture"] = used
    else:
        material.setdefault("pbrMetallicRoughness", {})["baseColorTexture"] = used
        make_unlit(asset, material)


def _split(values: np.ndarray, parts: list[Part]) -> list[np.ndarray]:
    return np.split(values, np.cumsum([len(p.positions) for p in parts])[:-1])


def _local(directions: np.ndarray, part: Part) -> np.ndarray:
    """World directions in the frame of the file's normals, unit."""
    local = directions @ part.to_local
    return (local / np.maximum(np.linalg.norm(local, axis=1, keepdims=True), 1e-30)).astype(np.float32)


def _local_texels(sheet: Sheet, values: np.ndarray) -> np.ndarray:
    out, start = values.copy(), 0
    for one in sheet.unwrapped:
        here = (sheet.cover.face >= start) & (sheet.cover.face < start + len(one.faces))
        out[here] = _local(values[here], one.part)
        start += len(one.faces)
    return out


def _exposure(values: np.ndarray, options: Options) -> float:
    if options.exposure is not None:
        return options.exposure
    if options.asked.what != "light":
        return 1.0
    return automatic_exposure(values[None], np.isfinite(values[None, :, 0]))


def _beside(output: Path, number: int, of: int) -> Path:
    return output.with_name(f"{output.stem}{f'-{number}' if of > 1 else ''}.exr")


def _own_lights(scene: Scene, what: str, time: float) -> list[Light]:
    """The lights of a scene, or one above it."""
    own: list[Any] = [scene.light(i, time) for i in range(len(scene.lights))]
    if what == "sun":
        own = [light for light in own if isinstance(light, DirectionalLight)][:1]
        above = scene.default_light()
        return own or [DirectionalLight(scene.bounds.mean(0) - (above.corner + (above.u + above.v) / 2.0))]
    return own or [scene.default_light()]


def check_output(path) -> Path:
    """`path`, if a bake can be written there; otherwise an InputError that names the cure."""
    return checked_output(path, (".glb",))


def is_gltf(path: Path) -> bool:
    """Whether a file is glTF, whose contents a bake keeps."""
    return path.suffix.lower() in GLTF_SUFFIXES


def check(
    what, *, lights, radius, spp, attribute, multiply, texture, uv, bits, exr, denoise, exposure, keep_hidden, time, plan,
    sampler, threads, up="y",
) -> Options:  # fmt: skip
    """The arguments of `bake`, checked as far as no scene is needed. Raises InputError."""
    if what not in QUANTITIES:
        raise InputError(f"what is {what!r}; it must be one of {', '.join(QUANTITIES)}")
    parse_plan(DEFAULT_PLAN if plan is None else plan)
    sample_sets(whole_number(spp, "spp", 1, 1024), sampler)
    lights = _checked_lights(what, lights, radius)
    if bits not in (8, 16):
        raise InputError(f"bits is {bits!r}; a PNG has 8 or 16")
    if texture is not None:
        whole_number(texture, "texture", 16, MAX_TEXTURE)
        if attribute is not None or multiply:
            raise InputError("attribute and multiply belong to values at vertices; leave them or texture out")
        if uv is None:
            needed("xatlas", "an atlas (--texture without --uv)", "bake")
    elif uv is not None or exr or denoise or bits != 8:
        raise InputError("uv, bits, exr and denoise belong to a texture; give its size as texture")
    if uv is not None:
        whole_number(uv, "uv", 0, 7)
    if denoise and what not in ("ao", "shadow"):
        raise InputError(f"denoise is for ao and shadow, and not for {what}; leave it out and raise spp")
    attribute = attribute or ("_BENT_NORMAL" if what == "bent-normal" else "COLOR_0")
    if attribute != "COLOR_0" and not (attribute.startswith("_") and attribute.isascii() and attribute[1:]):
        raise InputError(f"attribute is {attribute!r}; write COLOR_0, or a name of your own such as {_OWN_NAMES[what]}")
    if multiply and attribute != "COLOR_0":
        raise InputError("multiply is for COLOR_0; leave it or attribute out")
    if exposure is not None:
        exposure = number(exposure, "exposure", 0.0, np.inf)
    asked = Asked(what, lights, spp, sampler, plan, time, threads)
    return Options(asked, attribute, multiply, texture, uv, bits, exr, denoise, exposure, keep_hidden, up)


def _checked_lights(what: str, lights, radius) -> list[Light]:
    if what in _SKY:
        if lights is not None:
            raise InputError(f"{what} asks the sky; leave lights out")
        return [ambient(radius)]
    if radius is not None:
        raise InputError(f"radius is for ao and bent-normal, and not for {what}; leave it out")
    lights = [] if lights is None else check_lights(lights)
    if any(light.domain == "list" for light in lights):
        raise InputError("a bake takes lights one by one; PointLights is a list of them")
    if what == "sun" and lights and not (len(lights) == 1 and isinstance(lights[0], DirectionalLight)):
        raise InputError("sun takes one DirectionalLight; for several lights bake light")
    if what == "shadow" and any(light.domain == "hemisphere" for light in lights):
        raise InputError("a sky casts no shadow of its own; bake ao, or light")
    return lights
