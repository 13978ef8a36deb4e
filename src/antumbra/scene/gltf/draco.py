"""KHR_draco_mesh_compression: a library decodes a primitive, and its accessors get the values."""

import numpy as np

from ...errors import InputError
from ...extras import needed
from .accessors import Accessors
from .document import CURE
from .fields import Fields

EXTENSION = "KHR_draco_mesh_compression"
_TRIANGLES = 4


def decompress(primitive: Fields, accessors: Accessors) -> list[int]:
    """Give the accessors of a compressed primitive their values, and return which these are.

    None are if the file has them uncompressed too.

    Raises
    ------
    InputError
        If the library is missing, or the data cannot be decoded.
    """
    packed = primitive.extension(EXTENSION)
    attributes = primitive.mapping("attributes", len(accessors))
    if packed is None or "POSITION" not in attributes or accessors.has_data(attributes["POSITION"]):
        return []
    if primitive.whole("mode", _TRIANGLES) != _TRIANGLES:
        raise InputError(f"{primitive.where} is a compressed strip; {CURE}")
    library = needed("DracoPy", f"{primitive.where}, compressed with Draco,", "compressed")
    data, indices = accessors.view_bytes(packed, "bufferView"), primitive.whole("indices", high=len(accessors))
    try:
        mesh = library.decode(data)
        found = {
            attributes[name]: np.asarray(mesh.get_attribute_by_unique_id(number)["data"])
            for name, number in packed.mapping("attributes", 1 << 31).items()
            if name in attributes
        }
        found[indices] = np.asarray(mesh.faces).reshape(-1, 1)
    except Exception as error:  # the library raises various exceptions on damaged data
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(
            f"{primitive.where}: Draco data cannot be decoded ({reason}); export the file again"
        ) from error
    for index, values in found.items():
        accessors.supply(index, values)
    return list(found)
