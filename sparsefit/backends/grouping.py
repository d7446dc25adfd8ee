"""How back-ends with group norms weigh the groups; what adaptive ones learn from a first fit."""

from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np

from sparsefit.arrays import Array
from sparsefit.backends.exact_paths import ridge_weights
from sparsefit.errors import flag_setting, number_setting, one_of
from sparsefit.regression.objective import Penalty
from sparsefit.regression.problem import RegressionProblem

GroupWeights = Literal["unit", "sqrt-size"]
FAINT = 1e-3  # of the largest norm of a first fit: what smaller ones count as


def check_grouping(owner: str, separate: Any, group_weights: Any) -> None:
    """Raise InputError on group settings that are out of range."""
    flag_setting(owner, "separate", separate)
    one_of(f"group_weights of {owner}", group_weights, get_args(GroupWeights))


def check_pilot(owner: str, ridge: Any, power: Any) -> None:
    """Raise InputError on a setting of an adaptive back-end's first fit that is out of range."""
    number_setting(owner, "power", power, low=0.0, high=4.0)
    number_setting(owner, "pilot_ridge", ridge, low=0.0, open_low=True)


def size_weights(problem: RegressionProblem, group_weights: GroupWeights) -> Array:
    """omega (g,): 1, or the root of the number of columns of each group."""
    sizes = np.bincount(problem.groups)
    return np.ones(len(sizes)) if group_weights == "unit" else np.sqrt(sizes)


def adapted(problem: RegressionProblem, penalty: Penalty, *, ridge: float, power: float) -> Penalty:
    """The penalty with its weights (g,) divided by (|V0_g| / max |V0_g|)^power.

    V0 = (Z'Z/m + ridge I)^-1 Z'Y/m is the first fit, its norms over all targets together; those
    below `FAINT` times the largest count as that. Where V0 is zero, the weights stay.
    """
    statistics = problem.statistics
    first, _ = ridge_weights(statistics.gram, statistics.cross, ridge)
    everything = Penalty(penalty.groups, penalty.weights, joint=True)
    norms = everything.block_norms(first)[:, 0]
    largest = float(norms.max())
    if largest == 0.0:
        return penalty
    weights = penalty.weights * np.maximum(norms / largest, FAINT) ** -power
    return replace(penalty, weights=weights)
