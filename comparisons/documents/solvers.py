"""The JSON of solvers that are compared on the same graphs."""

from __future__ import annotations

from typing import Annotated

from .base import CostPerDof, Count, Document, about
from .runs import CertificateDocument


class VariantDocument(Document):
    """One graph, solved by both solvers."""

    name: Annotated[str, about("edges, frame, weight, dimensions, factor on the motion edges, kernel")]
    pose_difference: Annotated[float | None, about("largest difference in any x, y [m] or heading [rad]")]
    cost_difference: Annotated[float | None, about("relative difference of J")]
    cost: Annotated[float | None, about("J of the hand-written solver")]
    cost_per_dof: CostPerDof
    iterations: Annotated[Count, about("of the hand-written solver")]
    gtsam_iterations: Annotated[Count, about("of GTSAM")]
    seconds: Annotated[float | None, about("of the hand-written solver [s]")]
    gtsam_seconds: Annotated[float | None, about("of GTSAM [s]")]
    converged: Annotated[bool, about("whether the hand-written solver converged")]
    gtsam_converged: Annotated[bool, about("whether GTSAM converged")]
    certificate: Annotated[CertificateDocument | None, about("proof for the end of the hand-written solver")]
    gtsam_certificate: Annotated[CertificateDocument | None, about("proof for the end of GTSAM")]
    failure: Annotated[str | None, about("why a solver failed")]
    agree: Annotated[bool, about("poses differ by less than 1e-6 and J by less than 1e-9 of it")]


class ReasonDocument(Document):
    """A graph that the log does not determine."""

    name: Annotated[str, about("as in `variants`")]
    reason: Annotated[str, about("why it was left out")]


class SolversDocument(Document):
    """`slam-compare solvers`."""

    variants: Annotated[list[VariantDocument], about("the graphs that were solved")]
    skipped: Annotated[list[ReasonDocument], about("the graphs that the log does not determine, or that took too long")]


class BackendDocument(Document):
    """One solver on one pose graph."""

    file: Annotated[str, about("the pose graph")]
    backend: Annotated[str, about("graphslam, gtsam-lm, gtsam-gn, g2o-gn or g2o-lm")]
    chi2: Annotated[float | None, about("at the end, by one evaluator for all; null where the solver failed")]
    chi2_per_dof: Annotated[
        float | None, about("chi2 per degree of freedom: about 1 where the file's information fits")
    ]
    iterations: Annotated[Count, about("number of iterations")]
    seconds: Annotated[float | None, about("from the initial values to the stop rule [s], median")]
    converged: Annotated[bool, about("whether it met its stop rule")]
    reason: Annotated[str, about("why it ended")]
    certificate: Annotated[
        CertificateDocument | None, about("proof of global optimality; null where the solver failed")
    ]
    native: Annotated[bool, about("false where factors are evaluated in Python, so that the time is that of callbacks")]
    ratio: Annotated[float | None, about("time of graphslam over this time, where both reached the best chi2")]


class BackendsDocument(Document):
    """`slam-compare backends`."""

    rows: Annotated[list[BackendDocument], about("a row for each file and solver")]
    geometric_means: Annotated[
        dict[str, float | None], about("geometric mean of `ratio` over the files, `native` rows only")
    ]
