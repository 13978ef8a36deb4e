"""The passes of one frame: evaluate, G-buffer, trace, filter, refine, bounce, shade, layers, and smooth edges."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..engine.frame_tracer import FrameMethods
from ..query.pixel_refinement import BLOCK, block_copies, block_means, edges, picture_of
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadowQuery, Surfaces, join_bands
from ..query.surface_links import PictureSurfaces, picture_surfaces
from ..scene.lights import is_indirect, light_names
from ..scene.sky import Sky
from ..trace.counters import as_dict
from ..trace.transmission import TracedQuery
from .bounced_light import indirect_light
from .discontinuity_filter import smooth_irradiance
from .frame import (
    Frame,
    FrameState,
    Ground,
    Layers,
    arriving_light,
    edge_colours,
    queries_of,
    shade_surfaces,
    shading_inputs,
    surface_facing,
    trace_queries,
    trace_query,
    unfiltered_light,
    with_appearance,
    with_known_bits,
)
from .frame_request import edge_bytes, frame_memory, ray_counts
from .light_visibility import LightFractions, finer_query, light_fractions, refine_fractions, without_equal_samples
from .material_shading import MaterialShading
from .morphological_antialiasing import mixture
from .shading import Illumination, ambient_light, shade
from .shadow_catcher import ShadowCatcher
from .sky_background import add_skies, backdrop, skies_of, sky_behind
from .sparse_bounce import interpolated, sparse_grid, sparse_picture, sparse_surfaces

# --- Layers for compositing: base colours, each light alone, and objects ----------------------------------------------


def frame_layers(
    state: FrameState,
    surfaces: Surfaces,
    visible: PictureSurfaces,
    traced: list[TracedQuery],
    shares: list[np.ndarray],
    indirect: np.ndarray | None,
    materials: MaterialShading | None,
) -> Layers:
    """The `Layers` of a frame: shades its surfaces once more for each light."""
    request, ids = state.request, surfaces.ids
    gbuffer, colour = shading_inputs(surfaces)
    arrived, dark = arriving_light(state, surfaces, traced, visible), np.zeros(3, np.float32)
    up = state.tracer.scene.up

    def shaded(numbers: list[int], indirect: np.ndarray | None = None) -> np.ndarray:
        illumination = Illumination(request.lights, arrived, shares, dark, indirect).only(numbers)
        image = shade(gbuffer, colour, illumination, up, state.threads)
        if materials is not None:
            materials.shade(image, numbers, illumination, dark)
        return image

    images = [shaded([k]) for k in range(len(request.lights))]
    bounced = None if indirect is None else shaded([], indirect)
    hit = ids >= 0
    albedo = np.where(hit[..., None], colour[np.where(hit, gbuffer.face, 0)], np.float32(0.0))
    objects = state.tracer.scene.object_of_face[np.where(hit, ids, 0)]
    state.clock.lap("shade")
    return Layers(albedo, images, bounced, np.where(hit, objects, np.int32(-1)))


# --- Anti-aliasing ----------------------------------------------------------------------------------------------------


def smooth_edges(
    state: FrameState, surfaces: Surfaces, visible: PictureSurfaces, pictures: list[np.ndarray], ground: Ground | None
) -> np.ndarray:
    """Mix the pixels at edges of pictures with their neighbours across the edge.

    Returns (H, W) float32: the share of each pixel that shows surfaces.
    """
    coverage = (surfaces.ids >= 0).astype(np.float32)
    mixed = mixture(visible, edge_colours(state), state.threads)
    if ground is not None:
        free = np.float32(1.0) - coverage[..., None]
        lit, total = mixed.of(free * ground.share), mixed.of(free)
        share = np.divide(lit, total, out=np.ones_like(lit), where=total > 0.0)
        ground.share.reshape(-1, 3)[mixed.pixels] = share
    for picture in [coverage, *pictures]:
        mixed.mix(picture)
    state.clock.lap("shade")
    return coverage


# --- The passes -------------------------------------------------------------------------------------------------------


def render_frame(state: FrameState) -> Frame:
    """Render a frame. Compile its kernels first, or compilation counts in the timings; and hold the engine's lock."""
    request = state.request
    evaluate(state)
    surfaces, traced, irradiance = find_and_trace(state)
    surfaces = with_appearance(state, surfaces)
    visible, fractions = visible_fractions(state, surfaces, traced)
    edge = finer = indirect = coverage = None
    if request.finer is not None:
        edge, finer = refine(state, surfaces, visible, traced, fractions)
    visibility, shares = [light.fraction for light in fractions], [light.share for light in fractions]
    if request.passes:
        irradiance = diffuse(state, surfaces, traced) if irradiance is None else irradiance
        indirect = bounce(state, surfaces, visible, irradiance)
    materials = None
    if surfaces.materials is not None:
        smooth = request.smooth or request.smooth_skies
        materials = MaterialShading(state, surfaces, traced, visible if smooth else None)
    image, ambient, fill = shade_frame(state, surfaces, visible, traced, shares, indirect, materials)
    catcher = None if request.ground is None else ShadowCatcher(state, fill)
    ground = None if catcher is None else catcher.ground(surfaces)
    fill_background(state, surfaces, image, ground)
    layers = None
    if request.options.layers:
        layers = frame_layers(state, surfaces, visible, traced, shares, indirect, materials)
    if edge is not None and edge.any():
        coverage = (surfaces.ids >= 0).astype(np.float32)
        shade_edges(state, edge, EdgeInputs(image, coverage, ground, catcher, fill), ambient, indirect)
    if request.options.smooths_edges:
        coverage = smooth_edges(state, surfaces, visible, [image, *(layers.images if layers else [])], ground)
    gbuffer = surfaces.gbuffer._replace(face=surfaces.ids)
    counters = None if state.tally is None else as_dict(state.tally)
    tracer = state.tracer
    methods = tracer.methods() if state.known is None else FrameMethods(str(tracer.plan), None, None, None)
    return Frame(
        image=image,
        visibility=visibility,
        bits=[each.bits for each in traced],
        gbuffer=gbuffer,
        rays=state.rays,
        timings=state.clock.timings(),
        counters=counters,
        refined=finer,
        indirect=indirect,
        scheduled=methods.statistics,
        paging=tracer.paging(),
        plan=methods.plan,
        tree=methods.tree,
        choices=methods.choices,
        divided=coverage,
        names=tuple(light_names(request.lights)),
        backdrop=backdrop_of(state, surfaces, coverage, ground),
        layers=layers,
        ambient=ambient,
        ground=ground,
        camera=request.camera,
        lights=tuple(request.lights),
        options=request.options,
        seen_on=surfaces.device,
    )


