"""Several estimators on one log: metrics, tables, figures and the command line ``slam-compare``.

Nothing is imported here, so that ``slam-compare --help`` answers at once; take names from the modules, for example
``from comparisons.run import compare``.
"""
