"""Folders of results, written completely or not at all."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime
from itertools import count
from pathlib import Path

from graphslam import FormatError, OptionError
from graphslam.files import check_path, check_place

#: the default folder of the results folders
RESULTS = Path("results")


def check_can_write(path: Path, *, endings: tuple[str, ...] = ()) -> None:
    """Raise now rather than after minutes of work if a file cannot be written at ``path``.

    Args:
        path: of the file.
        endings: those that the name may have, such as (".png", ".pdf"); default: any.

    Raises:
        OptionError: the name has another ending.
        FormatError: no file can be written there.
    """
    if endings and path.suffix.lower() not in endings:
        raise OptionError(f"{path}: the name of this file must end in {' or '.join(endings)}")
    check_place(path)
    path = path.resolve()
    if not path.parent.is_dir():
        raise FormatError(path, None, f"cannot write into {path.parent}: there is no such folder")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise FormatError(path, None, f"cannot write into {path.parent}: Permission denied")


def check_can_make(directory: Path) -> None:
    """Raise `FormatError` now rather than after minutes of work if ``directory`` cannot be made or written into."""
    check_path(directory)
    for place in (directory, *directory.absolute().parents):
        if place.is_dir():
            if not os.access(place, os.W_OK | os.X_OK):
                raise FormatError(directory, None, f"cannot write into {place}: Permission denied")
            return
        if os.path.lexists(place):
            raise FormatError(directory, None, f"{place} is a file; give the name of a folder")


def new_directory(root: Path = RESULTS, now: datetime | None = None) -> Path:
    """Make the folder ``root/YYYY-mm-ddTHH-MM-SS`` (with -2, -3, ... where that exists) and return it.

    Raises:
        FormatError: the folder cannot be made.
    """
    stamp = (now or datetime.now()).strftime("%Y-%m-%dT%H-%M-%S")
    try:
        root.mkdir(parents=True, exist_ok=True)
        for attempt in count(1):
            directory = root / (stamp if attempt == 1 else f"{stamp}-{attempt}")
            # mkdir itself is the test: two runs of the same second never share a folder
            with suppress(FileExistsError):
                directory.mkdir()
                return directory
    except OSError as error:
        raise FormatError(root, None, f"cannot make a folder here: {error.strerror}") from None
    raise AssertionError("count() never ends")


def point_latest(directory: Path) -> None:
    """Link ``latest``, next to a results folder, to it, where links are possible and the name is free."""
    link = directory.parent / "latest"
    if os.path.lexists(link) and not link.is_symlink():
        return
    spare = directory.parent / f".latest-{directory.name}"
    with suppress(OSError):
        spare.symlink_to(directory.name, target_is_directory=True)
        # replacing is atomic, so that a reader never finds the link missing
        spare.replace(link)
    with suppress(OSError):
        spare.unlink()


class SavedFiles(dict[str, Path]):
    """The files that were written, by kind or name.

    Attributes:
        notes: which files could not be made, and why, one sentence each.
    """

    def __init__(self, files: Mapping[str, Path]) -> None:
        super().__init__(files)
        self.notes: list[str] = []


@contextmanager
def fill_results(directory: Path, *, new: bool) -> Iterator[Path]:
    """Fill a results folder whole or not at all; files of an earlier run in it, which its JSON lists, are removed.

    Args:
        directory: of the results.
        new: whether it was made by `new_directory` just now; then ``latest`` will point to it.
    """
    former = _written_before(directory)
    with fill_whole(directory, for_this_only=new) as folder:
        yield folder
        former -= {path.name for path in folder.iterdir()}
    for name in former:
        # readers would take them for a part of the new results
        (directory / name).unlink(missing_ok=True)
    if new:
        point_latest(directory)


def _written_before(directory: Path) -> set[str]:
    """The names of the files that an earlier comparison left in a folder, according to its comparison.json."""
    try:
        listed = json.loads((directory / "comparison.json").read_text(encoding="utf-8"))["files"].values()
        names = {Path(name).name for name in listed if Path(name).parent.name == directory.name}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return set()
    return {name for name in names if (directory / name).is_file()}


@contextmanager
def fill_whole(directory: Path, *, for_this_only: bool = False) -> Iterator[Path]:
    """Yield an empty folder; what the block puts there moves into ``directory`` only if the block ends well.

    ``directory`` is made if it does not exist. If the block fails it is removed again, provided that it was made here
    (or ``for_this_only`` says that the caller made it just for this) and is empty.

    Raises:
        FormatError: the folder cannot be made or written.
    """
    ours = for_this_only or not directory.exists()
    try:
        directory.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=".unfinished-", dir=directory))
    except OSError as error:
        raise FormatError(directory, None, f"cannot write into this folder: {error.strerror}") from None
    try:
        yield temporary
        for path in sorted(temporary.iterdir()):
            path.replace(directory / path.name)
    except OSError as error:
        raise FormatError(error.filename or directory, None, f"cannot be written: {error.strerror}") from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        with suppress(OSError):
            # refuses, as it should, unless the folder is empty
            if ours:
                directory.rmdir()
