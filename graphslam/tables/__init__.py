"""Logs from tables: odometry, sightings and, where they are known, true poses and landmarks.

`parts_of_tables` is what `Log.from_tables` calls. Its parts:

table           what every table has; a table in memory
text_table      tables in text files
sources         which table a path, a data frame or an array is
columns, times  which column is what, and times in nanoseconds
options         units, clocks and axes
poses           headings of quaternions, controls between poses
drive           the streams of a drive, with checks of their units
join            the streams as arguments of a log
"""

from .join import Drive, parts_of_tables, read_drive
from .options import TableOptions

__all__ = ["Drive", "TableOptions", "parts_of_tables", "read_drive"]
