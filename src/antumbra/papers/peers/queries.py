"""The shadow query of a camera and a light."""

from ...query.gbuffer import from_hits
from ...query.light_samples import light_samples
from ...query.rasteriser import rasterise
from ...query.shadow_query import ShadowQuery, shadow_queries
from ...scene.camera import Camera
from ...scene.lights import Light
from ...scene.triangles import Triangles


def query_of(triangles: Triangles, camera: Camera, light: Light, spp: int, threads: int) -> ShadowQuery:
    """The shadow query of the surfaces that a camera sees, with `spp` rays a pixel."""
    rays = camera.rays(triangles.origin)
    hits = rasterise(triangles.vertices.reshape(-1, 9), rays, threads)
    gbuffer = from_hits(*hits, triangles, rays, threads)
    return shadow_queries(triangles, gbuffer, [light], [light_samples(light, spp)], threads=threads)[0]
