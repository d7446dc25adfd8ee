"""Studies: one TOML file, every planned case a row, and results that are written by the program."""

from sparsefit.study.study import Study

__all__ = ["Study"]
