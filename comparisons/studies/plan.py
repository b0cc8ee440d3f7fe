"""A study file and the list of its runs: logs x simulator settings x seeds x estimators x options.

`simulated_log` makes the log of a simulated world that a study file describes.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from os import PathLike
from pathlib import Path
from typing import Any

from graphslam import FormatError, Log, OptionError, simulate
from graphslam.errors import printable, quoted, reason_of, shortened
from graphslam.files import path_of

from ..estimators import ESTIMATORS, default_estimators
from ..options import AUTO, BOOK, MODELS, LogOptions, Option, RunOptions, SimulationOptions, options_of
from ..options.reading import OF_FILES, sha256_of
from ..options.toml_files import TomlFile, read_noise


def simulated_log(settings: Mapping[str, Any], seed: int, name: str = "simulated") -> Log:
    """The log of a world.

    Args:
        settings: options of `SimulationOptions`, flat.
        seed: random seed of the simulator.
        name: of the log.

    Raises:
        OptionError: a setting has an impossible value.
    """
    return simulate(**SimulationOptions.of(**{**settings, "seed": seed}).keywords_of_simulate(), name=name)


#: the most runs of a study, the most combinations of values in one table, and the most seeds: all are made at once
MOST_RUNS, MOST_COMBINATIONS, MOST_SEEDS = 500_000, 10_000, 1_000_000
#: so many worlds of a table are tried before a study begins, at 4 ms each; one after them that is impossible fails in its run
_TRIED = 500
#: what [options] may have: every option of a run but its seed
_OPTIONS = {n: each for n, each in options_of(RunOptions).items() if n != "seed" and each.only != "python"}
#: those that decide which log the estimators work on
_OF_LOGS = options_of(LogOptions)
#: what [simulate] may have: every option of a simulated log but its seed
_SETTINGS = {name: each for name, each in options_of(SimulationOptions).items() if name != "seed"}


@dataclass(frozen=True)
class Run:
    """One run of a study: everything that a process anywhere needs to do it, as plain data.

    Attributes:
        log: the name of the log in tables: the file as the study names it, or the world and its varied settings.
        source: {"file", "sha256"} or {"simulate": settings}, see `simulated_log`.
        seed: random seed of the simulator and of the estimator.
        estimator: its name.
        method: the name of the estimator in tables, with the varied options that it uses.
        options: those of the study that the estimator uses, by their names in `RunOptions`. "noise" is "auto", or the
            content of the noise file, and numbers of the noise models stand beside the other options.
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
        run. The name of the log counts, so that two worlds with the same settings are two. The name of the method does
        not.
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
        path, text: the study file and its content.
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
    path = path_of(path)
    file, known = TomlFile(path), _keys()
    file.check_keys(file.table, (*known, "seeds", "simulate", "options"))
    keys = {name: each.default for name, each in known.items()}
    keys |= file.options({name: file.table[name] for name in known if name in file.table}, known)
    sources = [*_files(file, keys["logs"]), *_worlds(file)]
    if not sources:
        raise FormatError(path, None, "a study needs logs = [..] with files, or a table [simulate]")
    methods, seeds = list(_methods(file, keys["estimators"])), _seeds(file)
    if (count := len(sources) * len(seeds) * len(methods)) > MOST_RUNS:
        what = f"{len(sources)} logs, {len(seeds)} seeds and {len(methods)} methods"
        raise FormatError(path, None, f"{what} are {count:,} runs; a study has at most {MOST_RUNS:,}")
    runs: dict[str, Run] = {}
    for (log, source), seed, (estimator, method, options) in product(sources, seeds, methods):
        if "simulate" in source:
            options = {name: value for name, value in options.items() if name not in OF_FILES}
        run = Run(log, source, seed, estimator, method, options)
        runs.setdefault(run.key, run)
    database = path.parent / (keys["database"] or f"{path.stem}.sqlite")
    return Study(path, file.text, database, keys["time_limit"], tuple(runs.values()))


def _keys() -> dict[str, Option]:
    """The keys of a study file outside of its tables; read late, because a script may have added estimators."""
    keys = (
        Option(name="database", kind=Path, each=Path, default=None),
        Option(name="time_limit", kind=float, each=float, default=600.0, positive=True),
        Option(name="estimators", kind=tuple, each=str, default=default_estimators(), choices=tuple(ESTIMATORS)),
        Option(name="logs", kind=tuple, each=str, default=()),
    )
    return {each.name: each for each in keys}


def _seeds(file: TomlFile) -> list[int]:
    seeds = file.table.get("seeds", 1)
    if type(seeds) is int and seeds > MOST_SEEDS:
        raise file.error("seeds", f"a study has at most {MOST_SEEDS} seeds, not {quoted(seeds)}")
    listed = list(range(seeds)) if type(seeds) is int else seeds
    if not isinstance(listed, list) or not listed or not all(type(seed) is int and seed >= 0 for seed in listed):
        raise file.error(
            "seeds", f"seeds should be their number, or a list of whole numbers from 0, not {quoted(seeds)}"
        )
    return list(dict.fromkeys(listed))


