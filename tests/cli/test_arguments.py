import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
from antumbra.cli import arguments
from antumbra.cli.scene_arguments import parse_scene


@pytest.mark.parametrize(
    "text, value",
    [("0", 0), ("5000", 5000), ("100k", 100_000), ("100K", 100_000), ("2.5M", 2_500_000), (" 1m ", 1_000_000)],
)
def test_counts(text, value):
    assert arguments.parse_count(text, "--triangles") == value


@pytest.mark.parametrize("text", ["", "k", "-5", "1.5", "0.0001k", "1e3", "nan", "1 000", "9" * 30, "9" * 400, "³"])
def test_bad_counts(text):
    with pytest.raises(at.InputError, match="--triangles is"):
        arguments.parse_count(text, "--triangles")


def test_sizes():
    assert arguments.parse_size("1920x1080") == (1920, 1080)
    assert arguments.parse_size("16X9") == (16, 9)
    assert arguments.parse_size("512") == (512, 512)
    assert arguments.parse_size("1x32768") == (1, 32768)


@pytest.mark.parametrize("text", ["", "0x0", "0", "32x0", "-1x5", "32769x1", "a", "1x2x3", "1.5x2", "9" * 5000])
def test_bad_sizes(text):
    with pytest.raises(at.InputError, match=r"--size is .*1024x768"):
        arguments.parse_size(text)


def test_cameras():
    assert arguments.parse_camera("2") == 2
    assert arguments.parse_camera("0\x1f") == 0  # a blank to patterns, and not to int()
    spec = arguments.parse_camera("1,2,3:4,5,6")
    assert (spec.position.tolist(), spec.target.tolist(), spec.vfov) == ([1, 2, 3], [4, 5, 6], 60.0)
    assert arguments.parse_camera("-1,-2e0,.5:4,5,6:30").vfov == 30.0


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x",
        "1,2,3",
        "1,2:3,4,5",
        "1,2,3:4,5,nan",
        "1,2,3:4,5,6:inf",
        "1,2,3:4,5,6:7:8",
        "1,2,3:4,5,6:",
        "1,,3:4,5,6",
    ],
)
def test_bad_cameras(text):
    with pytest.raises(at.InputError, match=f"--camera {text}: "):
        arguments.parse_camera(text)


@pytest.mark.parametrize(
    "text, chosen",
    [
        ("16", {}),
        ("32", {"size": 32}),
        ("all", {"size": None}),
        ("bounce", {"bounce": True}),
        ("32,bounce", {"size": 32, "bounce": True}),
        ("last-frame", {"last_frame": True}),
        (" last-frame , all,bounce", {"size": None, "bounce": True, "last_frame": True}),
    ],
)
def test_rays_for_srdh(text, chosen):
    assert vars(arguments.parse_srdh_rays(text)) == vars(at.SrdhRays(**chosen))


@pytest.mark.parametrize(
    "text, word",
    [
        ("", "''"),
        ("16,", "''"),
        ("x", "'x'"),
        ("16x16", "'16x16'"),
        ("-1", "'-1'"),
        ("³", "'³'"),
        ("0", "size is 0"),
        ("65537", "65536"),
        ("16,32", "'32'"),
        ("16,all", "'all'"),
        ("bounce,bounce", "'bounce'"),
        ("last_frame", "'last_frame'"),
    ],
)
def test_bad_rays_for_srdh(text, word):
    with pytest.raises(at.InputError, match=f"--srdh-rays {text}: .*{word}"):
        arguments.parse_srdh_rays(text)


@pytest.fixture
def floor():
    return at.Scene.from_arrays([[-1.0, 0, -1], [1, 0, -1], [1, 0, 1]], up="y")


def test_a_camera_that_looks_straight_down_has_another_up(floor):
    down = arguments.make_camera(arguments.parse_camera("0,5,0:0,0,0"), floor, 0.0, (4, 3))
    assert down.up.tolist() == [0, 0, -1] and (down.width, down.height) == (4, 3)
    level = arguments.make_camera(arguments.parse_camera("0,5,1:0,0,0:20"), floor, 0.0, (4, 3))
    assert level.up.tolist() == [0, 1, 0] and level.vfov == 20.0
    ground = at.Scene.from_arrays([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0]], up="z")
    assert arguments.make_camera(arguments.parse_camera("0,0,5:0,0,0"), ground, 0.0, (4, 3)).up.tolist() == [0, 1, 0]
    assert arguments.make_camera(arguments.parse_camera("0,5,1:0,0,0"), ground, 0.0, (4, 3)).up.tolist() == [0, 0, 1]


