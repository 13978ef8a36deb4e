"""The metallic-roughness parameters of each pixel, and normals bent by normal maps. Shadows stay geometric."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..kernels.exact.filters import cross, dot
from ..kernels.jit import kernel
from ..kernels.parallel import new_ticket, run, shares, thread_count
from ..kernels.simd import get, ptr, put
from ..query.shadow_query import PixelMaterials, ShadingNormals, Surfaces, three_at
from ..scene.appearance import Appearance
from ..scene.materials import LINEAR, SHARES, PbrParameters, TextureMap
from .pixel_appearance import (
    NO_FRAME,
    Eye,
    FaceColours,
    SurfacePoints,
    barycentric_weights,
    colours_of_pixels,
    decoded_textures,
    evaluate_normal,
    seen_only,
    triangle_frame,
)

# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

_CURE = 'render with materials="diffuse"'

_COMPONENTS = (2.0 * np.arange(256) / 255.0 - 1.0).astype(np.float32)
"""(256,) float32: the components of normals. Both middle bytes are 0, so that a flat map changes nothing."""
_COMPONENTS[127:129] = 0.0


# --- Values of maps ---------------------------------------------------------------------------------------------------


class _Maps:
    """Looks up the maps of the materials that pixels show."""

    def __init__(self, surfaces: Surfaces, places: SurfacePoints, appearance: Appearance, eye: Eye, threads: int):
        assert appearance.pbr is not None
        self._places, self._appearance, self._eye, self._threads = places, appearance, eye, threads
        self._parameters, self._colour = appearance.pbr, surfaces.triangles.colour
        self.material = np.where(places.ids >= 0, appearance.material_of_face[places.ids], -1)

    def factors(self, of: Callable[[PbrParameters], object], neutral: object) -> NDArray[np.float32]:
        """(H, W, ...) float32: a factor of each pixel's material; `neutral` where there is none."""
        values = np.array([of(each) for each in self._parameters] + [neutral], np.float32)
        return values[self.material]

    def values(
        self,
        of: Callable[[PbrParameters], TextureMap | None],
        neutral: Sequence[float],
        table: NDArray[np.float32] = SHARES,
    ) -> NDArray[np.float32] | None:
        """(H, W, 3) float32: the values of a map, `neutral` where there is none; None if no pixel shows one."""
        appearance, maps = self._appearance, [of(each) for each in self._parameters]
        if appearance.second_uv is None:
            maps = [None if each is None or each.second else each for each in maps]
        textures = seen_only(self._places, appearance, [None if each is None else each.texture for each in maps])
        if appearance.uv is None or all(texture is None for texture in textures):
            return None
        has_map = np.array([texture is not None for texture in textures])
        face_colours = FaceColours(
            self._colour,
            appearance.material_of_face,
            np.where(has_map[:, None], 1.0, neutral).astype(np.float32),
            has_map,
            appearance.textured if appearance.mapped is None else appearance.mapped,
            _coordinates(appearance, [each if shown else None for each, shown in zip(maps, has_map)]),
            np.empty((0, 3, 4), np.float32),
            decoded_textures(textures, _CURE, self._threads, table),
        )
        out = colours_of_pixels(self._places, face_colours, self._eye, self._threads)
        out[self.material < 0] = neutral
        return out


def _coordinates(appearance: Appearance, maps: list[TextureMap | None]) -> NDArray[np.float32]:
    """(n, 3, 2) float32: the texture coordinates of corners, in the map of each material."""
    assert appearance.uv is not None
    uv = appearance.uv
    for k, each in enumerate(maps):
        if each is not None and (each.second or each.transform is not None):
            rows = appearance.material_of_face == k
            uv = uv.copy() if uv is appearance.uv else uv
            own = appearance.second_uv if each.second else uv
            assert own is not None
            uv[rows] = each.transformed(own[rows])
    return uv


