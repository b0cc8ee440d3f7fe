"""Cells that NumPy reads at once are the numbers that Python reads one by one."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graphslam.log.cells import nanoseconds
from graphslam.log.text_table import TextTable, grid_of

CELLS = [
    "0", "-0", "-0.0", "5.", ".5", "+1.5", "0.1", "0.30000000000000004", "9007199254740993", "1e-3", "-2.5E+07", "1e400",
    "123456789012345678901234567890", "1716000000.123456789", "9223372036854775808", "0.000000000000000000000000123", " 7",
]  # fmt: skip


def table(cells, separator=","):
    return "\n".join(f"1{separator}{cell}{separator}2" for cell in cells)


def test_every_form_of_a_number():
    numbers = grid_of(table(CELLS), ",", 3, ".").numbers(1)
    expected = [float(cell) for cell in CELLS]
    assert numbers.tolist() == expected
    assert np.signbit(numbers).tolist() == [math.copysign(1, number) < 0 for number in expected]


@given(st.lists(st.floats(allow_nan=False) | st.decimals(-10, 10, places=7, allow_nan=False).map(float), min_size=1))
def test_the_numbers_are_those_of_python(numbers):
    assert grid_of(table(map(repr, numbers)), ",", 3, ".").numbers(1).tolist() == numbers


def test_decimal_commas_and_cells_that_are_missing():
    assert grid_of("1,5;-2,25\n3;4e-1", ";", 2, ",").numbers(1).tolist() == [-2.25, 0.4]
    assert np.isnan(grid_of(table(["", "NA", "nan", "-", "null"]), ",", 3, ".").numbers(1)).all()


@pytest.mark.parametrize("cell", ["fast", "1_0", "1.2.3", "--1", "1-2", "0x10", "."])
def test_what_is_no_number(cell):
    grid = grid_of(table(["1", cell]), ",", 3, ".")
    assert grid.decimals(1) is None
    with pytest.raises(ValueError):
        grid.numbers(1)


@pytest.mark.parametrize("text", ["1,2\n3", "1,2\n3,4,5", "1,2,3\n4", '1,"2"', "1 2", "1,2,3,4\n5,6\n7,8,9"])
def test_rows_that_are_no_grid(text):
    assert grid_of(text, ",", 3 if text.startswith("1,2,3") else 2, ".") is None


@pytest.mark.parametrize(
    ("cell", "unit", "expected"),
    [
        ("1716000000.123456789", None, 1_716_000_000_123_456_789), ("0.29999999999999998", "s", 300_000_000),
        ("-1.5", "s", -1_500_000_000), ("1716000000123.4", None, 1_716_000_000_123_400_000), ("12.34567", "us", 12_346),
        ("1716000000123456789", None, 1_716_000_000_123_456_789), ("1.5e3", "ms", 1_500_000_000),
    ],
)  # fmt: skip
def test_times_are_exact(cell, unit, expected, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"t,a\n{cell},1\n")
    assert nanoseconds(TextTable(path), 0, unit).tolist() == [expected]
