"""Raw 2D lidar scans in; tracked vehicles, times to collision and warnings out."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from outrider.io.run import Run, open_run
    from outrider.offline import read, run, track
    from outrider.records import Frame
    from outrider.settings import Settings

__version__ = "0.1.0"
__all__ = ["Frame", "Run", "Settings", "__version__", "open_run", "read", "run", "track"]

_HOME = {
    "Frame": "records",
    "Run": "io.run",
    "Settings": "settings",
    "open_run": "io.run",
    "read": "offline",
    "run": "offline",
    "track": "offline",
}


def __getattr__(name: str) -> Any:
    """Public names are imported when they are first used, so that `import outrider` stays fast."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Public names."""
    return sorted({*globals(), *__all__})
