"""On board: the forward pass as samples come, the estimator as it would fly, and its C."""

from sparsefit.onboard.flown import Stream, as_flown
from sparsefit.onboard.online import OnlineEstimator, refusal

__all__ = ["OnlineEstimator", "Stream", "as_flown", "refusal"]
