"""The files that a scene file refers to: buffers and images of glTF, materials and textures of OBJ."""

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from ..base.errors import InputError
from ..base.files import sibling
from .gltf.gltf_file import is_data_uri
from .json_fields import parse
from .obj_file import SideFiles, decoded_text, texture_names
from .obj_stream import texts_of

_LIBRARY, _CONTINUED = b"mtllib", re.compile(rb"\\\r?\n")


def referred_files(path: Path) -> list[Path] | None:
    """The files that a file refers to, whether they exist or not; None: they are not known.

    Perhaps more than its reader opens. What is damaged refers to none, as its reader will say.
    """
    suffix = path.suffix.lower()
    if suffix == ".vrt" or path.is_dir():
        return None
    with suppress(InputError, OSError, ValueError):
        if suffix == ".gltf":
            return list(_files_of_gltf(path))
        if suffix == ".obj":
            return [each for each in _files_of_obj(path) if each is not None]
    return []


def _files_of_gltf(path: Path) -> Iterator[Path]:
    root = parse(path.read_bytes(), path.name)
    for fields in (*root.objects("buffers"), *root.objects("images")):
        uri = fields.text("uri", None)
        if uri is not None and not is_data_uri(uri):
            yield sibling(path.parent, uri, path.name)


def _files_of_obj(path: Path) -> Iterator[Path | None]:
    files, names = SideFiles(path.parent, path.name), dict[bytes, None]()
    for text in texts_of(path):
        lines = (part.partition(b"\n")[0].strip() for part in _CONTINUED.sub(b" ", text).split(_LIBRARY)[1:])
        names.update((line, None) for line in lines if line)
    for library in (decoded_text(name) for name in names):
        yield files.path_of(library)
        data = files.read(library, "")
        for texture in texture_names(data) if data is not None else ():
            yield files.path_of(texture)
