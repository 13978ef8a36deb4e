"""The page in the browser: its server, and what happens when somebody comes, clicks or changes something."""

import errno
import io
import socket
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from typing import Any

import numpy as np

from ..errors import InputError
from ..extras import import_extra
from .controls import Controls
from .glb import glb_of
from .guard import LOG, Guard, guarding, one_line
from .marks import Marks
from .model import Model
from .pictures import Traced
from .probe import probe
from .standin import Pieces, colours_of, light_of, pieces_of
from .viewing import Viewing
from .worker import CLICK, MESH, Worker

_SETTLED = 0.5  # seconds after a change until the stand-in gets the new light


class Page:
    """A page and its server.

    Parameters
    ----------
    model : Model
    host, port : str, int
        Port 0: any free one.
    allow_host : names or addresses
        Under which the page may be reached besides its own.

    Raises
    ------
    InputError
        If viser is missing or cannot be guarded, the port is busy, or a name is wrong.
    """

    def __init__(self, model: Model, host: str, port: int, allow_host: Sequence[str] = ()):
        viser = import_extra("viser", "the viewer", "view")
        self.model, self.host = model, host
        self.guard, port = Guard(host, allow_host), checked_port(host, port)
        self._viewings: dict[int, Viewing] = {}
        self._pieces: tuple[float, Pieces] | None = None  # those of a time
        self._standin: bytes | None = None
        with redirect_stdout(io.StringIO()), guarding(self.guard):  # the command says the address itself
            self.server = viser.ViserServer(host, port, label=model.scene.name, verbose=False)
        if not self.guard.in_place:
            self.server.stop()
            raise InputError(
                f"viser {viser.__version__} cannot be guarded; pip install 'antumbra[view]' gets a fit one"
            )
        self.port = self.server.get_port()  # another one if somebody has just taken ours
        self.worker = Worker(self.tell)
        self._furnish()
        self.controls, self.marks = Controls(self), Marks(self)
        self.server.on_client_connect(self.heard(self._enter))
        self.server.on_client_disconnect(self.heard(self._leave))
        self.server.scene.on_click()(self.heard(self._click))

    @property
    def url(self) -> str:
        """The address of the page, with its token if it has one."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)
        page = f"http://{f'[{host}]' if ':' in host else host}:{self.port}"
        return f"{page}/{self.guard.token}/" if self.guard.token else page

    def heard(self, act: Callable) -> Callable:
        """A listener for viser that calls the coroutine function `act`. The panel shows its errors."""

        async def listener(*event: Any) -> None:
            try:
                await act(*event)
            except Exception as error:
                if not isinstance(error, InputError):  # which a message that no page sends can cause
                    LOG.warning("a message was not understood: %s", one_line(error))
                self.tell(error)

        return listener

    def changed(self) -> None:
        """Draw everything anew after a change of the model."""
        self.controls.refresh()
        self.marks.refresh()
        for viewing in list(self._viewings.values()):
            viewing.begin(0.0)
        if self._standin is not None:
            self.worker.ask("stand-in", MESH, self._make_standin, _SETTLED)

    def tell(self, error: Exception) -> None:
        """Show an error in the panel."""
        reason = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        self.controls.say(one_line(reason))

    def close(self) -> None:
        """End the server and its threads."""
        self.worker.close()
        with redirect_stdout(io.StringIO()):
            self.server.stop()

    def _furnish(self) -> None:
        scene, stage = self.server.scene, self.model.stage
        self.server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        scene.set_up_direction(tuple(stage.up))
        scene.world_axes.visible = False
        pose, camera = stage.first_pose(self.model.first_camera(1024, 1024)), self.server.initial_camera
        camera.position, camera.look_at, camera.fov = pose.position, pose.target, pose.vfov

    async def _enter(self, client: Any) -> None:
        viewing = self._viewings[client.client_id] = Viewing(self.model, self.worker, client, self._drawn)
        if self._standin is not None:
            viewing.put_standin(self._standin)
        client.camera.on_update(self.heard(viewing.look))
        await viewing.look(client.camera)

    async def _leave(self, client: Any) -> None:
        if viewing := self._viewings.pop(client.client_id, None):
            viewing.leave()

    def _drawn(self, picture: Traced) -> None:
        self.controls.tell(picture)
        if self._standin is None and self.model.in_memory and not self.worker.has("stand-in"):
            self.worker.ask("stand-in", MESH, self._make_standin)

    async def _click(self, event: Any) -> None:
        origin = self.model.stage.to_world(np.array(event.ray_origin))
        direction = np.array(event.ray_direction, np.float64)

        def work(check) -> None:
            found = probe(self.model, origin, direction)
            self.marks.point_at(found)
            self.controls.describe(found)

        self.worker.ask("click", CLICK, work)

    def _make_standin(self, check) -> None:
        """Bake the light of the stand-in, and send it to all browsers."""
        model, scene, time = self.model, self.model.scene, self.model.time
        if model.exposure is None:
            return
        if self._pieces is None or self._pieces[0] != time:
            self._pieces = time, pieces_of(scene.triangles(time, model.threads))
        pieces = self._pieces[1]
        colours = colours_of(light_of(model, pieces, check), pieces.normals, scene.colours[pieces.faces], model)
        self._standin = glb_of(model.stage.to_page(pieces.corners + scene.origin), colours)
        for viewing in list(self._viewings.values()):
            viewing.put_standin(self._standin)


def checked_port(host: str, port: int) -> int:
    """The port, or a free one for 0, if a server can listen there.

    Raises
    ------
    InputError
        If the port is busy or not allowed, or the host is not an address of this machine.
    """
    if not host:
        raise InputError("the host is empty; give 127.0.0.1 for this machine alone, or 0.0.0.0 for all that reach it")
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as found:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            found.bind(address)
            return found.getsockname()[1]
    except (OSError, OverflowError) as error:
        number = getattr(error, "errno", None)
        if number == errno.EADDRINUSE:
            raise InputError(f"port {port} is busy; give another one by --port or port=, 0 for any free port") from None
        if number == errno.EACCES:
            raise InputError(f"port {port} is reserved; give one from 1024 to 65535, or 0 for any free port") from None
        raise InputError(f"cannot listen at {host}, port {port} ({error}); 127.0.0.1 is this machine") from None
