"""Packages whose public names are imported at their first use (PEP 562), so that importing a package is fast."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(
    package: str, public: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package.

    Args:
        package: its ``__name__``.
        public: module below the package -> its public names, separated by spaces; "" -> names of public modules.
    """
    module_of = {name: module for module, names in public.items() for name in names.split()}
    namespace = vars(sys.modules[package])

    def get(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = import_module(f".{module_of[name] or name}", package)
        namespace[name] = getattr(module, name) if module_of[name] else module
        return namespace[name]

    return get, lambda: sorted({*namespace, *module_of}), list(module_of)
