"""Pickles of scenes hold what must travel: geometry and textures, once each, and nothing that can be computed again."""

import pickle

import numpy as np
import pytest

import antumbra as at
import city_files
from gltf_files import png
from instance_scenes import random_scenes
from moving_square import write
from terrain_scenes import scene_of

PER_TRIANGLE = 60  # bytes: corners in float64, indices, and attributes of vertices
ABOUT = 20_000  # bytes: names, bounds and notes


def noise(side):
    return np.random.default_rng(3).integers(0, 256, (side, side, 3), np.uint8)


def plane(n):
    """(vertices, faces, uv) of a square of 2 n n triangles."""
    x, z = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1))
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1, 1)
    faces = np.concatenate([first + (0, n + 1, 1), first + (1, n + 1, n + 2)])
    return np.stack([x, 0.1 * np.sin(3 * x + z), z], -1).reshape(-1, 3), faces, np.stack([x, z], -1).reshape(-1, 2)


def arrays(tmp_path):
    return at.Scene.from_arrays(*plane(20)[:2]), 0


def coloured(tmp_path):
    vertices, faces, _ = plane(20)
    return at.Scene.from_arrays(vertices, faces, np.repeat([[0.2, 0.4, 0.6], [1, 0, 0]], len(faces) // 2, 0)), 0


def textured(tmp_path):
    vertices, faces, uv = plane(20)
    return at.Scene.from_arrays(vertices, faces, uv=uv, texture=noise(256)), 4 * 256 * 256


def smooth_texture(tmp_path):
    vertices, faces, uv = plane(20)
    picture = np.zeros((1024, 1024, 3), np.uint8) + np.arange(1024, dtype=np.uint16)[:, None].astype(np.uint8)
    return at.Scene.from_arrays(vertices, faces, uv=uv, texture=picture), 60_000


def shared_texture(tmp_path):
    """Eight nodes of a trimesh scene that show one picture."""
    trimesh, image = pytest.importorskip("trimesh"), pytest.importorskip("PIL.Image")
    vertices, faces, uv = plane(8)
    look = trimesh.visual.TextureVisuals(uv=uv, image=image.fromarray(noise(128)))
    mesh, whole = trimesh.Trimesh(vertices, faces, visual=look, process=False), trimesh.Scene()
    for k in range(8):
        matrix = trimesh.transformations.translation_matrix((3 * k, 0, 0))
        whole.add_geometry(mesh, node_name=f"n{k}", geom_name="plane", transform=matrix)
    return at.load(whole), 4 * 128 * 128


def obj_file(tmp_path):
    (tmp_path / "paper.png").write_bytes(png(noise(64)))
    (tmp_path / "a.mtl").write_text("newmtl paper\nmap_Kd paper.png\n")
    vertices, faces, uv = plane(8)
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"vt {u} {v}" for u, v in uv]
    lines += ["f " + " ".join(f"{k}/{k}" for k in face) for face in (faces + 1).tolist()]
    (tmp_path / "a.obj").write_text("\n".join(["mtllib a.mtl", "usemtl paper", *lines]))
    return at.load(tmp_path / "a.obj"), (tmp_path / "paper.png").stat().st_size


def moved(tmp_path):
    scene = arrays(tmp_path)[0]
    scene.update(transform=np.diag([1.0, 2.0, 1.0, 1.0]))
    return scene, 0


def replaced(tmp_path):
    scene = arrays(tmp_path)[0]
    scene.update(plane(20)[0] * (1, 3, 1))
    scene.update(transform=np.diag([1.0, 0.5, 1.0, 1.0]))
    return scene, 0


def dimmed(tmp_path):
    scene = textured(tmp_path)[0]
    scene.set_transmittance({"*": 0.5})
    return scene, 5 * 256 * 256  # with the mask


def generated(tmp_path):
    return at.procedural("atrium", triangles=2000), 0


def city(tmp_path):
    return at.load(city_files.put(tmp_path, city_files.everything())), 0


def terrain(tmp_path):
    return scene_of(np.random.default_rng(1).random((30, 40))), 0


def instances(tmp_path):
    return random_scenes()[0], 0


def animation(tmp_path):
    return at.load(write(tmp_path / "moving")), 0


KINDS = (arrays, coloured, textured, smooth_texture, shared_texture, obj_file, moved, replaced, dimmed, generated, city)
KINDS += terrain, instances, animation


def answers(scene):
    """What a scene answers, as arrays; afterwards it keeps everything that it found on the way."""
    camera = scene.default_camera(16, 12)
    rng = np.random.default_rng(5)
    points = rng.uniform(*(scene.bounds + [[-0.5], [0.5]]), (40, 3))
    frame = at.render(scene, camera, [at.DirectionalLight((0.3, -1, 0.2)), at.Sky()], spp=4)
    hit, closest = scene.closest_hit(points, rng.normal(size=(40, 3))), scene.closest_points(points)
    objects = scene.object_of_face[np.arange(scene.n_triangles)]
    return [frame.image, *frame.bits, *hit, *closest, scene.contains(points), np.asarray(objects), scene.bounds]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_a_pickle_of_a_used_scene_is_small_and_answers_alike(kind, tmp_path):
    scene, pictures = kind(tmp_path)
    fresh = pickle.dumps(scene)
    assert len(fresh) < PER_TRIANGLE * scene.n_triangles + pictures + ABOUT
    before = answers(scene)
    used = pickle.dumps(scene)
    assert len(used) <= len(fresh) + 500, "what the scene found on the way travels"
    for data in (fresh, used):
        again = pickle.loads(data)
        for one, other in zip(before, answers(again), strict=True):
            np.testing.assert_array_equal(one, other)
        assert repr(again) == repr(scene) and again.notes[: len(scene.notes)] == scene.notes


def test_a_moved_scene_goes_on_from_its_pickle(tmp_path):
    for kind in (moved, replaced):
        scene = kind(tmp_path)[0]
        again = pickle.loads(pickle.dumps(scene))
        for each in (scene, again):
            each.update(transform=np.diag([2.0, 1.0, 1.0, 1.0]))
        np.testing.assert_array_equal(again.triangles().vertices, scene.triangles().vertices)
        np.testing.assert_array_equal(again.bounds, scene.bounds)


def test_nodes_that_share_a_picture_share_its_texture(tmp_path):
    scene = shared_texture(tmp_path)[0]
    assert len({id(each.texture) for each in scene.appearance.materials}) == 1
