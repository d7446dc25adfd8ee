"""The columns of `cases.parquet` of a study of solvers, each declared here and nowhere else.

What is not `planned` is measured. Times are seconds of CPU unless they say otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

from sparsefit.study.run.columns import FLAG, KINDS, LEVEL, REAL, TEXT, WHOLE, Column
from sparsefit.study.spec.contenders import Contender
from sparsefit.study.spec.document import canonical_json
from sparsefit.study.spec.solver_problems import ProblemSource
from sparsefit.study.spec.solver_study import SolverCase, SolverStudy


@dataclass(frozen=True)
class PlannedSolve:
    """A case as it is planned; identity: what it is, whatever study asks for it."""

    study: SolverStudy
    case: SolverCase
    identity: str

    @property
    def source(self) -> ProblemSource:
        """The problem that is solved."""
        return self.study.problems[self.case.problem]

    @property
    def contender(self) -> Contender:
        """Who solves it."""
        return self.study.contenders[self.case.contender]


SOLVER_COLUMNS: tuple[Column[PlannedSolve], ...] = (
    Column("case_id", TEXT, planned=lambda row: row.study.case_id(row.case)),
    Column("study", TEXT, planned=lambda row: row.study.name),
    Column("problem", TEXT, planned=lambda row: row.source.name),
    # The [[problems]] entry that it is of, and what was swept there.
    Column("series", TEXT, planned=lambda row: row.source.series),
    Column("level", TEXT, planned=lambda row: row.source.level),
    Column("samples", WHOLE),
    Column("columns", WHOLE),
    Column("targets", WHOLE),
    Column("objective", TEXT, planned=lambda row: row.contender.objective),
    Column("backend", TEXT, planned=lambda row: row.contender.backend),
    Column("settings", TEXT, planned=lambda row: canonical_json(dict(row.contender.settings))),
    Column("solver", TEXT, planned=lambda row: row.contender.solver),
    # Asked of the solver; NaN where it has none.
    Column("tolerance", LEVEL, planned=lambda row: row.case.tolerance),
    Column("points", WHOLE),  # penalties of the path, 1 for a single fit
    Column("status", TEXT),
    Column("reason", TEXT),
    Column("word", TEXT),  # the back-end's own status
    Column("certificate_kind", TEXT),
    Column("certificate", REAL),  # its own duality gap, worst over the path
    Column("excess", REAL),  # above the best certified lower bound, worst over the path
    Column("cpu", REAL),  # median
    Column("cpu_low", REAL),  # 95 % interval of the median, by order statistics
    Column("cpu_high", REAL),
    Column("wall", REAL),  # median
    Column("repeats", WHOLE),
    Column("known", FLAG),  # whether the median is known to the precision asked for
    Column("first", REAL),  # imports and compilation, on a small problem
    Column("memory", REAL),  # MB above what the process had, at its highest
    Column("load", REAL),  # of the machine, when the case began
    Column("disturbed", FLAG),  # whether the wall clock ran well ahead of the CPU's
    Column("flight", WHOLE, planned=lambda row: row.case.problem),  # the problem's number
    Column("identity", TEXT, planned=lambda row: row.identity),
    Column("version", TEXT),
)
SOLVER_KINDS = {column.name: column.kind for column in SOLVER_COLUMNS}
EVERY_KIND = SOLVER_KINDS | KINDS  # as what a value is read back, of whatever study
