from __future__ import annotations

import math
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from comparisons.options.toml_files import TomlFile, to_toml
from graphslam import FormatError

TEXT = st.text(st.characters(exclude_categories=["Cs"]))
PLAIN = st.one_of(TEXT, st.booleans(), st.integers(-(2**63), 2**63 - 1), st.floats(allow_nan=False))
VALUE = st.one_of(PLAIN, st.lists(PLAIN, max_size=3))
TABLE = st.dictionaries(TEXT, st.one_of(VALUE, st.dictionaries(TEXT, VALUE, max_size=3)), max_size=4)


@pytest.mark.slow
@given(TABLE)
def test_what_is_written_is_read_back_equal(table: dict) -> None:
    assert tomllib.loads(to_toml(table, "a comment\nof two lines")) == table


def test_floats_keep_their_last_digit_and_none_is_left_out() -> None:
    assert tomllib.loads(to_toml({"a": 0.1 + 0.2, "b": None, "c": 1e-9, "d": 5e-324})) == {
        "a": 0.30000000000000004, "c": 1e-9, "d": 5e-324,
    }  # fmt: skip
    assert math.isnan(tomllib.loads(to_toml({"a": math.nan}))["a"])


def test_an_unknown_key_is_told_with_its_line_and_the_nearest_known_one(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("# first\nseeds = 3\n[options]\npartikles = 3\n")
    file = TomlFile(path)
    file.check_keys(file.table, ("seeds", "options"))
    with pytest.raises(
        FormatError, match=r"a\.toml:4: unknown key 'partikles' in \[options\]; did you mean 'particles'"
    ):
        file.check_keys(file.table["options"], ("seed", "particles"), "options")


def test_types(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text('a = 1\nb = true\n[t]\nc = "x"\n')
    file = TomlFile(path)
    assert file.value(file.table, "a", int) == 1
    assert isinstance(file.value(file.table, "a", float), float)
    assert file.value(file.table, "d", float) is None
    with pytest.raises(FormatError, match=r":2: b should be a number, not True"):
        file.value(file.table, "b", float)
    with pytest.raises(FormatError, match=r":4: t\.c should be a whole number or a list \[\.\.\], not 'x'"):
        file.value(file.table["t"], "c", int, list, where="t")


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"a = \n", ":1: not valid TOML"),
        (b"\xff", "UTF-8"),
        (
            b"a = 1\nangles = degrees # of the gyroscope\n",
            r':2: not valid TOML: .*; text stands in quotes: angles = "degrees"$',
        ),
    ],
)
def test_what_is_no_toml(tmp_path: Path, content: bytes, word: str) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=word):
        TomlFile(path)
    with pytest.raises(FormatError, match="no such file"):
        TomlFile(tmp_path / "b.toml")


def test_the_line_of_a_key_is_that_of_its_own_table(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("range_std = 1\n[other]\nrange_std = 2\n[sensor]\nbearing_std = 1\nrange_std = -3\n")
    file = TomlFile(path)
    lines = {key: file.line_of(key) for key in ("range_std", "other.range_std", "sensor.range_std", "sensor", "x")}
    assert lines == {"range_std": 1, "other.range_std": 3, "sensor.range_std": 6, "sensor": 4, "x": None}
