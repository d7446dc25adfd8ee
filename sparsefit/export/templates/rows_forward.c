/* ---- rows: v' by the forward difference, at the first of two samples ------------------------ */

static sf_real sf_seconds(const sf_flow *flow, uint32_t from)
{
    return (sf_real)(uint32_t)(flow->time_us[from + 1u] - flow->time_us[from]) * SF_R(1e-6);
}

/* State x, y, vx, vy and acceleration of the window's row. */
static void sf_differentiate(const sf_flow *flow, sf_real state[4], sf_real rate[2])
{
    const sf_real step = sf_seconds(flow, 0u);
    uint32_t c;
    for (c = 0u; c < 4u; c++) {
        state[c] = flow->window[0][c];
    }
    for (c = 0u; c < 2u; c++) {
        rate[c] = (flow->window[1][2u + c] - flow->window[0][2u + c]) / step;
    }
}

