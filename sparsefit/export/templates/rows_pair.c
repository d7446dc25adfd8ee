/* ---- rows: ${pair_words} */

/* State x, y, vx, vy and acceleration of the window's row. */
static void sf_differentiate(const sf_flow *flow, sf_real state[4], sf_real rate[2])
{
    const sf_real step = sf_seconds(flow, 0u);
    uint32_t c;
    for (c = 0u; c < 4u; c++) {
        state[c] = ${pair_state};
    }
    for (c = 0u; c < 2u; c++) {
        rate[c] = (flow->window[1][2u + c] - flow->window[0][2u + c]) / step;
    }
}

