"""The case of view factors for the tests of all studies."""

from study_cases import StudyCase

CASE = StudyCase(
    "view_factors",
    {"per": "face", "samples": 64},
    exact=lambda found: {"n": len(found)},
    close=lambda found, metres: {"areas": found.areas},  # m2; tangents do not turn along: only expectations are equal
    command="view-factors",
    words=("--samples", "64", "-o", "out.csv"),
    outputs=("-o", "a.npz", "a.csv"),
    numbers=("n", "rays"),
)
