"""Films: their size, speed and pictures, read back by ffmpeg and Pillow."""

import sys

import numpy as np
import pytest
from PIL import Image

from antumbra import InputError
from antumbra.picture.image_files import check_film, write_film


@pytest.fixture
def pictures(tmp_path):
    """Five pictures of 31 x 21 pixels: a white bar moves to the right over a coloured ground."""
    paths = [tmp_path / f"{k}.png" for k in range(5)]
    for k, path in enumerate(paths):
        pixels = np.full((21, 31, 3), (40, 90, 160), np.uint8)
        pixels[:, 6 * k : 6 * k + 6] = 255
        Image.fromarray(pixels).save(path)
    return paths


def frames_of(path) -> tuple[dict, list[np.ndarray]]:
    import imageio_ffmpeg

    reader = imageio_ffmpeg.read_frames(str(path))
    metadata = next(reader)
    width, height = metadata["size"]
    return metadata, [np.frombuffer(data, np.uint8).reshape(height, width, 3) for data in reader]


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_films_have_the_pictures_their_speed_and_colours(pictures, tmp_path, suffix):
    calls = []
    write_film(pictures, tmp_path / f"a{suffix}", 10.0, lambda *done: calls.append(done))
    metadata, frames = frames_of(tmp_path / f"a{suffix}")
    assert metadata["fps"] == 10.0 and len(frames) == 5 and calls[-1] == (5, 5)
    for k, frame in enumerate(frames):
        assert frame.shape == (22, 32, 3)  # odd sides are filled up
        assert frame[10, 6 * k + 1 : 6 * k + 5].min() > 200
        ground = frame[10, (6 * k + 15) % 30].astype(int)
        assert np.abs(ground - (40, 90, 160)).max() < 30
        assert np.abs(frame[10, -1].astype(int) - frame[10, -2]).max() < 60
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"{k}.png" for k in range(5)] + [f"a{suffix}"]


def test_gifs(pictures, tmp_path):
    write_film(pictures, tmp_path / "a.gif", 24.0)
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 5 and film.size == (31, 21) and film.info["loop"] == 0
        total = 0
        for k in range(5):
            film.seek(k)
            total += film.info["duration"]
            pixels = np.asarray(film.convert("RGB")).astype(int)
            assert (pixels[10, 6 * k + 1 : 6 * k + 5] > 240).all()
            assert np.abs(pixels[10, (6 * k + 15) % 30] - (40, 90, 160)).max() < 8
    assert total == 210  # 5 / 24 s, in hundredths


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_film_that_cannot_be_finished_leaves_nothing(pictures, tmp_path, suffix):
    pictures[3].write_bytes(b"no picture")
    (tmp_path / f"a{suffix}").write_text("older")
    with pytest.raises(InputError, match="cannot be written"):
        write_film(pictures, tmp_path / f"a{suffix}", 24.0)
    assert (tmp_path / f"a{suffix}").read_text() == "older" and len(list(tmp_path.iterdir())) == 6


def test_an_interrupted_film_leaves_nothing(pictures, tmp_path):
    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_film(pictures, tmp_path / "a.mp4", 24.0, stop)
    assert len(list(tmp_path.iterdir())) == 5


def test_a_missing_ffmpeg_is_named_with_its_cure(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"a \.mp4 file needs imageio_ffmpeg: pip install 'antumbra\[video\]'"):
        check_film(tmp_path / "a.mp4")
    assert check_film(tmp_path / "a.gif") == tmp_path / "a.gif"
    with pytest.raises(InputError, match="avi"):
        check_film(tmp_path / "a.avi")
