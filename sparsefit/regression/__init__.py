"""The convex core, for any design matrix: problem, objective, certificate, fit and path."""

from sparsefit.regression.certificate import Certificate
from sparsefit.regression.fit import Fit, Path, fit, path
from sparsefit.regression.problem import RegressionProblem

__all__ = ["Certificate", "Fit", "Path", "RegressionProblem", "fit", "path"]
