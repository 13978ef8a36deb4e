"""Functions whose keywords are the fields of a class of options."""

import inspect
from dataclasses import dataclass

import pytest

from antumbra.base.checks import flag
from antumbra.base.errors import InputError
from antumbra.base.option_fields import (
    RealNumber,
    WholeNumber,
    check_fields,
    deciding_fields,
    describe_fields,
    field_values,
    option,
    optional,
    with_keywords,
)


@describe_fields
@dataclass(frozen=True, kw_only=True)
class Baking:
    """How a cake is baked.

    Parameters
    ----------

    Notes
    -----
    Warm.
    """

    degrees: float = option(180.0, RealNumber(0.0, 300.0, unit="Celsius"))
    """Of the oven."""
    eggs: "int | None" = option(None, WholeNumber(0, 12, optional=True), decides=False)
    """How many."""

    def __post_init__(self):
        check_fields(self)


@with_keywords(Baking)
def bake(cake: str, *, oven: str = "gas", **keywords) -> Baking:
    """Bake a cake.

    Parameters
    ----------
    cake : str
        Its name.

    Returns
    -------
    Baking
    """
    return Baking(**keywords)


def test_signature_and_docstring_have_the_fields():
    assert str(inspect.signature(bake)) == (
        f"(cake: str, *, oven: str = 'gas', degrees: float = 180.0, eggs: 'int | None' = None) -> {__name__}.Baking"
    )
    assert (bake.__name__, bake.__module__) == ("bake", __name__)
    describe_fields = "degrees : float\n    Of the oven.\neggs : int or None\n    How many.\n\n"
    assert f"    Its name.\n{describe_fields}Returns\n" in bake.__doc__
    assert f"Parameters\n----------\n{describe_fields}Notes\n" in Baking.__doc__


def test_values():
    made = bake("pie", oven="wood", degrees=200, eggs=3)
    assert field_values(made) == {"degrees": 200.0, "eggs": 3} and deciding_fields(made) == {"degrees": 200.0}
    with pytest.raises(TypeError, match=r"^bake\(\) got an unexpected keyword argument 'degree'$"):
        bake("pie", degree=1, eggs=2)
    with pytest.raises(InputError, match=r"^degrees \(Celsius\) is 400; it must lie between 0 and 300$"):
        bake("pie", degrees=400)
    with pytest.raises(InputError, match=r"^eggs is 13; it must be a whole number from 0 to 12$"):
        bake("pie", eggs=13)


def test_flags_may_be_none():
    assert [optional(flag)(value, "x") for value in (None, True, False)] == [None, True, False]
    with pytest.raises(InputError, match="x is 1"):
        optional(flag)(1, "x")


def test_without_docstrings():
    def plain(**keywords): ...

    assert with_keywords(Baking)(plain).__doc__ is None
