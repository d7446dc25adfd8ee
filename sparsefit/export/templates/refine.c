/* ---- off the grid ----------------------------------------------------------------------------
 *
 * As functions of k all sums are band-limited by the flight's extent. Their values and two
 * derivatives at neighbouring wavenumbers of the grid give the polynomial of degree 5 between them
 * (Hermite), and so the residual R(k) = |Phi|^2 - c'G^-1 c there, and with the weights W = G^-1 c
 *
 *     dR/dk = sum over x, y of  W' (dG/dk) W - 2 W' dc/dk,
 *
 * whose zero is found by the rule of false position (Illinois). Positions are counted from the
 * middle of the flight first, which halves the band.
 */

#define SF_LOBES 3u    /* minima of the residual on the grid that are descended into, deepest first */
#define SF_STEPS ${steps}u   /* of a descent, at most */
#define SF_END SF_R(${end})  /* of an interval of the grid: a shorter step ends a descent */
#define SF_RESOLVED SF_R(${resolved}) /* ${coarse} lobes: a step in k times the extent is at most this */

typedef struct {
    sf_fit fit;
    sf_real k;
    sf_real error;  /* standard error of k; NaN on the grid */
    sf_real left;   /* |Phi - theta W|^2 */
    sf_doubt doubt; /* SF_EDGE, SF_COARSE or none */
} sf_place;

typedef struct {
    sf_real nodes[2][SF_ORDERS][SF_TERMS]; /* sums at the ends of the interval, from the centre */
    sf_real k;                             /* of the first */
    sf_real width;                         /* to the second */
} sf_interval;

/* Turn the harmonics along one axis to another origin: cos(k(x - x0)) = cos kx cos kx0 + ... */
static void sf_turn(sf_real terms[SF_ORDERS][SF_TERMS], uint32_t base, uint32_t side,
                    uint32_t stride, uint32_t other, sf_real h[SF_ORDERS][SF_SIDE])
{
    uint32_t j;
    uint32_t p;
    uint32_t d;
    uint32_t e;
    for (j = 0u; j < side; j++) {
        for (p = 1u; p < side; p += 2u) {
            const uint32_t even = base + p * stride + j * other;
            const uint32_t odd = even + stride;
            for (d = SF_ORDERS; d-- > 0u;) {
                sf_real cosine = SF_R(0);
                sf_real sine = SF_R(0);
                for (e = 0u; e <= d; e++) {
                    cosine += h[e][p] * terms[d - e][even] + h[e][p + 1u] * terms[d - e][odd];
                    sine += h[e][p] * terms[d - e][odd] - h[e][p + 1u] * terms[d - e][even];
                }
                terms[d][even] = cosine;
                terms[d][odd] = sine;
            }
        }
    }
}

/* The sums of a scale with positions counted from the middle of the flight. */
static void sf_load_centred(const sf_flow *flow, uint32_t scale, sf_real terms[SF_ORDERS][SF_TERMS])
{
    const uint32_t base[3] = {0u, SF_CROSS, SF_CROSS + SF_CROSS_SIDE * SF_CROSS_SIDE};
    const uint32_t side[3] = {SF_SIDE, SF_CROSS_SIDE, SF_CROSS_SIDE};
    sf_real h[SF_ORDERS][SF_SIDE];
    uint32_t part;
    sf_load(flow, scale, terms);
    sf_harmonics(SF_WAVENUMBER[scale], SF_R(0.5) * (flow->lowest[0] + flow->highest[0]), h);
    for (part = 0u; part < 3u; part++) {
        sf_turn(terms, base[part], side[part], side[part], 1u, h);
    }
    sf_harmonics(SF_WAVENUMBER[scale], SF_R(0.5) * (flow->lowest[1] + flow->highest[1]), h);
    for (part = 0u; part < 3u; part++) {
        sf_turn(terms, base[part], side[part], 1u, side[part], h);
    }
}

