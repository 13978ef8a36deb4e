"""The warm-ups of studies are among all warm-ups, and compile kernels."""

from antumbra.city.city_warm_ups import WARM_UPS
from antumbra.work.warm_ups import all_warm_ups


def test_warm_ups_of_studies_are_listed_once_and_recorded():
    names = [make().name for make in WARM_UPS]
    every = [each.name for each in all_warm_ups()]
    assert len(names) >= 4 and all(every.count(name) == 1 for name in names)
    assert all(each.kernels() for each in all_warm_ups() if each.name in names)
