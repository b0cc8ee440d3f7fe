"""Studies: many logs, simulator settings, seeds, estimators and options, run in parallel, kept in one SQLite file.

`plan` reads a study file and lists its runs, `sweep` executes those that are missing and writes one row for each, and
`summary` summarises the rows. A run passes through `plan.Run`, `execute.execute` and `execute.Outcome` to
`execute.StudyDatabase`. `sweep.study_particles` is a plan for one log without a file. The checks `consistency`, `solvers`
and `backends` have rows of their own; the loop that executes their tasks is that of all studies, `attempt.as_they_end`.
"""
