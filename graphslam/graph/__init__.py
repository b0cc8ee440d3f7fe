"""The graph of a log, its landmark map, and where it begins."""

from .graph import EDGES, FRAMES, WEIGHTS, Graph, check_graph

__all__ = ["EDGES", "FRAMES", "Graph", "WEIGHTS", "check_graph"]