/* dR/dk (times the unit of the rates) from the fit, and the rates of the sums. */
static sf_real sf_slope(const sf_fit *fit, const sf_real rates[SF_TERMS])
{
    sf_real slope = SF_R(0);
    uint32_t a;
    uint32_t b;
    uint32_t c;
    for (a = 0u; a < 8u; a++) {
        for (b = 0u; b < a; b++) {
            const sf_real both = fit->weights[a][0] * fit->weights[b][0]
                                 + fit->weights[a][1] * fit->weights[b][1];
            slope += SF_R(2) * sf_gram(rates, a, b) * both;
        }
        for (c = 0u; c < 2u; c++) {
            const sf_real w = fit->weights[a][c];
            slope += w * (sf_gram(rates, a, a) * w - SF_R(2) * sf_cross(rates, a, c));
        }
    }
    return slope;
}

/* The fit at share t of an interval; returns dR/dt there. */
static sf_real sf_fit_between(const sf_interval *interval, sf_real t, sf_fit *fit)
{
    const sf_real h = interval->width;
    const sf_real t2 = t * t;
    const sf_real t3 = t2 * t;
    const sf_real t4 = t3 * t;
    const sf_real t5 = t4 * t;
    /* Of values, slopes (times h) and half the bends (times h^2) at the ends; then their rates. */
    const sf_real up = SF_R(10) * t3 - SF_R(15) * t4 + SF_R(6) * t5;
    const sf_real up_rate = SF_R(30) * t2 - SF_R(60) * t3 + SF_R(30) * t4;
    const sf_real basis[2][3] = {
        {SF_R(1) - up, h * (t - SF_R(6) * t3 + SF_R(8) * t4 - SF_R(3) * t5),
         h * h * (t2 - SF_R(3) * t3 + SF_R(3) * t4 - t5)},
        {up, h * (SF_R(7) * t4 - SF_R(4) * t3 - SF_R(3) * t5), h * h * (t3 - SF_R(2) * t4 + t5)}};
    const sf_real rate[2][3] = {
        {SF_R(0) - up_rate, h * (SF_R(1) - SF_R(18) * t2 + SF_R(32) * t3 - SF_R(15) * t4),
         h * h * (SF_R(2) * t - SF_R(9) * t2 + SF_R(12) * t3 - SF_R(5) * t4)},
        {up_rate, h * (SF_R(28) * t3 - SF_R(12) * t2 - SF_R(15) * t4),
         h * h * (SF_R(3) * t2 - SF_R(8) * t3 + SF_R(5) * t4)}};
    sf_real terms[SF_TERMS];
    sf_real rates[SF_TERMS];
    uint32_t i;
    uint32_t n;
    uint32_t d;
    for (i = 0u; i < SF_TERMS; i++) {
        terms[i] = SF_R(0);
        rates[i] = SF_R(0);
        for (n = 0u; n < 2u; n++) {
            for (d = 0u; d < SF_ORDERS; d++) {
                terms[i] += basis[n][d] * interval->nodes[n][d][i];
                rates[i] += rate[n][d] * interval->nodes[n][d][i];
            }
        }
    }
    sf_least_squares(terms, fit);
    return sf_slope(fit, rates);
}

