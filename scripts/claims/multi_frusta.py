"""The claims of the paper on multi-frusta tracing [Benthin and Wald 2009]."""

from antumbra.lab.papers.multi_frusta.frusta_measurements import exponents
from antumbra.lab.papers.multi_frusta.frusta_published import COUNTERS, pairs, shadow_factors

from .claim import NO_GPU, RANGE, UNKNOWN, Claim, Condition, Results, at_size, spread

_P, _S = ("table 1 primary", "primary:paper"), ("table 1", "multifrusta:paper")


def _factors(r: Results, kind: tuple[str, str], field: str, tracer: str = "") -> tuple[float, float, float]:
    """By what factor a tracer, by default the paper's, reduces a counter or the time of packets."""
    table, paper = kind
    rows = [scene[table] for scene in r["rows"].values()]
    return spread([each["packet16:paper"][field] / each[tracer or paper][field] for each in rows])


def _per_scene(r: Results, table: str, a: str, b: str, field: str) -> tuple[float, float, float]:
    """The ratio of a field of two rows of a table, over the scenes."""
    return spread([scene[table][a][field] / scene[table][b][field] for scene in r["rows"].values()])


def _change(r: Results, tracer: str, field: str) -> tuple[float, float, float]:
    """The change of a counter in Table 2, in per cent."""
    low, high, middle = _per_scene(r, "table 2", tracer, "multifrusta:paper", field)
    return 100 * low - 100, 100 * high - 100, 100 * middle - 100


def _small_light(r: Results) -> tuple[float, float]:
    """The factor of tests with a quarter of the light's edge."""
    rows = [scene["figure 6"]["0.25"] for scene in r["rows"].values()]
    return spread(
        [row["packet16:paper"]["triangle_tests"] / row["multifrusta:paper"]["triangle_tests"] for row in rows]
    )[:2]


def _with_primary(r: Results) -> tuple[float, float]:
    """The speedups of shadow rays together with primary rays and shading, which the paper's times include."""

    def seconds(scene: Results, shadows: str, primary: str) -> float:
        return float(scene["table 1"][shadows]["seconds"] + scene["table 1 primary"][primary]["shaded"])

    return spread(
        [
            seconds(s, "packet16:paper", "packet16:paper") / seconds(s, "multifrusta:paper", "primary:paper")
            for s in r["rows"].values()
        ]
    )[:2]


def _culled(r: Results, kind: tuple[str, str]) -> tuple[float, float, float]:
    """The share of accessed triangles that culling drops, in per cent."""
    table, paper = kind
    rows = [scene[table][paper] for scene in r["rows"].values()]
    return spread([100 - 100 * row["candidates"] / row["triangles"] for row in rows])


def _better_for_shadows(r: Results) -> tuple[int, int]:
    """(scenes where frusta save more box tests of shadow rays than of primary rays, scenes)."""
    saved = [
        [s[table]["packet16:paper"]["box_tests"] / s[table][paper]["box_tests"] for table, paper in (_P, _S)]
        for s in r["rows"].values()
    ]
    return sum(primary < shadows for primary, shadows in saved), len(saved)


def _corners_beside_boxes(r: Results) -> tuple[float, float]:
    """The triangle tests that shrunk corner rays save, relative to those that box tests at the leaves save."""
    saved = [
        [
            s["table 2"]["multifrusta:paper"]["triangle_tests"] - s["table 2"][f"multifrusta:{t}"]["triangle_tests"]
            for t in ("corners", "leaf-boxes")
        ]
        for s in r["rows"].values()
    ]
    return spread([100 * corners / boxes for corners, boxes in saved])[:2]


_BOTH = "our frusta test more triangles with 16 rays than packets do, the paper's fewer (last table of the page)"

