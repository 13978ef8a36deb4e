"""`antumbra.view`: opens a scene in the browser."""

import sys
import webbrowser
from collections.abc import Sequence
from html import escape
from time import sleep

from ..checks import flag, items, quoted, text, whole_number
from ..engine.in_memory_source import rays_job
from ..engine.plan import Plan
from ..engine.precompilation import precompile
from ..engine.scene_loading import SceneLike, scene_of
from ..errors import InputError
from ..jobs.job_kernels import points_job
from ..jobs.sun.location import Place
from ..picture.render_kernels import precompile_quality
from ..scene.camera import Camera
from ..scene.lights import Light
from .model import Model
from .page import Page
from .pictures import Step, traced

HOST, PORT = "127.0.0.1", 8080


class Viewer:
    """An open page. `antumbra.view` makes it; as a context manager it closes the page at the end.

    Attributes
    ----------
    url : str
        The address of the page, with its token if other machines can reach it.
    scene : Scene or PagedScene
    time : float
        Seconds. Setting it moves the animation.
    lights : list of lights
        The lights that shine, where the user moved them.
    camera : Camera
        That of the browser that moved last.

    Notes
    -----
    What the user left outlives the page: ``at.render(scene, viewer.camera, viewer.lights, time=viewer.time)``.
    """

    def __init__(self, page: Page):
        if not isinstance(page, Page):
            raise InputError(f"page is {quoted(page)}; antumbra.view opens a page")
        self._page: Page | None = page
        self._model = page.model
        self.url, self.scene = page.url, page.model.scene

    @property
    def time(self) -> float:
        """The time that the page shows, in seconds. Setting it moves the animation."""
        return self._model.time

    @time.setter
    def time(self, time: float) -> None:
        self._model.go_to(time)
        if self._page is not None:
            self._page.changed()

    @property
    def lights(self) -> list[Light]:
        """The lights that shine, where the user moved them."""
        return [lamp.light for lamp in self._model.shining]

    @property
    def camera(self) -> Camera:
        """The camera of the browser that moved last; before the first one, that of the first view."""
        return self._model.seen_by or self._model.first_camera(1024, 1024)

    def wait(self) -> None:
        """Wait until the page is closed, or for Ctrl-C."""
        while self._page is not None:
            sleep(0.2)

    def close(self) -> None:
        """End the server. A closed page can be closed again."""
        page, self._page = self._page, None
        if page is not None:
            page.close()

    def __enter__(self) -> "Viewer":
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Viewer({self.scene.name!r}, {self.url if self._page is not None else 'closed'})"

    def _repr_html_(self) -> str:
        """What a notebook shows: the page."""
        if self._page is None:
            return f"<p>{escape(repr(self))}</p>"
        return f'<iframe src="{self.url}" width="100%" height="600" style="border: 0"></iframe>'


def view(
    scene: SceneLike, lights: Sequence[Light] | Light | None = None, *, camera: Camera | None = None, time: float = 0.0,
    plan: str | Plan | None = None, threads: int | None = None, max_memory: int | None = None,
    place: Place | None = None, port: int = PORT, host: str = HOST, allow_host: Sequence[str] | str = (),
    browser: bool | None = None,
) -> Viewer:  # fmt: skip
    """Show a scene in the browser: pictures by the tracer, lights that can be moved, and what a clicked point sees.

    While the camera moves, the browser shows a stand-in: triangles with baked light. As soon as it rests, traced
    pictures appear, from coarse to fine. It needs ``antumbra[view]``.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    lights : list of lights, one light, or None
        None: ``scene.default_lights(time)``.
    camera : Camera or None
        The first view. None: the scene's first camera, or ``scene.default_camera()``.
    time : float
        Seconds into the animation.
    plan, threads, max_memory
        As in `antumbra.render`.
    place : Place or None
        Where on Earth the scene lies (`antumbra.place_of`). The sun then follows a day and an hour.
    port : int
        Port of the server; 0: any free one.
    host : str
        Address at which the server listens. The default serves this machine alone. ``0.0.0.0`` serves all who can
        reach it and know the token in `Viewer.url`.
    allow_host : str or list of str
        Further names or addresses under which browsers may reach the page, such as that of a proxy. Requests for any
        other name are refused, as are those that pages of other sites send.
    browser : bool or None
        Whether to open a browser. None: not in a notebook, which shows the page itself.

    Returns
    -------
    Viewer
        It has `url` and `close()`.

    Raises
    ------
    InputError
        If viser is missing, the port is busy, or an argument is wrong.
    """
    port = whole_number(port, "port", 0, 65535)
    text(host, "host")
    allowed = items(allow_host, str, "allow_host")
    if browser is not None:
        browser = flag(browser, "browser")
    model = Model(scene_of(scene), lights, camera, time, plan=plan, threads=threads, max_memory=max_memory, place=place)
    prepare(model)
    viewer = Viewer(Page(model, host, port, allowed))
    if "ipykernel" not in sys.modules if browser is None else browser:
        webbrowser.open(viewer.url)
    return viewer


def prepare(model: Model) -> None:
    """Compile the kernels, and build the tree by a first coarse picture. So the page answers as soon as it opens."""
    precompile(rays_job)
    precompile_quality()
    precompile(points_job)
    traced(model, model.first_camera(1280, 800), Step(4, 4))
