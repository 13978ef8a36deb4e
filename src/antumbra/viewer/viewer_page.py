"""`antumbra.view`: open a scene in the browser, with the server of the page and its event handlers."""

import errno
import io
import shlex
import socket
import sys
import webbrowser
from collections.abc import Awaitable, Callable, Sequence
from contextlib import redirect_stdout
from html import escape
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.checks import flag, items, quoted, text, whole_number
from ..base.errors import InputError
from ..base.extras import import_extra
from ..engine.plan import Plan
from ..engine.precompilation import precompile
from ..engine.scene_loading import SceneLike, scene_of
from ..picture.png_files import png_file
from ..picture.render_options import EngineOptions
from ..scene.camera import Camera
from ..scene.height_tints import height_tints
from ..scene.lights import Light
from ..scene.triangles import Triangles
from ..sun.location import Place
from .control_panel import Controls
from .gizmos import Gizmos, probe
from .progressive_pictures import (
    CLICK,
    HAZE,
    MESH,
    NEW_MESH,
    Check,
    ClientView,
    Step,
    TaskQueue,
    TracedPicture,
    first_pose,
    place_camera,
    trace_picture,
)
from .proxy_mesh import ProxyMesh, glb_of, proxy_colours, proxy_light, proxy_mesh
from .request_guard import LOG, Guard, guarding, one_line
from .viewer_model import Model

# --- The server and its event handlers --------------------------------------------------------------------------------


_STILL = 1120, 900  # pixels of the page for which the first picture is traced
_SETTLED = 0.5  # seconds after a change until the proxy mesh is baked again


