"""Which requests reach the page: a real server, and real clients of it."""

import asyncio
import gzip
import http.client
import logging
import re
import socket
import time
from types import SimpleNamespace

import pytest

import antumbra as at
from antumbra.viewer import request_guard
from antumbra.viewer.request_guard import LOG, Guard, guarding, is_loopback, name_of, one_line
from pages import CAMERA, SUN, box_on_floor

viser = pytest.importorskip("viser", reason="no viser: the guard of the viewer is NOT tested")
websockets = pytest.importorskip("websockets")
msgpack = pytest.importorskip("msgspec.msgpack")  # with which viser packs its messages

from websockets.sync.client import connect  # noqa: E402

from antumbra.viewer.viewer_model import Model  # noqa: E402
from antumbra.viewer.viewer_page import Page, checked_port  # noqa: E402

VERSION = f"viser-v{viser.__version__}"


def opened(host="127.0.0.1", **options):
    return Page(Model(box_on_floor(), SUN, CAMERA), host, 0, **options)


@pytest.fixture(scope="module")
def local():
    page = opened(allow_host=["proxy.example"])
    yield page
    page.close()


@pytest.fixture(scope="module")
def shared():
    page = opened("0.0.0.0")
    yield page
    page.close()


def fetched(page, path="/", host=None, **headers):
    """(status, body) of a plain request. host None: that of the page."""
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=20)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in {"Host": host or f"127.0.0.1:{page.port}", **headers}.items():
        for each in [value] if isinstance(value, str) else value:
            connection.putheader(name, each)
    connection.endheaders()
    answer = connection.getresponse()
    return answer.status, answer.read()


def shaken(page, path="/", host=None, **headers):
    """(status of a WebSocket handshake, length of the first message) of a client that is as viser's own."""
    more = {"Host": host, **headers} if host else headers

    class Client(websockets.ClientProtocol):
        def connect(self):
            request = super().connect()
            for name, value in more.items():
                if name in request.headers:
                    del request.headers[name]
                for each in [value] if isinstance(value, str) else value:
                    request.headers[name] = each
            return request

    with socket.create_connection(("127.0.0.1", page.port), timeout=20) as link:
        client = Client(websockets.uri.parse_uri(f"ws://127.0.0.1:{page.port}{path}"), subprotocols=[VERSION])
        client.send_request(client.connect())
        link.sendall(b"".join(client.data_to_send()))
        status = None
        while True:
            data = link.recv(1 << 16)
            client.receive_data(data) if data else client.receive_eof()
            for event in client.events_received():
                if status is not None:
                    return status, len(event.data)
                status = event.status_code
            if status not in (None, 101) or not data:
                return status, 0


def connected(page, version=VERSION):
    """A WebSocket to a page without a token, as viser's client opens it."""
    return connect(f"ws://127.0.0.1:{page.port}", subprotocols=[version], max_size=None, compression=None)


FOREIGN = [
    {"host": "evil.example"}, {"host": "evil.example:{port}"}, {"host": "127.0.0.1.evil.example:{port}"},
    {"host": "10.1.2.3:{port}"}, {"host": "localhost:{port}:1"}, {"host": "localhost@evil.example"}, {"host": "[::2]"},
    {"host": "localhost:99999"}, {"Origin": "http://evil.example"}, {"Origin": "http://evil.example:{port}"},
    {"Origin": "null"}, {"Origin": "http://127.0.0.1:1"}, {"Origin": "http://localhost:{port}"},
    {"Origin": "http://127.0.0.1:{port}.evil.example"}, {"Origin": "file://"}, {"Origin": "ftp://127.0.0.1:{port}"},
    {"Origin": "//127.0.0.1:{port}"}, {"Host": ["127.0.0.1:{port}", "evil.example"]},
    {"Origin": ["http://127.0.0.1:{port}", "http://evil.example"]},
    {"host": "proxy.example", "Origin": "http://evil.example"},
]  # fmt: skip

OWN = [
    {}, {"host": "localhost:{port}"}, {"host": "LocalHost"}, {"host": "[::1]:{port}"}, {"host": "127.0.0.1"},
    {"Origin": "http://127.0.0.1:{port}"}, {"host": "localhost:{port}", "Origin": "http://localhost:{port}"},
    {"host": "localhost:9000", "Origin": "http://localhost:9000"},  # ssh -L 9000:localhost:8080
    {"host": "proxy.example", "Origin": "https://proxy.example"}, {"Origin": "https://proxy.example"},
]  # fmt: skip


