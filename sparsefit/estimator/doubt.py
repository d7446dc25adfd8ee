"""Why an estimate is not to be believed: one enum, and the words for it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Doubt(StrEnum):
    """What keeps a flow from being told. The reason of an estimate is the same in words."""

    NO_WEIGHTS = "no-weights"
    """The back-end gave every column the weight zero."""
    STILL_AIR = "still-air"
    """The flow velocity is nothing beside the vehicle's own."""
    DISAGREEMENT = "disagreement"
    """The logged velocity is not that of the logged position."""
    FEW_SAMPLES = "few-samples"
    """There are fewer samples than a length scale has unknowns, or than a standard error needs."""
    UNDERSAMPLED = "undersampled"
    """The flow changes too much from sample to sample."""
    NO_FLOW = "no-flow"
    """No length scale explains more than a uniform wind does."""
    EDGE = "edge"
    """The best length scale is a bound of the search."""
    LEFT_OVER = "left-over"
    """A flow is left that the back-end did not propose."""
    BEATEN = "beaten"
    """Another length scale fits better than the one that was proposed."""
    RIVAL = "rival"
    """Another length scale fits too nearly as well."""
    IMPRECISE = "imprecise"
    """A parameter is known too poorly, or not at all."""
    VEHICLE = "vehicle"
    """The vehicle that fits best cannot be."""
    NO_CELLS = "no-cells"
    """Waves were found that make no cells of one flow or two."""
    MEAN_VELOCITY = "mean-velocity"
    """The readout gives no mean velocity above zero."""
    SHORT_TRACK = "short-track"
    """The flight covers less than one period of the flow."""
    MISFIT = "misfit"
    """There is a flow, but it is not the one that was fitted."""

    @property
    def no_flow(self) -> bool:
        """Whether it says that there is no cellular flow at all."""
        return self in (Doubt.STILL_AIR, Doubt.NO_FLOW)


@dataclass(frozen=True)
class Verdict:
    """A status, with the doubt behind ``unidentifiable`` or ``misfit`` and the reason in words."""

    status: str
    reason: str = ""
    doubt: Doubt | None = None

    @classmethod
    def against(cls, doubt: Doubt, reason: str) -> Verdict:
        """The verdict ``unidentifiable``, for a doubt and the words for it."""
        return cls("unidentifiable", reason, doubt)
