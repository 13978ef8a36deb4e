"""Files at URLs: which names are URLs, ranges of bytes, and what a server that fails leads to."""

from pathlib import Path

import pytest

from antumbra.base.errors import InputError
from antumbra.base.remote_files import RemoteFile, gdal_name, url_of, without_urls
from range_server import serving

URLS = {
    "https://example.org/d/a.tif": ("https://example.org/d/a.tif", "/vsicurl/https://example.org/d/a.tif"),
    "HTTP://example.org/a.tif": ("http://example.org/a.tif", "/vsicurl/http://example.org/a.tif"),
    "/vsicurl/https://example.org/a.tif": ("https://example.org/a.tif", "/vsicurl/https://example.org/a.tif"),
    "s3://bucket/d/a.tif": ("s3://bucket/d/a.tif", "/vsis3/bucket/d/a.tif"),
    "/vsis3/bucket/a.tif": ("s3://bucket/a.tif", "/vsis3/bucket/a.tif"),
    "gs://bucket/a.tif": ("gs://bucket/a.tif", "/vsigs/bucket/a.tif"),
    "az://container/a.tif": ("az://container/a.tif", "/vsiaz/container/a.tif"),
}
LOCAL = (
    *(
        "a.tif",
        "/data/https/a.tif",
        "s3/a.tif",
        "vsis3/bucket/a.tif",
        "C:/a.tif",
        "https://example.org",
        "file:///a.tif",
    ),
    *("/vsizip/a.zip/a.tif", "/vsizip//vsicurl/https://example.org/a.zip/a.tif", "/vsicurl/a.tif", "ftp://host/a.tif"),
)


@pytest.mark.parametrize("text", URLS)
def test_urls_and_the_paths_of_gdal_are_recognised_although_a_path_joins_slashes(text):
    url = url_of(Path(text))
    assert (url, gdal_name(url)) == URLS[text]


@pytest.mark.parametrize("text", LOCAL)
def test_other_names_are_local(text):
    assert url_of(Path(text)) is None


def test_names_in_files_are_refused():
    with without_urls("as a file says"):
        assert url_of(Path("a.tif")) is None
        with pytest.raises(InputError, match=r"a\.tif: is read from s3://bucket/a\.tif, as a file says"):
            url_of(Path("s3://bucket/a.tif"))
    assert url_of(Path("s3://bucket/a.tif")) == "s3://bucket/a.tif"


def test_ranges_are_read_and_nothing_else(tmp_path, monkeypatch):
    pytest.importorskip("obstore")
    data = bytes(range(256)) * 400
    (tmp_path / "a b.bin").write_bytes(data)
    with serving(tmp_path, monkeypatch) as server:
        file = RemoteFile(f"{server.url}/a%20b.bin", "a b.bin")
        assert file.size == len(data)
        for offset, size in ((0, 10), (1000, 5000), (len(data) - 3, 10), (len(data), 4)):
            view = memoryview(bytearray(size))
            n = file.read(view, offset)
            assert bytes(view[:n]) == data[offset : offset + size]
        assert server.sent == 10 + 5000 + 3
        assert server.paths() == {"/a b.bin"}


def test_a_missing_file_and_a_server_without_ranges_are_one_line_with_the_remedy(tmp_path, monkeypatch):
    pytest.importorskip("obstore")
    (tmp_path / "a.bin").write_bytes(b"abc" * 100)
    with serving(tmp_path, monkeypatch, ranges=False) as server:
        remedy = "check the URL and your access to it, or download the file"
        with pytest.raises(InputError, match=rf"b\.bin: cannot be read from {server.url} \(.*{remedy}"):
            RemoteFile(f"{server.url}/b.bin", "b.bin")
        file = RemoteFile(f"{server.url}/a.bin", "a.bin")
        with pytest.raises(InputError, match=rf"a\.bin: cannot be read from .*{remedy}"):
            file.read(memoryview(bytearray(5)), 7)
