/* ---- samples --------------------------------------------------------------------------------- */

/*
 * The block joins the sum of all rows before it. What rounding takes of it stays in the block and
 * joins with the next (compensated summation; not to be compiled with -ffast-math).
 */
static void sf_fold(sf_real *rest, sf_real *block)
{
    const sf_real before = SF_R(SF_FORGETTING) * *rest;
    const sf_real after = before + *block;
    *block -= after - before;
    *rest = after;
}

static void sf_fold_block(sf_flow *flow)
{
    uint32_t g;
    uint32_t d;
    uint32_t i;
    for (i = 0u; i < 2u; i++) {
        sf_fold(&flow->squares[1][i], &flow->squares[0][i]);
    }
    for (g = 0u; g < SF_SCALES; g++) {
        for (d = 0u; d < SF_ORDERS; d++) {
            for (i = 0u; i < SF_TERMS; i++) {
                sf_fold(&flow->sums[1][g][d][i], &flow->sums[0][g][d][i]);
            }
        }
    }
${fold_columns}    flow->in_block = 0u;
}

/* One row: Phi = tau (v' - a) + v at a position from the origin, into all sums. */
static void sf_add_row(sf_flow *flow, const sf_real state[4], const sf_real rate[2])
{
    const sf_real x = state[0] - flow->origin[0];
    const sf_real y = state[1] - flow->origin[1];
    const sf_real place[2] = {x, y};
    sf_real phi[2];
    uint32_t g;
    uint32_t c;
${columns_declared}    for (c = 0u; c < 2u; c++) {
        phi[c] = flow->response_time * (rate[c] - flow->thrust[c]) + state[2u + c];
        flow->squares[0][c] += phi[c] * phi[c];
        if ((flow->rows == 0u) || (place[c] < flow->lowest[c])) {
            flow->lowest[c] = place[c];
        }
        if ((flow->rows == 0u) || (place[c] > flow->highest[c])) {
            flow->highest[c] = place[c];
        }
    }
    for (g = 0u; g < SF_SCALES; g++) {
        sf_real hx[SF_ORDERS][SF_SIDE];
        sf_real hy[SF_ORDERS][SF_SIDE];
        sf_harmonics(SF_WAVENUMBER[g], x, hx);
        sf_harmonics(SF_WAVENUMBER[g], y, hy);
        sf_add_to_scale(flow->sums[0][g], hx, hy, phi);
${columns_taken}    }
${columns_added}    flow->rows += (flow->rows < UINT32_MAX) ? 1u : 0u;
    flow->in_block++;
    if (flow->in_block >= SF_BLOCK) {
        sf_fold_block(flow);
    }
}

/* Whether a number is one, and no larger than any that a flight has: NaN compares as false. */
static int sf_is_sane(sf_real value)
{
    return (value >= -SF_LARGEST) && (value <= SF_LARGEST);
}

/* Whether a sample begins a new window: a gap, or a step that the derivative cannot take. */
static int sf_breaks(const sf_flow *flow, uint64_t time_us)
{
    const uint64_t step = time_us - flow->time_us[flow->held - 1u];
    const sf_real nominal = (sf_real)flow->sample_us;
    if (step > (uint64_t)UINT32_MAX) {
        return 1;
    }
    return ${step_test};
}

/* ---- what sf_flow.h declares ------------------------------------------------------------------- */

