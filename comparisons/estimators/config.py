"""The configuration of a run as a TOML file: ``slam-compare run --config config.toml`` repeats the run.

A configuration names the log by its absolute path and by the SHA-256 of its content. Noise file and map are copied beside it,
because later runs may replace them. The place of the results is not part of it, so that a repeated run does not overwrite the
results of the first.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

from graphslam import OptionError, sample_log_path
from graphslam.files import path_of
from graphslam.maps.landmark_map import as_map

from ..options import AUTO, BOOK, MODELS, LimitOptions, RunOptions, options_of
from ..options.reading import given_models, sha256_of
from ..options.toml_files import TomlFile, to_toml
from . import check_estimators

#: the options that name files that decide the results
FILES = ("noise", "map")

#: stands for the name of a log that was not read from a file, so that no other log is taken for it
UNNAMED = "a log that was not read from a file; name a file"


def config_text(
    source: Path | tuple[Path | None, ...] | None, estimators: Sequence[str] | None, options: RunOptions, *,
    time_limit: float | None = None, copies: Mapping[str, str],
) -> str:  # fmt: skip
    """The configuration of a run as TOML.

    Args:
        source: the file or folder of the log, or of each of several.
        estimators: those that were asked for; None for all.
        options: as they were given; what the log decides is decided again.
        time_limit: of each estimator [s].
        copies: names of the files beside the configuration that the options name, {"noise": "noise.toml"}, see `copies_of`.
    """
    sources = source if isinstance(source, tuple) else (source,)
    paths = [path for path in sources if path is not None]
    names = [UNNAMED if path is None else _path_text(path.absolute()) for path in sources]
    table: dict[str, Any] = {
        "log": None if paths == [sample_log_path()] else names[0],
        "others": names[1:] or None,
        "log_sha256": sha256_of(*paths) if len(paths) == len(sources) else None,
        "estimators": estimators,
        "time_limit": time_limit,
        **{each.name: value for each, value in options.changed() if each.only != "python" and each.model not in MODELS},
    }
    for name in FILES:
        if (path := getattr(options, name)) not in (None, AUTO, BOOK):
            table[name] = _path_text(path.absolute())
    return to_toml(
        table | dict(copies) | given_models(options),
        f"Repeat this run: slam-compare run --config config.toml\nmade with {', '.join(versions())}",
    )


def copies_of(options: RunOptions) -> dict[str, tuple[str, Callable[[Path], object]]]:
    """Copies of the noise file and of the map that options give: by option the name of the file, and what writes it."""
    copies: dict[str, tuple[str, Callable[[Path], object]]] = {}
    if options.noise not in (None, AUTO, BOOK):
        content = options.noise.read_bytes()
        copies["noise"] = "noise.toml", lambda path: path.write_bytes(content)
    if (known := options.landmark_map or options.map) is not None:
        copies["map"] = "map.npz", as_map(known).save
    return copies


def read_config(path: Path) -> dict[str, Any]:
    """The values of a configuration file, flat: {"log": Path, "estimators": [...], "particles": 100, "nn": 0.1, ...}.

    A relative path in the file starts from the folder of the file.

    Raises:
        FormatError: the file is not valid TOML, has an unknown key, or an impossible value; with the line.
    """
    file = TomlFile(path)
    of_run = {"log": str, "others": list, "log_sha256": str, "estimators": list, "time_limit": float}
    values = {key: file.value(file.table, key, kind) for key, kind in of_run.items() if key in file.table}
    known = options_of(RunOptions)
    rest = {key: value for key, value in file.table.items() if key not in of_run}
    plain = [name for name, each in known.items() if each.model not in MODELS and each.only != "python"]
    file.check_keys(rest, (*of_run, *plain, *MODELS))
    values |= file.options(rest, known)
    file.attempt(lambda: RunOptions.of(**{name: value for name, value in values.items() if name in known}))
    if "estimators" in values:
        file.attempt(lambda: check_estimators(values["estimators"]))
    file.attempt(lambda: LimitOptions.of(time_limit=values.get("time_limit")))
    for key in ("log", *FILES):
        if key in values and (key == "log" or Path(values[key]) not in (AUTO, BOOK)):
            values[key] = path.parent / _path_of(values[key])
    if "others" in values:
        values["others"] = [path.parent / _path_of(str(each)) for each in values["others"]]
    return values


def _path_text(path: Path) -> str:
    """A path as text; a URI where it has bytes that are not UTF-8, which TOML cannot hold."""
    text = str(path)
    return text if text.encode(errors="replace").decode() == text else path.as_uri()


def _path_of(text: str | Path) -> Path:
    uri = str(text)
    return path_of(os.fsdecode(unquote_to_bytes(uri[7:])) if uri.startswith("file:///") else text)


def check_unchanged(logs: Sequence[Path | None], sha256: str) -> None:
    """Raise `OptionError` unless the content of logs (None: the sample log) has this SHA-256."""
    paths = [sample_log_path() if log is None else log for log in logs]
    if sha256_of(*paths) != sha256:
        raise OptionError(
            f"{' or '.join(map(str, paths))} has changed since the configuration was saved (SHA-256); take the key "
            "log_sha256 out of the configuration to run on the file as it is"
        )


def versions() -> list[str]:
    """This project, Python and the packages that the numbers depend on, with their versions."""
    found = []
    for name in ("virtual-motion-slam", "numpy", "scipy", "gtsam"):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            found.append(f"{name} (not installed)")
    return [*found, f"Python {platform.python_version()}"]
