"""The parts of `benchmarks/fuzz.py`: random graphs, damaged files and command lines."""
