"""Guard the viewer's server: check the host, origin and token of each request, and drop unsafe messages.

Any web page can open a WebSocket to any address, and a DNS name can be made to point at this machine at any time.
Therefore the ``Host`` and ``Origin`` of every request are checked, and a page exposed to other machines needs a token.

viser obeys whatever a client sends: a client could remove controls that all browsers share, upload files, or publish
the page through viser's relay on the internet. Only messages that our page sends reach viser.
"""

import asyncio
import importlib
import logging
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from http import HTTPStatus
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from ..base.checks import quoted
from ..base.errors import InputError
from ..base.wording import counted
from .page_html import with_our_look

LOG = logging.getLogger("antumbra.viewer")

_LOOPBACK = "localhost", "127.0.0.1", "::1"
_LONGEST = 200  # most characters of a log line that a client can cause
_STARTING = threading.Lock()  # one server starts at a time

MAX_CLIENTS = 16
"""Most browsers that a page serves at a time; each takes about 45 MB of memory for its pictures and proxy mesh."""

_MAX_MESSAGE = 1 << 16  # bytes of a client's message; those of our page have less than a thousand
_CLIENT_MESSAGES = {
    "ViewerCameraMessage", "GuiUpdateMessage", "SceneNodeClickMessage", "ScenePointerMessage",
    "TransformControlsUpdateMessage", "TransformControlsDragStartMessage", "TransformControlsDragEndMessage",
}  # fmt: skip


class Guard:
    """Decides which requests reach the page.

    Parameters
    ----------
    host : str
        The address on which the server listens.
    allow_host : sequence of str
        Additional names or addresses of the page.

    still : bytes
        A PNG file that the page shows until the browser has drawn a picture; empty for none.

    Attributes
    ----------
    token : str
        The first part of the path of each request; empty if only this machine can reach the server.
    """

    def __init__(self, host: str, allow_host: Sequence[str] = (), still: bytes = b""):
        self.still = still
        self.allowed = {_allowed(name) for name in allow_host}
        names = _LOOPBACK if is_loopback(host) else (*_LOOPBACK, *_names())
        self.names = {*self.allowed, *names, canonical(host)}
        self.token = "" if is_loopback(host) else secrets.token_urlsafe(16)
        self.in_place = False  # whether a server uses it
        self.clients = 0  # connected browsers

    def refusal(self, request: Any, reached: str) -> str | None:
        """The reason why a request is refused, on one line; None: it is allowed.

        Parameters
        ----------
        request : websockets.http11.Request
        reached : str
            The address of this machine to which the client connected.
        """
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        host = name_of(hosts[0]) if len(hosts) == 1 else None
        if host is None or host not in {*self.names, canonical(reached)}:
            return f"{_quoted_list(hosts)} is not an address of this page; add it with --allow-host or allow_host="
        if origins and not (len(origins) == 1 and self._is_own(origins[0], hosts[0])):
            return f"pages of {_quoted_list(origins)} may not access this page"
        if not secrets.compare_digest(_token_of(request.path).encode(), self.token.encode()) and self.token:
            return "the token is missing; open the complete address that was printed at the start"
        return None

    def _is_own(self, origin: str, host: str) -> bool:
        """Whether a page of this origin is served by this host.

        The port of `host` may differ from ours, as in ``ssh -L 9000:localhost:8080``; no page can set that header.
        """
        scheme, _, netloc = origin.partition("://")
        return scheme in ("http", "https") and (netloc.lower() == host.lower() or name_of(netloc) in self.allowed)

    def check(self, connection: Any, request: Any, serve: Callable[[Any, Any], Any]) -> Any:
        """The response to a request: 403, 503 above `MAX_CLIENTS`, or that of `serve` to the path without its token."""
        reason = self.refusal(request, connection.local_address[0])
        if reason is not None:
            LOG.warning("refused a request: %s", one_line(reason))
            return connection.respond(HTTPStatus.FORBIDDEN, f"{reason}\n")
        if self.clients >= MAX_CLIENTS:
            LOG.warning("refused a browser: %d are connected", self.clients)
            return connection.respond(
                HTTPStatus.SERVICE_UNAVAILABLE,
                f"{counted(self.clients, 'browser', 'show')} this page; close one, then reload\n",
            )
        if self.token:
            request = type(request)(request.path.removeprefix(f"/{self.token}") or "/", request.headers)
        return with_our_look(serve(connection, request), self.still)


