"""Columns of text tables are the numbers that Python reads one by one, and their times are exact."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from graphslam.errors import FormatError
from graphslam.log.cells import nanoseconds
from graphslam.log.text_table import TextTable

CELLS = [
    "0", "-0", "-0.0", "5.", ".5", "+1.5", "0.1", "0.30000000000000004", "9007199254740993", "1e-3", "-2.5E+07", "1e400",
    "123456789012345678901234567890", "1716000000.123456789", "9223372036854775808", "0.000000000000000000000000123", " 7",
]  # fmt: skip


def table(folder, cells, separator=","):
    rows = [f"1{separator}{cell}{separator}2" for cell in cells]
    path = folder / "table.csv"
    path.write_text("\n".join([separator.join("abc"), *rows]) + "\n")
    return TextTable(path)


def numbers(folder, cells, separator=","):
    return table(folder, cells, separator).numbers([1])[:, 0]


def test_every_form_of_a_number(tmp_path):
    found, expected = numbers(tmp_path, CELLS), [float(cell) for cell in CELLS]
    assert found.tolist() == expected
    assert np.signbit(found).tolist() == [math.copysign(1, number) < 0 for number in expected]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    given=st.lists(st.floats(allow_nan=False) | st.decimals(-10, 10, places=7, allow_nan=False).map(float), min_size=1)
)
def test_the_numbers_are_those_of_python(tmp_path, given):
    assert numbers(tmp_path, map(repr, given)).tolist() == given


def test_decimal_commas_and_cells_that_are_missing(tmp_path):
    assert numbers(tmp_path, ["1,5", "-2,25", "4e-1"], ";").tolist() == [1.5, -2.25, 0.4]
    found = numbers(tmp_path, ["1.5", "", "NA", "nan", "-", "null"])
    assert found[0] == 1.5
    assert np.isnan(found[1:]).all()


@pytest.mark.parametrize("cell", ["fast", "1_0", "1.2.3", "--1", "1-2", "0x10", "."])
def test_what_is_no_number(cell, tmp_path):
    with pytest.raises(FormatError, match="table.csv:3: 'b' should be a number, not "):
        numbers(tmp_path, ["1", cell])


@pytest.mark.parametrize(
    ("cell", "unit", "expected"),
    [
        ("1716000000.123456789", None, 1_716_000_000_123_456_789), ("0.29999999999999998", "s", 300_000_000),
        ("-1.5", "s", -1_500_000_000), ("1716000000123.4", None, 1_716_000_000_123_400_000), ("12.34567", "us", 12_346),
        ("1716000000123456789", None, 1_716_000_000_123_456_789), ("1.5e3", "ms", 1_500_000_000),
        ("-1716000000.1234567896", "s", -1_716_000_000_123_456_790), ("1716000000.9999999996", "s", 1_716_000_001 * 10**9),
    ],
)  # fmt: skip
def test_times_are_exact(cell, unit, expected, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"t,a\n{cell},1\n")
    assert nanoseconds(TextTable(path), 0, unit, "odometry").tolist() == [expected]
    path.write_text(f"t;a\n{cell.replace('.', ',')};1,5\n")
    assert nanoseconds(TextTable(path), 0, unit, "odometry").tolist() == [expected]


@pytest.mark.parametrize("comment", ["v1.2", "10.1.2.3", "30.11.2026"])
def test_decimal_commas_beside_other_points(comment, tmp_path):
    """Three decimals in each number were taken for thousands, because of a point in another cell."""
    path = tmp_path / "a.csv"
    path.write_text(f"t;nu;comment\n1,000;1,500;{comment}\n1,100;1,500;{comment}\n")
    assert TextTable(path).numbers([0, 1]).tolist() == [[1.0, 1.5], [1.1, 1.5]]
