"""What a run is told, as one object and as a TOML file: ``slam-compare run --config run.toml``.

A saved configuration repeats its run bit for bit. It names the log by its whole path and by the SHA-256 of its content;
where results go is not part of it, so that a repeat does not overwrite what it repeats.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from graphslam import FormatError, MotionModel, OptionError, SensorModel

from .estimator import RunOptions
from .estimators import ESTIMATORS
from .toml_files import TomlFile, nearest, to_toml

#: the noise models: tables of a configuration, ``[motion]`` and ``[sensor]``
MODELS: dict[str, type] = {"motion": MotionModel, "sensor": SensorModel}
#: the options of `RunOptions` but its models, and the type of each
OPTIONS: dict[str, type] = {
    f.name: {"str": str, "str | None": str, "int": int, "float": float}[str(f.type)]
    for f in fields(RunOptions)
    if f.name not in MODELS
}
_DATA: dict[str, type] = {
    "log": str, "log_sha256": str, "format": str, "dimensions": int, "robot": int, "keep_every": float, "stride": int,
    "max_range": float, "noise": str, "range_scale": float, "range_bias": float,
}  # fmt: skip
#: every key that a configuration may have at its top
KEYS = (*_DATA, "estimators", *OPTIONS, *MODELS)


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """The effective configuration of a run.

    Attributes:
        log: the file or folder, None for the sample log of the package.
        log_sha256: of its content when the configuration was saved, or None.
        format, dimensions, robot, keep_every: how the log is read, see `graphslam.load`; dimensions 2 leaves psi out.
            None: by content.
        stride, max_range: which of its poses and sightings are kept.
        range_scale, range_bias: the line by which the sensor measures ranges, undone, see `Log.with_corrected_ranges`.
        estimators: which run; None for all that can.
        options: what they are told.
    """

    log: Path | None = None
    log_sha256: str | None = None
    format: str | None = None
    dimensions: int | None = None
    robot: int | None = None
    keep_every: float | None = None
    stride: int = 1
    max_range: float | None = None
    range_scale: float = 1.0
    range_bias: float = 0.0
    estimators: tuple[str, ...] | None = None
    options: RunOptions = field(default_factory=RunOptions)

    def to_toml(self) -> str:
        """The configuration as TOML; what is None (chosen by what suits the log) is left out."""
        table: dict[str, Any] = {
            "log": None if self.log is None else str(self.log.absolute()),
            "log_sha256": self.log_sha256,
            "format": self.format,
            "dimensions": self.dimensions,
            "robot": self.robot,
            "keep_every": self.keep_every,
            "stride": self.stride if self.stride > 1 else None,
            "max_range": self.max_range,
            "range_scale": self.range_scale if self.range_scale != 1 else None,
            "range_bias": self.range_bias if self.range_bias != 0 else None,
            "estimators": self.estimators,
            **asdict(self.options),
        }
        comment = f"Repeat this run: slam-compare run --config config.toml\nmade with {', '.join(versions())}"
        return to_toml(table, comment)


def read_config(path: Path) -> dict[str, Any]:
    """The values of a configuration file, flat: {"log": Path, "particles": 100, "motion.nn": 0.1, ...}.

    A relative path of a log or of a noise file starts from the folder of the file.

    Raises:
        FormatError: the file is not valid TOML, has an unknown key, or a value that is impossible; with the line.
    """
    file = TomlFile(path)
    table = file.table
    file.check_keys(table, KEYS)
    flat = {key: file.value(table, key, kind) for key, kind in _DATA.items() if key in table}
    flat |= read_options(file, {key: value for key, value in table.items() if key in OPTIONS or key in MODELS})
    if (estimators := file.value(table, "estimators", list)) is not None:
        flat["estimators"] = check_estimators(file, estimators)
    for key in ("log", "noise"):
        if key in flat:
            flat[key] = path.parent / flat[key]
    check_options(file, flat)
    return flat


def check_options(file: TomlFile, flat: Mapping[str, Any]) -> None:
    """Raise `FormatError`, with the line where it is found, for an option with an impossible value."""
    try:
        run_options(flat)
    except OptionError as error:
        # the sentence begins with the name of the option
        raise file.error(str(error).split()[0], str(error)) from None


def check_estimators(file: TomlFile, names: list[Any]) -> list[str]:
    """The names of estimators of a file, checked.

    Raises:
        FormatError: one is unknown, or there is none.
    """
    for name in names:
        if not isinstance(name, str):
            raise file.error("estimators", f"estimators should be a list of names, not {names!r}")
        if name not in ESTIMATORS:
            raise file.error(
                "estimators", f"there is no estimator {name!r}; did you mean {nearest(name, ESTIMATORS)!r}?"
            )
    if not names:
        raise file.error("estimators", f"name at least one estimator: {', '.join(ESTIMATORS)}")
    return list(dict.fromkeys(names))


def read_options(file: TomlFile, table: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """The options of the estimators in a table, flat: {"particles": 100, "motion.nn": 0.1}.

    Raises:
        FormatError: a key is unknown or a value has a wrong type.
    """
    file.check_keys(table, (*OPTIONS, *MODELS), where)
    flat = {key: file.value(table, key, OPTIONS[key], where=where) for key in table if key in OPTIONS}
    for name in table:
        if name in MODELS:
            inner = f"{where}.{name}" if where else name
            flat |= {f"{name}.{key}": value for key, value in read_model(file, table, name, inner)}
    return flat


def read_model(file: TomlFile, table: Mapping[str, Any], name: str, where: str) -> Iterator[tuple[str, Any]]:
    """The parameters of a noise model in ``table[name]``, one by one.

    Raises:
        FormatError: a key is unknown or a value has a wrong type.
    """
    model = file.value(table, name, dict)
    file.check_keys(model, [f.name for f in fields(MODELS[name])], where)
    for key in model:
        if key == "offset":
            yield key, tuple(file.value(model, key, list, where=where))
        else:
            yield key, file.value(model, key, float, where=where)


def run_options(flat: Mapping[str, Any]) -> RunOptions:
    """The options from their flat form.

    Raises:
        OptionError: a value is impossible.
    """
    plain = {key: value for key, value in flat.items() if key in OPTIONS}
    return RunOptions(**plain, **models(flat))


def models(flat: Mapping[str, Any]) -> dict[str, Any]:
    """{"motion": MotionModel, "sensor": SensorModel} from keys such as "motion.nn"; None where there are none.

    Raises:
        OptionError: a value is impossible.
    """
    found = {}
    for name, kind in MODELS.items():
        said = {k.removeprefix(f"{name}."): v for k, v in flat.items() if k.startswith(f"{name}.")}
        found[name] = kind(**said) if said else None
    return found


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file's content, in hexadecimal digits; of a folder's files, their names and contents.

    Raises:
        FormatError: a file cannot be read.
    """
    try:
        if path.is_dir():
            whole = hashlib.sha256()
            for inner in sorted(each for each in path.iterdir() if each.is_file()):
                whole.update(f"{inner.name}\n{sha256_of(inner)}\n".encode())
            return whole.hexdigest()
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise FormatError(path, None, f"cannot be read: {error.strerror}") from None


def check_unchanged(path: Path, sha256: str) -> None:
    """Raise `OptionError` unless the file's content is the one whose SHA-256 is given."""
    if sha256_of(path) != sha256:
        raise OptionError(
            f"{path} has changed since the configuration was saved (SHA-256); take the key log_sha256 out of the "
            "configuration to run on the file as it is"
        )


def versions() -> list[str]:
    """This project, Python and the packages that the numbers depend on, with their versions."""
    found = []
    for name in ("virtual-motion-slam", "numpy", "scipy", "numba", "gtsam"):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            found.append(f"{name} (not installed)")
    return [*found, f"Python {platform.python_version()}"]
