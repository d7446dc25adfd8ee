"""Logs of flights in files: tables as CSV or Parquet both ways, PX4's logs and IGC files read.

The readers are imported when they are first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sparsefit.logs.checks import LogQuality as LogQuality
    from sparsefit.logs.checks import check_log as check_log
    from sparsefit.logs.checks import quality_of as quality_of
    from sparsefit.logs.files import read_flight as read_flight
    from sparsefit.logs.files import read_table as read_table
    from sparsefit.logs.files import write_flight as write_flight

__all__ = ["LogQuality", "check_log", "quality_of", "read_flight", "read_table", "write_flight"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = "files" if name.endswith(("_flight", "_table")) else "checks"
    return getattr(import_module(f"{__name__}.{home}"), name)
