/* ---- the answer: the one length scale of the grid that leaves least ------------------------- */

static void sf_read(const sf_flow *flow, sf_answer *answer)
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
    sf_load(flow, best, terms);
    sf_least_squares(terms[0], &fit);
    answer->length_scale = SF_PI / SF_WAVENUMBER[best];
    answer->grid_length_scale = answer->length_scale;
    sf_tell(flow, &fit, answer);
    if (answer->doubt == SF_NO_DOUBT) {
        answer->doubt = sf_short(flow, &fit, answer);
    }
}

