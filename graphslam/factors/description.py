"""The arguments of a factor as plain data: to read them, to print and save them, and to make the factor again.

GTSAM returns a Python factor that only a graph holds as a bare `gtsam.CustomFactor`, and can neither save nor copy it.
So the callback of each factor keeps the factor's description, and hands it over when it cannot be evaluated.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from ..edges.robust import KERNELS
from ..errors import FactorError, FormatError, OptionError, SlamError, quoted, reason_of
from ..files import path_of, write_text
from ..models import MotionModel, SensorModel

#: the factor types by name; each enters itself when its class is defined
FACTOR_TYPES: dict[str, Any] = {}
#: functions among the arguments of factors, by the names that files have for them
Functions = Mapping[str, Callable[..., Any]]
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

    def to_dict(self, functions: Functions | None = None) -> dict[str, Any]:
        """Plain data for JSON: {"kind", "keys", "arguments"}.

        Args:
            functions: names of the functions among the arguments, such as the residual of a `ResidualFactor`.

        Raises:
            OptionError: an argument is a function without a name.
        """
        arguments = {name: _plain(self.kind, name, value, functions) for name, value in self.arguments.items()}
        return {"kind": self.kind, "keys": list(self.keys), "arguments": arguments}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], functions: Functions | None = None) -> FactorDescription:
        """The inverse of `to_dict`.

        Raises:
            OptionError: the data is no description, or a function of that name is not given.
        """
        try:
            arguments = {name: _revived(value, functions or {}) for name, value in data["arguments"].items()}
            return cls(str(data["kind"]), tuple(int(key) for key in data["keys"]), arguments)
        except OptionError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise OptionError(f"no description of a factor ({quoted(error)}): {quoted(data)}") from None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FactorDescription) and self.equals(other, 0.0)

    def equals(self, other: FactorDescription, tolerance: float) -> bool:
        """Whether type and keys are the same, and no number of the arguments differs by more than the tolerance."""
        mine, theirs = self.arguments, other.arguments
        same = (self.kind, self.keys, mine.keys()) == (other.kind, other.keys, theirs.keys())
        return same and all(_close(mine[name], theirs[name], tolerance) for name in mine)

    def __hash__(self) -> int:
        return hash((self.kind, self.keys))

    def __str__(self) -> str:
        return f"{self.kind}({', '.join(map(key_name, self.keys))})"


def _close(a: Any, b: Any, tolerance: float) -> bool:
    try:
        return np.shape(a) == np.shape(b) and bool(np.allclose(a, b, rtol=0, atol=tolerance))
    except TypeError:  # words, models and functions
        return bool(np.array_equal(a, b))


def key_name(key: int) -> str:
    """The name that GTSAM prints for a key, such as x3; the number itself if its first byte is no letter."""
    try:
        return str(gtsam.DefaultKeyFormatter(key))
    except UnicodeDecodeError:
        return str(key)


def describe(factor: gtsam.NonlinearFactor) -> FactorDescription:
    """The description of a factor of this package, also when a graph returns it as a bare `gtsam.CustomFactor`.

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


def save_factors(
    factors: Iterable[gtsam.NonlinearFactor] | gtsam.NonlinearFactorGraph,
    path: str | Path,
    functions: Functions | None = None,
) -> None:
    """Write a graph as JSON: the descriptions of factors of this package, and GTSAM's own factors as GTSAM serialises them.

    The file is written completely or not at all.

    Args:
        factors: a graph, or factors.
        path: the file.
        functions: names of the functions among the arguments, such as ``{"gps": gps}`` where a `ResidualFactor` has the
            residual ``gps``. The file holds the name alone, and `load_factors` needs the function again.

    Raises:
        OptionError: a factor has a function without a name as argument, is of another program's Python code, or is of a type
            that GTSAM cannot serialise.
        FormatError: the file cannot be written.
    """
    if isinstance(factors, gtsam.NonlinearFactorGraph):
        factors = [factors.at(k) for k in range(factors.size())]
    natives, places = gtsam.NonlinearFactorGraph(), []
    for number, factor in enumerate(factors):
        if factor is None:
            # GTSAM leaves an empty place where a factor was removed
            places.append(None)
        elif isinstance(factor, gtsam.CustomFactor):
            places.append(describe(factor).to_dict(functions))
        else:
            alone = gtsam.NonlinearFactorGraph()
            alone.add(factor)
            _serialized(alone, f"factor {number}, a {type(factor).__name__},")
            places.append({"gtsam": natives.size()})
            natives.add(factor)
    data = {"format": "graphslam factors", "version": 2, "factors": places, "gtsam": _serialized(natives)}
    write_text(path, json.dumps(data, indent=1))


