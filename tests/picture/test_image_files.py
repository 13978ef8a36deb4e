import os
import struct
import zlib

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import antumbra as at
from antumbra import InputError
from antumbra.picture import image_files
from antumbra.picture.image_files import to_srgb8


def entries(folder):
    return sorted(os.listdir(folder))


def png_chunks(data):
    at = 8
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        yield data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        at += 12 + length


def test_png_holds_the_tonemapped_picture(frame, tmp_path):
    frame.save(tmp_path / "a.png", exposure=0.7)
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == "RGB"
        assert (np.asarray(image) == to_srgb8(frame.image, 0.7)).all()
    assert entries(tmp_path) == ["a.png"]


def test_png_says_that_it_is_srgb(frame, tmp_path):
    frame.save(tmp_path / "a.png")
    chunks = dict(png_chunks((tmp_path / "a.png").read_bytes()))
    assert chunks[b"sRGB"] == b"\0"
    height, width = frame.image.shape[:2]
    assert len(zlib.decompress(chunks[b"IDAT"])) == height * (1 + 3 * width)


def test_png_without_exposure_has_the_automatic_one(frame, tmp_path):
    frame.save(tmp_path / "a.png")
    frame.save(str(tmp_path / "b.png"), exposure=image_files.frame_exposure(frame))
    frame.save(tmp_path / "c.PNG", exposure=4.0 * image_files.frame_exposure(frame))
    data = [(tmp_path / name).read_bytes() for name in ("a.png", "b.png", "c.PNG")]
    assert data[0] == data[1] != data[2]


def test_exr_holds_every_channel_exactly(frame, tmp_path):
    frame.save(tmp_path / "a.exr", exposure=0.1)
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    g, ids = frame.gbuffer, {"triangle.id"}
    wanted = {c: frame.image[..., k] for k, c in enumerate("RGB")} | {"A": frame.mask.astype(np.float32)}
    wanted |= {f"normal.{c}": g.normal[..., k] for k, c in enumerate("XYZ")}
    wanted |= {f"position.{c}": g.position[..., k] for k, c in enumerate("XYZ")}
    wanted |= {"depth.Z": g.depth, "shadow.0": frame.visibility[0], "shadow.1": frame.visibility[1]}
    wanted |= {"triangle.id": g.face.view(np.uint32)}
    assert channels.keys() == wanted.keys()
    for name, values in wanted.items():
        assert channels[name].dtype == (np.uint32 if name in ids else np.float32), name
        assert (channels[name] == values).all(), name
    assert np.isinf(channels["depth.Z"]).any() and not np.isinf(channels["depth.Z"]).all()
    assert entries(tmp_path) == ["a.exr"]


def test_an_empty_view_can_be_saved(frame, tmp_path):
    nothing = frame.gbuffer._replace(
        face=np.full_like(frame.gbuffer.face, -1), depth=np.full_like(frame.gbuffer.depth, np.inf)
    )
    empty = frame._replace(image=np.zeros_like(frame.image), gbuffer=nothing)
    empty.save(tmp_path / "a.png")
    empty.save(tmp_path / "a.exr")
    with Image.open(tmp_path / "a.png") as image:
        assert not np.asarray(image).any()


@pytest.mark.parametrize("exposure", [0.0, -1.0, np.nan, np.inf, "bright"])
def test_an_exposure_that_is_no_positive_number_is_refused(frame, tmp_path, exposure):
    for name in ("a.png", "a.exr"):
        with pytest.raises(InputError, match="exposure is"):
            frame.save(tmp_path / name, exposure=exposure)
    assert entries(tmp_path) == []


