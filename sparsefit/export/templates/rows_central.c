/* ---- rows: v' from three samples, the quotients weighted by the opposite step --------------- */

/* State x, y, vx, vy and acceleration of the window's row. */
static void sf_differentiate(const sf_flow *flow, sf_real state[4], sf_real rate[2])
{
    const sf_real before = sf_seconds(flow, 0u);
    const sf_real after = sf_seconds(flow, 1u);
    uint32_t c;
    for (c = 0u; c < 4u; c++) {
        state[c] = flow->window[1][c];
    }
    for (c = 0u; c < 2u; c++) {
        const sf_real v = flow->window[1][2u + c];
        const sf_real left = (v - flow->window[0][2u + c]) / before;
        const sf_real right = (flow->window[2][2u + c] - v) / after;
        rate[c] = (after * left + before * right) / (before + after);
    }
}