def filled(headers, port):
    fill = lambda v: v.replace("{port}", str(port)) if isinstance(v, str) else [fill(each) for each in v]
    return {name: fill(value) for name, value in headers.items()}


@pytest.mark.parametrize("headers", FOREIGN, ids=repr)
def test_foreign_requests_are_refused(local, headers, caplog):
    given = filled(headers, local.port)
    with caplog.at_level(logging.WARNING, LOG.name):
        assert shaken(local, **given) == (403, 0)
        status, body = fetched(local, **given)
    assert status == 403 and body.count(b"\n") == 1 and b"<html" not in body
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) == 2 and all(line.startswith("refused a request: ") and "\n" not in line for line in lines)


@pytest.mark.parametrize("headers", OWN, ids=repr)
def test_own_requests_are_served(local, headers):
    given = filled(headers, local.port)
    status, length = shaken(local, **given)
    assert status == 101 and length > 100  # the scene
    status, body = fetched(local, **given)
    assert status == 200 and b"<title>Antumbra</title>" in body


def test_the_compressed_page_has_our_title_too(local):
    connection = http.client.HTTPConnection("127.0.0.1", local.port, timeout=20)
    connection.request("GET", "/", headers={"Accept-Encoding": "gzip"})
    answer = connection.getresponse()
    assert answer.status == 200 and gzip.decompress(answer.read()) == fetched(local)[1]


def test_requests_without_a_host_are_refused(local):
    for version in b"HTTP/1.1", b"HTTP/1.0":
        with socket.create_connection(("127.0.0.1", local.port), timeout=20) as link:
            link.sendall(b"GET / " + version + b"\r\n\r\n")
            assert b"200" not in (link.recv(1000) or b"").split(b"\r\n")[0]


def test_a_page_for_other_machines_needs_its_token(shared):
    token = shared.guard.token
    assert len(token) >= 20 and shared.url == f"http://127.0.0.1:{shared.port}/{token}/"
    for path in "/", "/wrong/", f"/{token[:-1]}/", f"/{token}x/", f"/x/{token}/", f"/?token={token}", "/\xff/":
        path = path.encode("latin-1").decode("latin-1") if path.isascii() else "/%FF/"
        assert shaken(shared, path) == (403, 0), path
        assert fetched(shared, path)[0] == 403, path
    for path in f"/{token}/", f"/{token}", f"/{token}/?fixedDpr=1":
        status, length = shaken(shared, path)
        assert status == 101 and length > 100, path
        status, body = fetched(shared, path)
        assert status == 200 and b"<html" in body.lower(), path
    assert fetched(shared, f"/{token}/missing.js")[0] == fetched(shared, f"/{token}/../__init__.py")[0] == 404


def test_the_token_is_not_enough(shared):
    path = f"/{shared.guard.token}/"
    for headers in {"host": "evil.example"}, {"Origin": "http://evil.example"}, {"host": "8.8.8.8"}:
        assert shaken(shared, path, **headers) == (403, 0) and fetched(shared, path, **headers)[0] == 403
    for host in socket.gethostname(), f"{socket.gethostname().upper()}:1234", "localhost":
        assert fetched(shared, path, host)[0] == 200


def test_pages_for_this_machine_have_no_token(local):
    assert local.guard.token == "" and local.url == f"http://127.0.0.1:{local.port}"
    assert opened_token("::1") == opened_token("localhost") == opened_token("127.0.0.2") == ""
    tokens = {opened_token("0.0.0.0"), opened_token("::"), opened_token("0.0.0.0")}
    assert len(tokens) == 3 and "" not in tokens


def opened_token(host):
    return Guard(host).token


MALFORMED = [
    b"", b"\x00", b"\xc1", b"\x81\xa4type", b"\x80", b"\x81\xa4type\xa7Nothing", b"\x81\xa4type\x01", b"\x90",
    b"\x93\x01\x02\x03", b"\x81\xa4type\xa7Message", "text", "{}", b"\x81\xa4type\xb3ViewerCameraMessage",
    b"\xff" * 1000, b"\x91" * 5000,
]  # fmt: skip


