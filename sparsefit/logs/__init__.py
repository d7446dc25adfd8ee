"""Logs of flights in files: tables as CSV or Parquet both ways, PX4's logs and IGC files read."""

from sparsefit.logs.checks import LogQuality, check_log
from sparsefit.logs.files import read_flight, read_table, write_flight

__all__ = ["LogQuality", "check_log", "read_flight", "read_table", "write_flight"]
