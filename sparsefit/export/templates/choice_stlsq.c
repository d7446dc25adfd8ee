/* ---- sequentially thresholded least squares ----------------------------------------------------
 *
 * On the support S of each component of Phi: V = (Z_S'Z_S/m + ridge I)^-1 Z_S'Phi/m, then columns
 * with |V| < ${threshold} |Phi|/sqrt(m) leave for good, at most SF_ITERATIONS times${unbias_words}.
 */

#define SF_ITERATIONS ${iterations}u
#define SF_RIDGE SF_R(${ridge})
#define SF_THRESHOLD SF_R(${threshold})

/* v = (Z_S'Z_S/m + ridge I)^-1 of a target, on n columns of a support, by Cholesky. */
static void sf_solve_on(sf_flow *flow, const uint32_t support[SF_COLUMNS], uint32_t n, sf_real ridge,
                        const sf_real unit[SF_COLUMNS], const sf_real target[SF_COLUMNS],
                        sf_real v[SF_COLUMNS])
{
    sf_real inverse[SF_COLUMNS]; /* of the factor's diagonal; 0 for a column that is left out */
    uint32_t a;
    uint32_t b;
    uint32_t e;
    for (a = 0u; a < n; a++) {
        const uint32_t row = a * (a + 1u) / 2u;
        sf_real sum = target[support[a]];
        for (b = 0u; b <= a; b++) {
            const uint32_t other = b * (b + 1u) / 2u;
            const uint32_t place = sf_pair(support[a], support[b]);
            sf_real value = (flow->gram[0][place] + flow->gram[1][place]) * unit[support[a]]
                            * unit[support[b]];
            if (b == a) {
                value += ridge;
            }
            for (e = 0u; e < b; e++) {
                value -= flow->work[row + e] * flow->work[other + e];
            }
            flow->work[row + b] = (b < a) ? (value * inverse[b]) : value;
        }
        inverse[a] = (flow->work[row + a] > SF_FLOOR) ? (SF_R(1) / ${sqrt}(flow->work[row + a]))
                                                      : SF_R(0);
        for (e = 0u; e < a; e++) {
            sum -= flow->work[row + e] * v[e];
        }
        v[a] = sum * inverse[a];
    }
    for (a = n; a-- > 0u;) {
        sf_real sum = v[a];
        for (e = a + 1u; e < n; e++) {
            sum -= flow->work[e * (e + 1u) / 2u + a] * v[e];
        }
        v[a] = sum * inverse[a];
    }
}

/* The scale with the largest weight; SF_SCALES without any. */
static uint32_t sf_choose(sf_flow *flow, sf_answer *answer)
{
    sf_real norm[SF_COLUMNS];
    sf_real unit[SF_COLUMNS];
    sf_real target[SF_COLUMNS][2];
    const sf_real root = ${sqrt}(sf_rows(flow));
    uint32_t moving = 0u; /* columns that the last iterations still removed */
    uint32_t a;
    uint32_t c;
    sf_scale_columns(flow, norm, unit, target);
    for (c = 0u; c < 2u; c++) {
        const sf_real threshold = SF_THRESHOLD * ${sqrt}(sf_target_square(flow, c));
        sf_real v[SF_COLUMNS];
        sf_real of_target[SF_COLUMNS];
        uint32_t support[SF_COLUMNS];
        uint32_t n = 0u;
        uint32_t gone = 0u;
        uint32_t iteration;
        for (a = 0u; a < SF_COLUMNS; a++) {
            flow->weights[a][c] = SF_R(0);
            of_target[a] = target[a][c];
            v[a] = SF_R(0);
            support[n] = a;
            n++;
        }
        for (iteration = 0u; iteration < SF_ITERATIONS; iteration++) {
            uint32_t kept = 0u;
            sf_solve_on(flow, support, n, SF_RIDGE, unit, of_target, v);
            for (a = 0u; a < n; a++) {
                if (${fabs}(v[a]) >= threshold) {
                    support[kept] = support[a];
                    v[kept] = v[a];
                    kept++;
                }
            }
            gone = n - kept;
            n = kept;
            if (gone == 0u) {
                break;
            }
        }
        moving += gone;
${unbias}        for (a = 0u; a < n; a++) {
            flow->weights[support[a]][c] = v[a] * unit[support[a]] * root;
        }
    }
    answer->certificate = (sf_real)moving / (sf_real)(2u * SF_COLUMNS);
    return sf_heaviest(flow->weights);
}