@pytest.mark.parametrize("message", MALFORMED, ids=lambda m: repr(m)[:24])
def test_malformed_messages_are_one_line(local, message, caplog, capfd):
    with caplog.at_level(logging.DEBUG, LOG.name), connected(local) as client:
        client.recv()
        client.send(message)
        with pytest.raises(websockets.ConnectionClosed):
            while True:
                client.recv(timeout=20)
    (line,) = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert "\n" not in line.getMessage() and line.exc_info is None and "malformed message" in line.getMessage()
    assert client.close_code == 1002 and "Traceback" not in "".join(capfd.readouterr())
    assert shaken(local)[0] == 101  # it serves on


def sent(page, *messages, done):
    """Send dictionaries as viser's client does, until `done()` holds and all that follows from them is done."""
    with connected(page) as client:
        client.recv()
        for message in messages:
            client.send(msgpack.encode(message))
        end = time.monotonic() + 20
        while not done():
            assert time.monotonic() < end, "nothing happens"
            time.sleep(0.01)
        assert page.worker.wait()


def camera(**other):
    vectors = {name: [0.0, 0.0, 1.0] for name in ("position", "look_at", "up_direction")}
    fields = {"wxyz": [1.0, 0.0, 0.0, 0.0], "fov": 1.0, "near": 0.1, "far": 10.0, "image_height": 4, "image_width": 4}
    return {"type": "ViewerCameraMessage", **vectors, **fields, **other}


WRONG_VALUES = [
    camera(wxyz=[0.0] * 4), camera(wxyz=[float("nan")] * 4), camera(position=[1e300] * 3), camera(fov=-1.0),
    camera(image_width=1 << 40, image_height=1 << 40), camera(image_width=-5), camera(fov=1e9),
    {"type": "GuiUpdateMessage", "uuid": "nothing", "updates": {"value": 1}},
    {"type": "TransformControlsUpdateMessage", "name": "/nothing", "wxyz": [1, 0, 0, 0], "position": [0, 0, 0]},
]  # fmt: skip


@pytest.mark.parametrize("message", WRONG_VALUES, ids=lambda m: f"{m}"[:60])
def test_messages_with_wrong_values_change_nothing(local, message, capfd, monkeypatch):
    cameras = []
    seen = property(lambda _: None, lambda _, camera: cameras.append(camera))
    monkeypatch.setattr(type(local.model), "last_camera", seen, raising=False)
    sent(local, message, camera(image_width=7), done=lambda: cameras)
    assert [found.width for found in cameras] == [7]  # of the message that follows
    assert "Traceback" not in "".join(capfd.readouterr()) and shaken(local)[0] == 101


def test_wrong_values_of_controls_are_one_line(local, capfd, caplog):
    slider = local.controls.sliders["bearing"]
    wrong = "east", None, [1, 2], {"a": 1}, float("nan"), 1e400
    update = lambda value: {"type": "GuiUpdateMessage", "uuid": slider._impl.uuid, "updates": {"value": value}}
    with caplog.at_level(logging.WARNING, LOG.name):
        sent(local, *map(update, wrong), update(123.0), done=lambda: slider.value == 123.0)
    assert caplog.records and all(r.exc_info is None and "\n" not in r.getMessage() for r in caplog.records)
    assert "Traceback" not in "".join(capfd.readouterr()) and shaken(local)[0] == 101


def removals(page):
    """Messages by which a client would change controls for all others, or reach beyond the page."""
    slider = page.controls.sliders["bearing"]._impl.uuid
    attributes = {"removed": True, "sync_cb": None, "update_cb": [], "is_button": True, "uuid": "x", "props": None}
    for name, value in attributes.items():
        for more in {}, {"value": 5.0}:
            yield {"type": "GuiUpdateMessage", "uuid": slider, "updates": {name: value, **more}}
    yield {"type": "GuiRemoveMessage", "uuid": slider}
    yield {"type": "RemoveSceneNodeMessage", "name": "/point", "owner": ""}
    yield {"type": "ResetGuiMessage"}
    yield {"type": "ShareUrlRequest"}  # opens a tunnel to a relay on the internet
    yield {"type": "FileTransferStartUpload", "source_component_uuid": slider, "transfer_uuid": "a", "filename": "a"}


