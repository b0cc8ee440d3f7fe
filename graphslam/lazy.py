"""Packages whose public names are imported at their first use (PEP 562), so that importing a package is fast."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any


def lazy_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package, from the imports below ``if TYPE_CHECKING:`` in its source.

    ``from .module import Name`` makes a public name. ``from . import module`` makes a public module, which is no part of
    ``__all__``: whoever imports all names wants no modules.

    Args:
        package: its ``__name__``.
    """
    source = sys.modules[package].__loader__.get_source(package)  # type: ignore[union-attr]
    blocks = (node for node in ast.parse(source).body if isinstance(node, ast.If))
    imports = (node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom))
    module_of = {alias.name: node.module or "" for node in imports for alias in node.names}
    namespace = vars(sys.modules[package])

    def get(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = import_module(f".{module_of[name] or name}", package)
        namespace[name] = getattr(module, name) if module_of[name] else module
        return namespace[name]

    return get, lambda: sorted({*namespace, *module_of}), [name for name in module_of if module_of[name]]