sf_status sf_init(sf_flow *flow, const sf_config *config)
{
    uint32_t i;
    uint32_t d;
    uint32_t g;
    uint32_t part;
    if ((flow == NULL) || (config == NULL)) {
        return SF_BAD_ARGUMENT;
    }
    flow->ready = 0u;
    if (!(config->response_time > SF_R(0)) || !sf_is_sane(config->response_time)
        || !sf_is_sane(config->thrust_x) || !sf_is_sane(config->thrust_y)
        || !sf_is_sane(config->origin_x) || !sf_is_sane(config->origin_y)
        || (config->sample_us == 0u)) {
        return SF_BAD_ARGUMENT;
    }
    flow->sample_us = config->sample_us;
    flow->response_time = config->response_time;
    flow->thrust[0] = config->thrust_x;
    flow->thrust[1] = config->thrust_y;
    flow->origin[0] = config->origin_x;
    flow->origin[1] = config->origin_y;
    flow->held = 0u;
    flow->skipped = 0u;
    flow->in_block = 0u;
    flow->rows = 0u;
    for (i = 0u; i < 2u; i++) {
        flow->lowest[i] = SF_R(0);
        flow->highest[i] = SF_R(0);
    }
    for (part = 0u; part < 2u; part++) {
        for (i = 0u; i < 2u; i++) {
            flow->squares[part][i] = SF_R(0);
        }
        for (g = 0u; g < SF_SCALES; g++) {
            for (d = 0u; d < SF_ORDERS; d++) {
                for (i = 0u; i < SF_TERMS; i++) {
                    flow->sums[part][g][d][i] = SF_R(0);
                }
            }
        }
${clear_columns}    }
    for (i = 0u; i < SF_WINDOW; i++) {
        flow->time_us[i] = 0u;
        for (d = 0u; d < 4u; d++) {
            flow->window[i][d] = SF_R(0);
        }
    }
    flow->ready = SF_READY;
    return SF_OK;
}

sf_status sf_update(sf_flow *flow, uint64_t time_us, sf_real x, sf_real y, sf_real vx, sf_real vy)
{
    sf_status status = SF_OK;
    sf_real state[4];
    sf_real rate[2];
    uint32_t i;
    uint32_t c;
    if (flow == NULL) {
        return SF_BAD_ARGUMENT;
    }
    if (flow->ready != SF_READY) {
        return SF_NOT_READY;
    }
    if (!sf_is_sane(x) || !sf_is_sane(y) || !sf_is_sane(vx) || !sf_is_sane(vy)) {
        return SF_BAD_SAMPLE;
    }
    if (flow->held > 0u) {
        if (time_us <= flow->time_us[flow->held - 1u]) {
            return SF_BAD_TIME;
        }
        if (sf_breaks(flow, time_us)) {
            flow->held = 0u;
            status = SF_GAP;
        }
    }
    if (flow->held == SF_WINDOW) { /* the oldest sample leaves */
        for (i = 1u; i < SF_WINDOW; i++) {
            flow->time_us[i - 1u] = flow->time_us[i];
            for (c = 0u; c < 4u; c++) {
                flow->window[i - 1u][c] = flow->window[i][c];
            }
        }
        flow->held = SF_WINDOW - 1u;
    }
    flow->time_us[flow->held] = time_us;
    flow->window[flow->held][0] = x;
    flow->window[flow->held][1] = y;
    flow->window[flow->held][2] = vx;
    flow->window[flow->held][3] = vy;
    flow->held++;
    if (flow->held == SF_WINDOW) {
        if (flow->skipped == 0u) {
            sf_differentiate(flow, state, rate);
            sf_add_row(flow, state, rate);
        }
        flow->skipped = (flow->skipped + 1u) % SF_EVERY;
    }
    return status;
}

sf_status sf_estimate(${estimate_const}sf_flow *flow, sf_answer *answer)
{
    if ((flow == NULL) || (answer == NULL)) {
        return SF_BAD_ARGUMENT;
    }
    answer->status = SF_NOT_READY;
    answer->doubt = SF_FEW_SAMPLES;
    answer->rows = 0u;
    answer->refined = 0u;
    answer->mean_velocity = SF_R(NAN);
    answer->length_scale = SF_R(NAN);
    answer->timescale = SF_R(NAN);
    answer->grid_length_scale = SF_R(NAN);
    answer->rival = SF_R(0);
    answer->length_scale_error = SF_R(NAN);
    answer->unexplained = SF_R(NAN);
    answer->certificate = SF_R(NAN);
    if (flow->ready != SF_READY) {
        return SF_NOT_READY;
    }
    answer->status = SF_UNIDENTIFIABLE;
    answer->rows = flow->rows;
    if (flow->rows < SF_MINIMUM_ROWS) {
        return answer->status;
    }
    if (!(sf_phi_square(flow) > SF_R(0))) {
        answer->doubt = SF_NO_FLOW;
        return answer->status;
    }
${estimate_body}
    answer->status = (answer->doubt == SF_NO_DOUBT) ? SF_OK : SF_UNIDENTIFIABLE;
    return answer->status;
}
