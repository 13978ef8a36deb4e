"""Files on web servers and in object storage: the URLs that users give, and their bytes, read by range.

Only names that the user gives, on the command line or as an argument, may lead to the network. Names inside files pass
through `files.sibling` and `files.checked_file`, which refuse URLs, and a recorded command runs within `without_urls`.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from urllib.parse import unquote

from .errors import InputError
from .extras import import_extra

# --- URLs -------------------------------------------------------------------------------------------------------------


_URL = re.compile(r"(?:/vsicurl/(?=https?:))?(?:(https?|s3|gs|az):/+|/vsi(s3|gs|az)/+)([^/]+/.+)", re.I)
_refusal: ContextVar[str | None] = ContextVar("antumbra_refusal_of_urls", default=None)


def url_of(path: Path) -> str | None:
    """The URL that a path names: of https, http, s3, gs or az, or a path of GDAL's; None for local paths.

    A `Path` joins slashes, so ``https:/host/a.tif`` is ``https://host/a.tif``.

    Raises
    ------
    InputError
        If it is a URL, within `without_urls`.
    """
    match = _URL.fullmatch(path.as_posix())
    if match is None:
        return None
    url = f"{(match[1] or match[2]).lower()}://{match[3]}"
    if refusal := _refusal.get():
        raise InputError(f"{path.name}: is read from {url}, {refusal}")
    return url


@contextmanager
def without_urls(refusal: str) -> Iterator[None]:
    """Within the context, URLs are refused, since a file names them; `refusal`: which one, and the remedy."""
    token = _refusal.set(refusal)
    try:
        yield
    finally:
        _refusal.reset(token)


def gdal_name(url: str) -> str:
    """A URL as a path in GDAL's virtual file systems."""
    scheme, _, rest = url.partition("://")
    return f"/vsicurl/{url}" if scheme in ("http", "https") else f"/vsi{scheme}/{rest}"


def unreachable(where: str, url: str, reason: object) -> InputError:
    """The error about a file that a server does not deliver."""
    text = " ".join(str(reason).partition("\n")[0].split())[:160]
    line = "check the URL and your access to it, or download the file"
    return InputError(f"{where}: cannot be read from {url.rpartition('/')[0]} ({text}); {line}")


# --- Bytes ------------------------------------------------------------------------------------------------------------


_RETRIES = {"max_retries": 3}


class RemoteFile:
    """The bytes of a file at a URL. Several threads may read at a time.

    Credentials and endpoints of object storage come from the environment, as obstore documents them.

    Attributes
    ----------
    size : int

    Raises
    ------
    InputError
        If the server has no such file, does not tell its size, or cannot be reached.
    """

    def __init__(self, url: str, where: str):
        self._obstore = import_extra("obstore", f"{where}: reading from {url.partition(':')[0]}", "cloud")
        stores = import_extra("obstore.store", where, "cloud")
        self._url, self._where, self.closed = url, where, False
        folder, _, name = url.rpartition("/")
        self._name = unquote(name) if url.startswith("http") else name  # the library quotes it
        options = {"allow_http": True} if url.startswith("http:") else None  # None: those of the environment
        try:
            self._store = stores.from_url(folder, client_options=options, retry_config=_RETRIES)
            self.size = int(self._obstore.head(self._store, self._name)["size"])
        except Exception as error:  # the library has classes of errors of its own, and raises those of Python
            raise unreachable(where, url, error) from None

    def read(self, view: memoryview, offset: int) -> int:
        """Fill a view with the bytes from `offset` on, and return their number; fewer at the end of the file.

        Raises
        ------
        InputError
            If the server does not deliver them.
        """
        end = min(offset + len(view), self.size)
        if end <= offset:
            return 0
        try:
            data = memoryview(self._obstore.get_range(self._store, self._name, start=offset, end=end))
        except Exception as error:
            raise unreachable(self._where, self._url, error) from None
        view[: len(data)] = data
        return len(data)

    def state(self) -> object:
        """Another one each time, since what a server delivers is checked whenever it arrives."""
        return object()

    def close(self) -> None:
        """Let no more bytes be read."""
        self.closed = True
