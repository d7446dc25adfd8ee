/* ---- the answer: the deepest lobe, off the grid, and its rival ------------------------------- */

static void sf_read(const sf_flow *flow, sf_answer *answer)
{
    const sf_real square = sf_phi_square(flow);
    sf_place best;
    sf_real rival_left = square;
    uint32_t lobes[SF_LOBES] = {0u, 0u, 0u};
    const uint32_t count = sf_deepest(flow, lobes);
    uint32_t lobe;

    answer->doubt = SF_NO_FLOW;
    if (count == 0u) {
        return;
    }
    sf_descend(flow, lobes[0], &best);
    answer->grid_length_scale = SF_PI / SF_WAVENUMBER[lobes[0]];
    for (lobe = 1u; lobe < count; lobe++) {
        sf_place other;
        sf_descend(flow, lobes[lobe], &other);
        if (other.left < best.left) {
            rival_left = best.left;
            answer->rival = SF_PI / best.k;
            best = other;
            answer->grid_length_scale = SF_PI / SF_WAVENUMBER[lobes[lobe]];
        } else if (other.left < rival_left) {
            rival_left = other.left;
            answer->rival = SF_PI / other.k;
        } else {
            /* the third best says nothing more */
        }
    }
    answer->refined = (best.doubt == SF_NO_DOUBT) ? 1u : 0u;
    answer->length_scale = SF_PI / best.k;
    answer->length_scale_error = answer->length_scale * best.error / best.k;
    sf_tell(flow, &best.fit, answer);
    if (answer->doubt != SF_NO_DOUBT) {
        return;
    }
    if (best.doubt != SF_NO_DOUBT) {
        answer->doubt = best.doubt;
    } else if (!sf_exceeds(rival_left, best.left, sf_rows(flow), SF_DISTINCT)) {
        answer->doubt = SF_RIVAL;
    } else if (SF_R(2) * answer->length_scale_error > SF_PRECISION * answer->length_scale) {
        answer->doubt = SF_IMPRECISE;
    } else {
        answer->doubt = sf_short(flow, &best.fit, answer);
    }
}

