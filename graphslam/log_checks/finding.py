"""`Finding`: something in a log that is probably a mistake."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Something in a log that is probably a mistake.

    Attributes:
        check: a short name, "bearing sign" for example.
        message: one sentence with the likely cause.
    """

    check: str
    message: str
