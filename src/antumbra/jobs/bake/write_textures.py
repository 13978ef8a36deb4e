"""A bake into textures."""

from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from ...files import atomic_output
from ..engines import Engine
from .asset import Asset
from .base import base_texels
from .charts import Sheet, atlas, existing
from .edit import Remapper, change_materials, make_unlit, own_primitives
from .hidden import Solids
from .images import encoded, png_of, save_exr
from .measure import Meter
from .options import Options, exposure_of
from .parts import accessors_of, to_local
from .report import Baked, Clock
from .sources import Opened
from .textures import Texels, image_of, seam_differences


def bake_textures(source: Opened, options: Options, output: Path, clock: Clock, engine: Engine) -> Baked | None:
    """Measure the texels of all sheets, and write the files; None if the engine leaves texels to others."""
    scene, asset, parts = source
    accessors, size = accessors_of(asset, scene.name), options.texture
    assert size is not None
    sheets = atlas(parts, size) if options.uv is None else existing(parts, accessors, options.uv, size)
    clock.lap("unwrap")
    meter = Meter(scene, options.asked, sum(len(sheet.cover.texel) for sheet in sheets))
    texels = [Texels(sheet, meter, options.denoise, engine.folder) for sheet in sheets]
    job = [each.parts for each in texels]
    if not engine.finish(job):
        return None
    solids = None if options.keep_hidden else Solids(scene, options.asked.time, options.asked.threads)
    measured = [each.values(solids) for each in texels]
    if options.asked.what == "bent-normal":
        measured = [(_local_texels(sheet, values), hidden) for sheet, (values, hidden) in zip(sheets, measured)]
    clock.lap("trace")
    everything = np.concatenate([values for values, _ in measured])
    exposure = exposure_of(everything, options)
    originals = [dict(part.json, attributes=dict(part.json["attributes"])) for part in parts]
    primitives, images, seams = own_primitives(asset, parts), [], []
    remapper = Remapper(asset, accessors)
    for i, (sheet, (values, _)) in enumerate(zip(sheets, measured)):
        image = image_of(sheet.cover, values)
        images.append((_beside(output, i, len(sheets)), image))
        seams.append(seam_differences(sheet, image))
        shown = _shown(asset, accessors, sheet, values * exposure, [originals[k] for k in sheet.members], options)
        texture = asset.texture(png_of(encoded(shown, options.bits, options.asked.what in ("shadow", "sun", "light"))),
                                options.asked.what)  # fmt: skip
        own = [primitives[k] for k in sheet.members]
        sets = [_uv_set(one, primitive, remapper, asset, options.uv) for one, primitive in zip(sheet.unwrapped, own)]
        change_materials(asset, own, sets, partial(_give, asset, texture, options))
    images = images if options.exr else []
    with ExitStack() as files:  # all of them, or none
        for path, image in images:
            save_exr(image, files.enter_context(atomic_output(path)))
        files.enter_context(atomic_output(output)).write_bytes(asset.glb())
    engine.end(job)
    clock.lap("write")
    seam = np.concatenate(seams)
    return Baked(
        output,
        [path for path, _ in images],
        options.asked.what,
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


def _give(asset: Asset, texture: int, options: Options, material: dict, uv_set: int) -> None:
    """Put a baked texture into a material."""
    used = {"index": texture, "texCoord": uv_set}
    if options.asked.what == "ao":
        material["occlusionTexture"] = used
    elif options.asked.what == "bent-normal":
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


def _beside(output: Path, number: int, of: int) -> Path:
    return output.with_name(f"{output.stem}{f'-{number}' if of > 1 else ''}.exr")