def evaluate(state: FrameState) -> None:
    """Evaluate the triangles at the frame's time, and build their tree if primary visibility uses rays."""
    request = state.request
    state.tracer.begin(frame_memory(request), *ray_counts(request), request.options.time, request.frames)
    state.clock.lap("evaluate")
    if state.tracer.build_for_camera(request.camera):
        state.clock.lap("build")


class _TracedBand(NamedTuple):
    """The rows of a band, with what its rays have found, without their queries, which would take more memory."""

    rows: slice
    surfaces: Surfaces
    bits: list[NDArray[np.uint64]]
    irradiance: NDArray[np.float32] | None  # see `diffuse`; None: it is not traced with the band


def find_and_trace(state: FrameState) -> tuple[Surfaces, list[TracedQuery], NDArray[np.float32] | None]:
    """Find the surfaces that the camera sees and trace their rays, one band of rows after another.

    Return the surfaces, the traced shadow queries, and `diffuse` of a store, whose chunks serve all rays of a band;
    None: of other scenes, and of frames without bounced light.
    """
    request, bands = state.request, list[_TracedBand]()
    bounced = bool(request.passes) and state.known is None and state.tracer.memory is not None
    for rows in state.tracer.bands(request.camera.height):
        surfaces = find_surfaces(state, rows)
        traced = trace(state, surfaces, rows)
        irradiance = diffuse(state, surfaces, traced) if bounced else None
        bands.append(_TracedBand(rows, surfaces, [each.bits for each in traced], irradiance))
    if len(bands) == 1:
        return surfaces, traced, irradiance
    bands.sort(key=lambda band: band.rows.start)
    surfaces = join_bands([band.surfaces for band in bands])
    state.tracer.triangles = surfaces.triangles
    bits = [np.concatenate(of_light) for of_light in zip(*(band.bits for band in bands))]
    queries = queries_of(state, surfaces, request.samples)
    traced = [state.tracer.traced_query(query, words) for query, words in zip(queries, bits)]
    irradiance = np.concatenate([band.irradiance for band in bands if band.irradiance is not None]) if bounced else None
    return surfaces, traced, irradiance


def find_surfaces(state: FrameState, rows: slice) -> Surfaces:
    """Find the surfaces that the camera sees in a range of rows."""
    surfaces = state.tracer.surfaces(state.request.camera, rows, state.request.progress)
    state.clock.lap("gbuffer")
    return surfaces