/* From a minimum of the residual on the grid to the one off it. */
static void sf_descend(const sf_flow *flow, uint32_t scale, sf_place *place)
{
    const sf_real square = sf_phi_square(flow);
    sf_interval interval;
    sf_fit end;
    sf_real bend;
    sf_real left_end;
    sf_real right_end;
    sf_real t_left = SF_R(0);
    sf_real t_right = SF_R(1);
    sf_real last = SF_R(1);
    uint32_t moved = 0u;
    uint32_t step;
    uint32_t lower; /* the scale of the smaller wavenumber: scales ascend, wavenumbers descend */

    place->k = SF_WAVENUMBER[scale];
    place->error = SF_R(NAN);
    place->doubt = SF_EDGE;
    sf_load_centred(flow, scale, interval.nodes[0]);
    sf_least_squares(interval.nodes[0][0], &place->fit);
    place->left = sf_left(square, place->fit.explained);
    lower = (sf_slope(&place->fit, interval.nodes[0][1]) < SF_R(0)) ? scale : (scale + 1u);
    if ((lower == 0u) || (lower >= SF_SCALES)) {
        return;
    }
    interval.k = SF_WAVENUMBER[lower];
    interval.width = SF_WAVENUMBER[lower - 1u] - SF_WAVENUMBER[lower];
    place->doubt = SF_COARSE;
    if (interval.width * sf_extent(flow) > SF_RESOLVED) {
        return;
    }
    sf_load_centred(flow, lower, interval.nodes[0]);
    sf_load_centred(flow, lower - 1u, interval.nodes[1]);
    left_end = sf_fit_between(&interval, t_left, &end);
    right_end = sf_fit_between(&interval, t_right, &end);
    if ((left_end > SF_R(0)) || (right_end < SF_R(0))) {
        return;
    }
    place->doubt = SF_NO_DOUBT;
    bend = (right_end - left_end) / (interval.width * interval.width);
    for (step = 0u; step < SF_STEPS; step++) {
        const sf_real rise = right_end - left_end;
        const sf_real t = (rise > SF_R(0)) ? ((t_left * right_end - t_right * left_end) / rise)
                                           : t_right;
        const sf_real slope = sf_fit_between(&interval, t, &place->fit);
        const sf_real moved_by = ${fabs}(t - last);
        last = t;
        place->k = interval.k + t * interval.width;
        if ((moved_by <= SF_END) || !((t > t_left) && (t < t_right))) {
            break; /* as near as rounding lets it */
        }
        /* An end that stays twice counts half: the other one moves, too. */
        if (slope < SF_R(0)) {
            right_end *= (moved == 1u) ? SF_R(0.5) : SF_R(1);
            moved = 1u;
            left_end = slope;
            t_left = t;
        } else {
            left_end *= (moved == 2u) ? SF_R(0.5) : SF_R(1);
            moved = 2u;
            right_end = slope;
            t_right = t;
        }
    }
    place->left = sf_left(square, place->fit.explained);
    /* R grows by R/(2m) x rows that correlate at one standard error: R''/2 error^2. */
    place->error = ${sqrt}(place->left * SF_CORRELATION / (sf_rows(flow) * bend));
}

/* The deepest minima of the residual on the grid, deepest first; returns how many there are. */
static uint32_t sf_deepest(const sf_flow *flow, uint32_t lobes[SF_LOBES])
{
    const sf_real square = sf_phi_square(flow);
    sf_real depth[SF_LOBES];
    sf_real before = square;
    sf_real here = square;
    uint32_t count = 0u;
    uint32_t scale;
    for (scale = 0u; scale <= SF_SCALES; scale++) {
        sf_real after = square;
        if (scale < SF_SCALES) {
            sf_real terms[SF_ORDERS][SF_TERMS];
            sf_fit fit;
            sf_load(flow, scale, terms);
            sf_least_squares(terms[0], &fit);
            after = sf_left(square, fit.explained);
        }
        if ((scale > 0u) && (here < before) && (here <= after)) {
            uint32_t place = (count < SF_LOBES) ? count : SF_LOBES;
            while ((place > 0u) && (here < depth[place - 1u])) {
                place--;
            }
            if (place < SF_LOBES) {
                uint32_t i;
                count = (count < SF_LOBES) ? (count + 1u) : SF_LOBES;
                for (i = count - 1u; i > place; i--) {
                    depth[i] = depth[i - 1u];
                    lobes[i] = lobes[i - 1u];
                }
                depth[place] = here;
                lobes[place] = scale - 1u;
            }
        }
        before = here;
        here = after;
    }
    return count;
}

