"""Logs, maps and pose graphs in files and tables: `formats` chooses the reader by the content of a file."""
