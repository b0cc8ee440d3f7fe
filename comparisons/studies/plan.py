"""A study file and the list of its runs: logs x simulator settings x seeds x estimators x options."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from os import PathLike
from pathlib import Path
from typing import Any

from graphslam import WORLDS, FormatError, OptionError
from graphslam.formats import FORMATS

from ..config import MODELS, check_estimators, check_options, read_model, read_options, sha256_of
from ..estimators import ESTIMATORS
from ..toml_files import TomlFile, nearest
from .simulated import SETTINGS, simulated_log

KEYS = ("database", "time_limit", "seeds", "estimators", "logs", "format", "dimensions", "simulate", "options")
#: seconds that a run may take unless the study says otherwise
TIME_LIMIT = 600.0


@dataclass(frozen=True)
class Run:
    """One run of a study: everything that a process anywhere needs to do it, as plain data.

    Attributes:
        log: how tables call the log: the file as the study names it, or the world and its varied settings.
        source: {"file", "format", "dimensions", "sha256"} or {"simulate": settings}, see `simulated.simulated_log`.
        seed: of the simulator and of the estimator's random numbers.
        estimator: its name.
        method: how tables call the estimator: its name and the varied options that it uses.
        options: what it is told, flat, see `comparisons.config`; only what the study says and the estimator uses.
    """

    log: str
    source: Mapping[str, Any]
    seed: int
    estimator: str
    method: str
    options: Mapping[str, Any]

    @cached_property
    def key(self) -> str:
        """The run's identity: a digest of what decides its numbers.

        A file counts by its content, so a study can be moved to another folder or machine, and a changed log is a new
        run. How the study names the log or world counts: two worlds of the same settings are two. How tables call the
        method does not.
        """
        source = dict(self.source)
        if source.get("sha256") is not None:
            del source["file"]
        identity = [source, self.log, self.seed, self.estimator, dict(self.options)]
        return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:24]


@dataclass(frozen=True)
class Study:
    """A study: its runs in the order in which they are started, and where their rows go.

    Attributes:
        path, text: the study file and what it says.
        database: the SQLite file.
        time_limit: of each run [s].
        runs: those of one log and seed stand together, so that a process makes or reads the log once.
    """

    path: Path
    text: str
    database: Path
    time_limit: float
    runs: tuple[Run, ...]


def read_study(path: str | PathLike[str]) -> Study:
    """Read a study file (see docs/studies.md).

    Raises:
        FormatError: it is not valid TOML, has an unknown key, or a value that is impossible; with the line.
    """
    path = Path(path)
    file = TomlFile(path)
    table = file.table
    file.check_keys(table, KEYS)
    database = file.value(table, "database", str)
    limit = file.value(table, "time_limit", float)
    if limit is not None and not 0 < limit < float("inf"):
        raise file.error("time_limit", f"time_limit should be a number of seconds above 0, not {limit!r}")
    sources = [*_files(file), *_worlds(file)]
    if not sources:
        raise FormatError(path, None, "a study needs logs = [..] with files, or a table [simulate]")
    methods = list(_methods(file))
    runs: dict[str, Run] = {}
    for (log, source), seed, (estimator, method, options) in product(sources, _seeds(file), methods):
        run = Run(log, source, seed, estimator, method, options)
        runs.setdefault(run.key, run)
    return Study(
        path=path,
        text=file.text,
        database=path.parent / (database or f"{path.stem}.sqlite"),
        time_limit=TIME_LIMIT if limit is None else limit,
        runs=tuple(runs.values()),
    )


def _seeds(file: TomlFile) -> list[int]:
    seeds = file.value(file.table, "seeds", int, list)
    if seeds is None:
        return [0]
    if isinstance(seeds, int) and seeds >= 1:
        return list(range(seeds))
    if isinstance(seeds, list) and seeds and all(type(seed) is int and seed >= 0 for seed in seeds):
        return list(dict.fromkeys(seeds))
    raise file.error("seeds", f"seeds should be their number, or a list of whole numbers not below 0, not {seeds!r}")


def _files(file: TomlFile) -> Iterator[tuple[str, dict[str, Any]]]:
    """Names and sources of the log files. One that cannot be read is kept: its runs become rows with that error."""
    table, folder = file.table, file.path.parent
    format, dimensions = file.value(table, "format", str), file.value(table, "dimensions", int)
    if format is not None and format not in FORMATS:
        raise file.error("format", f"there is no format {format!r}; did you mean {nearest(format, FORMATS)!r}?")
    if dimensions not in (None, 2, 3):
        raise file.error("dimensions", f"dimensions should be 2 or 3, not {dimensions}")
    for pattern in file.value(table, "logs", list) or []:
        if not isinstance(pattern, str):
            raise file.error("logs", f"logs should be a list of names of files, not {pattern!r}")
        for found in _expanded(file, folder, pattern):
            try:
                digest = sha256_of(found)
            except FormatError:
                digest = None
            name = str(found.relative_to(folder)) if found.is_relative_to(folder) else str(found)
            yield name, {"file": str(found.absolute()), "format": format, "dimensions": dimensions, "sha256": digest}


def _expanded(file: TomlFile, folder: Path, pattern: str) -> list[Path]:
    if not any(letter in pattern for letter in "*?["):
        return [folder / pattern]
    root = Path(pattern).anchor
    found = sorted(Path(root or folder).glob(pattern.removeprefix(root)))
    if not found:
        raise file.error("logs", f"no file matches {pattern!r} in {root or folder}")
    return found


def _worlds(file: TomlFile) -> Iterator[tuple[str, dict[str, Any]]]:
    """Names and sources of the simulated logs, one for each combination of settings."""
    tables = file.value(file.table, "simulate", dict, list)
    tables = tables if isinstance(tables, list) else [] if tables is None else [tables]
    names: set[str] = set()
    for number, table in enumerate(tables, start=1):
        if not isinstance(table, dict):
            raise file.error(
                "simulate", f"simulate should be a table [simulate], or several [[simulate]], not {table!r}"
            )
        rest = {key: value for key, value in table.items() if key not in ("name", "vary")}
        world = rest.get("world", "book")
        if world not in WORLDS:
            raise file.error("world", f"there is no world {world!r}; did you mean {nearest(str(world), WORLDS)!r}?")
        fixed = _settings(file, rest, "simulate")
        name = file.value(table, "name", str, where="simulate") or world
        if name in names:
            name = f"{name}-{number}"
        names.add(name)
        for varied in _combinations(file, table, "simulate", _settings):
            settings = fixed | varied
            _check_settings(file, settings)
            yield _label(name, varied), {"simulate": settings}


def _settings(file: TomlFile, table: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The simulator's settings in a table, flat and checked for their types."""
    file.check_keys(table, ("name", "vary", "world", *SETTINGS, *MODELS), where)
    flat = {key: file.value(table, key, *SETTINGS[key], where=where) for key in table if key in SETTINGS}
    if "world" in table:
        flat["world"] = table["world"]
    for name in MODELS:
        if name in table:
            flat |= {f"{name}.{key}": value for key, value in read_model(file, table, name, f"{where}.{name}")}
    return flat


