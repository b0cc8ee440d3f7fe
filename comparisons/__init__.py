"""Several estimators on one log: metrics, tables, figures and the command line ``slam-compare``.

Everything that a verb of ``slam-compare`` does is a function here, which returns an object with its results:

    import comparisons

    comparison = comparisons.run("my.npz", estimators=["graph", "fastslam1"], particles=5000)
    comparison.table["graph"].ate_m
    comparison.figure()
    comparison.save("out")

Modules are imported when a name is first used, so that ``slam-compare --help`` answers at once.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from . import display

if TYPE_CHECKING:
    from .backends import compare_backends
    from .calibration import calibrate
    from .comparison import Comparison, run
    from .consistency import study_consistency
    from .datasets import survey
    from .options import RunOptions
    from .particles import study_particles
    from .show.films import animate
    from .show.report import write_report
    from .solvers import compare_solvers
    from .studies.plan import read_study
    from .studies.summary import summarise
    from .studies.sweep import sweep

#: the public names, and the module that has each
_HOMES = {
    "Comparison": ".comparison",
    "RunOptions": ".options",
    "animate": ".show.films",
    "calibrate": ".calibration",
    "compare_backends": ".backends",
    "compare_solvers": ".solvers",
    "read_study": ".studies.plan",
    "run": ".comparison",
    "study_consistency": ".consistency",
    "study_particles": ".particles",
    "summarise": ".studies.summary",
    "survey": ".datasets",
    "sweep": ".studies.sweep",
    "write_report": ".show.report",
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

# the package stands above results and presentation: results ask it for their presentation
display.load_renderers.append(lambda: import_module(".show", __name__))


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name], __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
