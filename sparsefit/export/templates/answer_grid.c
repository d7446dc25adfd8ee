/* ---- the answer: the 8 columns of one length scale of the grid ------------------------------- */

static void sf_read(const sf_flow *flow, uint32_t best, sf_answer *answer)
{
    sf_real terms[SF_ORDERS][SF_TERMS];
    sf_fit fit;
    sf_load(flow, best, terms);
    sf_least_squares(terms[0], &fit);
    answer->length_scale = SF_PI / SF_WAVENUMBER[best];
    answer->grid_length_scale = answer->length_scale;
    sf_tell(flow, &fit, answer);
    if (answer->doubt == SF_NO_DOUBT) {
        answer->doubt = sf_short(flow, &fit, answer);
    }
}

