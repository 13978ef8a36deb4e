"""Images of kernel libraries for Windows and macOS: their memory, as their systems' loaders would lay it out.

    python scripts/library_images.py LIBRARY IMAGE.npz

`tests/support/foreign_library.py` runs such images in a process of Linux with the same kind of processor, since kernels
need nothing of their system but copying and filling memory. Loaders, signatures and threads are not tested thereby.
"""

import json
import sys
from pathlib import Path
from typing import NamedTuple

import lief
import numpy as np
from numpy.typing import NDArray

lief.logging.disable()  # it reports parts of signatures that kernels do not have


class LibraryImage(NamedTuple):
    """A library in memory."""

    memory: NDArray[np.uint8]
    base: int  # the address for which it is linked
    pointers: list[int]  # offsets of addresses to be moved with the image
    imports: dict[str, list[int]]  # name -> the offsets of its addresses
    exports: dict[str, int]  # name -> offset
    convention: str  # "windows", or "system" if calls are like those of Linux

    def save(self, path: Path) -> None:
        """Write an .npz file."""
        rest = {name: value for name, value in self._asdict().items() if name != "memory"}
        np.savez(path, memory=self.memory, rest=json.dumps(rest))


def _windows_image(binary: lief.PE.Binary) -> LibraryImage:
    memory = np.zeros(binary.optional_header.sizeof_image, np.uint8)
    for section in binary.sections:
        content = np.frombuffer(bytes(section.content), np.uint8)[: max(section.virtual_size, 0)]
        memory[section.virtual_address : section.virtual_address + len(content)] = content
    pointers = [
        block.virtual_address + entry.position
        for block in binary.relocations
        for entry in block.entries
        if entry.type == lief.PE.RelocationEntry.BASE_TYPES.DIR64
    ]
    imports: dict[str, list[int]] = {}
    for entry in (entry for library in binary.imports for entry in library.entries):
        imports.setdefault(entry.name, []).append(entry.iat_address)
    exports = {entry.name: entry.address for entry in binary.get_export().entries}
    x86 = binary.header.machine == lief.PE.Header.MACHINE_TYPES.AMD64
    return LibraryImage(
        memory, binary.optional_header.imagebase, pointers, imports, exports, "windows" if x86 else "system"
    )


def _macos_image(binary: lief.MachO.Binary) -> LibraryImage:
    memory = np.zeros(max(each.virtual_address + each.virtual_size for each in binary.segments), np.uint8)
    for segment in binary.segments:
        content = np.frombuffer(bytes(segment.content), np.uint8)
        memory[segment.virtual_address : segment.virtual_address + len(content)] = content
    pointers = [each.address for each in binary.relocations]
    for each in binary.relocations:
        if isinstance(each, lief.MachO.RelocationFixup):  # a link of a chain stands where the address belongs
            memory[each.address : each.address + 8] = np.frombuffer(each.target.to_bytes(8, "little"), np.uint8)
    imports: dict[str, list[int]] = {}
    for binding in binary.bindings:
        imports.setdefault(binding.symbol.name.removeprefix("_"), []).append(binding.address)
    exports = {each.name.removeprefix("_"): each.value for each in binary.exported_symbols}
    return LibraryImage(memory, 0, pointers, imports, exports, "system")


def image_of(path: Path) -> LibraryImage:
    """The image of a .dll or .dylib file."""
    binary = lief.parse(str(path))
    assert isinstance(binary, (lief.PE.Binary, lief.MachO.Binary)), path
    return _windows_image(binary) if isinstance(binary, lief.PE.Binary) else _macos_image(binary)


if __name__ == "__main__":
    image_of(Path(sys.argv[1])).save(Path(sys.argv[2]))
