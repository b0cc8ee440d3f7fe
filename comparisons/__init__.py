"""Several estimators on one log: metrics, tables, figures and the command line ``slam-compare``.

Everything that a verb of ``slam-compare`` does is a function here, which returns an object with its figures:

    import comparisons

    comparison = comparisons.run("my.npz", ["graph", "fastslam1"], particles=5000)
    comparison.table["graph"].ate_m
    comparison.figure()
    comparison.save("out")

Names are found when they are first used, so that ``slam-compare --help`` answers at once.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from graphslam.calibration import calibrate

    from .api import run
    from .backends import compare_backends
    from .comparison import Comparison
    from .consistency import study_consistency
    from .datasets import survey
    from .estimator import RunOptions
    from .films.animate import animate
    from .particles import study_particles
    from .report import write_report
    from .solvers import compare_solvers
    from .studies.plan import read_study
    from .studies.summary import summarise
    from .studies.sweep import sweep

#: name, and the module that has it
_HOMES = {
    "run": ".api",
    "Comparison": ".comparison",
    "RunOptions": ".estimator",
    "animate": ".films.animate",
    "compare_solvers": ".solvers",
    "compare_backends": ".backends",
    "study_particles": ".particles",
    "study_consistency": ".consistency",
    "survey": ".datasets",
    "write_report": ".report",
    "read_study": ".studies.plan",
    "sweep": ".studies.sweep",
    "summarise": ".studies.summary",
    "calibrate": "graphslam.calibration",
}

__all__ = [
    "Comparison",
    "RunOptions",
    "animate",
    "calibrate",
    "compare_backends",
    "compare_solvers",
    "read_study",
    "run",
    "study_consistency",
    "study_particles",
    "summarise",
    "survey",
    "sweep",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name], __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
