"""Write docs/schema.json from the classes of results: ``python docs/make_json.py``. The site makes the page json.md of it.

What a class shows is said in `comparisons.results.documents`.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from comparisons.comparison import RunDocument
from comparisons.datasets import Survey
from comparisons.evaluation import EvaluateDocument
from comparisons.importing import Import, Overview
from comparisons.results.documents import AnimateDocument, SimulateDocument, shown_by
from comparisons.studies.backends import BackendComparison
from comparisons.studies.consistency import ConsistencyStudy
from comparisons.studies.solvers import SolverComparison
from comparisons.studies.summary import Summary
from comparisons.studies.sweep import ParticleStudy, SweepOutcome
from graphslam.calibration import Calibration
from graphslam.se2 import Array

DOCS = Path(__file__).parent
#: the class whose object each verb writes
DOCUMENTS: dict[str, type] = {
    "associate": RunDocument,
    "report": RunDocument,
    "run": RunDocument,
    "evaluate": EvaluateDocument,
    "simulate": SimulateDocument,
    "solvers": SolverComparison,
    "backends": BackendComparison,
    "particles": ParticleStudy,
    "consistency": ConsistencyStudy,
    "datasets": Survey,
    "study": Summary,
    "sweep": SweepOutcome,
    "animate": AnimateDocument,
    "calibrate": Calibration,
    "import": Import,
    "show": Overview,
}
VERBS = {kind.__name__: verb for verb, kind in DOCUMENTS.items()}
#: JSON of a type; a number that is not finite becomes null
PLAIN: dict[Any, dict[str, Any]] = {
    NoneType: {"type": "null"},
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"anyOf": [{"type": "number"}, {"type": "null"}]},
    str: {"type": "string"},
    Path: {"type": "string"},
    np.ndarray: {"type": "array", "items": {"anyOf": [{"type": "number"}, {"type": "null"}]}},
    Any: {},
}
#: arrays and classes that have a name of their own on the page
NAMES = {
    "x [m], y [m], heading [rad]; null where unknown": "pose",
    "x, y [m] and, where the landmark has one, heading [rad]": "position",
    "n rows of n numbers, n as long as the mean": "covariance",
    "LogDocument": "Log", "Row": "Estimator",
}  # fmt: skip
HEAD = """\
# JSON of every verb

Every verb takes `--json FILE` (or `-` for standard output, which then carries nothing else), and `run` always writes a
`comparison.json`. [schema.json](schema.json) is the JSON Schema (draft 2020-12) of all of them, with one entry of `$defs` for
each verb. Both this page and the schema are generated from the classes of results by `python docs/make_json.py`,
and the tests validate the output of every verb. To validate a file yourself:

```python
import json
from pathlib import Path

import comparisons, jsonschema

comparisons.run(estimators=["graph"]).save("out")
schema = json.loads(Path("docs/schema.json").read_text())
document = json.loads(Path("out/comparison.json").read_text())
jsonschema.validate(document, {"$ref": "#/$defs/run"} | schema)
print(document["estimators"][0]["ate_m"])
```

