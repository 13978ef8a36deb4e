"""The result of a `Renderer`: a frame with its timings."""

from time import perf_counter
from typing import NamedTuple

import numpy as np

from ..engine.auto.strategies import StrategyChoice
from ..picture.image_files import LUMINANCE
from ..query.gbuffer import GBuffer

PHASES = ("evaluate", "gbuffer", "cull", "build", "trace", "filter", "shade")


class Layers(NamedTuple):
    """The parts of a frame's image. Their sum, with ambient light, is the image, but for divided edges."""

    albedo: np.ndarray  # (H, W, 3) float32, linear: the base colour of the surface; 0 in the background
    lights: list[np.ndarray]  # per light (H, W, 3) float32: the image by this light alone, with its shadows
    indirect: np.ndarray | None  # (H, W, 3) float32: the image by light that bounced once; None without `bounce`
    object: np.ndarray  # (H, W) int32: index in `Scene.objects`; -1 in the background

    @property
    def images(self) -> list[np.ndarray]:
        """The images by a part of the light."""
        return self.lights if self.indirect is None else [*self.lights, self.indirect]


class Ground(NamedTuple):
    """The ground that catches shadows, where the centre of a pixel sees no surface but this ground.

    Lists of lights, and their bits, are as in `Frame`, without lights that stand for bounced light.
    """

    height: float  # along the scene's up axis, world
    mask: np.ndarray  # (H, W) bool: pixels whose centre sees the ground
    position: np.ndarray  # (H, W, 3) float32, recentred frame, as `GBuffer.position`; 0 elsewhere
    visibility: list[np.ndarray]  # per light (H, W) float32 in [0, 1]: share of the light seen; 1 elsewhere
    bits: list[np.ndarray]  # per light (H, W, ceil(n / 64)) uint64: bit s = sample s occluded; 0 elsewhere
    share: np.ndarray  # (H, W, 3) float32: light with shadows over light without, of what shows no surface; 1 elsewhere

    @property
    def lost(self) -> np.ndarray:
        """(H, W) float32: the share of the light's luminance that is lost; 0 where no shadow is."""
        return np.float32(1.0) - self.share @ LUMINANCE


class Frame(NamedTuple):
    """A rendered frame. H, W: the camera's height and width."""

    image: np.ndarray  # (H, W, 3) float32, linear
    visibility: list[np.ndarray]  # per light (H, W) float32 in [0, 1]: share of the light seen; 1 in the background
    bits: list[np.ndarray]  # per light (H, W, ceil(n / 64)) uint64: bit s = sample s occluded; 0 in the background
    gbuffer: GBuffer  # the surface seen by each pixel
    rays: int  # shadow rays, including those at bounce surfaces; diffuse rays are not counted
    timings: dict[str, float]  # seconds of each phase in PHASES, and "total"; compilation is never included
    counters: dict[str, int] | None  # sums over the shadow rays (see trace.counters); None unless requested
    refined: np.ndarray | None = None  # (H, W) bool: refined pixels in penumbrae and at edges; None unless requested
    indirect: np.ndarray | None = None  # (H, W, 3) float32: irradiance after one bounce; None unless requested
    scheduled: list[dict] | None = None  # CHC+RT only: the statistics of each query, as from `Statistics.as_dict`
    paging: dict[str, int] | None = None  # stores only: chunks read and evicted, see `store.chunk_residency.Paging`
    plan: str = ""  # the methods that ran; of the plan "auto" those that it chose
    choices: list[StrategyChoice] | None = None  # the plan "auto" only: how each query was answered, and why
    divided: np.ndarray | None = None  # (H, W) float32: share of each pixel with surfaces; None: edges not smoothed
    names: tuple[str, ...] = ()  # of the lights, all different: their own, or their kinds, such as "sun"
    backdrop: np.ndarray | None = None  # (H, W, 3) float32, shares of white: what a PNG shows behind, with shadows
    layers: Layers | None = None  # the image light by light, base colours and objects; None unless requested
    ambient: np.ndarray | None = None  # (3,) float32: ambient irradiance of surfaces that face up; 0 with `indirect`
    ground: Ground | None = None  # the shadows on the ground; None unless requested

    @property
    def coverage(self) -> np.ndarray:
        """(H, W) float32: the share of each pixel that shows surfaces: 0 or 1, and between them at smoothed edges."""
        return self.mask.astype(np.float32) if self.divided is None else self.divided

    @property
    def mask(self) -> np.ndarray:
        """(H, W) bool: whether the pixel sees a surface. Elsewhere `visibility` is 1, since nothing hides the light.

        ``np.where(frame.mask, frame.visibility[0], np.nan)`` leaves the background out of means and plots.
        """
        return self.gbuffer.face >= 0

    def save(self, path, exposure: float | None = None, background=None) -> None:
        """Write the frame as ``.png`` (sRGB) or ``.exr`` (linear).

        An ``.exr`` has the channels R, G, B and A; ``shadow.NAME``, the share of each light that is seen; depth.Z,
        normal.X/Y/Z, position.X/Y/Z and triangle.id. With a ground also ground.R/G/B, `Ground.share`; A then has
        `Ground.lost` where no surface is seen. With `layers` also ``light.NAME.R/G/B``, albedo.R/G/B,
        indirect.R/G/B and object.id.

        Parameters
        ----------
        path : str or path-like
            A name that ends in ``.png`` or ``.exr``.
        exposure : float or None
            Exposure of a PNG; None: automatic.
        background : None, "transparent" or (3,) float
            Of a PNG: an alpha channel, or an sRGB colour in [0, 1], for frames rendered with ``background=False``.

        Raises
        ------
        InputError
            If the suffix is unknown or the path cannot be written; no partial file is left.
        """
        from ..picture.image_files import save_frame

        save_frame(self, path, exposure, background=background)

    def _repr_png_(self) -> bytes:
        """The picture as a notebook shows it: as `save` writes it to a ``.png``."""
        from ..picture.image_files import frame_exposure, png_bytes, screen_picture

        return png_bytes(screen_picture(self, frame_exposure(self)))

    def __repr__(self) -> str:
        height, width = self.image.shape[:2]
        lights, seconds = len(self.visibility), self.timings["total"]
        about = f"{width}x{height}, {lights} light{'s' * (lights != 1)}, {self.rays:,} rays, {1000 * seconds:.3g} ms"
        return f"Frame({about}, plan {self.plan!r}; {', '.join(self._fields)})"


class Clock:
    """Accumulates the seconds of each phase."""

    def __init__(self):
        self.seconds = dict.fromkeys(PHASES, 0.0)
        self.start = self.last = perf_counter()

    def lap(self, phase: str) -> None:
        now = perf_counter()
        self.seconds[phase] += now - self.last
        self.last = now

    def timings(self) -> dict[str, float]:
        return {**self.seconds, "total": self.last - self.start}