class Page:
    """A page and its server.

    Parameters
    ----------
    model : Model
    host, port : str, int
        Port 0: any free port.
    allow_host : sequence of str
        Additional names or addresses of the page.
    still : (h, w, 3) uint8
        The picture that the page shows until the browser has drawn one.

    Raises
    ------
    InputError
        If viser is missing or cannot be guarded, the port is busy, or a name is invalid.
    """

    def __init__(
        self, model: Model, host: str, port: int, allow_host: Sequence[str] = (), still: NDArray[np.uint8] = HAZE
    ):
        viser = import_extra("viser", "the viewer", "view")
        self.model, self.host = model, host
        self.guard, port = Guard(host, allow_host, png_file(still)), checked_port(host, port)
        self._still = still
        self._views: dict[int, ClientView] = {}
        self._mesh: tuple[ProxyMesh, float, Triangles | None] | None = None  # with its time and `SceneData.moved`
        self._proxy: bytes | None = None
        with redirect_stdout(io.StringIO()), guarding(self.guard):  # the command prints the address itself
            self.server = viser.ViserServer(host, port, label=f"Antumbra: {model.scene.name}", verbose=False)
        if not self.guard.in_place:
            self.server.stop()
            raise InputError(
                f"viser {viser.__version__} cannot be guarded; pip install 'antumbra[view]' installs a suitable version"
            )
        self.port = self.server.get_port()  # differs if another process has just taken ours
        self.worker = TaskQueue(self.show_error)
        self._set_up_scene()
        self.controls, self.gizmos = Controls(self), Gizmos(self)
        self.server.on_client_connect(self.listener(self._connect))
        self.server.on_client_disconnect(self.listener(self._disconnect))
        self.server.scene.on_click()(self.listener(self._click))

    @property
    def url(self) -> str:
        """The address of the page, with its token if it has one."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)
        page = f"http://{f'[{host}]' if ':' in host else host}:{self.port}"
        return f"{page}/{self.guard.token}/" if self.guard.token else page

    def listener(self, act: Callable[..., Awaitable[None]]) -> Callable[..., Awaitable[None]]:
        """A viser callback that awaits `act` and shows its errors in the panel."""

        async def listener(*event: Any) -> None:
            try:
                await act(*event)
            except Exception as error:
                if not isinstance(error, InputError):  # caused by a message that our page does not send
                    LOG.warning("invalid message: %s", one_line(error))
                self.show_error(error)

        return listener

    def changed(self) -> None:
        """Redraw everything after a change of the model."""
        self.controls.refresh()
        self.gizmos.refresh()
        for client_view in list(self._views.values()):
            client_view.begin(0.0)
        if self._proxy is not None:
            self.worker.submit("proxy mesh", NEW_MESH, self._bake_proxy, _SETTLED)

    def show_error(self, error: Exception) -> None:
        """Show an error in the panel."""
        reason = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        self.controls.say(one_line(reason))

    def close(self) -> None:
        """Stop the server and its threads."""
        self.worker.close()
        with redirect_stdout(io.StringIO()):
            self.server.stop()

    def _set_up_scene(self) -> None:
        scene, page_frame = self.server.scene, self.model.page_frame
        self.server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        self.server.gui.main_panel.dock_right()  # beside the scene, not over it
        scene.set_up_direction(tuple(page_frame.up))
        scene.world_axes.visible = False
        place_camera(self.server.initial_camera, first_pose(self.model, 1024, 1024))

    def show_first_view(self, client_id: int, camera: Any) -> None:
        """Move the camera of a browser to where a new page looks from."""
        self._views[client_id].go_home(camera)

    def latest(self, client_id: int) -> TracedPicture | None:
        """The picture that a browser shows; None before the first one."""
        view = self._views.get(client_id)
        return None if view is None else view.latest

    def camera_of(self, client_id: int) -> Camera | None:
        """The camera of a browser; None before its first message."""
        view = self._views.get(client_id)
        return None if view is None or view.pose is None else self.model.page_frame.camera(view.pose)

    async def _connect(self, client: Any) -> None:
        client_view = self._views[client.client_id] = ClientView(
            self.model, self.worker, client, self._on_sent, self._still
        )
        if self._proxy is not None:
            client_view.put_proxy(self._proxy)
        client_view.go_home(client.camera)
        client.camera.on_update(self.listener(client_view.look))
        await client_view.look(client.camera)

    async def _disconnect(self, client: Any) -> None:
        if client_view := self._views.pop(client.client_id, None):
            client_view.leave()
            self.controls.forget(client.client_id)

    def _on_sent(self, picture: TracedPicture) -> None:
        self.controls.show_picture(picture)
        if self._proxy is None and self.model.in_memory and not self.worker.has("proxy mesh"):
            self.worker.submit("proxy mesh", MESH, self._bake_proxy)

    async def _click(self, event: Any) -> None:
        origin = self.model.page_frame.to_world(np.array(event.ray_origin))
        direction = np.array(event.ray_direction, np.float64)

        def work(check: Check) -> None:
            point = probe(self.model, origin, direction)
            self.gizmos.point_at(point)
            self.controls.describe(point)

        self.worker.submit("click", CLICK, work)

    def _bake_proxy(self, check: Check) -> None:
        """Bake the proxy mesh and send it to all browsers."""
        model, scene, time = self.model, self.model.scene, self.model.time
        if model.exposure is None:
            return
        moved = scene.data.moved
        if self._mesh is None or self._mesh[1] != time or self._mesh[2] is not moved:
            self._mesh = proxy_mesh(scene.triangles(time, model.threads)), time, moved
        pieces = self._mesh[0]
        base = height_tints(scene.data, pieces.corners.mean(1))
        if base is None:
            base = scene.colours[pieces.faces]
        colours = proxy_colours(proxy_light(model, pieces, check), pieces.normals, base, model)
        self._proxy = glb_of(model.page_frame.to_page(pieces.corners + scene.origin), colours)
        for client_view in list(self._views.values()):
            client_view.put_proxy(self._proxy)


def checked_port(host: str, port: int) -> int:
    """The port, or a free one for 0, if a server can listen there.

    Raises
    ------
    InputError
        If the port is busy or not allowed, or the host is not an address of this machine.
    """
    if not host:
        raise InputError("the host is empty; use 127.0.0.1 for this machine alone, or 0.0.0.0 to expose the page")
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as server:
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            server.bind(address)
            return int(server.getsockname()[1])
    except (OSError, OverflowError) as error:
        number = getattr(error, "errno", None)
        if number == errno.EADDRINUSE:
            raise InputError(f"port {port} is busy; choose another with --port or port=, 0 for any free port") from None
        if number == errno.EACCES:
            raise InputError(
                f"port {port} is reserved; choose one from 1024 to 65535, or 0 for any free port"
            ) from None
        raise InputError(f"cannot listen on {host}, port {port} ({error}); 127.0.0.1 is this machine") from None


# --- The public face --------------------------------------------------------------------------------------------------


HOST, PORT = "127.0.0.1", 8080


class Viewer:
    """An open page, returned by `antumbra.view`. As a context manager, it closes the page at the end.

    Attributes
    ----------
    url : str
        The address of the page, with its token if other machines can reach it.
    scene : Scene or PagedScene
    time : float
        Seconds. Setting it moves the animation.
    lights : list of lights
        The lights that are on, as moved by the user.
    camera : Camera
        The camera of the browser that moved last.

    Notes
    -----
    The state remains after the page is closed: ``at.render(scene, viewer.camera, viewer.lights, time=viewer.time)``.
    """

    def __init__(self, page: Page):
        if not isinstance(page, Page):
            raise InputError(f"page is {quoted(page)}; antumbra.view opens a page")
        self._page: Page | None = page
        self._model = page.model
        self.url, self.scene = page.url, page.model.scene

    @property
    def time(self) -> float:
        """The time shown by the page, in seconds. Setting it moves the animation."""
        return self._model.time

    @time.setter
    def time(self, time: float) -> None:
        self._model.go_to(time)
        if self._page is not None:
            self._page.changed()

    @property
    def lights(self) -> list[Light]:
        """The lights that are on, as moved by the user."""
        return [lamp.light for lamp in self._model.active_lights]

    @property
    def camera(self) -> Camera:
        """The camera of the browser that moved last; before any, the initial camera."""
        return self._model.last_camera or self._model.first_camera(1024, 1024)

    def wait(self) -> None:
        """Wait until the page is closed or Ctrl-C is pressed."""
        while self._page is not None:
            sleep(0.2)

    def close(self) -> None:
        """Stop the server. Closing again has no effect."""
        page, self._page = self._page, None
        if page is not None:
            page.close()

    def __enter__(self) -> "Viewer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Viewer({self.scene.name!r}, {self.url if self._page is not None else 'closed'})"

    def _repr_html_(self) -> str:
        """The page, embedded in a notebook."""
        if self._page is None:
            return f"<p>{escape(repr(self))}</p>"
        return f'<iframe src="{self.url}" width="100%" height="600" style="border: 0"></iframe>'


def view(
    scene: SceneLike,
    lights: Sequence[Light] | Light | None = None,
    *,
    camera: Camera | None = None,
    time: float = 0.0,
    plan: str | Plan | None = None,
    threads: int | None = None,
    max_memory: int | None = None,
    device: str | None = None,
    place: Place | None = None,
    port: int = PORT,
    host: str = HOST,
    allow_host: Sequence[str] | str = (),
    browser: bool | None = None,
) -> Viewer:
    """Show a scene in the browser, with traced pictures, movable lights, and the visibility at clicked points.

    While the camera moves, the browser shows a proxy mesh with baked light; when it stops, traced pictures appear, from
    coarse to fine. Requires ``antumbra[view]``.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    lights : list of lights, one light, or None
        None: ``scene.default_lights(time)``.
    camera : Camera or None
        The initial view. None: the scene's first camera, or ``scene.default_camera()``.
    time : float
        Seconds into the animation.
    plan, threads, max_memory, device
        As in `antumbra.render`.
    place : Place or None
        Location of the scene on Earth (`antumbra.place_of`), which lets the sun follow a date and time.
    port : int
        Port of the server; 0: any free port.
    host : str
        Address on which the server listens. The default serves this machine alone. ``0.0.0.0`` exposes the page to
        the network, protected by the token in `Viewer.url`.
    allow_host : str or list of str
        Additional names or addresses of the page, such as that of a proxy. Requests for any other name are refused, as
        are requests from pages of other sites.
    browser : bool or None
        Whether to open a browser. None: except in a notebook, which embeds the page.

    Returns
    -------
    Viewer
        With the attribute `url` and the method `close()`.

    Raises
    ------
    InputError
        If viser is missing, the port is busy, or an argument is invalid.

    Examples
    --------
    >>> room = at.procedural("atrium", triangles=5_000)
    >>> viewer = at.view(room, room.lights)  # doctest: +SKIP
    """
    port = whole_number(port, "port", 0, 65535)
    text(host, "host")
    allowed = items(allow_host, str, "allow_host")
    if browser is not None:
        browser = flag(browser, "browser")
    engine = EngineOptions(plan=plan, threads=threads, max_memory=max_memory, device=device)
    model = Model(scene_of(scene), lights, camera, time, engine=engine, place=place)
    if isinstance(scene, str | Path):
        model.source = shlex.quote(str(scene))
    viewer = Viewer(Page(model, host, port, allowed, prepare(model).image))
    if "ipykernel" not in sys.modules if browser is None else browser:
        webbrowser.open(viewer.url)
    return viewer


def name_scene(viewer: Viewer, source: str) -> None:
    """Name the scene in the commands that the page copies: the argument SCENE and its options, quoted for a shell."""
    viewer._model.source = source


def prepare(model: Model) -> TracedPicture:
    """Compile the kernels, and build the tree with a coarse picture, so that the page responds when it opens."""
    precompile("ray queries")
    precompile("filter and refinement")
    precompile("points")
    return trace_picture(model, model.first_camera(*_STILL), Step(4, 4))
