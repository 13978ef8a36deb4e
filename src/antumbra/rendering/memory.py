"""The memory of a frame: an estimate by what is asked, so that the chunks of a store get all the rest."""

from ..engine.frame_tracer import CELL_BYTES, FrameMemory, ray_set_count
from .request import Request

PASS_BYTES = 48  # of a pass of diffuse rays, for each pixel: directions, hits, cells, numbers of triangles
SURFACE_BYTES = 48  # of the surfaces that a pass meets, for each pixel
LIGHT_BYTES = 44  # of a shadow query with one word of bits, and its share, for each pixel
SUBPIXELS = 16
_EDGES = 4  # every so manieth pixel is divided, as a guess
_PICTURE_BYTES = 72  # of rays, hits, surfaces, receivers, the triangles that pixels see, the image and its inputs
_BAND_BYTES = 40  # of surfaces in bands, while they are put together
_SMOOTH_BYTES = 64
_EDGE_BYTES = 40  # of smoothed edges: their boundaries, and the shares of neighbours
_FINER_BYTES = 96  # of the pixels whose penumbrae are refined
_BOUNCE_BYTES = 80


def frame_memory(request: Request) -> FrameMemory:
    """The memory of a frame."""
    pixels, bytes_ = request.camera.width * request.camera.height, _PICTURE_BYTES + _BAND_BYTES
    bytes_ += sum(LIGHT_BYTES + 16 * (-(-samples.shape[1] // 64)) for samples in request.samples)
    bytes_ += _SMOOTH_BYTES * request.smooth + PASS_BYTES * request.camera.listed
    bytes_ += _EDGE_BYTES * request.options.smooths_edges
    cells = sum(CELL_BYTES * ray_set_count(light, samples) for light, samples in zip(request.lights, request.samples))
    passes = 0
    if request.finer is not None:
        bytes_ += _FINER_BYTES * len(request.samples)
        passes = edge_bytes(len(request.lights)) // _EDGES
    if request.passes is not None:
        bytes_ += _BOUNCE_BYTES
        each = PASS_BYTES + SURFACE_BYTES + LIGHT_BYTES * len(request.lights)
        passes = max(passes, each * len(request.passes.directions))
    return FrameMemory(bytes_ * pixels, cells * pixels, passes * pixels)


def edge_bytes(lights: int) -> int:
    """The memory of the sub-pixels of a pixel."""
    return SUBPIXELS * (PASS_BYTES + SURFACE_BYTES + _PICTURE_BYTES // 2 + LIGHT_BYTES * lights)
