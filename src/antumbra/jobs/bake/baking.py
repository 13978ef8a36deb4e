"""`antumbra.bake`: what surfaces receive, written into a glTF file."""

from collections.abc import Sequence

from ...checks import choice
from ...engine.scene_loading import SceneLike
from ...progress import Progress, with_progress
from ...scene.lights import Light
from ..engines import engine_of
from .options import check, check_output, own_lights
from .report import Baked, Clock
from .sources import Given, given, is_gltf, opened
from .write_textures import bake_textures
from .write_vertices import bake_vertices

__all__ = ["Baked", "Given", "bake", "check", "check_output", "is_gltf"]


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
        Folder in which an interrupted bake keeps its finished parts; or who does them, see `antumbra.jobs.engines`.
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
    output, engine = check_output(output), engine_of(keep)
    choice(up, "up", (None, "y", "z"))
    options = check(
        what, lights=lights, radius=radius, spp=spp, attribute=attribute, multiply=multiply, texture=texture, uv=uv,
        bits=bits, exr=exr, denoise=denoise, exposure=exposure, keep_hidden=keep_hidden, time=time, plan=plan,
        sampler=sampler, threads=threads,
    )  # fmt: skip
    clock = Clock()
    source = opened(scene if isinstance(scene, Given) else given(scene, up), time)
    if not options.asked.lights:
        own = own_lights(source.scene, what, time)
        options = options._replace(asked=options.asked._replace(lights=own))
    clock.lap("read")
    job = bake_textures if options.texture else bake_vertices
    made = job(source, options, output, clock, engine)
    return made  # type: ignore[return-value]  # None: a shard, of a command