Numbers have all their digits, so that reading them gives the same values again. No number is NaN or infinite; `null`
stands for an unknown value. Lengths are in metres, angles in radians, times in seconds. A pose is `[x, y, heading]` with
the heading in [-pi, pi), a position `[x, y]` or `[x, y, heading]`, a covariance a list of rows. Ids of landmarks are keys,
and therefore text. Repeating a run (`--config`) writes the same JSON except for `seconds` and `files`.
"""


def schema() -> dict[str, Any]:
    """The JSON Schema of all verbs."""
    kinds, models = list(DOCUMENTS.values()), dict[str, Any]()
    for kind in kinds:  # grows while it is read
        if kind.__name__ not in models:
            models[kind.__name__] = model_of(kind, kinds)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "What slam-compare writes as JSON",
        "description": "One entry of $defs for each verb. No number is NaN or infinite; null is an unknown value.",
        "$defs": {verb: {"$ref": f"#/$defs/{kind.__name__}"} for verb, kind in DOCUMENTS.items()} | models,
    }


def model_of(kind: type, kinds: list[type]) -> dict[str, Any]:
    """The schema of a class; the classes of its parts are appended to ``kinds``."""
    hints, sentences = get_type_hints(kind, include_extras=True), sentences_of(kind)
    properties = {}
    for name, attribute in shown_by(kind).items():
        if attribute in hints:
            hint, said = hints[attribute], sentences.get(attribute, "")
        else:
            method = inspect.getattr_static(kind, attribute)
            function = method.fget if isinstance(method, property) else method.func
            hint = get_type_hints(function, include_extras=True)["return"]
            said = in_words(inspect.getdoc(function))
        entry = entry_of(hint, kinds)
        known = {"description": said} if said and not entry.get("description") else {}
        properties[name] = known | entry
    return {
        "title": kind.__name__, "description": inspect.getdoc(kind).split("\n\n")[0].replace("\n", " "), "type": "object",
        "properties": properties, "required": list(properties), "additionalProperties": False,
    }  # fmt: skip


def entry_of(hint: Any, kinds: list[type]) -> dict[str, Any]:
    """The schema of a type."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return dict(parts[1])
    if origin in (Union, UnionType):
        entries = [entry for part in parts for entry in (lambda e: e.get("anyOf", [e]))(entry_of(part, kinds))]
        return {"anyOf": [entry for k, entry in enumerate(entries) if entry not in entries[:k]]}
    if origin is Literal:
        return {"enum": list(parts)}
    if origin in (dict, Mapping):
        names = {"propertyNames": {"pattern": "^-?[0-9]+$"}} if parts[0] is int else {}
        return {"type": "object", **names, "additionalProperties": entry_of(parts[1], kinds)}
    if origin in (list, tuple, Sequence):
        return {"type": "array", "items": entry_of(parts[0], kinds)}
    if is_dataclass(hint):
        kinds.append(hint)
        return {"$ref": f"#/$defs/{hint.__name__}"}
    # `Array` is an alias of which newer versions of NumPy do not tell the origin
    return dict(PLAIN[np.ndarray if hint == Array or origin is np.ndarray else hint])


def sentences_of(kind: type) -> dict[str, str]:
    """What is said of each field: in its metadata, or below "Attributes:" in the docstring of its class or of a base."""
    found: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        _, _, attributes = inspect.cleandoc(each.__doc__ or "").partition("Attributes:\n")
        for names, text in re.findall(r"^    (\w[\w, ]*): (.*(?:\n     .*)*)", attributes, re.MULTILINE):
            found |= dict.fromkeys(names.split(", "), in_words(text))
    for f in fields(kind):
        if "help" in f.metadata:
            unit = f" [{f.metadata['unit']}]" if f.metadata["unit"] else ""
            found[f.name] = f"{f.metadata['help']}{unit}"
    return found


def in_words(text: str | None) -> str:
    """The first paragraph of a docstring as the meaning of a value in JSON."""
    first = re.sub(r"\s+", " ", (text or "").split("\n\n")[0]).removesuffix(".")
    first = re.sub(r"\bNone\b", "null", first.replace("``", "`"))
    return first[:1].lower() + first[1:] if first[1:2].islower() else first


def page() -> str:
    """The page that lists every field."""
    components = schema()["$defs"]
    parts = [HEAD]
    for name, model in components.items():
        if "properties" not in model:
            continue
        title = VERBS.get(name, f"<a id='{name}'></a>{NAMES.get(name, name)}")
        parts.append(f"\n## {title}\n\n{model['description']}\n\n| field | type | meaning |\n|---|---|---|\n")
        for field, entry in model["properties"].items():
            parts.append(f"| `{field}` | {kind(entry)} | {entry.get('description', '')} |\n")
    return "".join(parts)


def kind(entry: dict[str, Any]) -> str:
    """The type of a field in words."""
    if "anyOf" in entry:
        return " or ".join(kind(part) for part in entry["anyOf"])
    if "$ref" in entry:
        name = entry["$ref"].rpartition("/")[2]
        return f"[{VERBS.get(name, NAMES.get(name, name))}](#{VERBS.get(name, name)})"
    if "enum" in entry:
        return " or ".join(map(json.dumps, entry["enum"]))
    if entry.get("type") == "array":
        inner = kind(entry["items"])
        return NAMES.get(entry.get("description", ""), f"list of ({inner})" if " or " in inner else f"list of {inner}")
    if entry.get("type") == "object":
        inner = entry.get("additionalProperties")
        return f"{{key: {kind(inner)}}}" if isinstance(inner, dict) and inner else "object"
    return {"string": "text"}.get(entry.get("type", "any"), entry.get("type", "any"))


if __name__ == "__main__":
    (DOCS / "schema.json").write_text(json.dumps(schema(), indent=1) + "\n", encoding="utf-8")
