"""A proof that the end of a solver is the global minimum of its cost; see docs/certificate.md."""

from .certificate import (
    GLOBAL,
    GLOBAL_HELD,
    GLOBAL_WEIGHTS,
    GLOBAL_WEIGHTS_HELD,
    NOT_APPLICABLE,
    NOT_PROVEN,
    PROVEN,
    Certificate,
)
from .proof import prove, prove_edges

__all__ = [
    "GLOBAL", "GLOBAL_HELD", "GLOBAL_WEIGHTS", "GLOBAL_WEIGHTS_HELD", "NOT_APPLICABLE", "NOT_PROVEN", "PROVEN", "Certificate",
    "prove", "prove_edges",
]  # fmt: skip
