"""A unit is a name, a number or a fraction of two; anything else is no unit."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posecal.data.units import MILLIMETRES, millimetres_per
from posecal.errors import PoseDataError


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1.0), ("cm", 10.0), ("m", 1000.0)])
@pytest.mark.parametrize("spelt", [str, str.upper, " {} ".format])
def test_a_named_unit_has_its_length_in_any_case(unit: str, factor: float, spelt: type[str]) -> None:
    assert millimetres_per(spelt(unit)) == factor
    assert MILLIMETRES[unit] == factor


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("25.4", 25.4), ("1/0.0036", 1 / 0.0036), ("1e3", 1000.0), ("3/4", 0.75), (" 2 / 8 ", 0.25), ("1/", 1.0)],
)
def test_a_number_or_a_fraction_is_the_millimetres_in_one_unit(unit: str, factor: float) -> None:
    assert millimetres_per(unit) == factor


@pytest.mark.parametrize(
    "unit", ["", " ", "inch", "0", "-1", "nan", "inf", "1/0", "0/1", "1/inf", "1/2/3", "mm/2", "1e999"]
)
def test_anything_else_is_refused_with_what_a_unit_is(unit: str) -> None:
    words = (
        r"; expected mm, cm, m, or the millimetres in one unit as a number \(25\.4\) or fraction \(1/0\.0036\); deg, "
    )
    with pytest.raises(PoseDataError, match=rf"^unit: '{unit}'{words}"):
        millimetres_per(unit)


@given(st.floats(1e-6, 1e6), st.floats(1e-3, 1e3))
def test_a_fraction_is_the_quotient_of_its_numbers(over: float, under: float) -> None:
    assert millimetres_per(f"{over!r}/{under!r}") == over / under
