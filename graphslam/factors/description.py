"""What a factor was made from, as plain data: read it back, save it, make the factor anew.

GTSAM hands out a Python factor that it holds as a bare `gtsam.CustomFactor`, and can neither save nor copy it. So a
factor's callback knows its description and tells it when asked to evaluate nothing.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from ..edges.robust import KERNELS, Kernel
from ..errors import FactorError, FormatError, OptionError
from ..files import write_whole
from ..models import MotionModel, SensorModel

_MODELS: dict[str, Any] = {model.__name__: model for model in (MotionModel, SensorModel)}
_MODELS |= {type(kernel).__name__: type(kernel) for kernel in KERNELS.values()}


@dataclass(frozen=True, eq=False)
class FactorDescription:
    """A factor type's name, its keys, and the arguments besides them; arrays, numbers, words and noise models.

    Picklable, and equal to another of the same content. Its arrays are read-only copies.
    """

    kind: str
    keys: tuple[int, ...]
    arguments: Mapping[str, Any]

    def build(self) -> gtsam.NonlinearFactor:
        """A factor like the one described.

        Raises:
            OptionError: there is no such factor type, or its arguments are impossible.
        """
        from .. import factors

        make = getattr(factors, self.kind, None) if self.kind.endswith("Factor") else None
        if make is None:
            raise OptionError(f"there is no factor type {self.kind!r} in graphslam.factors")
        if self.kind in _MANY_KEYS:
            return make(list(self.keys), **self.arguments)
        return make(*self.keys, **self.arguments)

    def rekeyed(self, keys: Mapping[int, int]) -> FactorDescription:
        """The same factor on other keys; those that the mapping lacks stay."""
        return replace(self, keys=tuple(keys.get(key, key) for key in self.keys))

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON: {"kind", "keys", "arguments"}.

        Raises:
            OptionError: an argument is a function, which cannot be written down.
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
            raise OptionError(f"no description of a factor ({error!r}): {data!r}") from None

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, FactorDescription) or (self.kind, self.keys) != (other.kind, other.keys):
            return False
        mine, theirs = self.arguments, other.arguments
        return mine.keys() == theirs.keys() and all(_same(mine[name], theirs[name]) for name in mine)

    def __hash__(self) -> int:
        return hash((self.kind, self.keys))

    def __str__(self) -> str:
        names = ", ".join(map(key_name, self.keys))
        return f"{self.kind}({names})"


def key_name(key: int) -> str:
    """How GTSAM calls a key, x3; the number itself where its first byte is no letter."""
    try:
        return str(gtsam.DefaultKeyFormatter(key))
    except UnicodeDecodeError:
        return str(key)


#: factor types whose first argument is a list of keys
_MANY_KEYS = ("LandmarkFactor", "ResidualFactor")


def describe(factor: gtsam.NonlinearFactor) -> FactorDescription:
    """What a factor of ours was made from, also one that a graph handed out.

    Raises:
        OptionError: the factor is none of ours; GTSAM's own have readers of their own, such as ``measured()``.
    """
    if isinstance(factor, gtsam.CustomFactor):
        try:
            # nothing to evaluate at: the callback complains, and says who it is
            factor.unwhitenedError(gtsam.Values())
        except FactorError as error:
            if error.description is not None:
                return error.description
        except Exception:
            pass  # somebody else's factor, and whatever it raises
    raise OptionError(f"{type(factor).__name__} is none of the factor types of graphslam.factors")


def save_factors(factors: Iterable[gtsam.NonlinearFactor] | gtsam.NonlinearFactorGraph, path: str | Path) -> None:
    """Write the descriptions of factors of ours as JSON; whole or not at all.

    Raises:
        OptionError: a factor is none of ours (GTSAM writes its own: ``factor.serialize()``), or has a function in it.
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
        FormatError: the file cannot be read, or is no such file.
    """
    path = Path(path)
    try:
        data = json.loads(path.read_text())
        if data["format"] != "graphslam factors" or data["version"] != 1:
            raise KeyError("format")
        descriptions = [FactorDescription.from_dict(each) for each in data["factors"]]
    except OSError as error:
        raise FormatError(path, None, f"cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        if isinstance(error, OptionError):
            raise FormatError(path, None, str(error)) from None
        raise FormatError(path, None, "is no file of save_factors, version 1") from None
    graph = gtsam.NonlinearFactorGraph()
    for number, description in enumerate(descriptions):
        try:
            graph.add(description.build())
        except (OptionError, TypeError, ValueError, AttributeError) as error:
            raise FormatError(path, None, f"factor {number}, {description}: {error}") from None
    return graph


def _plain(kind: str, name: str, value: Any) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if type(value).__name__ in _MODELS:
        return {"type": type(value).__name__, **vars(value)}
    if callable(value):
        raise OptionError(f"{kind}: the argument {name} is a function, which cannot be saved")
    if isinstance(value, tuple):
        return [_plain(kind, name, part) for part in value]
    return np.asarray(value).tolist()


def _revived(value: Any) -> Any:
    if isinstance(value, dict):
        fields = dict(value)
        return _MODELS[fields.pop("type")](**fields)
    return value


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, (str, Kernel, MotionModel, SensorModel)) or a is None or callable(a):
        return bool(a == b)
    if b is None or np.shape(a) != np.shape(b):
        return False
    return bool(np.array_equal(a, b))
