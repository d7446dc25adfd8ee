"""On board: the forward pass as samples come, the estimator as it would fly, and its C."""

from sparsefit.onboard.online import OnlineEstimator, Stream, as_flown, refusal

__all__ = ["OnlineEstimator", "Stream", "as_flown", "refusal"]
