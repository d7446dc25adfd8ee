/* ---- rows: a polynomial of degree ${order} through ${window} samples, in their middle (Savitzky, Golay) - */

/* Weights of the samples in the polynomial's value, and in its slope times the step. */
static const sf_real SF_VALUE[SF_WINDOW] = {
${value_kernel}};
static const sf_real SF_SLOPE[SF_WINDOW] = {
${slope_kernel}};

/* State x, y, vx, vy and acceleration of the window's row. */
static void sf_differentiate(const sf_flow *flow, sf_real state[4], sf_real rate[2])
{
    const uint32_t middle = SF_WINDOW / 2u;
    const sf_real step = (sf_real)(uint32_t)(flow->time_us[SF_WINDOW - 1u] - flow->time_us[0])
                         * SF_R(1e-6) / (sf_real)(SF_WINDOW - 1u);
    sf_real slope[2] = {SF_R(0), SF_R(0)};
    uint32_t c;
    uint32_t i;
    for (c = 0u; c < 4u; c++) {
        state[c] = flow->window[middle][c];
    }
    /* Differences from the middle sample: what is summed is small, and so is its rounding. */
    for (i = 0u; i < SF_WINDOW; i++) {
        for (c = 0u; c < 4u; c++) {
            const sf_real away = flow->window[i][c] - flow->window[middle][c];
            state[c] += SF_VALUE[i] * away;
            if (c >= 2u) {
                slope[c - 2u] += SF_SLOPE[i] * away;
            }
        }
    }
    rate[0] = slope[0] / step;
    rate[1] = slope[1] / step;
}

