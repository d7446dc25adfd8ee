/* ---- the LASSO -------------------------------------------------------------------------------
 *
 *     min over V of 1/(2m) |Phi - Z V|^2 + alpha sum |V|,   alpha = ${alpha_fraction} max |Z'Phi|/m
 *
 * by coordinate descent on G = Z'Z/m: V_a = soft(C_a + V_a, alpha) with C = Z'Phi/m - G V. At most
 * SF_SWEEPS sweeps an answer, from the weights of the answer before. How near the optimum that is
 * the duality gap says, of both components: with q = <R, Phi>/m, r = |R|^2/m of the residual R and
 * the dual point s R/m, s = min(q/r, alpha/max |C|),
 *
 *     P - D = r/2 + alpha sum |V| - s q + s^2 r/2,   in units of |Phi|^2/2m.
 */

#define SF_ALPHA_FRACTION SF_R(${alpha_fraction})
#define SF_SETTLED SF_R(${settled}) /* of |Phi|/sqrt(m): steps below it are none */

static sf_real sf_soft(sf_real value, sf_real threshold)
{
    if (value > threshold) {
        return value - threshold;
    }
    return (value < SF_R(0) - threshold) ? (value + threshold) : SF_R(0);
}

/* Sweeps over the weights v of one component; correlation begins as Z'Phi/m and ends as C. */
static void sf_sweep(const sf_flow *flow, sf_real alpha, sf_real settled, sf_real v[SF_COLUMNS],
                     sf_real correlation[SF_COLUMNS])
{
    uint32_t sweep;
    uint32_t a;
    uint32_t b;
    for (sweep = 0u; sweep <= SF_SWEEPS; sweep++) {
        sf_real largest = SF_R(0);
        for (a = 0u; a < SF_COLUMNS; a++) {
            /* The first pass only takes the old weights' part from the correlation. */
            const sf_real next = (sweep == 0u) ? v[a] : sf_soft(correlation[a] + v[a], alpha);
            const sf_real step = (sweep == 0u) ? next : (next - v[a]);
            if ((step > SF_R(0)) || (step < SF_R(0))) {
                const sf_real size = ${fabs}(step);
                for (b = 0u; b < SF_COLUMNS; b++) {
                    correlation[b] -= step * flow->work[sf_pair(a, b)];
                }
                v[a] = next;
                largest = (size > largest) ? size : largest;
            }
        }
        if ((sweep > 0u) && (largest <= settled)) {
            break;
        }
    }
}

/* P - D of one component. */
static sf_real sf_gap(sf_real alpha, sf_real square, const sf_real target[SF_COLUMNS],
                      const sf_real v[SF_COLUMNS], const sf_real correlation[SF_COLUMNS])
{
    sf_real q = square;
    sf_real r;
    sf_real norm = SF_R(0);
    sf_real highest = SF_R(0);
    sf_real fitted = SF_R(0);
    sf_real s;
    uint32_t a;
    for (a = 0u; a < SF_COLUMNS; a++) {
        const sf_real size = ${fabs}(correlation[a]);
        q -= v[a] * target[a];
        fitted += v[a] * correlation[a];
        norm += ${fabs}(v[a]);
        highest = (size > highest) ? size : highest;
    }
    r = q - fitted;
    s = (r > SF_R(0)) ? (q / r) : SF_R(1);
    if (s * highest > alpha) {
        s = alpha / highest;
    }
    return SF_R(0.5) * r + alpha * norm - s * q + SF_R(0.5) * s * s * r;
}

/* The scale with the largest weight; SF_SCALES without any. */
static uint32_t sf_choose(sf_flow *flow, sf_answer *answer)
{
    sf_real norm[SF_COLUMNS];
    sf_real unit[SF_COLUMNS];
    sf_real target[SF_COLUMNS][2];
    const sf_real root = ${sqrt}(sf_rows(flow));
    sf_real alpha = SF_R(0);
    sf_real gap = SF_R(0);
    sf_real null = SF_R(0);
    uint32_t pair = 0u;
    uint32_t a;
    uint32_t b;
    uint32_t c;
    sf_scale_columns(flow, norm, unit, target);
    for (a = 0u; a < SF_COLUMNS; a++) {
        for (b = 0u; b <= a; b++) {
            flow->work[pair] = (flow->gram[0][pair] + flow->gram[1][pair]) * unit[a] * unit[b];
            pair++;
        }
        for (c = 0u; c < 2u; c++) {
            const sf_real size = ${fabs}(target[a][c]);
            alpha = (size > alpha) ? size : alpha;
        }
    }
    alpha *= SF_ALPHA_FRACTION;
    for (c = 0u; c < 2u; c++) {
        const sf_real square = sf_target_square(flow, c);
        sf_real v[SF_COLUMNS];
        sf_real first[SF_COLUMNS];
        sf_real correlation[SF_COLUMNS];
        for (a = 0u; a < SF_COLUMNS; a++) {
            v[a] = flow->weights[a][c] * norm[a] / root;
            first[a] = target[a][c];
            correlation[a] = target[a][c];
        }
        sf_sweep(flow, alpha, SF_SETTLED * ${sqrt}(square), v, correlation);
        gap += sf_gap(alpha, square, first, v, correlation);
        null += SF_R(0.5) * square;
        for (a = 0u; a < SF_COLUMNS; a++) {
            flow->weights[a][c] = v[a] * unit[a] * root;
        }
    }
    answer->certificate = gap / null;
    return sf_heaviest(flow->weights);
}

