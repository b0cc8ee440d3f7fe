"""Plotly's own script, to be written into the page: from the package ``plotly``, never from the network."""

from __future__ import annotations

from importlib.metadata import version
from importlib.util import find_spec

from graphslam import OptionError


def plotly_script() -> tuple[str, str]:
    """The source of plotly.js, and what it is called.

    Raises:
        OptionError: the extra ``report`` is not installed.
    """
    check_plotly()
    from plotly.offline import get_plotlyjs, get_plotlyjs_version

    return get_plotlyjs(), f"plotly {version('plotly')} (plotly.js {get_plotlyjs_version()})"


def check_plotly() -> None:
    """Raise `OptionError` unless the extra ``report`` is installed."""
    if find_spec("plotly") is None:
        raise OptionError("the report page needs the package plotly: pip install 'virtual-motion-slam[report]'")
