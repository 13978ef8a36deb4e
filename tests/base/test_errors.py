"""Messages are one line, whatever the names in them."""

import pickle
import warnings

import pytest

import antumbra as at
from antumbra.base.errors import one_line
from gltf_files import single


def test_a_message_is_one_line():
    error = at.InputError("a\nb\tc\x1b[31m: <Thing object at 0x7f00aa> is none")
    assert str(error) == "a b c?[31m: <Thing object> is none"
    assert str(pickle.loads(pickle.dumps(error))) == str(error) and isinstance(error, ValueError)
    assert one_line("plain: Ä, 日本") == "plain: Ä, 日本"


@pytest.mark.parametrize(
    "name", ["two\nlines.glb", "bell\a.obj", "\x1b[2Jclear.ply", "back\rward.stl", "x\u2028y.json"]
)
def test_names_of_files_stay_on_the_line(name, tmp_path):
    for path in (tmp_path / name, name):
        with pytest.raises(at.InputError) as caught:
            at.load(path)
        assert str(caught.value).isprintable()
    with pytest.raises(at.InputError) as caught:
        at.Scene.from_arrays([[0, 0, 0]], name=name)
    assert str(caught.value).isprintable()


def test_notes_are_one_line_without_addresses(tmp_path):
    """Pillow names the buffer that it cannot read by its address."""
    made = single()
    made.json["meshes"][0]["primitives"][0]["material"] = made.add(
        "materials", name="two\nlines", pbrMetallicRoughness={"baseColorTexture": {"index": 0}}
    )
    made.add("textures", source=0)
    made.add("images", bufferView=made.view(b"no picture at all"), mimeType="image/png", name="a\nb")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = at.load(made.write(tmp_path))
    messages = [*scene.notes, *(str(each.message) for each in caught)]
    assert messages and all(note.isprintable() and " at 0x" not in note for note in messages), messages