def load_factors(path: str | Path, functions: Functions | None = None) -> gtsam.NonlinearFactorGraph:
    """The graph of a file that `save_factors` wrote, each factor in its place.

    Args:
        path: the file.
        functions: those that `save_factors` was given.

    Raises:
        FormatError: the file cannot be read, has another content, or needs a function that is not given.
    """
    path, graph, natives = path_of(path), gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph()
    try:
        data = json.loads(path.read_text())
        if data["format"] != "graphslam factors" or data["version"] not in (1, 2):
            raise KeyError("format")
        described = enumerate(data["factors"])
        serialized = data.get("gtsam")
    except OSError as error:
        raise FormatError(path, None, f"cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError):
        raise FormatError(path, None, "is no file of save_factors, version 1 or 2") from None
    try:
        if serialized is not None:
            natives.deserialize(serialized)
    except (RuntimeError, TypeError) as error:
        raise FormatError(path, None, f"GTSAM cannot read its own factors: {reason_of(error)}") from None
    for number, each in described:
        name = f"factor {number}"
        try:
            if each is None:
                graph.resize(graph.size() + 1)
            elif isinstance(each, dict) and "gtsam" in each:
                place = each["gtsam"]
                if not isinstance(place, int) or not 0 <= place < natives.size():
                    raise ValueError(f"there is no factor {quoted(place)} among GTSAM's own")
                graph.add(natives.at(place))
            else:
                description = FactorDescription.from_dict(each, functions)
                name += f", {description}"
                graph.add(description.build())
        except (SlamError, TypeError, ValueError, AttributeError) as error:
            raise FormatError(path, None, f"{name}: {reason_of(error)}") from None
    return graph


def _serialized(graph: gtsam.NonlinearFactorGraph, name: str = "the graph") -> str:
    """GTSAM's own text of a graph of its own factors, every number with all its digits."""
    try:
        return str(graph.serialize())
    except RuntimeError as error:
        raise OptionError(f"{name} cannot be saved: GTSAM does not serialise it ({reason_of(error)})") from None


def _plain(kind: str, name: str, value: Any, functions: Functions | None) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if type(value).__name__ in _MODELS:
        return {"type": type(value).__name__, **asdict(value)}
    if callable(value):
        for word, function in (functions or {}).items():
            if function is value:
                return {"function": word}
        advice = "name it: save_factors(..., functions={'a name': the function}), and give load_factors the same"
        raise OptionError(f"{kind}: the argument {name} is a function, which cannot be saved; {advice}")
    return np.asarray(value).tolist()


def _revived(value: Any, functions: Functions) -> Any:
    if isinstance(value, dict) and "function" in value:
        if (name := value["function"]) not in functions:
            raise OptionError(f"it needs the function {name!r}: load_factors(..., functions={{{name!r}: ...}})")
        return functions[name]
    if isinstance(value, dict):
        return _MODELS[value["type"]](**{name: part for name, part in value.items() if name != "type"})
    return value


def _named_in_graph(graph: gtsam.NonlinearFactorGraph, text: str) -> str:
    def named(line: re.Match[str]) -> str:
        return line[1] + _named(graph.at(int(line[2])), line[3])

    return re.sub(r"^(Factor (\d+): )(CustomFactor on )", named, text, flags=re.MULTILINE)


def _named(factor: gtsam.NonlinearFactor, text: str) -> str:
    try:
        return text.replace("CustomFactor on ", f"{describe(factor).kind} on ", 1)
    except OptionError:
        return text


def _name_in_prints(kind: Any, named: Callable[[Any, str], str]) -> None:
    """Make ``print(graph)``, ``graph.print()`` and the same of a factor name our types; nothing else of GTSAM changes.

    GTSAM prints each Python factor as 'CustomFactor', and has no place for another name.
    """
    shown, printed = kind.__repr__, kind.print

    def text_of(self: Any) -> str:
        return named(self, shown(self))

    def print_named(self: Any, *arguments: Any, **keywords: Any) -> None:
        with redirect_stdout(StringIO()) as captured:
            printed(self, *arguments, **keywords)
        sys.stdout.write(named(self, captured.getvalue()))

    print_named.__doc__ = printed.__doc__
    kind.__repr__, kind.print = text_of, print_named


_name_in_prints(gtsam.NonlinearFactorGraph, _named_in_graph)
_name_in_prints(gtsam.CustomFactor, _named)
