"""MTL files: the materials of an OBJ file, and the files beside a scene that it may refer to."""

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.files import checked_file, sibling
from ..kernels.parallel import map_in_threads
from ..scene.materials import BLEND, MASK, OPAQUE, Material, Texture, check_textures, without_texture

_MAX_BYTES = 1 << 28
_OPTIONS = re.compile(r"^(?:-(?:[ost]\s+\S+\s+\S+\s+\S+|mm\s+\S+\s+\S+|\w+\s+\S+)\s+)+")  # before a texture's name


class SideFiles:
    """Files of materials and textures, read from a scene's folder only. Each failure adds a note."""

    def __init__(self, folder: Path, file: str) -> None:
        self.file = file
        self.notes: list[str] = []
        self._folder = folder

    def read(self, name: str, instead: str) -> bytes | None:
        """The contents of a file; None, with a note that ends with what happens instead, if it cannot be read."""
        name = _OPTIONS.sub("", name.strip()).replace("\\", "/")
        where = f"{self.file}: file {name[:80]!r}"
        try:
            path = checked_file(sibling(self._folder, name, f"{self.file}: file"), where)
            if path.stat().st_size > _MAX_BYTES:
                raise InputError(f"{where} is too large")
            return path.read_bytes()
        except (InputError, OSError) as error:
            self.notes.append(f"{error} ({instead})")
            return None


def read_materials(libraries: Iterable[str], files: SideFiles) -> dict[str | None, Material]:
    """The materials in MTL files, by name: Kd (linear) and d or Tr, with the textures map_Kd and map_d."""
    fields = dict[str, dict[str, str]]()
    for library in dict.fromkeys(libraries):
        data = files.read(library, "its materials are white")
        if data is not None:
            fields.update(_fields_of(decoded_text(data)))
    names = [(each.get("map_kd", ""), each.get("map_d", "")) for each in fields.values()]
    textures = _read_textures([pair for pair in dict.fromkeys(names) if any(pair)], files)
    return {name: _material(name, each, textures.get(pair)) for (name, each), pair in zip(fields.items(), names)}


def decoded_text(data: bytes) -> str:
    """A text in UTF-8, else in Windows-1252: names in an OBJ file and its MTL files must be decoded alike."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _fields_of(text: str) -> dict[str, dict[str, str]]:
    """Name of a material -> its lines: the first word, in lower case -> the rest."""
    materials, current = dict[str, dict[str, str]](), dict[str, str]()
    for line in text.splitlines():
        word, *rest = line.split(maxsplit=1)[:2] or [""]
        if word.lower() == "newmtl" and rest:
            current = materials.setdefault(" ".join(rest[0].split()), {})
        elif rest:
            current[word.lower()] = rest[0].strip()
    return materials


def _material(name: str, fields: dict[str, str], texture: Texture | None) -> Material:
    diffuse = _numbers(fields.get("kd", ""))
    r, g, b = diffuse[:3] if len(diffuse) >= 3 else diffuse[:1] * 3 or [1.0] * 3
    opacity, clearness = _numbers(fields.get("d", "")), _numbers(fields.get("tr", ""))
    alpha = opacity[-1] if opacity else 1.0 - clearness[-1] if clearness and "d" not in fields else 1.0
    mode = MASK if texture is not None and texture.has_alpha else BLEND if alpha < 1.0 else OPAQUE
    material = Material(name, (r, g, b, alpha), texture, mode)
    lost = "map_kd" in fields and (texture is None or texture.picture is None)
    return without_texture(material) if lost else material


def _numbers(text: str) -> list[float]:
    """The numbers among the words of a line, clamped to [0, 1]."""
    numbers = list[float]()
    for word in text.split():
        try:
            numbers.append(float(np.clip(float(word), 0.0, 1.0)))
        except ValueError:  # such as -halo
            continue
    return numbers


def _read_textures(names: list[tuple[str, str]], files: SideFiles) -> dict[tuple[str, str], Texture]:
    """(file of the colour, file of the opacity) -> texture, decoded on all cores; unusable files are left out."""
    colours = {colour for colour, _ in names}
    files_named = dict.fromkeys(name for pair in names for name in pair if name)
    data = {name: files.read(name, "shown in pink" if name in colours else "left out") for name in files_named}

    def texture(colour: str, opacity: str) -> Texture:
        alpha = data.get(opacity)
        return Texture(f"{files.file}: {colour or opacity}", data.get(colour), has_alpha=bool(alpha), opacity=alpha)

    def error_of(texture: Texture) -> str | None:
        try:
            texture.preview_levels  # noqa: B018  # decodes it
        except ValueError as error:
            return str(error)
        return None

    usable = [pair for pair in names if any(data.get(name) for name in pair)]
    of_bytes = dict[tuple[bytes | None, bytes | None], Texture]()  # files may have several names
    textures = {pair: of_bytes.setdefault((data.get(pair[0]), data.get(pair[1])), texture(*pair)) for pair in usable}
    check_textures(of_bytes.values(), files.file)
    found = dict(zip(of_bytes, map_in_threads(error_of, of_bytes.values())))
    errors = {pair: found[data.get(pair[0]), data.get(pair[1])] for pair in usable}
    for pair in [pair for pair, error in errors.items() if error is not None]:
        for name in pair:  # find the file that cannot be decoded
            if data.get(name) and (error := error_of(texture(name, ""))) is not None:
                files.notes.append(
                    f"{files.file}: texture {name[:80]!r} is unusable ({error}); "
                    + ("shown in pink" if name in colours else "left out")
                )
                data[name] = None
        textures[pair] = texture(*pair)
    return {pair: each for pair, each in textures.items() if each.picture is not None or each.opacity is not None}
