/* ---- the length scale of the grid that leaves least ------------------------------------------ */

static uint32_t sf_least(const sf_flow *flow)
{
    sf_real terms[SF_ORDERS][SF_TERMS];
    sf_fit fit;
    sf_real least = SF_R(0);
    uint32_t best = SF_SCALES;
    uint32_t scale;
    for (scale = 0u; scale < SF_SCALES; scale++) {
        sf_real left;
        sf_load(flow, scale, terms);
        sf_least_squares(terms[0], &fit);
        left = sf_left(sf_phi_square(flow), fit.explained);
        if ((scale == 0u) || (left < least)) {
            least = left;
            best = scale;
        }
    }
    return best;
}

