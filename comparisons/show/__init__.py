"""Everything that only shows: tables, figures, the interactive report and animations.

Results do not import this package; `comparisons.results` calls the functions of `tables`. Figures are loaded when the first
one is made.
"""
