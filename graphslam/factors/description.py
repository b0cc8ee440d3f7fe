"""What a factor was made from, as plain data: to read it, to save it, and to make the factor again.

GTSAM returns a Python factor that only a graph holds as a bare `gtsam.CustomFactor`, and can neither save nor copy it.
So the callback of each factor keeps the factor's description, and hands it over when it cannot be evaluated.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from ..edges.robust import KERNELS
from ..errors import FactorError, FormatError, OptionError, quoted
from ..files import write_whole
from ..models import MotionModel, SensorModel

#: the factor types by name; each enters itself when its class is defined
FACTOR_TYPES: dict[str, Any] = {}
_MODELS: dict[str, Any] = {model.__name__: model for model in (MotionModel, SensorModel, *map(type, KERNELS.values()))}


@dataclass(frozen=True, eq=False)
class FactorDescription:
    """The name of a factor type, its keys, and its other arguments: arrays, numbers, words, models and kernels.

    It can be pickled, and equals another of the same content. Its arrays are read-only copies.
    """

    kind: str
    keys: tuple[int, ...]
    arguments: Mapping[str, Any]

    def build(self) -> gtsam.NonlinearFactor:
        """A new factor of this description.

        Raises:
            OptionError: there is no such factor type, or its arguments are impossible.
        """
        if self.kind not in FACTOR_TYPES:
            raise OptionError(f"there is no factor type {quoted(self.kind)} in graphslam.factors")
        make = FACTOR_TYPES[self.kind]
        return make(*([list(self.keys)] if make.keys_in_list else self.keys), **self.arguments)

    def rekeyed(self, keys: Mapping[int, int]) -> FactorDescription:
        """The same factor on other keys {old: new}; keys that are not in the mapping stay."""
        return replace(self, keys=tuple(keys.get(key, key) for key in self.keys))

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON: {"kind", "keys", "arguments"}.

        Raises:
            OptionError: an argument is a function, which cannot be saved.
        """
        arguments = {name: _plain(self.kind, name, value) for name, value in self.arguments.items()}
        return {"kind": self.kind, "keys": list(self.keys), "arguments": arguments}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> FactorDescription:
        """The inverse of `to_dict`.

        Raises:
            OptionError: the data is no description.
        """
        try:
            arguments = {name: _revived(value) for name, value in data["arguments"].items()}
            return cls(str(data["kind"]), tuple(int(key) for key in data["keys"]), arguments)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise OptionError(f"no description of a factor ({quoted(error)}): {quoted(data)}") from None

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, FactorDescription) or (self.kind, self.keys) != (other.kind, other.keys):
            return False
        mine, theirs = self.arguments, other.arguments
        return mine.keys() == theirs.keys() and all(np.array_equal(mine[name], theirs[name]) for name in mine)

    def __hash__(self) -> int:
        return hash((self.kind, self.keys))

    def __str__(self) -> str:
        return f"{self.kind}({', '.join(map(key_name, self.keys))})"


def key_name(key: int) -> str:
    """The name that GTSAM prints for a key, such as x3; the number itself if its first byte is no letter."""
    try:
        return str(gtsam.DefaultKeyFormatter(key))
    except UnicodeDecodeError:
        return str(key)


def describe(factor: gtsam.NonlinearFactor) -> FactorDescription:
    """What a factor of this package was made from, also when a graph returns it as a bare `gtsam.CustomFactor`.

    Raises:
        OptionError: the factor has another origin; GTSAM's own factors have readers such as ``measured()``.
    """
    if isinstance(factor, gtsam.CustomFactor):
        try:
            # there are no values to evaluate at: the error that the callback raises carries the description
            factor.unwhitenedError(gtsam.Values())
        except FactorError as error:
            if error.description is not None:
                return error.description
        except Exception:
            pass  # the callback of another program's factor may raise anything
    raise OptionError(f"{type(factor).__name__} is none of the factor types of graphslam.factors")


def save_factors(factors: Iterable[gtsam.NonlinearFactor] | gtsam.NonlinearFactorGraph, path: str | Path) -> None:
    """Write the descriptions of factors of this package as JSON; the file is written completely or not at all.

    Raises:
        OptionError: a factor is GTSAM's own (save it with ``factor.serialize()``), or has a function as argument.
        FormatError: the file cannot be written.
    """
    if isinstance(factors, gtsam.NonlinearFactorGraph):
        factors = [factors.at(k) for k in range(factors.size())]
    data = {"format": "graphslam factors", "version": 1, "factors": [describe(factor).to_dict() for factor in factors]}
    text = json.dumps(data, indent=1)
    with write_whole(path) as temporary:
        temporary.write_text(text)


def load_factors(path: str | Path) -> gtsam.NonlinearFactorGraph:
    """The factors of a file that `save_factors` wrote.

    Raises:
        FormatError: the file cannot be read, or has another content.
    """
    path, graph = Path(path), gtsam.NonlinearFactorGraph()
    try:
        data = json.loads(path.read_text())
        if data["format"] != "graphslam factors" or data["version"] != 1:
            raise KeyError("format")
        described = enumerate(data["factors"])
    except OSError as error:
        raise FormatError(path, None, f"cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError):
        raise FormatError(path, None, "is no file of save_factors, version 1") from None
    for number, each in described:
        name = f"factor {number}"
        try:
            description = FactorDescription.from_dict(each)
            name += f", {description}"
            graph.add(description.build())
        except (OptionError, TypeError, ValueError, AttributeError) as error:
            raise FormatError(path, None, f"{name}: {error}") from None
    return graph


def _plain(kind: str, name: str, value: Any) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if type(value).__name__ in _MODELS:
        return {"type": type(value).__name__, **asdict(value)}
    if callable(value):
        raise OptionError(f"{kind}: the argument {name} is a function, which cannot be saved")
    return np.asarray(value).tolist()


def _revived(value: Any) -> Any:
    if isinstance(value, dict):
        return _MODELS[value["type"]](**{name: part for name, part in value.items() if name != "type"})
    return value
