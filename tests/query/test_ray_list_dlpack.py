"""DLPack out: every array that the package returns goes to other libraries without a copy."""

import numpy as np
import pytest

import antumbra as at

SCENE = at.procedural("atrium", triangles=2000)
CAMERA = SCENE.cameras[0].resized(16, 16)


def arrays() -> dict[str, np.ndarray]:
    """The arrays of all results, by name."""
    quad, point = SCENE.lights[0], at.PointLight((0.0, 4.0, 0.0))
    frame = at.render(SCENE, CAMERA, [quad, point], spp=70, adaptive=128, bounce=1, filter=True)
    told = {"image": frame.image, "refined": frame.refined, "indirect": frame.indirect}
    told |= {f"bits {k}": b for k, b in enumerate(frame.bits)}
    told |= {f"visibility {k}": v for k, v in enumerate(frame.visibility)}
    origins = np.array([[0.0, 2.0, 0.0], [0.0, 1.0, 1.0]])
    told["occluded"] = SCENE.occluded(origins, (0.0, -1.0, 0.0))
    told["objects"] = SCENE.object_of_face
    for result in (
        frame.gbuffer,
        at.visibility(SCENE, origins, point),
        SCENE.closest_hit(origins, (0.0, -1.0, 0.0)),
        SCENE.triangles(),
    ):
        fields = {name: value for name, value in result._asdict().items() if value is not None}
        told |= {f"{type(result).__name__}.{name}": value for name, value in fields.items()}
    return told


ARRAYS = arrays()


@pytest.mark.parametrize("name", ARRAYS)
def test_an_array_is_exported_without_a_copy(name):
    array = ARRAYS[name]
    array.__dlpack__()  # a consumer of an old version, such as torch 1.13; read-only memory would be refused
    taken = np.from_dlpack(array)
    assert array.flags.c_contiguous and array.size
    assert taken.dtype == array.dtype and np.shares_memory(taken, array) and (taken == array).all()


def test_bits_can_be_exported_as_signed_integers():
    bits = ARRAYS["bits 0"]
    taken = np.from_dlpack(bits.view(np.int64))
    assert np.shares_memory(taken, bits) and ((taken >> 3 & 1) == (bits >> np.uint64(3) & np.uint64(1))).all()
    assert (taken != 0).any()


def test_results_go_in_again():
    """What one query returns, another accepts by DLPack."""

    class Foreign:
        """An array of another library."""

        def __init__(self, array):
            self.array = array

        def __dlpack__(self, **options):
            return self.array.__dlpack__(**options)

        def __dlpack_device__(self):
            return self.array.__dlpack_device__()

    points = SCENE.triangles().vertices[::40, 0] + np.float32(0.01)
    light = at.PointLight((0.0, 4.0, 0.0))
    found = [at.visibility(SCENE, p, light, spp=1).bits for p in (points, Foreign(points))]
    assert (found[0] == found[1]).all() and found[0].any() and not found[0].all()