def test_clients_cannot_change_what_others_share(local, capfd, caplog):
    slider, messages = local.controls.sliders["bearing"], list(removals(local))
    update = {"type": "GuiUpdateMessage", "uuid": slider._impl.uuid, "updates": {"value": 77.0}}
    with caplog.at_level(logging.WARNING, LOG.name):
        sent(local, *messages, update, done=lambda: slider.value == 77.0)
    assert not slider._impl.removed and slider._impl.sync_cb is not None
    ignored = [record.getMessage() for record in caplog.records]
    assert len(ignored) == len(messages) and all(line.startswith("ignored a message that") for line in ignored)
    assert "Traceback" not in "".join(capfd.readouterr()) and shaken(local)[0] == 101


def test_a_page_serves_a_limited_number_of_browsers(local, monkeypatch, caplog):
    monkeypatch.setattr(request_guard, "MAX_CLIENTS", 2)
    until = time.monotonic() + 20
    while local.guard.clients and time.monotonic() < until:  # those of other tests have left
        time.sleep(0.01)
    with connected(local) as one, connected(local) as other:
        one.recv(timeout=20), other.recv(timeout=20)
        with caplog.at_level(logging.WARNING, LOG.name):
            status, body = fetched(local)
            assert status == 503 and body == b"2 browsers show this page; close one, then reload\n"
            assert shaken(local) == (503, 0)
    while local.guard.clients and time.monotonic() < until + 20:
        time.sleep(0.01)
    assert fetched(local)[0] == 200 and shaken(local)[0] == 101


@pytest.mark.parametrize("bytes_", [b"\x16\x03\x01\x00", b"GET\r\n\r\n", b"POST / HTTP/1.1\r\n\r\n", b"\r\n" * 9, b""])
def test_malformed_handshakes_are_one_line(local, bytes_, capfd, caplog):
    with caplog.at_level(logging.WARNING, LOG.name), socket.create_connection(("127.0.0.1", local.port), 20) as link:
        link.sendall(bytes_)
        link.shutdown(socket.SHUT_WR)
        while link.recv(1000):
            pass
    assert "Traceback" not in "".join(capfd.readouterr()) and shaken(local)[0] == 101
    assert all("\n" not in record.getMessage() and record.exc_info is None for record in caplog.records)


def test_clients_of_another_version_are_one_line(local, caplog, capfd):
    with (
        caplog.at_level(logging.WARNING, LOG.name),
        connected(local, "viser-v0.0") as client,
        pytest.raises(websockets.ConnectionClosed),
    ):
        client.recv(timeout=20)
    assert "viser-v0.0" in caplog.text and "".join(capfd.readouterr()) == ""


def test_names_of_hosts_are_read():
    known = {"a.example:80": "a.example", "A.Example": "a.example", "[0:0::1]:8080": "::1", "127.0.0.1": "127.0.0.1"}
    assert {text: name_of(text) for text in known} == known
    assert all(name_of(text) is None for text in ("", ":80", "a b", "a/b", "a?b", "u@a", "a:b", "[::1", "a:99999"))
    assert is_loopback("localhost") and not is_loopback("0.0.0.0") and not is_loopback("::")
    assert "\n" not in one_line("a\nb\x1b[0m") and len(one_line("x" * 9999)) < 210


@pytest.mark.parametrize("name", ["http://a", "a:80", "", "a b", 7, None, "a/b"])
def test_names_that_are_none_are_refused(name):
    with pytest.raises(at.InputError, match=r"allow_host: .* without a port"):
        Guard("127.0.0.1", [name])
    assert "::1" in Guard("0.0.0.0", ["::1", "10.0.0.7"]).allowed


def test_other_servers_are_left_alone():
    """A server of somebody else that starts at the same moment gets no guard."""
    import websockets.asyncio.server as library

    original = library.serve
    guard = Guard("127.0.0.1")

    async def start():
        with guarding(guard):
            async with library.serve(lambda connection: connection.close(), "127.0.0.1", 0):
                pass

    asyncio.run(start())
    assert not guard.in_place and library.serve is original


def test_a_viser_that_takes_no_guard_is_refused(monkeypatch):
    stopped = []
    server = SimpleNamespace(stop=lambda: stopped.append(True))
    monkeypatch.setattr(viser, "ViserServer", lambda *_, **__: server)
    with pytest.raises(at.InputError, match=re.escape(f"viser {viser.__version__} cannot be guarded")):
        opened()
    assert stopped


def test_an_empty_host_is_refused():
    with pytest.raises(at.InputError, match="the host is empty"):
        checked_port("", 0)
