"""Several estimators on one log: metrics, tables, figures and the command line ``slam-compare``.

Everything that a verb of ``slam-compare`` does is a function here, which returns an object with its results:

    import comparisons

    comparison = comparisons.run("my.npz", estimators=["graph", "fastslam1"], particles=5000)
    comparison.table["graph"].ate_m
    comparison.figure()
    comparison.save("out")

Modules are imported when a name is first used, so that ``slam-compare --help`` answers at once.
"""

# ruff: noqa: F401

from importlib import import_module
from typing import TYPE_CHECKING

from graphslam.lazy import lazy_names

from . import results

if TYPE_CHECKING:
    from .comparison import Comparison, run
    from .datasets import survey
    from .evaluation import evaluate
    from .importing import import_log, inspect_log
    from .options import RunOptions
    from .options.reading import calibrate
    from .show.films import animate
    from .show.report import write_report
    from .studies.backends import compare_backends
    from .studies.consistency import study_consistency
    from .studies.plan import read_study
    from .studies.solvers import compare_solvers
    from .studies.summary import summarise
    from .studies.sweep import study_particles, sweep

__getattr__, __dir__, __all__ = lazy_names(__name__)

# the package stands above results and presentation: results ask it for their presentation
results.presentation.append(lambda: import_module(".show.tables", __name__))