def _files(file: TomlFile, patterns: tuple[str, ...]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Names and sources of the log files. One that cannot be read is kept: its runs become rows with that error."""
    folder = file.path.parent
    for pattern in patterns:
        paths = [folder / pattern]
        if any(letter in pattern for letter in "*?["):
            root = Path(pattern).anchor
            try:
                paths = sorted(Path(root or folder).glob(pattern.removeprefix(root)))
            except (ValueError, NotImplementedError, OSError) as error:
                raise file.error("logs", f"{quoted(pattern)} is no pattern of files: {shortened(str(error))}") from None
            if not paths:
                raise file.error("logs", f"no file matches {quoted(pattern)} in {root or folder}")
        for path in paths:
            try:
                digest = sha256_of(path)
            except FormatError:
                digest = None
            name = path.relative_to(folder) if path.is_relative_to(folder) else path
            yield printable(str(name)), {"file": str(path.absolute()), "sha256": digest}


def _worlds(file: TomlFile) -> Iterator[tuple[str, dict[str, Any]]]:
    """Names and sources of the simulated logs, one for each combination of settings."""
    tables = file.value(file.table, "simulate", dict, list)
    check = partial(file.options, known=_SETTINGS)
    names: set[str] = set()
    for number, table in enumerate([tables] if isinstance(tables, dict) else tables or [], start=1):
        where = "simulate" if isinstance(tables, dict) else f"simulate[{number - 1}]"
        if not isinstance(table, dict):
            wrong = f"simulate should be a table [simulate], or several [[simulate]], not {quoted(table)}"
            raise file.error("simulate", wrong)
        fixed = check({key: value for key, value in table.items() if key not in ("name", "vary")}, where=where)
        name = file.value(table, "name", str, where=where) or fixed.get("world", "book")
        if name in names:
            name = f"{name}-{number}"
        names.add(name)
        for k, varied in enumerate(_combinations(file, table, where, check)):
            if k < _TRIED:
                _check_world(file, fixed | varied, where)
            yield _label(name, varied), {"simulate": fixed | varied}


def _check_world(file: TomlFile, settings: Mapping[str, Any], where: str) -> None:
    """Simulate one step: the simulator itself checks its settings."""
    try:
        simulated_log({**settings, "steps": min(settings.get("steps", 1), 1)}, seed=0)
    except OptionError as error:
        raise file.error(f"{where}.{str(error).split()[0]}", f"{where}: {error}") from None
    except (TypeError, ValueError) as error:
        raise file.error(where, f"{where}: these settings make no world: {reason_of(error)}") from None


def _methods(file: TomlFile, names: tuple[str, ...]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Estimators with their options; what an estimator does not use is left out, so no run is done twice."""
    table = file.value(file.table, "options", dict) or {}
    if "seed" in table:
        raise file.error("options.seed", "a study has seeds: set seeds at the top of the file instead of options.seed")
    if "map" in table or "map" in (table.get("vary") or {}):
        raise file.error(
            "options.map", "studies do not localise in maps; use slam-compare run LOG --map FILE for each log"
        )

    def check(part: Mapping[str, Any], where: str) -> dict[str, Any]:
        values = file.options(part, _OPTIONS, where)
        file.attempt(lambda: RunOptions.of(**values), where)
        return values

    fixed = check({key: value for key, value in table.items() if key != "vary"}, "options")
    combinations = list(_combinations(file, table, "options", check))
    for name in names:
        methods: set[str] = set()
        for varied in combinations:
            used = {n for n in fixed | varied if n in _OF_LOGS or n in ESTIMATORS[name].uses}
            method = _label(name, {key: value for key, value in varied.items() if key in used})
            if method not in methods:
                methods.add(method)
                options = {key: value for key, value in (fixed | varied).items() if key in used}
                if (noise := options.get("noise")) in (AUTO, BOOK):
                    # text, as the key and the database need it
                    options["noise"] = str(noise)
                elif noise is not None:
                    options["noise"] = read_noise(file.path.parent / noise)
                yield name, method, options


def _combinations(
    file: TomlFile, table: Mapping[str, Any], where: str, check: Callable[..., dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    """All combinations of the lists in ``table["vary"]``, each checked as if it stood in the table itself."""
    vary = file.value(table, "vary", dict, where=where) or {}
    where = f"{where}.vary"
    axes = []
    for key, values in vary.items():
        # vary.sensor.range_rate = [..]: one axis for each number of the model
        inside = values if isinstance(values, dict) and key in MODELS else {None: values}
        for inner, listed in inside.items():
            name = key if inner is None else f"{key}.{inner}"
            if not isinstance(listed, list) or not listed:
                raise file.error(f"{where}.{name}", f"{where}.{name} should be a list of values, not {quoted(listed)}")
            axes.append([check({key: v if inner is None else {inner: v}}, where=where) for v in listed])
    if (count := math.prod(map(len, axes))) > MOST_COMBINATIONS:
        raise file.error(where, f"{where} has {count:,} combinations of values; there may be {MOST_COMBINATIONS:,}")
    for chosen in product(*axes):
        yield {name: value for entry in chosen for name, value in entry.items()}


def _label(name: str, varied: Mapping[str, Any]) -> str:
    """'fastslam1 particles=100 range_rate=0.1'; a long list is named by its length and a digest."""
    return " ".join([name, *(f"{key}={_short(value)}" for key, value in varied.items())])


def _short(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        text = json.dumps(value, separators=(",", ":"))
        return text if len(text) <= 24 else f"[{len(value)}:{hashlib.sha256(text.encode()).hexdigest()[:4]}]"
    if isinstance(value, bool):
        return str(value).lower()
    # repr, so that two numbers that differ never have the same name
    return repr(value) if isinstance(value, float) else str(value)
