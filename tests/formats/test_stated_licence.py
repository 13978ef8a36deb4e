"""Licences that glTF and CityJSON files state."""

import json

from antumbra.formats.stated_licence import licence_in


def test_licences_that_files_state(tmp_path):
    glb = tmp_path / "a.glb"
    root = json.dumps({"asset": {"version": "2.0", "copyright": "2026, CC BY 4.0"}}).encode()
    sizes = (20 + len(root)).to_bytes(4, "little") + len(root).to_bytes(4, "little")
    glb.write_bytes(b"glTF" + bytes([2, 0, 0, 0]) + sizes + b"JSON" + root)
    (tmp_path / "a.gltf").write_bytes(root)
    (tmp_path / "b.city.json").write_text(json.dumps({"type": "CityJSON", "metadata": {"license": "CC0"}}))
    (tmp_path / "c.json").write_text("[1]")
    (tmp_path / "d.json").write_text("{")
    found = [licence_in(tmp_path / name) for name in ("a.glb", "a.gltf", "b.city.json", "c.json", "d.json", "e.obj")]
    assert found == ["2026, CC BY 4.0", "2026, CC BY 4.0", "CC0", None, None, None]
