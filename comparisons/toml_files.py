"""TOML files of options: read with a clear message that names the line, and written again by the package ``tomli-w``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from graphslam import OptionError, toml_file
from graphslam.errors import quoted
from graphslam.toml_file import TYPE_NAMES

from .option import Option
from .options import MODELS


class TomlFile(toml_file.TomlFile):
    """A TOML file of options."""

    def options(self, table: Mapping[str, Any], known: Mapping[str, Option], where: str = "") -> dict[str, Any]:
        """The options of a table, flat and checked; those of the noise models stand in tables [motion] and [sensor].

        Args:
            table: whose keys are read.
            known: the options, by name; see `options.options_of`.
            where: the name of the table, for messages.

        Raises:
            FormatError: a key is unknown or a value is impossible; with the line.
        """
        inside = {model: {n: o for n, o in known.items() if o.model == model} for model in MODELS}
        plain = {n: o for n, o in known.items() if o.model not in MODELS and o.only != "python"}
        for key in table:
            if key in known and known[key].model in MODELS:
                raise self.error(f"{where}.{key}" if where else key, f"{key} belongs in the table [{known[key].model}]")
        self.check_keys(table, (*plain, *(model for model in MODELS if inside[model])), where)
        values: dict[str, Any] = {}
        for key in table:
            place = f"{where}.{key}" if where else key
            if key in plain:
                values[key] = self.checked(plain[key], table[key], place)
            else:
                values |= self.options_of_model(self.value(table, key, dict, where=where), inside[key], place)
        return values

    def options_of_model(self, table: Mapping[str, Any], known: Mapping[str, Option], where: str) -> dict[str, Any]:
        """The numbers of one noise model in its table [motion] or [sensor], by the names of their options."""
        names = {name.removeprefix("sensor_"): name for name in known}
        self.check_keys(table, names, where)
        values = {key: self.checked(known[names[key]], table[key], f"{where}.{key}") for key in table}
        model = MODELS[where.rpartition(".")[2]]
        self.attempt(lambda: model().changed(**values), where)
        return {names[key]: value for key, value in values.items()}

    def checked(self, option: Option, value: Any, place: str) -> Any:
        """The value of an option; ``place`` is its key.

        Raises:
            FormatError: the value is impossible; with the line.
        """
        try:
            if option.each is not str and option.each is not Path and isinstance(value, str):
                raise OptionError(f"{place} should be {TYPE_NAMES[option.each]}, not {quoted(value)}")
            return option.checked(value)
        except OptionError as error:
            raise self.error(place, str(error)) from None


def to_toml(table: Mapping[str, Any], comment: str = "") -> str:
    """A table as TOML: text, numbers, true and false, lists of these, and tables.

    Args:
        table: keys with None are left out, because TOML has no such value.
        comment: lines for the head of the file.
    """
    return "".join(f"# {line}\n" for line in comment.splitlines()) + tomli_w.dumps(_present(table))


def _present(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _present(entry) for key, entry in value.items() if entry is not None}
    if isinstance(value, (list, tuple)):
        return [_present(entry) for entry in value]
    return str(value) if isinstance(value, Path) else value
