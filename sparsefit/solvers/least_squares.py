"""Plain least squares, as the paper prints it (Eq. 20), and with a truncated spectrum."""

from dataclasses import dataclass
from typing import ClassVar

from sparsefit.errors import number_setting
from sparsefit.regression.backend import Solution
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.problem import RegressionProblem


@dataclass(frozen=True)
class LeastSquares:
    """argmin_W |Y - theta W|_F, the minimum-norm solution (Eq. 20; LAPACK QR and SVD).

    rcond: singular values of theta below rcond * s_max count as zero. None, the default, is the
    literal reading: the rounding level, eps * max(m, k). Fewer samples than columns are refused
    unless rcond says how to regularise (Section V.B).
    """

    name: ClassVar[str] = "least-squares"
    certificate_kind: ClassVar[CertificateKind] = "normal_equations"
    rcond: float | None = None

    def __post_init__(self) -> None:
        if self.rcond is not None:
            number_setting(
                self.name,
                "rcond",
                self.rcond,
                low=0.0,
                high=1.0,
                meaning="it is relative to the largest singular value",
            )

    def solve(self, problem: RegressionProblem) -> Solution:
        """The minimum-norm least-squares weights over the retained singular values."""
        if problem.samples < problem.columns and self.rcond is None:
            return Solution(
                None,
                "error",
                f"{problem.samples} samples are fewer than {problem.columns} columns: the set of "
                "candidates cannot exceed the data (paper, Section V.B); use more samples, fewer "
                "columns, or stlsq, lasso or group-lasso, which do not need it",
            )
        known = "spectrum" in vars(problem)
        spectrum = problem.spectrum
        kept = spectrum.retained(self.rcond, problem.samples)
        scaled = spectrum.projected[kept] / spectrum.singular_values[kept, None]
        return Solution(
            spectrum.right_vectors[kept].T @ scaled,
            solver_status=f"rank {int(kept.sum())}",
            shared_seconds=spectrum.seconds if known else 0.0,
        )
