"""Films of an estimator at work: as an animated GIF, an MP4, or an HTML page with its own player.

`animate.animate` makes a `film.Film`. The way of one film: a kind of film (`relaxation`, `cloud`, `growth`) runs the
estimator and keeps `frame.Frame` data; its scene draws a frame onto the `stage`, on which everything that stands still
is drawn once; the `projector` turns frames into pixels; `palette`, `writers` and `player` put these into files.

Nothing is imported here; take names from the modules: ``from comparisons.films.animate import animate``.
"""