CLAIMS: tuple[Claim, ...] = (
    Claim(
        "Abstract, 5.1, 7",
        "soft shadows 3.34 to 6.11 times as fast as packets of 16 rays",
        RANGE + "; with primary rays and shading, as the paper's (which also filters), {:.2f} to {:.2f}; `multifrusta` "
        "{:.2f} to {:.2f}",
        lambda r: (
            *_factors(r, _S, "seconds"),
            *_with_primary(r),
            *_factors(r, _S, "seconds", "multifrusta")[:2],
        ),
        lambda low, high, middle, *_: middle >= 3.34,
        _BOTH,
    ),
    Claim(
        "5.1, 7",
        "primary rays without shading 3.42 to 7.83 times as fast",
        RANGE + "; `multifrusta` {:.2f} to {:.2f}",
        lambda r: (*_factors(r, _P, "seconds"), *_factors(r, _P, "seconds", "multifrusta")[:2]),
        lambda low, high, middle, *_: middle >= 3.42,
        UNKNOWN,
    ),
    Claim(
        "5.1",
        "primary rays with shading 2.98 to 6.09 times as fast",
        RANGE,
        lambda r: _factors(r, _P, "shaded"),
        lambda low, high, middle: middle >= 2.98,
        "this follows from the claim above",
    ),
    Claim(
        "5.1, 7",
        "11.8 to 21 times fewer box tests for primary rays",
        RANGE,
        lambda r: _factors(r, _P, "box_tests"),
        lambda low, high, middle: middle >= 11.8,
    ),
    Claim(
        "5.1, 7",
        "14.1 to 23.8 times fewer box tests for soft shadows",
        RANGE + "; `multifrusta` {:.1f} to {:.1f}",
        lambda r: (*_factors(r, _S, "box_tests"), *_factors(r, _S, "box_tests", "multifrusta")[:2]),
        lambda low, high, middle, *_: middle >= 14.1,
        UNKNOWN,
    ),
    Claim(
        "5.1",
        "usually saves more box tests for shadow rays than for primary rays (in 3 of 4 scenes)",
        "in {} of {} scenes",
        _better_for_shadows,
        lambda better, scenes: better > scenes / 2,
        UNKNOWN,
    ),
    Claim(
        "5.1",
        "1.45 to 2.3 times fewer triangles accessed for primary rays",
        RANGE,
        lambda r: _factors(r, _P, "triangles"),
        lambda low, high, middle: middle >= 1.45,
    ),
    Claim(
        "5.1",
        "1.89 to 3.67 times fewer triangles accessed for soft shadows",
        RANGE,
        lambda r: _factors(r, _S, "triangles"),
        lambda low, high, middle: middle >= 1.89,
    ),
    Claim(
        "5.1",
        "2.98 to 9.5 times fewer triangles after culling for primary rays",
        RANGE,
        lambda r: _factors(r, _P, "candidates"),
        lambda low, high, middle: middle >= 2.98,
    ),
    Claim(
        "5.1",
        "4.96 to 10.06 times fewer triangles after culling for soft shadows",
        RANGE,
        lambda r: _factors(r, _S, "candidates"),
        lambda low, high, middle: middle >= 4.96,
        UNKNOWN,
    ),
    Claim(
        "5.1",
        "1.67 to 3.1 times fewer tests of 16 rays (#isec) for primary rays",
        RANGE,
        lambda r: _factors(r, _P, "triangle_tests"),
        lambda low, high, middle: middle >= 1.67,
        UNKNOWN,
        "Fern's factor is printed as 2.08, but the paper's rows give 1.48",
    ),
    Claim(
        "5.1",
        "1.01 to 1.44 times fewer tests of 16 rays (#isec) for soft shadows",
        RANGE + "; {:.2f} to {:.2f} with a quarter of the light's edge",
        lambda r: (*_factors(r, _S, "triangle_tests"), *_small_light(r)),
        lambda low, high, middle, *_: middle >= 1.01,
        "#isec rises where the paper's falls; it depends on the size of the light",
    ),
    Claim(
        "5.2",
        "packets of 256 rays reach at most 50 % of the speed of frusta",
        "{:.0f} to {:.0f} %",
        lambda r: tuple(100 * x for x in _per_scene(r, "table 1", "multifrusta:paper", "packet256", "seconds")[:2]),
        lambda low, high: high <= 50,
        "frusta gain less here (first claim)",
    ),
    Claim(
        "5.2",
        "packets of 256 rays test 3 to 4 % fewer boxes than frusta",
        "{:.0f} to {:.0f} % fewer nodes",
        lambda r: tuple(
            100 - 100 * x for x in _per_scene(r, "table 1", "packet256", "multifrusta:paper", "nodes")[1::-1]
        ),
        lambda low, high: low > 0,
    ),
    Claim(
        "5.2",
        "packets of 256 rays are slower than packets of 16 in some cases",
        "{:.2f} to {:.2f} times as fast",
        lambda r: _per_scene(r, "table 1", "packet16:paper", "packet256", "seconds")[:2],
        lambda low, high: low < 1,
        UNKNOWN,
    ),
    Claim(
        "5.3, Table 2",
        "boxes tested by rays at the leaves: 26.4 % fewer triangle tests, 155 % more box tests; does not pay off",
        "{:.0f} to {:.0f} % triangle tests, +{:.0f} to +{:.0f} % box tests, {:.2f} to {:.2f} times as fast",
        lambda r: (
            *_change(r, "multifrusta:leaf-boxes", "triangle_tests")[:2],
            *_change(r, "multifrusta:leaf-boxes", "box_tests")[:2],
            *_per_scene(r, "table 2", "multifrusta:paper", "multifrusta:leaf-boxes", "seconds")[:2],
        ),
        lambda *n: n[1] < 0 < n[2] and n[-1] < 1,
    ),
    Claim(
        "4.1, 4.2, Table 2",
        "frusta access only slightly more triangles than with box tests by rays, which save 14.8 %",
        "these save {:.0f} to {:.0f} %",
        lambda r: [-x for x in _change(r, "multifrusta:leaf-boxes", "triangles")[1::-1]],
        lambda low, high: high <= 20,
        UNKNOWN,
    ),
    Claim(
        "4.2, Table 1",
        "back-face and corner-ray culling drop 61 to 88 % of the triangles that shadow frusta access",
        "{:.0f} to {:.0f} %, median {:.0f} %",
        lambda r: _culled(r, _S),
        lambda low, high, middle: middle >= 61,
    ),
    Claim(
        "4.2, Table 1",
        "back-face and corner-ray culling drop 62 to 83 % of the triangles that primary frusta access",
        "{:.0f} to {:.0f} %, median {:.0f} %",
        lambda r: _culled(r, _P),
        lambda low, high, middle: middle >= 62,
        "primary rays see both sides of triangles here, so back faces are not culled",
    ),
    Claim(
        "5.3, Table 2",
        "shrunk corner rays save almost as many triangle tests as boxes tested by rays (21.1 and 26.4 %)",
        "{:.0f} to {:.0f} % as many",
        _corners_beside_boxes,
        lambda low, high: low >= 80,
        "boxes tested by rays save far more here",
    ),
    Claim(
        "5.3, Table 2",
        "shrunk corner rays: 21.1 % fewer triangle tests, saves at most 10 % of the time",
        "{:.0f} to {:.0f} % triangle tests, {:.2f} to {:.2f} times as fast",
        lambda r: (
            *_change(r, "multifrusta:corners", "triangle_tests")[:2],
            *_per_scene(r, "table 2", "multifrusta:paper", "multifrusta:corners", "seconds")[:2],
        ),
        lambda *n: n[1] < 0 and n[2] >= 1 and n[3] <= 1.1,
    ),
    Claim(
        "5.3, Table 2",
        "shrunk intervals: 7.7 % fewer triangles accessed, does not pay off",
        "{:.0f} to {:.0f} % triangles accessed, {:.2f} to {:.2f} times as fast",
        lambda r: (
            *_change(r, "multifrusta:full", "triangles")[:2],
            *_per_scene(r, "table 2", "multifrusta:paper", "multifrusta:full", "seconds")[:2],
        ),
        lambda *n: n[3] <= 1,
        "it pays here, because it saves more triangles",
        "in `multifrusta` it takes 0.99 to 1.03 times as long, measured once",
    ),
    Claim(
        "5.4, Figure 5",
        "16 interleaved samples, filtered, have almost the quality of 256",
        "mean error of visibility at most {:.3f}, half a step of 16 samples being {:.3f}",
        lambda r: (max(s["figure 5"]["16 samples, filtered"]["mean"] for s in r["rows"].values()), 1 / 32),
        lambda error, step: error <= step,
    ),
    Claim(
        "4.5",
        "the filter takes less than 20 M cycles",
        "170 M cycles at 1024 x 1024, measured once",
        lambda r: (),
        lambda: False,
        UNKNOWN,
    ),
    Claim(
        "5.4, Figure 6",
        "accessed triangles and tests grow linearly with the size of the light",
        "triangles as edge^{:.2f} to edge^{:.2f}, tests as edge^{:.2f} to edge^{:.2f}",
        lambda r: (
            *spread([exponents(s["figure 6"], _S[1], "triangles")[0] for s in r["rows"].values()])[:2],
            *spread([exponents(s["figure 6"], _S[1], "triangle_tests")[0] for s in r["rows"].values()])[:2],
        ),
        lambda *powers: max(abs(x - 1) for x in powers) <= 0.25 or max(abs(x - 2) for x in powers) <= 0.5,
        "linear neither in the edge nor in the area; the paper does not say which of the two it means by size",
    ),
    Claim(
        "6",
        "frusta outperform packets for hard shadows too",
        "{:.2f} to {:.2f} times as fast, median {:.2f} (`multifrusta:by-sample` and `packet16`)",
        lambda r: _per_scene(r, "hard shadows", "packet16", "multifrusta:by-sample", "seconds"),
        lambda low, high, middle: middle > 1,
        UNKNOWN,
    ),
    Claim(
        "6",
        "does not perform well for incoherent rays",
        "ambient occlusion at {:.2f} to {:.2f} times the speed of packets",
        lambda r: spread([_light(s, "ambient occlusion") for s in r["rows"].values()])[:2],
        lambda low, high: high < 1,
    ),
    Claim(
        "6.1",
        "also applies to virtual point lights (no figures)",
        "{:.2f} to {:.2f} times as fast as packets",
        lambda r: spread([_light(s, "256 virtual point lights") for s in r["rows"].values()])[:2],
        lambda low, high: low > 1,
    ),
    Claim(
        "6.1",
        "also applies to environment maps and ambient occlusion (no figures)",
        "sky {:.2f} to {:.2f} times as fast as packets, ambient occlusion {:.2f} to {:.2f}; `multifrusta` {:.2f} to "
        "{:.2f} and {:.2f} to {:.2f}",
        lambda r: [
            speedup
            for tracer in ("multifrusta:by-sample", "multifrusta")
            for light in ("256 directions of a sky", "ambient occlusion")
            for speedup in spread([_light(s, light, tracer) for s in r["rows"].values()])[:2]
        ],
        lambda a, b, c, d, *_: a > 1 and c > 1,
        "with ambient occlusion, and outdoors, the frusta are too wide",
    ),
    Claim(
        "6.1, Figure 7",
        "few pixels lie at silhouettes: 11.5 % in Saloon",
        "{:.1f} to {:.1f} %",
        lambda r: spread([100 * s["figure 7"]["edges"] for s in r["rows"].values()])[:2],
        lambda low, high: high < 50,
        "",
        "judged as less than half, as scenes differ",
    ),
    Claim(
        "4.1",
        "the directions of less than 4 % of primary frusta contain a zero",
        "0.64 % in Sponza, 0.78 % in the robots and 0.70 % in the forest, counted once",
        lambda r: (),
        lambda: True,
    ),
    Claim(
        "5.4",
        "penumbrae are a fraction of the pixels, so refining them alone would be efficient",
        "15.9 % of the visible pixels in Sponza and 20.2 % in the robots, counted once",
        lambda r: (),
        lambda: True,
    ),
    Claim(
        "6",
        "over 30 M rays/s per core at 1 GHz, 16 to 36 frames per second with 16 cores",
        "{:.0f} to {:.0f} M rays/s",
        lambda r: spread(
            [s["table 1"][_S[1]]["rays"] / s["table 1"][_S[1]]["seconds"] / 1e6 for s in r["rows"].values()]
        )[:2],
        None,
        NO_GPU + ", Larrabee, and its simulator",
    ),
    Claim(
        "5", "a shallow tree is better for frusta, a deep one for packets", "", reason="each was measured with one tree"
    ),
    Claim("6", "scales linearly with the number of cores", "", reason="two cores are too few to tell"),
    Claim("6", "within twice the time of rasterised soft shadows", "", reason="no such rasterizer here"),
    Claim(
        "7",
        "entry points of larger blocks would save further box tests of primary rays (future work)",
        "{:.2f} to {:.2f} times fewer (`primary:entries`), {:.2f} to {:.2f} times as fast",
        lambda r: (
            *_per_scene(r, _P[0], _P[1], "primary:entries", "box_tests")[:2],
            *_per_scene(r, _P[0], _P[1], "primary:entries", "seconds")[:2],
        ),
        lambda low, *_: low > 1,
    ),
    Claim("3.1", "frusta without a far plane are easier and faster", "", reason="frusta of both kinds were not built"),
    Claim(
        "3.1, 4.3, Figure 4",
        "16 small frusta cull better than one that encloses all rays",
        "",
        reason="the large frustum was not built",
    ),
    Claim(
        "4.2, 4.4", "making rays on demand is faster than reading them from memory", "", reason="always on demand here"
    ),
    Claim(
        "4.2", "triangle data computed in advance would be faster still", "", reason="always computed in advance here"
    ),
    Claim(
        "4.4",
        "bounds of the samples are slightly better than the light's corners",
        "",
        reason="the samples are always bounded",
    ),
    Claim("7", "maps well to GPUs, grids and kd-trees", "", reason="Antumbra has none of these"),
)


