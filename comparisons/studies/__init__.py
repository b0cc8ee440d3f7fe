"""Studies: many logs, simulator settings, seeds, estimators and options, run in parallel, kept in one SQLite file.

`plan` reads a study file and lists its runs, `sweep` executes those that are missing and writes one row for each, and
`summary` summarises the rows. A run passes through `plan.Run`, `execute.execute` and `execute.Outcome` to
`database.StudyDatabase`. The other modules are the studies that have a verb of their own.
"""
