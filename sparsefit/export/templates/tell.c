/* ---- what is told of a fit ------------------------------------------------------------------- */

/* Whether 2 ln(likelihood ratio) of two residuals over m rows exceeds a limit. */
static int sf_exceeds(sf_real worse, sf_real better, sf_real rows, sf_real limit)
{
    return SF_R(2) * rows * ${log}(worse / better) > limit * SF_CORRELATION;
}

/* The rows that count: less than were taken where SF_FORGETTING is below 1. */
static sf_real sf_rows(const sf_flow *flow)
{
    return flow->sums[0][0][0][0] + flow->sums[1][0][0][0];
}

/* |Phi|^2 less what a uniform wind explains: |Phi|^2 - |sum of Phi|^2 / m. */
static sf_real sf_left_by_wind(const sf_flow *flow)
{
    const uint32_t x = SF_CROSS;
    const uint32_t y = SF_CROSS + SF_CROSS_SIDE * SF_CROSS_SIDE;
    const sf_real wind_x = flow->sums[0][0][0][x] + flow->sums[1][0][0][x];
    const sf_real wind_y = flow->sums[0][0][0][y] + flow->sums[1][0][0][y];
    const sf_real square = sf_phi_square(flow);
    return sf_left(square, (wind_x * wind_x + wind_y * wind_y) / sf_rows(flow));
}

/* U0, tau_w and what is left; SF_NO_FLOW where a uniform wind does nearly as well. */
static void sf_tell(const sf_flow *flow, const sf_fit *fit, sf_answer *answer)
{
    const sf_real square = sf_phi_square(flow);
    const sf_real left = sf_left(square, fit->explained);
    answer->mean_velocity = sf_mean_velocity(fit);
    answer->timescale = answer->length_scale / answer->mean_velocity;
    answer->unexplained = left / square;
    answer->doubt = sf_exceeds(sf_left_by_wind(flow), left, sf_rows(flow), SF_DETECTION)
                        ? SF_NO_DOUBT
                        : SF_NO_FLOW;
}

/* Whether the track is too short, or too straight, for the scale that was found. */
static sf_doubt sf_short(const sf_flow *flow, const sf_fit *fit, const sf_answer *answer)
{
    if (!(fit->pivot > SF_SAFE)) {
        return SF_DEPENDENT;
    }
    return (sf_extent(flow) < SF_R(2) * answer->length_scale) ? SF_SHORT_TRACK : SF_NO_DOUBT;
}

