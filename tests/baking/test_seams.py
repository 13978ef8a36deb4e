"""The report of seams, relative to the mean, in words."""

import numpy as np
import pytest

from antumbra.baking.seams import seam_of, seam_words


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
