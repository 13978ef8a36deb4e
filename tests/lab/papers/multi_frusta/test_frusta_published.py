"""The paper's own Table 1: its factors follow from its rows, except where it contradicts itself."""

import pytest

from antumbra.lab.papers.multi_frusta import frusta_published


def test_the_published_rows_give_the_published_factors():
    assert (
        len(frusta_published.TABLE1) == 16 and len(frusta_published.pairs("P")) == len(frusta_published.pairs("S")) == 4
    )
    factors = {packets.scene: packets.cycles / frusta.cycles for packets, frusta in frusta_published.pairs("S")}
    assert factors == pytest.approx({"T-Rex": 4.05, "Fern": 3.34, "Saloon": 6.11, "Fairy Forest": 3.97}, rel=0.01)
    shaded = {
        packets.scene: packets.with_shading / frusta.with_shading for packets, frusta in frusta_published.pairs("P")
    }
    assert shaded == pytest.approx({"T-Rex": 3.52, "Fern": 2.98, "Saloon": 6.09, "Fairy Forest": 3.52}, rel=0.01)


def test_factors_are_shown_as_printed_and_those_that_contradict_their_rows_are_named():
    fern, fairy_forest = (pair for pair in frusta_published.pairs("P") if pair[0].scene.startswith("F"))
    assert frusta_published.printed_factor(fern, "triangle_tests") == "2.08"
    assert frusta_published.printed_factor(fairy_forest, "candidates") == "4.61"
    assert frusta_published.printed_factor(fairy_forest, "with_shading") == "3.52"
    named = dict(frusta_published.contradictions())
    assert named["Fern, P, #isec"] == "the factor is printed as 2.08, but the rows give 1.48"
    assert named["Fairy Forest, P, +culling"] == "the factor is printed as 4.61, but the rows give 4.72"
    assert [place for place in named if place.count(", ") == 2] == [
        "Fern, P, #isec",
        "Saloon, P, #tris",
        "Fairy Forest, P, +culling",
    ]


def test_the_factors_of_shadow_rays_alone_hardly_differ_from_those_with_primary_rays():
    for primary, both in zip(frusta_published.pairs("P"), frusta_published.pairs("S")):
        assert {row.scene for row in (*primary, *both)} == {both[0].scene}
        factors = frusta_published.shadow_factors(primary, both)
        assert list(factors) == [*frusta_published.COUNTERS, "cycles"]
        for field, factor in factors.items():
            assert factor == pytest.approx(getattr(both[0], field) / getattr(both[1], field), rel=0.07)
    trex = frusta_published.shadow_factors(frusta_published.pairs("P")[0], frusta_published.pairs("S")[0])
    assert trex["box_tests"] == pytest.approx((36234 - 1218) / (1518 - 58))
    assert trex["cycles"] == pytest.approx((2572 - 104.3) / (635 - 29.6))