@pytest.mark.parametrize(
    "text, projection, extent",
    [
        ("ortho", "orthographic", None),
        ("top", "orthographic", None),
        ("panorama", "panoramic", None),
        ("ortho:0,5,3:0,0,0:2.5", "orthographic", 2.5),
        ("ortho:0,5,0:0,0,0:2.5", "orthographic", 2.5),
        ("panorama:0,1,0:1,1,0", "panoramic", None),
    ],
)
def test_cameras_of_other_kinds(floor, text, projection, extent):
    camera = arguments.make_camera(arguments.parse_camera(text), floor, 0.0, (8, 4))
    assert (camera.projection, camera.width, camera.height) == (projection, 8, 4)
    assert camera.extent == extent if extent else (camera.extent is None) == (projection == "panoramic")


def test_a_panorama_is_from_the_camera_of_a_scene():
    scene = at.procedural("atrium", triangles=2000)
    camera = arguments.make_camera(arguments.parse_camera("panorama"), scene, 0.0, (8, 4))
    np.testing.assert_array_equal(camera.position, scene.cameras[0].position)
    np.testing.assert_allclose(camera.axes, scene.cameras[0].axes, atol=1e-12)


def test_cameras_of_other_kinds_that_cannot_be(floor):
    for text, reason in [
        ("ortho:0,1,0", "HEIGHT"), ("top:0,0,0:1,1,1", "top"), ("ortho:0,0,1:0,0,0:0", "extent"),
        ("panorama:0,1,0", "TARGET"), ("panorama:0,1,0:0,0,0", "straight above or below"), ("fisheye", "panorama"),
    ]:  # fmt: skip
        with pytest.raises(at.InputError, match=reason):
            arguments.make_camera(arguments.parse_camera(text), floor, 0.0, (4, 4))


def test_cameras_that_cannot_be(floor):
    for text, reason in [("0,0,0:0,0,0", "at the camera position"), ("0,1,0:0,0,1:180", "vfov"), ("0", "no camera 0")]:
        with pytest.raises(at.InputError, match=reason):
            arguments.make_camera(arguments.parse_camera(text), floor, 0.0, (4, 4))


def test_without_a_camera_the_whole_scene_is_shown(floor):
    chosen, default = arguments.make_camera(None, floor, 0.0, (40, 30)), floor.default_camera(40, 30)
    assert repr(chosen) == repr(default)


def test_lights():
    point = arguments.parse_light("point:1,2,3@50")
    assert isinstance(point, at.PointLight) and point.position.tolist() == [1, 2, 3] and point.intensity == 50.0
    quad = arguments.parse_light("quad:0,5,0:2,0,0:0,0,4")
    assert isinstance(quad, at.QuadLight) and quad.intensity == 1.0
    assert (quad.corner.tolist(), quad.u.tolist(), quad.v.tolist()) == ([-1, 5, -2], [2, 0, 0], [0, 0, 4])
    disk = arguments.parse_light("disk:0,5,0:0,-2,0:0.5")
    assert isinstance(disk, at.DiskLight) and disk.normal.tolist() == [0, -1, 0] and disk.radius == 0.5
    sphere = arguments.parse_light("sphere:1,2,3:.25@1e3")
    assert isinstance(sphere, at.SphereLight) and (sphere.radius, sphere.intensity) == (0.25, 1000.0)
    sun = arguments.parse_light("sun:0,-2,0")
    assert isinstance(sun, at.DirectionalLight)
    assert sun.direction.tolist() == [0, -1, 0] and sun.angular_diameter == 0.53
    assert arguments.parse_light("sun:0,-1,0:2@3").angular_diameter == 2.0
    assert arguments.parse_light(" 1") == 1


