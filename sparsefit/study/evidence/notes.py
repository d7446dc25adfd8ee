"""What stands under the tables: what is counted, and how a failure counts."""

FAILURES = (
    "n: planned cases. Errors are over the cases with an estimate (status ok or inaccurate); "
    "every other case is a failure, and counts as a miss in the hit rate."
)
SIGNED = (
    "Signed means, the paper's convention (its “Absolute Error” and “Percentage Error” are "
    "signed): errors of opposite sign cancel. errors-absolute has the sizes."
)
EFFICIENCY = (
    "Bound: the semiparametric Cramér-Rao bound of each flight as flown, under noise on v' alone "
    "(Eq. 7); it assumes nothing of the flow but its length scale. Rms over the flights with "
    "status ok and a bound (their number: with bound); a failure has no error, so read the "
    "number of failures beside it. 1 is the limit of what knows no more than the bound does; "
    "parametric-nls knows Eq. 1 and may fall below it, and so may any back-end where it gives up "
    "the hardest flights."
)
COVERAGE = (
    "Share of the flights with status ok whose 95 % interval holds the truth, and the 95 % Wilson "
    "interval of that share: where it leaves 95 % out, the intervals are too narrow or too wide. "
    "Half-width: median, in percent of the estimate. Flights without a flow have no truth and "
    "are left out."
)
IDENTIFIABILITY = (
    "Off: called ok, but more than 5 % from the truth in U0, L_w or τ_w, and its share of those "
    "called ok. An unidentifiable flight deserved it if the numbers that it would have given are "
    "off by as much, or there are none. Other: inaccurate, or no answer. In flights without a "
    "flow status ok or inaccurate is a false alarm; called so: unidentifiable because no cellular "
    "flow is detected."
)
SCALES = (
    "All found: every flow's length scale within 1 %, over all planned cases. A scale counts as "
    "detected within 5 %; missed and spurious are means per case. Errors: the largest over the "
    "detected scales of a case, median over cases. Unseen: cases that ended as ok without all "
    "scales within 1 %. First row of each setting: all its cases; then "
    "each level of each factor, the others pooled."
)
TIMES = (
    "Worst: the largest certificate of the cases with an estimate. "
    "Times depend on the machine; the manifest names it."
)