def _check_settings(file: TomlFile, settings: Mapping[str, Any]) -> None:
    """One step of the world: the simulator itself says what is impossible."""
    try:
        simulated_log({**settings, "steps": min(settings.get("steps", 1), 1)}, seed=0)
    except OptionError as error:
        raise file.error(str(error).split()[0], f"simulate: {error}") from None
    except (TypeError, ValueError) as error:
        raise file.error("simulate", f"simulate: these settings make no world: {error}") from None


def _methods(file: TomlFile) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Estimators with their options; what an estimator does not use is left out, so no run is done twice."""
    names = file.value(file.table, "estimators", list)
    names = list(ESTIMATORS) if names is None else check_estimators(file, names)
    table = file.value(file.table, "options", dict) or {}
    if "seed" in table:
        raise file.error("options", "options has a seed, but a study has seeds: set seeds at the top of the file")
    fixed = read_options(file, {key: value for key, value in table.items() if key != "vary"}, "options")
    for name in names:
        uses = ESTIMATORS[name].uses
        seen = set()
        for varied in _combinations(file, table, "options", read_options):
            check_options(file, fixed | varied)
            options = {k: v for k, v in (fixed | varied).items() if uses is None or k in uses or "." in k}
            method = _label(name, {key: value for key, value in varied.items() if key in options})
            if method not in seen:
                seen.add(method)
                yield name, method, options


def _combinations(
    file: TomlFile,
    table: Mapping[str, Any],
    where: str,
    check: Callable[[TomlFile, Mapping[str, Any], str], dict[str, Any]],
) -> Iterator[dict[str, Any]]:
    """All combinations of the lists in ``table["vary"]``, each checked as if it stood in the table itself."""
    vary = file.value(table, "vary", dict, where=where) or {}
    where = f"{where}.vary"
    axes = []
    for key, values in vary.items():
        if isinstance(values, dict) and key in MODELS:
            # vary.sensor.range_rate = [..]: one axis for each parameter of the model
            pairs = [(f"{key}.{inner}", listed, inner) for inner, listed in values.items()]
        else:
            pairs = [(key, values, key)]
        for name, listed, last in pairs:
            if not isinstance(listed, list) or not listed:
                raise file.error(f"vary.{last}", f"{where}.{name} should be a list of values to try, not {listed!r}")
            nested = [{key: {last: value}} if last != key else {key: value} for value in listed]
            axes.append([check(file, entry, where) for entry in nested])
    for chosen in product(*axes):
        yield {name: value for entry in chosen for name, value in entry.items()}


def _label(name: str, varied: Mapping[str, Any]) -> str:
    """'fastslam1 particles=100 sensor.range_rate=0.1'; long lists are told by their length."""
    words = [f"{key}={_short(value)}" for key, value in varied.items()]
    return " ".join([name, *words])


def _short(value: Any) -> str:
    if isinstance(value, list):
        text = json.dumps(value, separators=(",", ":"))
        return text if len(text) <= 24 else f"[{len(value)}:{hashlib.sha256(text.encode()).hexdigest()[:4]}]"
    # repr: two values that differ never share a name
    return str(value).lower() if isinstance(value, bool) else str(value) if isinstance(value, str) else repr(value)
