"""A back-end whose module cannot be imported without a package that is not there."""

import no_such_solver


class Absent(no_such_solver.Solver):
    """Never made."""
