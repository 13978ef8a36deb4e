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
    method_with_keywords,
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


@with_keywords(Baking, 1)
def bake(given, cake: str, oven: str = "gas", *args, **keywords) -> Baking:
    """Bake a cake.

    Parameters
    ----------
    cake : str
        Its name.

    Returns
    -------
    Baking
    """
    return Baking(**given(*args, **keywords))


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


class Oven:
    @method_with_keywords(Baking, 1)
    def bake(self, given, cake: str, note: str = "", *args, **keywords) -> tuple[str, Baking]:
        """Bake a cake.

        Parameters
        ----------
        cake : str
        """
        return note, Baking(**given(*args, **keywords))


def test_methods_have_the_fields_too():
    assert Oven().bake("pie", note="hot", eggs=2) == ("hot", Baking(eggs=2))
    assert str(inspect.signature(Oven().bake)).startswith("(cake: str, *, note: str = '', degrees: float = 180.0")
    with pytest.raises(TypeError, match=r"^bake\(\) takes 2 positional arguments but 3 were given$"):
        Oven().bake("pie", "hot")


def test_own_parameters_after_the_positional_ones_need_their_names():
    with pytest.raises(TypeError, match=r"^bake\(\) takes 1 positional argument but 2 were given$"):
        bake("pie", "wood")
    with pytest.raises(TypeError, match=r"missing 1 required positional argument: 'cake'"):
        bake(eggs=1)


def test_flags_may_be_none():
    assert [optional(flag)(value, "x") for value in (None, True, False)] == [None, True, False]
    with pytest.raises(InputError, match="x is 1"):
        optional(flag)(1, "x")


def test_without_docstrings():
    def plain(given, *args, **keywords): ...

    assert with_keywords(Baking, 0)(plain).__doc__ is None