def _light(scene: Results, light: str, tracer: str = "multifrusta:by-sample") -> float:
    """The speedup of frusta, by default by sample, over packets for a light of Section 6.1."""
    rows = scene["section 6.1"][light]
    return float(rows["packet16"]["seconds"] / rows[tracer]["seconds"])


def _sizes(r: Results) -> str:
    primary, shadow = at_size(r, _SIZE, "primary_size"), at_size(r, _SIZE)
    lights = f"Section 6.1, for which the paper gives no figures, at {' x '.join(map(str, r['lights_size']))}"
    return f"**Sizes**: shadow rays at {shadow}; primary rays at {primary}; {lights}."


_SIZE = "1024 x 1024"


def _primary_rays(r: Results) -> str:
    """What the paper's factors of shadow rays would be without primary rays, which its rows include."""
    names = {**COUNTERS, "cycles": "time"}
    found = {name: spread([shadow_factors(*pair)[field] for pair in zip(pairs("P"), pairs("S"))])[:2]
             for field, name in names.items()}  # fmt: skip
    text = ", ".join(f"{name} {low:.2f} to {high:.2f}" for name, (low, high) in found.items())
    return (
        "**Primary rays**: the paper's shadow-ray rows include the primary rays, and their times include shading and "
        f"filtering; ours do not. Without primary rays and shading, the paper's factors would hardly change: {text}."
    )


CONDITIONS: tuple[Condition, ...] = (
    _sizes,
    _primary_rays,
    "**Scenes**: we lack the paper's T-Rex, Fern, Saloon and Fairy Forest; the tables name the scenes used instead.",
)