def trace(state: FrameState, surfaces: Surfaces, rows: slice) -> list[TracedQuery]:
    """Trace the shadow rays of a band's pixels, in a tree that also serves the rays of refined penumbrae."""
    request, tracer = state.request, state.tracer
    queries = queries_of(state, surfaces, request.samples)
    state.clock.lap("trace")
    if state.known is not None:
        return with_known_bits(state, queries, [bits[rows] for bits in state.known.bits])
    finer = [] if request.finer is None else [q._replace(samples=s) for q, s in zip(queries, request.finer.penumbra)]
    tracer.sample(surfaces.gbuffer, queries, request.lights, request.samples, request.facing)
    tracer.prepare([*queries, *finer], state.clock.lap)
    traced = trace_queries(state, queries)
    state.clock.lap("trace")
    return traced


def visible_fractions(
    state: FrameState, surfaces: Surfaces, traced: list[TracedQuery]
) -> tuple[PictureSurfaces, list[LightFractions]]:
    """The visible surfaces as input of filters, and the visible fraction of each light, filtered on request."""
    visible, facing = picture_surfaces(surfaces.gbuffer, state.tracer.view), surface_facing(surfaces)
    fractions = [light_fractions(visible, facing, each, state.request.smooth, state.threads) for each in traced]
    state.clock.lap("filter")
    return visible, fractions


def refine(
    state: FrameState,
    surfaces: Surfaces,
    visible: PictureSurfaces,
    traced: list[TracedQuery],
    fractions: list[LightFractions],
) -> tuple[np.ndarray, np.ndarray]:
    """Trace more rays in penumbrae, and replace the values of `fractions` there.

    Returns two (H, W) bool masks: edge pixels, which `shade_edges` splits into sub-pixels; and all refined pixels.
    """
    more, known = state.request.finer, state.known
    assert more is not None
    edge = edges(visible, edge_colours(state), state.threads)
    chosen = edge.copy()
    for i, (each, samples) in enumerate(zip(traced, more.penumbra)):
        finer = finer_query(visible, each, samples, state.threads)
        better = trace_query(state, finer) if known is None else _known(state, known.finer[i], finer)
        fractions[i] = refine_fractions(
            fractions[i], visible, surface_facing(surfaces), better, state.request.smooth, state.threads
        )
        chosen |= finer.sides != NOTHING
    state.clock.lap("trace")
    return edge, chosen


def _known(state: FrameState, bits: np.ndarray, query: ShadowQuery) -> TracedQuery:
    return with_known_bits(state, [query], [bits])[0]


_SMOOTHINGS = 6
"""Filter passes over bounced light. It varies slowly over a surface, and one window has few of its rays."""


def diffuse(state: FrameState, surfaces: Surfaces, traced: list[TracedQuery]) -> NDArray[np.float32]:
    """Irradiance of bounced light at the pixels of the sparse grid, (ceil(H / step), ceil(W / step), 3) float32."""
    step = state.request.options.bounce_step
    if state.known is not None:
        assert state.known.indirect is not None
        return state.known.indirect
    nearest = state.tracer.closest_hits(state.clock.lap)
    origins = sparse_grid(traced[0].query.origins, step)
    indirect = indirect_light(state, sparse_surfaces(surfaces, step), origins, nearest)
    state.clock.lap("trace")
    return indirect


def bounce(
    state: FrameState, surfaces: Surfaces, visible: PictureSurfaces, indirect: NDArray[np.float32]
) -> NDArray[np.float32]:
    """(H, W, 3) float32: irradiance of bounced light, filtered on request; `indirect`: from `diffuse`."""
    step = state.request.options.bounce_step
    if state.request.smooth:
        grid = sparse_picture(visible, step)
        for _ in range(_SMOOTHINGS):
            indirect = smooth_irradiance(grid, indirect, state.threads)
    indirect = interpolated(surfaces.gbuffer, indirect, step)
    state.clock.lap("filter")
    return indirect


