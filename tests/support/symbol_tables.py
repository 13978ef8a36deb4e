"""What shared libraries import, from their symbol tables, and the signatures of those for macOS."""

import struct

ADHOC = 0x2  # CS_ADHOC, a flag of a code directory
_LC_SYMTAB, _LC_CODE_SIGNATURE = 0x2, 0x1D
_CODE_DIRECTORY = 0xFADE0C02
_DYNSYM, _STRTAB_LINK, _UNDEFINED = 11, 6, 0


def text_at(data, at):
    return data[at : data.index(b"\0", at)].decode()


def imports_of(data):
    """The names that a library needs from others: ELF, Mach-O and PE files of 64 bits."""
    if data[:4] == b"\x7fELF":
        return _elf_imports(data)
    return _macho_imports(data) if data[:4] == b"\xcf\xfa\xed\xfe" else _pe_imports(data)


def _elf_imports(data):
    start, (size, count) = struct.unpack_from("<Q", data, 40)[0], struct.unpack_from("<HH", data, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", data, start + size * k) for k in range(count)]
    names = set()
    for section in [each for each in sections if each[1] == _DYNSYM]:
        strings = sections[section[_STRTAB_LINK]][4]
        for at in range(section[4], section[4] + section[5], 24):
            name, _, _, home = struct.unpack_from("<IBBH", data, at)
            if name and home == _UNDEFINED:
                names.add(text_at(data, strings + name))
    return names


def load_commands(data):
    """(command, offset) of each load command of a Mach-O file."""
    at = 32
    for _ in range(struct.unpack_from("<I", data, 16)[0]):
        command, size = struct.unpack_from("<II", data, at)
        yield command, at
        at += size


def _macho_imports(data):
    names = set()
    for at in [at for command, at in load_commands(data) if command == _LC_SYMTAB]:
        symbols, count, strings = struct.unpack_from("<III", data, at + 8)
        for k in range(count):
            name, kind = struct.unpack_from("<IB", data, symbols + 16 * k)
            if kind & 0x0F == 0x01:  # N_UNDF | N_EXT
                names.add(text_at(data, strings + name).removeprefix("_"))
    return names


def signature_flags(data):
    """The flags of the code directory in a Mach-O file; None if the file is not signed."""
    for at in [at for command, at in load_commands(data) if command == _LC_CODE_SIGNATURE]:
        start = struct.unpack_from("<I", data, at + 8)[0]
        for k in range(struct.unpack_from(">I", data, start + 8)[0]):
            blob = start + struct.unpack_from(">II", data, start + 12 + 8 * k)[1]
            magic, _, _, flags = struct.unpack_from(">IIII", data, blob)
            if magic == _CODE_DIRECTORY:
                return flags
    return None


def _pe_imports(data):
    header = struct.unpack_from("<I", data, 60)[0]
    sections, optional = struct.unpack_from("<H", data, header + 6)[0], header + 24
    first = optional + struct.unpack_from("<H", data, header + 20)[0]
    table = [struct.unpack_from("<III", data, first + 40 * k + 12) for k in range(sections)]  # address, size, file

    def place(address):
        return next(address - base + file for base, size, file in table if base <= address < base + size)

    names, at = set(), place(struct.unpack_from("<I", data, optional + 120)[0])
    while any(descriptor := struct.unpack_from("<IIIII", data, at)):
        entry = place(descriptor[0] or descriptor[4])
        while address := struct.unpack_from("<Q", data, entry)[0]:
            if not address >> 63:  # by name, not by number
                names.add(text_at(data, place(address) + 2))
            entry += 8
        at += 20
    return names
