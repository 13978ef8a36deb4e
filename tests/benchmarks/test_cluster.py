"""The benchmark of clusters runs, and its simulation is right where the answer is known."""

import pytest

import cluster


def test_the_simulation_of_known_cases():
    one = cluster.simulated([2.0] * 10, 1, 0.0, seed=1)
    assert one["seconds"] == cluster.START + 20.0 and one["of_ideal"] == 20.0 / one["seconds"]
    two = cluster.simulated([2.0] * 10, 2, 2.5e9, seed=1)
    assert two["start"] == cluster.START + 20.0 and two["seconds"] == two["start"] + 10.0
    many = cluster.simulated([2.0] * 10, 512, 0.0)
    assert many["seconds"] >= cluster.START + 2.0 and many["of_ideal"] < 0.01
    assert sum(cluster.larger([1.0, 3.0], 1.0)) == pytest.approx(3600.0, rel=0.1)


@pytest.mark.cluster
def test_cluster(run, small):
    pytest.importorskip("ray", reason="the benchmark of clusters needs Ray: pip install 'antumbra[ray]'")
    done = run("cluster", small, "--nodes", 1, 2, "--size", "64x96", "--spp", 4, "--hours", 0.1)
    assert [row["nodes"] for row in done.rows] == [1, 2] and all(len(row["parts"]) == 3 for row in done.rows)
    assert all(row["of_ideal"] > 0.0 for row in done.rows) and "of ideal" in done.out
