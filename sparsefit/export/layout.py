"""How much memory the C takes: the state's size, byte by byte, and that of its constants."""

from __future__ import annotations

from sparsefit.errors import InputError
from sparsefit.export.plan import Plan

TERMS = 43  # sums of a scale: 5 x 5 of the columns, 2 x (3 x 3) with Phi
BYTES = {"double": 8, "float": 4}
WORDS = 6  # counters of 32 bits in the state
CLOCK = 8  # bytes of a time stamp, and what the state's size is a multiple of


def reals(plan: Plan) -> int:
    """The real numbers of the state."""
    alone = 1 + 4 * 2 + 4 * plan.window + 4
    scales = 2 * len(plan.scales) * plan.orders * TERMS
    k = plan.columns
    return alone + scales + 3 * (k * (k + 1) // 2) + 2 * 2 * k + 2 * k


def ram(plan: Plan) -> int:
    """sizeof(sf_flow) [bytes]."""
    size = CLOCK * plan.window + 4 * WORDS + BYTES[plan.real] * reals(plan)
    return -(-size // CLOCK) * CLOCK


def constants(plan: Plan) -> int:
    """Bytes of the tables in flash: wavenumbers, kernels, and those of the harmonics."""
    kernels = 2 * plan.window if plan.derivative.method == "savgol" else 0
    numbers = len(plan.scales) + kernels + 5 + 18
    return BYTES[plan.real] * numbers + 4 * (5 + 2 * 8 + 18)


def refuse_large(plan: Plan, most: int) -> None:
    """Raise InputError where the state takes more than ``most`` bytes."""
    size = ram(plan)
    if size <= most:
        return
    fits = _most_scales(plan, most)
    told = f"at most {fits} scales fit" if fits else "no grid fits"
    raise InputError(
        f"{len(plan.scales)} scales with back-end {plan.backend.name!r} take {size} bytes of RAM, "
        f"more than {most}: {told}; use a coarser grid, --float, best-scale, or a larger --ram"
    )


def _most_scales(plan: Plan, most: int) -> int:
    """The most scales of this plan in so many bytes: the size grows with their number."""
    count = len(plan.scales)
    full = plan.columns // count if count else 0
    numbers = (most - CLOCK * plan.window - 4 * WORDS) // BYTES[plan.real]
    numbers -= 1 + 4 * 2 + 4 * plan.window + 4

    def size(g: int) -> int:
        k = full * g
        return 2 * g * plan.orders * TERMS + 3 * (k * (k + 1) // 2) + 6 * k

    return next((g for g in range(count, 0, -1) if size(g) <= numbers), 0)
