from __future__ import annotations

import json
import os
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from comparisons.results.documents import json_text, jsonable, write_json
from comparisons.results.files import check_can_make, check_can_write, fill_whole, new_directory, point_latest
from graphslam import FormatError

NOON = datetime(2024, 5, 6, 12, 0, 1)


def test_json_has_null_for_what_is_not_a_number() -> None:
    payload = {"a": np.array([1.0, np.nan, np.inf]), 3: np.float64(-np.inf), "b": (np.int64(4), np.bool_(True), None)}
    assert json.loads(json_text(payload)) == {"a": [1.0, None, None], "3": None, "b": [4, True, None]}


def test_json_keeps_every_digit_and_rows_on_their_line() -> None:
    rows = np.random.default_rng(0).normal(size=(3, 3))
    text = json_text({"poses": rows, "empty": [], "nested": {"x": {"y": [1]}}, "name": "σ"})
    assert np.array_equal(json.loads(text)["poses"], rows)
    assert text.count("\n") == 14
    assert "σ" in text
    assert json.loads(text)["nested"] == {"x": {"y": [1]}}


@pytest.mark.parametrize("shape", [(3, 2), (2, 3, 3), (4,), (0, 3), (3, 0), (1, 1)])
def test_arrays_are_laid_out_like_lists(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(0).normal(size=shape)
    values[values > 1] = np.nan
    lists = json.loads(json.dumps(values.tolist()), parse_constant=lambda _: None)
    assert json_text({"a": [values, 1], "b": values}) == json_text({"a": [lists, 1], "b": lists})


def test_paths_become_text() -> None:
    assert jsonable({"p": Path("a/b")}) == {"p": str(Path("a/b"))}


def test_write_json_is_whole_or_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json({"a": 1}, path)
    with pytest.raises(TypeError):
        write_json({"a": object()}, path)
    assert json.loads(path.read_text()) == {"a": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_a_folder_of_its_own_for_every_run(tmp_path: Path) -> None:
    names = [new_directory(tmp_path / "results", NOON).name for _ in range(3)]
    assert names == ["2024-05-06T12-00-01", "2024-05-06T12-00-01-2", "2024-05-06T12-00-01-3"]


def test_latest_follows(tmp_path: Path) -> None:
    for _ in range(2):
        directory = new_directory(tmp_path, NOON)
        point_latest(directory)
        assert (tmp_path / "latest").resolve() == directory
    assert sorted(p.name for p in tmp_path.iterdir()) == ["2024-05-06T12-00-01", "2024-05-06T12-00-01-2", "latest"]


def test_latest_never_replaces_something_of_the_users(tmp_path: Path) -> None:
    (tmp_path / "latest").write_text("mine")
    point_latest(new_directory(tmp_path, NOON))
    assert (tmp_path / "latest").read_text() == "mine"


def test_a_folder_is_filled_at_the_end_only(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "out"
    with fill_whole(target) as folder:
        (folder / "a").write_text("1")
        assert not (target / "a").exists()
    assert [p.name for p in target.iterdir()] == ["a"]
    with fill_whole(target) as folder:
        (folder / "a").write_text("2")
        (folder / "b").write_text("2")
    assert sorted(p.name for p in target.iterdir()) == ["a", "b"]
    assert (target / "a").read_text() == "2"


def write_and_fail(directory: Path, for_this_only: bool) -> None:
    with fill_whole(directory, for_this_only=for_this_only) as folder:
        (folder / "a").write_text("new")
        raise ZeroDivisionError


@pytest.mark.parametrize(
    ("exists", "for_this_only", "stays"), [(False, False, False), (True, False, True), (True, True, False)]
)
def test_a_failure_leaves_nothing_behind(tmp_path: Path, exists: bool, for_this_only: bool, stays: bool) -> None:
    target = tmp_path / "out"
    if exists:
        target.mkdir()
    with pytest.raises(ZeroDivisionError):
        write_and_fail(target, for_this_only)
    assert target.exists() == stays
    assert not stays or list(target.iterdir()) == []


def test_a_failure_spares_what_was_there(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    with pytest.raises(ZeroDivisionError):
        write_and_fail(tmp_path, for_this_only=True)
    assert [p.read_text() for p in tmp_path.iterdir()] == ["old"]


def test_places_that_cannot_be_written(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(FormatError, match="is a file"):
        check_can_make(file / "out")
    with pytest.raises(FormatError, match="cannot write into this folder"), fill_whole(file / "out"):
        pass
    with pytest.raises(FormatError, match="cannot make a folder"):
        new_directory(file)
    with pytest.raises(FormatError, match="is a folder"):
        check_can_write(tmp_path)
    with pytest.raises(FormatError, match="no such folder"):
        check_can_write(tmp_path / "no" / "a.json")
    check_can_make(tmp_path / "new" / "out")
    check_can_write(tmp_path / "a.json")


def test_pipes_and_devices_are_not_replaced_and_links_stay(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for refuse in (check_can_write, lambda path: write_json({}, path)):
        with pytest.raises(FormatError, match="pipe or device"):
            refuse(pipe)
    assert pipe.is_fifo()
    target, link = tmp_path / "target.json", tmp_path / "link.json"
    target.write_text("old")
    link.symlink_to(target)
    write_json({"a": 1}, link)
    assert link.is_symlink()
    assert json.loads(target.read_text()) == {"a": 1}
