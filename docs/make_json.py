"""Write docs/schema.json and docs/json.md from `comparisons.results.documents`: ``python docs/make_json.py``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec

from comparisons.results.documents import DOCUMENTS

DOCS = Path(__file__).parent
#: arrays that have a name of their own on the page
NAMES = {
    "x [m], y [m], heading [rad]; null where unknown": "pose",
    "x, y [m] and, where the landmark has one, heading [rad]": "position",
    "n rows of n numbers, n as long as the mean": "covariance",
}
HEAD = """\
# JSON of every verb

Every verb takes `--json FILE` (or `-` for standard output, which then carries nothing else), and `run` always writes a
`comparison.json`. [schema.json](schema.json) is the JSON Schema (draft 2020-12) of all of them, with one entry of `$defs` for
each verb. Both this page and the schema are generated from `comparisons/results/documents/` by `python docs/make_json.py`,
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
    references, components = msgspec.json.schema_components(list(DOCUMENTS.values()), ref_template="#/$defs/{name}")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "What slam-compare writes as JSON",
        "description": "One entry of $defs for each verb. No number is NaN or infinite; null is an unknown value.",
        "$defs": dict(zip(DOCUMENTS, references)) | components,
    }


def page() -> str:
    """The page that lists every field."""
    components = schema()["$defs"]
    parts = [HEAD]
    for name, model in components.items():
        if "properties" not in model:
            continue
        verb = next((verb for verb, document in DOCUMENTS.items() if document.__name__ == name), None)
        title = verb or f"<a id='{name}'></a>{name.removesuffix('Document')}"
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
        return f"[{name.removesuffix('Document')}](#{name})"
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
    (DOCS / "json.md").write_text(page(), encoding="utf-8")
