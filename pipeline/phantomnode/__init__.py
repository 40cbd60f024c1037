"""phantomnode: from a CAD curve to dynamic large-deformation contact-impact, with no fitted mesh.

The names below load on first use, so that ``import phantomnode`` costs nothing:

``load_case(path)``, ``prepare(case)``, ``run(case, out)``, ``open_results(folder)`` and ``read_geometry(path)``.
"""

from importlib import import_module
from typing import Any

_HOME = {
    "load_case": "phantomnode.pipeline.case",
    "prepare": "phantomnode.pipeline.prepare",
    "run": "phantomnode.pipeline.run",
    "open_results": "phantomnode.pipeline.results",
    "read_geometry": "phantomnode.geometry.readers",
}
__all__ = ["__version__", "load_case", "open_results", "prepare", "read_geometry", "run"]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use (PEP 562)."""
    if name == "__version__":
        return _version()
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'phantomnode' has no attribute {name!r}")


def _version() -> str:
    """Of the installed distribution."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("phantomnode")
    except PackageNotFoundError:  # a bare checkout on the path, not installed
        return "0+unknown"
