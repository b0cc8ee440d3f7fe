"""Studies: many logs, simulator settings, seeds, estimators and options, run in parallel, kept in one SQLite file.

`plan` reads a study file and lists its runs, `sweep` executes those that are missing and writes one row for each,
`summary` says what came out. The way of one run: `plan.Run` -> `execute.execute`, in a `child` process that can be
stopped -> `execute.Outcome` -> `database.StudyDatabase`.

Nothing is imported here, so that a child process imports only what it needs.
"""