@pytest.mark.parametrize(
    "text",
    [
        "", "lamp:1,2,3", "point", "point:1,2", "point:1,2,3:4", "point:1,2,3@", "point:1,2,3@-1", "point:1,2,3@nan",
        "point:1,2,3@4@5", "quad:0,0,0:1,0,0", "quad:0,0,0:1,0,0:2,0,0", "disk:0,0,0:0,0,0:1", "disk:0,0,0:0,1,0:0",
        "sphere:0,0,0", "sphere:0,0,0:-1", "sphere:0,0,0:1,2", "sun:0,0,0", "sun:0,-1,0:180", "sun:0,-1,0:1:2",
        "sun:inf,0,0", "point:1,2,3@1e31",
    ],
)  # fmt: skip
def test_bad_lights(text):
    with pytest.raises(at.InputError) as caught:
        arguments.parse_light(text)
    assert str(caught.value).startswith(f"--light {text}: ") and "\n" not in str(caught.value)


def test_every_kind_of_light_is_explained_and_understood(cli):
    told = cli("render", "--help").out
    for kind, form in arguments.LIGHT_FORMS.items():
        assert form in told
        fields = [
            "1" if f.startswith(("RADIUS", "ANGULAR")) else "1,0,0"
            for f in form.rstrip("]").replace("[", "").split(":")
        ]
        if kind == "quad":
            fields[-1] = "0,1,0"
        assert isinstance(arguments.parse_light(":".join([kind, *fields[1:]])), at.Light)


def test_lights_of_the_scene(floor):
    made = arguments.make_lights([], floor, 0.0)
    assert [type(light) for light in made] == [at.DirectionalLight, at.Sky]
    with pytest.raises(at.InputError, match="no light 0"):
        arguments.make_lights([0], floor, 0.0)
    mine = arguments.parse_light("point:0,1,0")
    assert arguments.make_lights([mine], floor, 0.0) == [mine]
    scene = at.procedural("atrium", triangles=2000)
    assert np.allclose(arguments.make_lights([0, mine], scene, 0.0)[0].u, scene.lights[0].u)


@given(st.text(max_size=40))
def test_any_text_is_understood_or_refused_in_one_line(text):
    kinds = "size", "camera", "light", "srdh_rays"
    for parse in (parse_scene, *(getattr(arguments, f"parse_{kind}") for kind in kinds)):
        try:
            parse(text)
        except at.InputError as error:
            assert str(error)


@given(st.text("0123456789.,:@-+einfaxk", max_size=30))
def test_any_numbers_are_understood_or_refused(text):
    for kind in arguments.LIGHT_FORMS:
        try:
            light = arguments.parse_light(f"{kind}:{text}")
        except at.InputError:
            continue
        assert isinstance(light, at.Light) and light.intensity >= 0.0


@pytest.mark.parametrize("kind, syntax", [("sun", "sun:X"), ("lamp", "light:X")])
def test_a_kind_of_light_that_cannot_be_added(kind, syntax):
    form = arguments.LightForm(syntax, at.PointLight)
    with pytest.raises(at.InputError, match=f"'{kind}' cannot be a kind of light: .*{syntax}"):
        arguments.register_light(kind, form)


def test_an_added_kind_of_light_is_understood_and_explained(monkeypatch):
    monkeypatch.setattr(arguments, "_added_lights", {})
    make = lambda x, height="2", **more: at.PointLight((float(x), float(height), 0), **more)
    arguments.register_light("lamp", arguments.LightForm("lamp:X[:HEIGHT]", make))
    assert arguments.parse_light("lamp:1").position.tolist() == [1, 2, 0]
    high = arguments.parse_light("lamp:1:5@7")
    assert (high.position.tolist(), high.intensity) == ([1, 5, 0], 7)
    with pytest.raises(at.InputError, match=r"write lamp:X\[:HEIGHT\], optionally followed by @INTENSITY"):
        arguments.parse_light("lamp:1:2:3")
    with pytest.raises(at.InputError, match=r"unknown kind 'lam'; write one of point:.* lamp:X\[:HEIGHT\]"):
        arguments.parse_light("lam:1")


def test_daylight_is_a_sky_that_joins_other_lights(floor):
    sun = arguments.parse_light("sun:0,-1,0.5")
    lights = arguments.make_picture_lights([sun], arguments.parse_sky("Daylight"), floor, 0.0)
    assert lights[0] is sun and repr(lights[1:]) == repr([at.Sky(up=floor.up)])
    (sky,) = arguments.make_picture_lights([], arguments.parse_sky("daylight"), floor, 0.0)
    assert repr(sky) == repr(lights[1])
    assert arguments.make_picture_lights([sun], arguments.parse_sky("none"), floor, 0.0) == [sun]
