"""The few lines of C that a back-end or a derivative adds to what all exported estimators share."""

STEP_TUNABLE = {
    "savgol": """\
/* Share of the nominal step by which a step may differ; beyond it the window begins anew. */
#ifndef SF_STEP_TOLERANCE
#define SF_STEP_TOLERANCE ${step_tolerance}
#endif
""",
    "gap": """\
/* Nominal steps beyond which a step is a gap: the window begins anew. */
#ifndef SF_LONGEST_STEP
#define SF_LONGEST_STEP ${longest_step}
#endif
""",
}
STEP_TEST = {
    "savgol": "${fabs}((sf_real)(uint32_t)step - nominal) > SF_R(SF_STEP_TOLERANCE) * nominal",
    "gap": "(sf_real)(uint32_t)step > SF_R(SF_LONGEST_STEP) * nominal",
}
SWEEPS = """
/* Sweeps of the coordinate descent, an answer; the next answer goes on from there. */
#ifndef SF_SWEEPS
#define SF_SWEEPS ${sweeps}u
#endif
"""
UNBIAS = """\
        sf_solve_on(flow, support, n, SF_R(0), unit, of_target, v);
"""
PAIRS = {  # of two samples: in words, and the state that their row has
    "forward": ("v' by the forward difference, at the first of two samples", "flow->window[0][c]"),
    "midpoint": (
        "difference quotient and mean of two samples",
        "SF_R(0.5) * (flow->window[0][c] + flow->window[1][c])",
    ),
}
ESTIMATE = {
    "refined": "    sf_read(flow, answer);",
    "least": "    sf_read(flow, sf_least(flow), answer);",
    "columns": """\
    {
        const uint32_t scale = sf_choose(flow, answer);
        answer->doubt = SF_NO_WEIGHTS;
        if (scale < SF_SCALES) {
            sf_read(flow, ${candidate}answer);
        }
    }""",
}
COLUMNS = {  # what keeping the Gram matrix of all columns adds, by where it goes
    "column_sizes": """\
#define SF_COLUMNS (8u * SF_SCALES)
#define SF_PAIRS (SF_COLUMNS * (SF_COLUMNS + 1u) / 2u)
""",
    "column_state": """\
    sf_real gram[2][SF_PAIRS];       /* theta'theta of all columns, rows of the lower triangle */
    sf_real cross[2][SF_COLUMNS][2]; /* theta'Phi */
    sf_real work[SF_PAIRS];
    sf_real weights[SF_COLUMNS][2];  /* of the answer before [m/s] */
""",
    "fold_columns": """\
    for (g = 0u; g < SF_PAIRS; g++) {
        sf_fold(&flow->gram[1][g], &flow->gram[0][g]);
    }
    for (g = 0u; g < SF_COLUMNS; g++) {
        for (i = 0u; i < 2u; i++) {
            sf_fold(&flow->cross[1][g][i], &flow->cross[0][g][i]);
        }
    }
""",
    "columns_declared": """\
    sf_real columns[SF_COLUMNS];
""",
    "columns_taken": """\
        for (c = 0u; c < 8u; c++) {
            columns[8u * g + c] = hx[0][SF_ALONG_X[c]] * hy[0][SF_ALONG_Y[c]];
        }
""",
    "columns_added": """\
    sf_add_columns(flow, columns, phi);
""",
    "clear_columns": """\
        for (g = 0u; g < SF_PAIRS; g++) {
            flow->gram[part][g] = SF_R(0);
            flow->work[g] = SF_R(0);
        }
        for (g = 0u; g < SF_COLUMNS; g++) {
            for (i = 0u; i < 2u; i++) {
                flow->cross[part][g][i] = SF_R(0);
                flow->weights[g][i] = SF_R(0);
            }
        }
""",
}
