"""The benchmark of small questions."""


def test_every_question_has_a_row(run):
    found = run("small", "--rounds", 1, "--threads", 1)
    names = [row["query"] for row in found.rows]
    assert names[0] == "occluded, 1 ray" and "visibility, 1 point, 1 point light" in names and len(names) >= 5
    assert all(row["microseconds"] > 0 for row in found.rows) and "occluded, 100 rays" in found.out
