"""Notes by kind."""

import warnings

from antumbra.engine.scene_loading import load
from antumbra.scene.scene_data import group_notes


def test_notes_of_a_kind_are_one_with_their_number():
    lost = [f'a.obj: file "t{i}.png" is missing (shown in pink)' for i in range(62)]
    spot = 'a.glb: lights[3] "Lamp 7" is a spot light; taken as a point light'
    found = group_notes([*lost[:30], spot, *lost[30:]])
    assert found == [f"{lost[0]} (and 61 more of this kind; Scene.notes has all)", spot]
    assert (
        group_notes([]) == []
        and group_notes([spot], "x") == [spot]
        and group_notes([spot, spot], "x")[0].endswith("kind; x)")
    )


def test_an_obj_file_without_its_textures_warns_once(tmp_path):
    lines = [f"v {i} 0 0\nv {i} 1 0\nv {i} 0 1\nvt 0 0\nusemtl m{i}\nf -3/-1 -2/-1 -1/-1" for i in range(20)]
    (tmp_path / "a.obj").write_text("mtllib a.mtl\n" + "\n".join(lines))
    (tmp_path / "a.mtl").write_text("\n".join(f"newmtl m{i}\nmap_Kd lost{i}.png" for i in range(20)))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = load(tmp_path / "a.obj")
    ours = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    assert len(ours) == 1 and "lost0.png" in ours[0] and "(and 19 more of this kind" in ours[0]
    assert len(scene.notes) == 20 and caught[0].filename == __file__
