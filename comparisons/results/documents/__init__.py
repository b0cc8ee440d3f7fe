"""The JSON of every verb as typed models. What the verbs write and its schema (docs/schema.json) both come from here.

The docstring of a model and the descriptions of its fields are those of the schema and of docs/json.md.
"""

from .logs import (
    CalibrateDocument,
    DatasetsDocument,
    Document,
    ImportDocument,
    ShowDocument,
    SimulateDocument,
    describe,
    document,
)
from .runs import (
    AnimateDocument,
    AssociationDocument,
    DoubtDocument,
    EstimatorDocument,
    EvaluatedDocument,
    EvaluateDocument,
    LandmarkStateDocument,
    RunDocument,
    SessionDocument,
    SessionErrorsDocument,
    VerdictDocument,
    certificate_document,
    parameters_document,
)
from .studies import (
    BackendsDocument,
    ConsistencyDocument,
    ParticlesDocument,
    SolversDocument,
    StudyDocument,
    SweepDocument,
)

#: the document that each verb writes
DOCUMENTS: dict[str, type[Document]] = {
    "run": RunDocument,
    "evaluate": EvaluateDocument,
    "simulate": SimulateDocument,
    "solvers": SolversDocument,
    "backends": BackendsDocument,
    "particles": ParticlesDocument,
    "consistency": ConsistencyDocument,
    "datasets": DatasetsDocument,
    "study": StudyDocument,
    "sweep": SweepDocument,
    "animate": AnimateDocument,
    "calibrate": CalibrateDocument,
    "import": ImportDocument,
    "show": ShowDocument,
}

__all__ = [
    "DOCUMENTS", "AssociationDocument", "Document", "DoubtDocument", "EstimatorDocument", "EvaluateDocument",
    "LandmarkStateDocument", "EvaluatedDocument", "SessionDocument", "SessionErrorsDocument", "VerdictDocument",
    "certificate_document", "describe",
    "document", "parameters_document",
]  # fmt: skip
