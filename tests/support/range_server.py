"""A web server on this machine that serves ranges of the files in a folder, and records what it was asked for."""

import re
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from urllib.parse import unquote, urlsplit


class RangeServer:
    """What was asked of a server: `requests` are (method, path), and `sent` counts bytes of files."""

    def __init__(self, folder: Path, ranges: bool):
        self.folder, self.ranges = folder, ranges
        self.requests, self.sent, self.url = list[tuple[str, str]](), 0, ""

    def paths(self) -> set[str]:
        return {path for _, path in self.requests}

    def forget(self) -> None:
        self.requests, self.sent = [], 0


@contextmanager
def serving(folder: Path, monkeypatch, ranges: bool = True):
    """A `RangeServer` of a folder, at `url`; without ranges, it sends whole files, as simple servers do."""
    for name in "NO_PROXY", "no_proxy":
        monkeypatch.setenv(name, "127.0.0.1")
    monkeypatch.setenv("GDAL_HTTP_MAX_RETRY", "0")
    server = RangeServer(folder, ranges)
    web = ThreadingHTTPServer(("127.0.0.1", 0), _handler_of(server))
    web.daemon_threads = True
    server.url = f"http://127.0.0.1:{web.server_address[1]}"
    thread = Thread(target=web.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    try:
        yield server
    finally:
        web.shutdown()
        web.server_close()
        thread.join()


def _handler_of(server: RangeServer) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *_):
            pass

        def do_HEAD(self):
            self._answer(body=False)

        def do_GET(self):
            self._answer(body=True)

        def _answer(self, body: bool):
            path = unquote(urlsplit(self.path).path)
            server.requests.append((self.command, path))
            file = server.folder / path.lstrip("/")
            if not file.is_file():
                self.send_response(404)
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            data = file.read_bytes()
            span = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", "")) if server.ranges else None
            first, last = 0, len(data) - 1
            if span:
                first, last = int(span[1]), min(int(span[2] or last), last)
            self.send_response(206 if span else 200)
            if span:
                self.send_header("Content-Range", f"bytes {first}-{last}/{len(data)}")
            if server.ranges:
                self.send_header("Accept-Ranges", "bytes")
            self.send_header("Content-Length", str(last + 1 - first))
            self.send_header("Last-Modified", "Sun, 29 Nov 2026 00:00:00 GMT")
            self.end_headers()
            if body:
                self.wfile.write(data[first : last + 1])
                server.sent += last + 1 - first

    return Handler