@pytest.mark.parametrize("name", ["a.jpg", "a", "a.png.txt", ".png"])
def test_other_suffixes_are_refused(frame, tmp_path, name):
    with pytest.raises(InputError, match=r"suffix.*use \.png or \.exr"):
        frame.save(tmp_path / name)
    with pytest.raises(InputError, match=r"suffix"):
        image_files.check_output(tmp_path / name)
    assert entries(tmp_path) == []


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_a_disk_that_is_full_leaves_the_older_file_and_no_other(frame, tmp_path, suffix):
    resource = pytest.importorskip("resource", reason="no RLIMIT_FSIZE on this system")
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"older")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (64, limits[1]))
    try:
        with pytest.raises(InputError, match="cannot be written") as caught:
            frame.save(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert str(path) in str(caught.value) and ".tmp" not in str(caught.value)
    assert path.read_bytes() == b"older"
    assert entries(tmp_path) == [path.name]


@pytest.mark.parametrize("writer, suffix", [("write_png", ".png"), ("write_exr", ".exr")])
@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_an_interrupted_save_leaves_no_file(frame, tmp_path, monkeypatch, writer, suffix, error):
    def interrupted(_, path, note, *more):
        path.write_bytes(b"half")
        raise error

    monkeypatch.setattr(image_files, writer, interrupted)
    with pytest.raises(error):
        frame.save(tmp_path / f"a{suffix}")
    assert entries(tmp_path) == []


@pytest.mark.parametrize("name", ["a.png", "a.exr"])
def test_a_note_is_kept_and_read_without_the_pixels(frame, tmp_path, name):
    path = tmp_path / name
    image_files.save_frame(frame, path, 1.0, "a note")
    assert image_files.note_of(path) == "a note"
    path.write_bytes(path.read_bytes()[: 300 if name == "a.png" else 1000])
    image_files.note_of(path)  # it must not fail on a partial picture
    frame.save(path)
    assert image_files.note_of(path) is None


def test_what_is_no_picture_has_no_note(tmp_path, capfd):
    for name in ("a.png", "a.exr"):
        assert image_files.note_of(tmp_path / name) is None
        (tmp_path / name).write_bytes(b"something else")
        assert image_files.note_of(tmp_path / name) is None
    assert capfd.readouterr() == ("", "")


def test_exr_holds_each_light_by_its_name(tmp_path):
    scene = at.procedural("atrium", triangles=2000)
    lamp = at.PointLight((0, 3, 0), intensity=20.0, colour=(1.0, 0.5, 0.2))
    lights = [scene.lights[0], lamp.named("lamp.left"), lamp, at.DirectionalLight((1, -1, 0))]
    frame = at.render(scene, scene.cameras[0].resized(40, 30), lights, spp=4, layers=True)
    frame.save(tmp_path / "a.exr")
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
        header = dict(file.header())
    names = ["quad", "lamp_left", "point", "sun"]
    assert list(frame.names) == names and {f"shadow.{name}" for name in names} <= channels.keys()
    whole = sum(np.stack([channels[f"light.{n}.{c}"] for c in "RGB"], -1) for n in names)
    rest = frame.image - whole  # ambient light, of one colour
    assert (rest > -1e-5).all() and (rest[frame.mask] > 0).any() and rest.mean() < whole.mean()
    assert all(channels[f"light.{name}.R"].max() > 0 for name in names)
    seen, albedo = frame.mask, np.stack([channels[f"albedo.{c}"] for c in "RGB"], -1)
    np.testing.assert_array_equal(albedo[seen], scene.colours[frame.gbuffer.face[seen]])
    assert 0 < seen.mean() < 1 and not albedo[~seen].any()
    np.testing.assert_array_equal(channels["object.id"], np.where(seen, 0, 2**32 - 1))
    assert "depth.Z is infinity" in header["background"]
    assert header["positionOrigin"] == str(scene.origin.tolist())


def test_an_exr_without_layers_is_smaller(tmp_path):
    scene = at.procedural("atrium", triangles=2000)
    frame = at.render(scene, scene.cameras[0].resized(40, 30), spp=4)
    assert frame.layers is None and not [name for name in image_files.exr_channels(frame) if name.startswith("light.")]


def test_an_exr_is_compressed_in_threads_that_end_with_it(frame, tmp_path, monkeypatch):
    """Threads of OpenEXR do not survive a fork, and a child that waited for them would hang."""
    counts, set_count = [], OpenEXR.set_global_thread_count
    monkeypatch.setattr(OpenEXR, "set_global_thread_count", lambda n: counts.append(n) or set_count(n))
    monkeypatch.setattr(image_files, "thread_count", lambda threads: 3)
    frame.save(tmp_path / "a.exr")
    assert counts == [3, 0] and OpenEXR.global_thread_count() == 0
    with pytest.raises(OSError, match=r"."):
        image_files.write_exr(image_files.exr_channels(frame), tmp_path / "missing" / "a.exr", None)
    assert counts == [3, 0, 3, 0]
    monkeypatch.setattr(image_files, "thread_count", lambda threads: 1)
    frame.save(tmp_path / "b.exr")
    assert counts[4:] == [0, 0] and (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
