"""Named tuples that fetch fields: only what is read, once it is read, and everything for kernels and pickles."""

import pickle
from typing import NamedTuple

import numpy as np

from antumbra.base.fetched_fields import FetchedFields
from antumbra.kernels.marshalling import flatten


class Place(NamedTuple):
    x: np.ndarray
    y: int


class FarPlace(FetchedFields, Place):
    _plain = Place

    @property
    def x(self):
        self.fetched = getattr(self, "fetched", 0) + 1
        return np.arange(3.0)


def far():
    return FarPlace(None, 7)


def test_other_fields_fetch_nothing():
    place = far()
    assert place.y == 7 and not hasattr(place, "fetched")
    assert place.x.tolist() == [0.0, 1.0, 2.0] and place.fetched == 1


def test_unpacking_indexing_copies_and_pickles_fetch():
    place = far()
    (x, y), (head, *_) = place, place[:1]
    for each in (x, place[0], head, next(iter(place)), place._replace(y=8).x, pickle.loads(pickle.dumps(place)).x):
        np.testing.assert_array_equal(each, np.arange(3.0))
    assert y == 7 and place._replace(y=8).y == 8
    assert type(place._replace(y=8)) is type(pickle.loads(pickle.dumps(place))) is Place


def test_kernels_take_it_for_the_plain_tuple():
    assert flatten((far(),))[0] == flatten((Place(np.arange(3.0), 7),))[0]