def shade_frame(
    state: FrameState,
    surfaces: Surfaces,
    visible: PictureSurfaces,
    traced: list[TracedQuery],
    shares: list[np.ndarray],
    indirect: np.ndarray | None,
    materials: MaterialShading | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The image, (H, W, 3) float32; its ambient light, (3,) float32; and the ambient light of the ground.

    If the frame has bounced light, its ambient light is zero, but the ground's ambient light still stands for bounced
    light. With ``ambient=False``, both are zero.
    """
    arrived, lights = arriving_light(state, surfaces, traced, visible), state.request.lights
    direct = [k for k, light in enumerate(lights) if not is_indirect(light)]
    fill = np.zeros(3, np.float32)
    if state.request.options.ambient:
        fill = ambient_light(surfaces.gbuffer, [lights[k] for k in direct], [arrived[k] for k in direct], state.threads)
    ambient = fill if indirect is None and len(direct) == len(lights) else np.zeros(3, np.float32)
    illumination = Illumination(lights, arrived, shares, ambient, indirect)
    image = shade_surfaces(state, surfaces, illumination)
    if materials is not None:
        materials.shade(image, range(len(lights)), illumination, fill)
        materials.emit(image)
    state.clock.lap("shade")
    return image, ambient, fill


def fill_background(state: FrameState, surfaces: Surfaces, image: np.ndarray, ground: Ground | None) -> None:
    """Fill pixels that see no surface with the light of skies, dimmed by shadows on the ground."""
    if skies := _seen_skies(state):
        free = surfaces.ids < 0
        add_skies(skies, state.tracer.view, free, image, state.threads)
        if ground is not None:
            image[free] *= ground.share[free]
        state.clock.lap("shade")


def backdrop_of(
    state: FrameState, surfaces: Surfaces, coverage: np.ndarray | None, ground: Ground | None
) -> np.ndarray | None:
    """The backdrop of a picture without a sky; None if it would be invisible, or if ``background=False``."""
    coverage = (surfaces.ids >= 0).astype(np.float32) if coverage is None else coverage
    if not state.request.options.background or _seen_skies(state) or (coverage == 1.0).all():
        return None
    daylight = backdrop(state.tracer.view, coverage, state.tracer.scene.up, state.threads)
    return daylight if ground is None else daylight * ground.share


def _seen_skies(state: FrameState) -> list[Sky]:
    return skies_of(state.request.lights) if state.request.options.background else []


class EdgeInputs(NamedTuple):
    """The images that `shade_edges` improves."""

    image: np.ndarray  # (H, W, 3) float32
    coverage: np.ndarray  # (H, W) float32: share of each pixel that shows surfaces
    ground: Ground | None  # whose `share` is updated
    catcher: ShadowCatcher | None
    fill: np.ndarray  # (3,) float32: the ambient light of the ground


def shade_edges(
    state: FrameState, edge: np.ndarray, inputs: EdgeInputs, ambient: np.ndarray, indirect: np.ndarray | None
) -> None:
    """Shade sixteen sub-pixels of each pixel in the mask `edge`, and write their mean to the image."""
    rows, columns = np.nonzero(edge)
    batch_size = state.tracer.at_once(edge_bytes(state.request))
    for first in range(0, len(rows), batch_size):
        batch = np.zeros_like(edge)
        batch[rows[first : first + batch_size], columns[first : first + batch_size]] = True
        _shade_edges(state, batch, first, inputs, ambient, indirect)


def _shade_edges(
    state: FrameState,
    edge: np.ndarray,
    first: int,
    inputs: EdgeInputs,
    ambient: np.ndarray,
    indirect: np.ndarray | None,
) -> None:
    """`shade_edges` for a batch of pixels; `first`: index of the batch's first pixel among all edge pixels."""
    finer = state.request.finer
    assert finer is not None
    pixels = state.tracer.subpixels(edge)
    state.clock.lap("gbuffer")
    queries = [without_equal_samples(query) for query in queries_of(state, pixels, finer.edges)]
    state.clock.lap("trace")
    if state.known is None:
        state.tracer.prepare_again(queries, state.clock.lap)
        traced = trace_queries(state, queries)
    else:
        batch = slice(first, first + int(np.count_nonzero(edge)))
        bits = [picture_of(blocks[batch], pixels.ids.shape) for blocks in state.known.edges]
        traced = with_known_bits(state, queries, bits)
    state.clock.lap("trace")
    around = None if indirect is None else block_copies(indirect[edge], pixels.ids.shape)
    pixels = with_appearance(state, pixels, BLOCK)
    light = unfiltered_light(state, pixels, traced, ambient, around)
    blocks = shade_surfaces(state, pixels, light)
    if pixels.materials is not None:
        materials = MaterialShading(state, pixels, traced, parts=BLOCK)
        materials.shade(blocks, range(len(light.lights)), light, inputs.fill)
        materials.emit(blocks)
    covered = (pixels.ids >= 0).astype(np.float32)
    count = int(np.count_nonzero(edge))
    share = block_means(covered, count)
    background = sky_behind(_seen_skies(state), state.tracer.view, *np.nonzero(edge))
    if inputs.catcher is not None and inputs.ground is not None:
        inputs.ground.share[edge] = dimmed = inputs.catcher.edge_shares(edge, pixels)
        background = background * dimmed
    inputs.image[edge] = block_means(blocks, count) + (np.float32(1.0) - share)[:, None] * background
    inputs.coverage[edge] = share
    state.clock.lap("shade")
