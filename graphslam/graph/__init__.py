"""The graph of a log or of a pose-graph file, other graphs made of it, and the map from its solution."""

from typing import TYPE_CHECKING

from ..lazy import lazy_names

if TYPE_CHECKING:
    from .g2o import Graph as Graph
    from .graph import check_graph as check_graph

__getattr__, __dir__, __all__ = lazy_names(__name__)
