/* ---- the sums of all columns of all scales ---------------------------------------------------
 *
 * theta'theta, its lower triangle row by row, and theta'Phi: what a back-end that weighs the scales
 * against each other needs.
 */

static void sf_add_columns(sf_flow *flow, const sf_real columns[SF_COLUMNS], const sf_real phi[2])
{
    uint32_t pair = 0u;
    uint32_t a;
    uint32_t b;
    for (a = 0u; a < SF_COLUMNS; a++) {
        for (b = 0u; b <= a; b++) {
            flow->gram[0][pair] += columns[a] * columns[b];
            pair++;
        }
        flow->cross[0][a][0] += columns[a] * phi[0];
        flow->cross[0][a][1] += columns[a] * phi[1];
    }
}

/* Where theta_a' theta_b stands. */
static uint32_t sf_pair(uint32_t a, uint32_t b)
{
    return (a >= b) ? (a * (a + 1u) / 2u + b) : (b * (b + 1u) / 2u + a);
}

/* Columns in unit rms: the norms |theta_a|, their inverses, and Z'Phi_c/m in units of |Phi|/sqrt(m). */
static void sf_scale_columns(const sf_flow *flow, sf_real norm[SF_COLUMNS], sf_real unit[SF_COLUMNS],
                             sf_real correlation[SF_COLUMNS][2])
{
    const sf_real root = SF_R(1) / ${sqrt}(sf_rows(flow));
    uint32_t a;
    uint32_t c;
    for (a = 0u; a < SF_COLUMNS; a++) {
        const uint32_t place = sf_pair(a, a);
        norm[a] = ${sqrt}(flow->gram[0][place] + flow->gram[1][place]);
        unit[a] = (norm[a] > SF_R(0)) ? (SF_R(1) / norm[a]) : SF_R(0);
        for (c = 0u; c < 2u; c++) {
            correlation[a][c] = (flow->cross[0][a][c] + flow->cross[1][a][c]) * unit[a] * root;
        }
    }
}

/* Mean square of one component of Phi. */
static sf_real sf_target_square(const sf_flow *flow, uint32_t c)
{
    return (flow->squares[0][c] + flow->squares[1][c]) / sf_rows(flow);
}

/* The scale with the largest ${readout_words}; SF_SCALES where all are zero. */
static uint32_t sf_heaviest(sf_real weights[SF_COLUMNS][2])
{
    sf_real largest = ${least_weight};
    uint32_t best = SF_SCALES;
    uint32_t any = 0u;
    uint32_t g;
    for (g = 0u; g < SF_SCALES; g++) {
        sf_real sum = SF_R(0);
        uint32_t a;
        uint32_t c;
        for (a = 8u * g; a < 8u * (g + 1u); a++) {
            for (c = 0u; c < 2u; c++) {
                const sf_real w = weights[a][c];
                any |= ((w > SF_R(0)) || (w < SF_R(0))) ? 1u : 0u;
                sum += ${readout_sum};
            }
        }
        if (sum > largest) {
            largest = sum;
            best = g;
        }
    }
    return (any != 0u) ? best : SF_SCALES;
}

