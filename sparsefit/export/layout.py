"""How much memory the C takes: the state's size, byte by byte, and that of its constants."""

from __future__ import annotations

from sparsefit.errors import InputError
from sparsefit.export.plan import Plan

TERMS = 43  # sums of a scale: 5 x 5 of the columns, 2 x (3 x 3) with Phi
BYTES = {"double": 8, "float": 4}
WORDS = 6  # counters of 32 bits in the state
CLOCK = 8  # bytes of a time stamp, and what the state's size is a multiple of


def ram(plan: Plan, scales: int | None = None) -> int:
    """sizeof(sf_flow) [bytes], of the plan's own or so many ``scales``."""
    count = len(plan.scales) if scales is None else scales
    k = plan.columns // len(plan.scales) * count
    alone = 1 + 4 * 2 + 4 * plan.window + 4
    reals = alone + 2 * count * plan.orders * TERMS + 3 * (k * (k + 1) // 2) + 6 * k
    size = CLOCK * plan.window + 4 * WORDS + BYTES[plan.real] * reals
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
    fits = next((g for g in range(len(plan.scales), 0, -1) if ram(plan, g) <= most), 0)
    told = f"at most {fits} scales fit" if fits else "no grid fits"
    raise InputError(
        f"{len(plan.scales)} scales with back-end {plan.backend.name!r} take {size} bytes of RAM, "
        f"more than {most}: {told}; use a coarser grid, --float, best-scale, or a larger --ram"
    )
