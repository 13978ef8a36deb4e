"""The report of seams, relative to the mean, in words."""

import numpy as np
import pytest

import antumbra as at
from antumbra.baking.seams import seam_of, seam_words
from baked_files import grid


def test_seams_are_measured_against_the_mean():
    differences = np.linspace(0.0, 1.0, 101)
    assert seam_of(differences, 10.0) == pytest.approx(0.099)
    assert seam_of(1000.0 * differences, 10_000.0) == pytest.approx(0.099)  # lux or kilolux
    assert seam_of(np.empty(0), 1.0) is None


@pytest.mark.parametrize(
    "seam, words, cure",
    [
        (0.01, "invisible", False),
        (0.04, "hardly visible", False),
        (0.1, "visible up close", True),
        (2.0, "clearly visible", True),
    ],
)
def test_the_report_says_what_a_person_sees(seam, words, cure):
    text = seam_words(seam)
    assert text.startswith(f"{words}: 99 % differ by less than {100 * seam:.2g} % of the mean")
    assert ("raise texture or spp" in text) == cure


def test_denoising_averages_the_same_texels_on_both_sides_of_a_seam(tmp_path):
    """A sphere of few texels above a floor: averages within charts would differ across their edges."""
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("xatlas")
    mesh = trimesh.creation.icosphere(4, 1.0)
    points, normals = np.array(mesh.vertices, np.float32), np.array(mesh.vertex_normals, np.float32)
    options = {"lights": at.AmbientOcclusion(intensity=1.0), "texture": 64, "spp": 16, "bounces": 1}
    seams = []
    floor = grid([-4, 4], [-4, 4], -1.1)
    scene = at.Scene.from_arrays(
        np.concatenate([points, floor[0]]),
        np.concatenate([np.array(mesh.faces), floor[1] + len(points)]),
        normals=np.concatenate([normals, np.tile([[0, 1, 0]], (4, 1))]),
        up="y",
    )
    for denoise in (False, True):
        seams.append(at.bake(scene, tmp_path / "out.glb", "light", denoise=denoise, **options).seam)
    assert seams[1] < 0.7 * seams[0]
