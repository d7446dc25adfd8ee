"""On board: recursive estimation from a stream of samples, in Python and in C."""

from sparsefit.onboard.online import OnlineEstimator, Stream, as_flown, refusal

__all__ = ["OnlineEstimator", "Stream", "as_flown", "refusal"]
