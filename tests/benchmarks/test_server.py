"""The benchmark of a server."""


def test_each_part_has_rows(run, small):
    found = run("server", small, "--rounds", 1, "--calls", 50, "--threads", 2)
    parts = {part: [row for row in found.rows if row["part"] == part] for part in ("latency", "scaling", "memory")}
    assert sum(map(len, parts.values())) == len(found.rows)
    ours = [row for row in parts["latency"] if row["library"] == "antumbra"]
    assert [row["rays"] for row in ours] == [1, 100, 10_000] and all(row["median_us"] > 0 for row in ours)
    assert all(row["median_us"] <= row["p99_us"] for row in parts["latency"])
    alone = [row["speedup"] for row in parts["scaling"] if row["count"] == 1]
    assert len(alone) > 3 and all(speedup == 1.0 for speedup in alone)
    assert {row["workers"] for row in parts["scaling"]} >= {"threads"} and "part memory" in found.out
    assert [row["query"] for row in parts["memory"]] == ["occluded", "closest_hit", "visibility"]