@contextmanager
def guarding(guard: Guard) -> Iterator[None]:
    """Install the guard in the websockets server that viser starts within this block.

    viser looks ``serve`` up in its module when a server starts. Callers must check `Guard.in_place` afterwards, because
    another version of viser might import it differently.
    """
    library: Any = importlib.import_module("websockets.asyncio.server")
    serve = library.serve

    def guarded(handler: Callable[..., Any], *args: Any, process_request: Any = None, **options: Any) -> Any:
        if process_request is None or not handler.__module__.startswith("viser."):
            return serve(handler, *args, process_request=process_request, **options)  # not viser's server
        guard.in_place = True
        asyncio.get_running_loop().set_exception_handler(_log_task)
        check = lambda connection, request: guard.check(connection, request, process_request)
        options["max_size"] = _MAX_MESSAGE
        return serve(_guarded(handler, guard), *args, process_request=check, logger=_logger(), **options)

    with _STARTING:
        library.serve = guarded
        try:
            yield
        finally:
            library.serve = serve


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach a server that listens on a name or address.

    Raises
    ------
    InputError
        If the host is invalid.
    """
    try:
        addresses = socket.getaddrinfo(host or None, None, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, UnicodeError) as error:
        raise InputError(f"cannot listen on {host!r} ({error}); 127.0.0.1 is this machine") from None
    return all(ip_address(str(address[0]).partition("%")[0]).is_loopback for *_, address in addresses)


def name_of(netloc: str) -> str | None:
    """The name or address in ``name:port``, in lower case; None if it is neither."""
    try:
        parts = urlsplit(f"//{netloc}")
        _ = parts.port  # raises
    except ValueError:
        return None
    if not parts.hostname or parts.netloc != netloc or set(netloc) & set("@ "):
        return None
    return canonical(parts.hostname)


def canonical(name: str) -> str:
    """A name in lower case, or an address as Python writes it."""
    try:
        return str(ip_address(name.partition("%")[0]))
    except ValueError:
        return name.lower()


def one_line(text: Any) -> str:
    """A text or exception caused by a client, on one line of bounded length."""
    text = f"{type(text).__name__}: {text}" if isinstance(text, BaseException) else str(text)
    line = " ".join("".join(c if c.isprintable() else " " for c in text[: 4 * _LONGEST]).split())
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]}..."


def _allowed(name: Any) -> str:
    host = name_of(name if not str(name).count(":") > 1 else f"[{name}]") if isinstance(name, str) else None
    if host is None or host != canonical(name):
        raise InputError(
            f"allow_host: {quoted(name)} is not a name or address; use one such as gpu.example.org, without a port"
        )
    return host


def _names() -> set[str]:
    """The names of this machine."""
    names = {socket.gethostname().lower(), socket.getfqdn().lower()} - {""}
    return names | {f"{name}.local" for name in names if "." not in name}


def _token_of(path: str) -> str:
    return path.partition("?")[0].split("/")[1] if path.startswith("/") else ""


def _quoted_list(values: list[str]) -> str:
    return one_line(", ".join(map(repr, values))) or "a request without Host"


def _guarded(handler: Callable[[Any], Awaitable[None]], guard: Guard) -> Callable[[Any], Awaitable[None]]:
    """Wrap viser's connection handler: it gets only messages of our page, and failures are logged as one line."""
    import viser

    async def guarded(connection: Any) -> None:
        if connection.subprotocol != f"viser-v{viser.__version__}":  # viser would print the mismatch
            LOG.warning("refused a client with another version: %s", one_line(connection.subprotocol))
            await connection.close(1002, f"the page is of viser {viser.__version__}; reload it")
            return
        receive = connection.recv

        async def receive_ours() -> Any:
            while True:
                message = await receive()
                if may_send(message):
                    return message
                LOG.warning("ignored a message that the page does not send: %s", one_line(message[:_LONGEST]))

        connection.recv = receive_ours
        guard.clients += 1
        try:
            await handler(connection)
        except Exception as error:
            LOG.warning("a malformed message ended a connection: %s", one_line(error))
            await connection.close(1002, "malformed message")
        finally:
            guard.clients -= 1

    return guarded


def may_send(message: bytes) -> bool:
    """Whether a client may send a message: whether our page does, or it is malformed, which viser will notice."""
    from msgspec import MsgspecError, msgpack  # of viser

    try:
        fields = msgpack.decode(message)
        kind = fields["type"]
        if kind == "GuiUpdateMessage":
            return set(fields["updates"]) <= {"value"}  # others are attributes of viser's own objects
        return kind in _CLIENT_MESSAGES or not _is_message(kind)
    except (MsgspecError, TypeError, KeyError, ValueError, RecursionError):
        return True


def _is_message(kind: object) -> bool:
    """Whether viser has messages of a kind."""
    from viser._messages import Message

    return isinstance(kind, str) and kind in {each.__name__ for each in Message.get_subclasses()}


def _log_task(loop: Any, context: dict[str, Any]) -> None:
    """The exception handler of the server's event loop. Tasks left over when it stops have no exception."""
    if context.get("exception") is not None:
        LOG.warning("invalid message: %s", one_line(context["exception"]))


class _OneLine(logging.Filter):
    """Replaces tracebacks of websockets, which any port scanner can trigger, by one line."""

    def filter(self, record: logging.LogRecord) -> bool:
        if record.exc_info and record.exc_info[1] is not None:
            record.msg, record.args = "%s: %s", (record.getMessage(), one_line(record.exc_info[1]))
            record.exc_info = record.exc_text = None
        return True


def _logger() -> logging.Logger:
    """The logger of a websockets server."""
    logger = logging.Logger("antumbra.viewer.server", logging.WARNING)
    logger.parent = LOG
    logger.addFilter(_OneLine())
    return logger
