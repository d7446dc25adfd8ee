"""Studies: one TOML file, every planned case a row, and results that are written by the program.

`sparsefit.Study` is the way in; a worker process imports what it computes with, and no more.
"""