def with_materials(
    surfaces: Surfaces, places: SurfacePoints, appearance: Appearance, eye: Eye, threads: int | None = None
) -> Surfaces:
    """Add the parameters of pixels, and bend their normals by normal maps. The appearance must have parameters."""
    maps = _Maps(surfaces, places, appearance, eye, thread_count(threads))
    assert appearance.pbr is not None
    shown = {k for k in np.unique(maps.material).tolist() if k >= 0 and not appearance.pbr[k].is_plain}
    if not shown:
        return surfaces
    bumps = maps.values(lambda pbr: pbr.normal_map, (0.0, 0.0, 1.0), _COMPONENTS)
    if bumps is not None and appearance.tangents is not None and appearance.hands is not None:
        bumps[..., :2] *= maps.factors(lambda pbr: pbr.normal_scale, 1.0)[..., None]
        surfaces = surfaces._replace(shading=_bumpy_normals(surfaces, places, appearance, bumps, threads))
    lobe = maps.factors(lambda pbr: pbr.has_lobe, False) > 0.0
    emission = None
    if any(appearance.pbr[k].emits for k in shown):
        emission = maps.factors(lambda pbr: pbr.emission, (0.0, 0.0, 0.0))
        if (texels := maps.values(lambda pbr: pbr.emission_map, (1.0, 1.0, 1.0), LINEAR)) is not None:
            emission *= texels
    metallic, roughness = maps.factors(lambda pbr: pbr.metallic, 0.0), maps.factors(lambda pbr: pbr.roughness, 1.0)
    if (texels := maps.values(lambda pbr: pbr.metal_map, (1.0, 1.0, 1.0))) is not None:
        metallic, roughness = metallic * texels[..., 2], roughness * texels[..., 1]
    occlusion = maps.values(lambda pbr: pbr.occlusion_map, (1.0, 1.0, 1.0))
    if occlusion is not None:
        strength = maps.factors(lambda pbr: pbr.occlusion_strength, 0.0)
        occlusion = np.float32(1.0) + strength * (occlusion[..., 0] - np.float32(1.0))
    return surfaces._replace(materials=PixelMaterials(lobe, metallic, roughness, occlusion, emission))


# --- Normal maps ------------------------------------------------------------------------------------------------------


@kernel
def _bump_rows(ticket, places, tangents, hands, bumps, out):
    """Worker: bend the normals `out` of rows by the values of normal maps, (x, y, z) along their tangents."""
    # In: places, `SurfacePoints`; tangents and hands, of `Appearance`; bumps, (H, W, 3). In and out: out, (H, W, 3)
    w = places.ids.shape[1]
    ids, faces, corners, kept = ptr(places.ids), ptr(places.face), ptr(places.corners), ptr(tangents)
    positions, geometric, normals, values = ptr(places.position), ptr(places.normal), ptr(out), ptr(bumps)
    for y0, last in shares(ticket):
        frame = NO_FRAME
        for at in range(y0 * w, last * w):
            k, bump = get(ids, at), three_at(values, at)
            if k < 0 or hands[k] == 0.0 or (bump[0] == 0.0 and bump[1] == 0.0):
                continue
            if get(faces, at) != frame.triangle:  # neighbouring pixels often see the same triangle
                frame = triangle_frame(corners, get(faces, at))
            b0, b1, b2 = barycentric_weights(frame, three_at(positions, at))
            p, q, r = three_at(kept, 3 * k), three_at(kept, 3 * k + 1), three_at(kept, 3 * k + 2)
            products = (
                b0 * p[0] + b1 * q[0] + b2 * r[0],
                b0 * p[1] + b1 * q[1] + b2 * r[1],
                b0 * p[2] + b1 * q[2] + b2 * r[2],
            )
            t, n = evaluate_normal(frame, products), three_at(normals, at)
            height = dot(t, n)
            t = t[0] - height * n[0], t[1] - height * n[1], t[2] - height * n[2]
            length = np.sqrt(dot(t, t))
            if not (length > 0.0 and length < np.inf):
                continue
            b = cross(n, t)
            x = bump[0] / length * (1.0 if dot(three_at(geometric, at), frame.g) >= 0.0 else -1.0)  # seen from behind
            y = bump[1] / length * np.float64(hands[k])
            m = (
                x * t[0] + y * b[0] + bump[2] * n[0],
                x * t[1] + y * b[1] + bump[2] * n[1],
                x * t[2] + y * b[2] + bump[2] * n[2],
            )
            scale = np.sqrt(dot(m, m))
            if scale > 0.0:
                put(normals, 3 * at, np.float32(m[0] / scale))
                put(normals, 3 * at + 1, np.float32(m[1] / scale))
                put(normals, 3 * at + 2, np.float32(m[2] / scale))


def _bumpy_normals(
    surfaces: Surfaces,
    places: SurfacePoints,
    appearance: Appearance,
    bumps: NDArray[np.float32],
    threads: int | None = None,
) -> ShadingNormals:
    """The shading normals of surfaces, bent by normal maps. The heights where light ends stay those of the mesh."""
    shading, (h, _) = surfaces.shading, surfaces.ids.shape
    if shading is None:
        shading = ShadingNormals(surfaces.gbuffer.normal.copy(), np.zeros(surfaces.ids.shape, np.float32))
    args = places, appearance.tangents, appearance.hands, bumps, shading.normal
    run(_bump_rows, thread_count(threads), new_ticket(h, 8), *args)
    return shading
