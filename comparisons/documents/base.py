"""The base of the models, and the types of their fields.

`document` fills a model from result objects whose attributes have the names of its fields.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec

from ..saving import jsonable

_MISSING = object()


class Document(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """The base of all models."""


def document(model: type[Document], *sources: object, **values: Any) -> dict[str, Any]:
    """The fields of a model as plain data for JSON, in their order.

    Args:
        model: names the fields.
        sources: objects; a field takes the attribute of its name from the first that has one.
        values: fields that are given here.

    Raises:
        AttributeError: no source has a field that is not given.
    """
    content = {}
    for field in msgspec.structs.fields(model):
        value = values.get(field.name, _MISSING)
        for source in sources:
            if value is _MISSING:
                value = getattr(source, field.name, _MISSING)
        if value is _MISSING:
            raise AttributeError(f"{model.__name__} needs a value for {field.name}")
        content[field.name] = value
    return jsonable(content)


def about(text: str) -> msgspec.Meta:
    """The description of a field."""
    return msgspec.Meta(description=text)


Count = Annotated[int, msgspec.Meta(ge=0)]
Id = Annotated[str, msgspec.Meta(pattern="^-?[0-9]+$")]
Dimensions = Annotated[Literal[2, 3], about("columns of a sighting: 2 without, 3 with orientation psi")]
Pose = Annotated[
    list[float | None],
    msgspec.Meta(min_length=3, max_length=3, description="x [m], y [m], heading [rad]; null where unknown"),
]
Position = Annotated[
    list[float | None],
    msgspec.Meta(min_length=2, max_length=3, description="x, y [m] and, where the landmark has one, heading [rad]"),
]
Covariance = Annotated[
    list[list[float]],
    msgspec.Meta(min_length=2, max_length=3, description="n rows of n numbers, n as long as the mean"),
]
CostPerDof = Annotated[
    float | None,
    about("J per degree of freedom: about 1 where the noise models fit, more where they are too small or sightings are "
          "wrong, less where they are too large; null where nothing is minimised"),
]  # fmt: skip
Band = Annotated[list[float | None], msgspec.Meta(min_length=2, max_length=2, description="lower and upper end")]
Quartiles = Annotated[
    list[float], msgspec.Meta(min_length=3, max_length=3, description="25 %, 50 % and 75 % over the seeds")
]
