"""The lights of a sky, against integrals of its radiance."""

import numpy as np
import OpenEXR
import pytest

import antumbra as at
from antumbra import InputError
from antumbra.scene.sky import with_rays

SUNNY = np.full((16, 32, 3), 0.1)
SUNNY[4, 20] = (400.0, 300.0, 200.0)


def irradiance(radiance, normal):
    """(3,): the integral of radiance times cosine, by the midpoint rule."""
    height, angle = (np.arange(800) + 0.5) / 400 - 1, (np.arange(1600) + 0.5) * np.pi / 800
    z, a = np.meshgrid(height, angle, indexing="ij")
    d = np.stack([np.sqrt(1 - z * z) * np.cos(a), z, np.sqrt(1 - z * z) * np.sin(a)], -1)
    return 4 * np.pi * (radiance(d) * np.maximum(d @ normal, 0)[..., None]).mean((0, 1))


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("image", [None, (1.0, 0.5, 0.25)])
def test_its_lights_add_up_to_its_irradiance(image, up):
    sky = at.Sky(image, up=up, intensity=2.0, colour=(1.0, 0.5, 1.0))
    tint = 2.0 * sky.intensities[:, None] * sky.colours * (1.0, 0.5, 1.0)
    for normal in np.concatenate([np.eye(3), -np.eye(3)]):
        found = np.maximum(sky.points @ normal, 0) @ tint
        np.testing.assert_allclose(found, irradiance(sky.radiance, normal), rtol=0.02)


def test_a_uniform_sky_gives_pi():
    sky = at.Sky((1.0, 1.0, 1.0))
    assert np.maximum(sky.points[:, 1], 0) @ sky.intensities == pytest.approx(np.pi, rel=1e-2)


def test_bright_parts_get_most_lights_and_lie_where_they_are_seen():
    sky = at.Sky(SUNNY)
    bright = sky.radiance(sky.points).sum(-1) > 30.0
    elevation, azimuth = np.pi / 2 - 4.5 * np.pi / 16, 20.5 * np.pi / 16 - np.pi
    towards = np.cos(elevation) * np.array([np.sin(azimuth), 0, -np.cos(azimuth)]) + [0, np.sin(elevation), 0]
    assert 0.4 < bright.mean() < 1.0
    assert (sky.points[bright] @ towards > np.cos(0.25)).all()
    turned = at.Sky(SUNNY, turn=90.0)
    np.testing.assert_allclose(turned.points[:, 0], sky.points[:, 2], atol=1e-12)  # from -z to -x


def test_a_floor_under_a_sky_gets_its_irradiance_and_a_roof_takes_it():
    floor = np.array([[[-5, 0, -5], [-5, 0, 5], [5, 0, 5]], [[-5, 0, -5], [5, 0, 5], [5, 0, -5]]], float)
    camera = at.Camera((0, 1, 0), (0, 0, 0), (0, 0, -1), 60.0, 16, 16)
    for roof, share in (False, 1.0), (True, 0.0):
        above = floor * (1e4, 1, 1e4) + (0, 2, 0)
        scene = at.Scene.from_arrays(np.concatenate([floor, above]) if roof else floor)
        frame = at.render(scene, camera, [at.Sky((1.0, 1.0, 1.0))], background=False)
        seen = frame.image[frame.gbuffer.face >= 0]
        direct = 0.0 if roof else 0.12  # the ambient light
        np.testing.assert_allclose(seen.mean(), share + direct, atol=0.03)


def test_files_hold_maps(tmp_path):
    image = SUNNY.astype(np.float32)
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": image}) as file:
        file.write(str(tmp_path / "a.exr"))
    exponent = np.floor(np.log2(image.max(-1))) + 1
    mantissa = np.floor(image / np.exp2(exponent)[..., None] * 256)
    rgbe = np.concatenate([mantissa, exponent[..., None] + 128], -1).astype(np.uint8)
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 32\n"
    (tmp_path / "plain.hdr").write_bytes(head + rgbe.tobytes())
    packed = lambda part: bytes([16, *part[:16], *(b for v in part[16:] for b in (129, v))])
    rows = b"".join(bytes([2, 2, 0, 32]) + b"".join(map(packed, row.T)) for row in rgbe)
    (tmp_path / "runs.hdr").write_bytes(head + rows)
    np.testing.assert_array_equal(at.Sky(tmp_path / "a.exr").map, image)
    plain, runs = (at.Sky(tmp_path / f"{name}.hdr").map for name in ("plain", "runs"))
    np.testing.assert_array_equal(plain, runs)
    np.testing.assert_allclose(plain, image, atol=400 / 256)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda folder: at.Sky(np.ones((2, 2))), "a map"),
        (lambda folder: at.Sky((1.0, -1.0, 1.0)), "not negative"),
        (lambda folder: at.Sky(count=0), "count"),
        (lambda folder: at.Sky(up="x"), "up"),
        (lambda folder: at.Sky(folder / "missing.hdr"), "missing.hdr"),
        (lambda folder: at.Sky(written(folder / "bad.hdr")), "not a Radiance picture"),
        (lambda folder: at.Sky(written(folder / "bad.jpg")), "one of .hdr, .exr"),
    ],
)
def test_bad_skies(tmp_path, make, message):
    with pytest.raises(InputError, match=message):
        make(tmp_path)


def written(path):
    path.write_bytes(b"nothing")
    return path


def test_a_damaged_exr_is_one_error_and_nothing_else(tmp_path, capfd):
    """OpenEXR reports damage on the standard error of the process, too."""
    path = tmp_path / "a.exr"
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": SUNNY.astype(np.float32)}) as file:
        file.write(str(path))
    data = path.read_bytes()
    for damaged in (data[: len(data) // 2], data[:8] + b"\xff" * 40 + data[48:], data[:-200] + bytes(200)):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"^a.exr: ") as caught:
            at.Sky(path)
        assert str(caught.value).isprintable()
    assert capfd.readouterr() == ("", "")


def test_a_sky_has_as_many_rays_a_pixel_as_other_lights():
    sky, lamp = at.Sky((0.2, 0.4, 0.8), turn=30.0, up="z").named("dome"), at.PointLight((0, 1, 0))
    fine = with_rays(sky, 64)
    assert (fine.count, fine.turn, fine.up, fine.name) == (1024, 30.0, "z", "dome")
    assert (fine.map == sky.map).all() and fine.intensities.sum() == pytest.approx(sky.intensities.sum())
    assert with_rays(sky, 4).count == 256 and with_rays(lamp, 64) is lamp
    alone = at.Sky(count=100, interleave=False)
    assert with_rays(alone, 64) is alone


def test_a_sky_of_another_number_of_lights_shares_its_map_and_keeps_its_image(monkeypatch):
    sky = at.Sky(np.random.default_rng(1).uniform(0.1, 2.0, (4, 8, 3)), turn=20.0, up="z").named("dome")
    assert len(sky.points) == 256  # which are cached from now on
    monkeypatch.setattr("antumbra.scene.sky._map_of", None)  # the map is not made again
    fine = sky.resampled(512)
    assert fine.map is sky.map and fine.image is sky.image and (fine.name, fine.turn) == ("dome", 20.0)
    assert (len(fine.points), len(fine.intensities), len(sky.points)) == (512, 512, 256)
    assert not sky.resampled(32, interleave=False).interleave and sky.interleave
