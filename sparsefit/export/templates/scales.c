/* ---- the sums of one length scale ------------------------------------------------------------
 *
 * Along each axis there are the harmonics h = (1, cos kx, sin kx, cos 2kx, sin 2kx); the 8
 * candidates are products of the first three, and products of two candidates are sums of products
 * of all five. So all of theta'theta is in the 5 x 5 sums of h_i(kx) h_j(ky), and theta'Phi in the
 * 3 x 3 sums of h_i h_j Phi, x and y. Each is kept with its next Taylor coefficients in k, where
 * SF_ORDERS > 1: they carry it to wavenumbers between those of the grid.
 */

#define SF_SIDE 5u
#define SF_CROSS 25u      /* where the sums with Phi_x begin; those with Phi_y follow */
#define SF_CROSS_SIDE 3u

/* d/d(kx) of a harmonic is its rate times its partner. */
static const uint32_t SF_PARTNER[SF_SIDE] = {0u, 2u, 1u, 4u, 3u};
static const sf_real SF_RATE[SF_SIDE] = {SF_R(0), SF_R(-1), SF_R(1), SF_R(-2), SF_R(2)};

/* The harmonics of the 8 candidates along x and along y, in the order of the library. */
static const uint32_t SF_ALONG_X[8] = {2u, 0u, 1u, 0u, 2u, 2u, 1u, 1u};
static const uint32_t SF_ALONG_Y[8] = {0u, 2u, 0u, 1u, 2u, 1u, 2u, 1u};

/* h_i h_j along one axis = WEIGHT[0] h_TERM[0] + WEIGHT[1] h_TERM[1], i, j < 3. */
static const uint32_t SF_TERM[3][3][2] = {
    {{0u, 0u}, {1u, 0u}, {2u, 0u}},
    {{1u, 0u}, {0u, 3u}, {4u, 0u}},
    {{2u, 0u}, {4u, 0u}, {0u, 3u}}};
static const sf_real SF_WEIGHT[3][3][2] = {
    {{SF_R(1), SF_R(0)}, {SF_R(1), SF_R(0)}, {SF_R(1), SF_R(0)}},
    {{SF_R(1), SF_R(0)}, {SF_R(0.5), SF_R(0.5)}, {SF_R(0.5), SF_R(0)}},
    {{SF_R(1), SF_R(0)}, {SF_R(0.5), SF_R(0)}, {SF_R(0.5), SF_R(-0.5)}}};

typedef struct {
    sf_real weights[8][2]; /* W [m/s] */
    sf_real explained;     /* |theta W|^2, both components [m^2/s^2] */
    sf_real pivot;         /* the smallest of the factor of unit columns; 0 where one is dependent */
} sf_fit;

/* Taylor coefficients in k of the harmonics of k x, at k. */
static void sf_harmonics(sf_real k, sf_real x, sf_real h[SF_ORDERS][SF_SIDE])
{
    const sf_real phase = k * x;
    const sf_real c = ${cos}(phase);
    const sf_real s = ${sin}(phase);
    uint32_t d;
    uint32_t i;
    h[0][0] = SF_R(1);
    h[0][1] = c;
    h[0][2] = s;
    h[0][3] = SF_R(1) - SF_R(2) * s * s;
    h[0][4] = SF_R(2) * s * c;
    for (d = 1u; d < SF_ORDERS; d++) {
        const sf_real reach = x / (sf_real)d;
        for (i = 0u; i < SF_SIDE; i++) {
            h[d][i] = reach * SF_RATE[i] * h[d - 1u][SF_PARTNER[i]];
        }
    }
}

/* Coefficient d of the product h_i(kx) h_j(ky). */
static sf_real sf_taylor(sf_real hx[SF_ORDERS][SF_SIDE], sf_real hy[SF_ORDERS][SF_SIDE], uint32_t d,
                         uint32_t i, uint32_t j)
{
    sf_real value = hx[0][i] * hy[d][j];
    uint32_t e;
    for (e = 1u; e <= d; e++) {
        value += hx[e][i] * hy[d - e][j];
    }
    return value;
}

/* One row more in the sums of one scale. */
static void sf_add_to_scale(sf_real sums[SF_ORDERS][SF_TERMS], sf_real hx[SF_ORDERS][SF_SIDE],
                            sf_real hy[SF_ORDERS][SF_SIDE], const sf_real phi[2])
{
    uint32_t d;
    uint32_t i;
    uint32_t j;
    for (d = 0u; d < SF_ORDERS; d++) {
        for (i = 0u; i < SF_SIDE; i++) {
            for (j = 0u; j < SF_SIDE; j++) {
                const sf_real value = sf_taylor(hx, hy, d, i, j);
                sums[d][i * SF_SIDE + j] += value;
                if ((i < SF_CROSS_SIDE) && (j < SF_CROSS_SIDE)) {
                    const uint32_t place = SF_CROSS + i * SF_CROSS_SIDE + j;
                    sums[d][place] += value * phi[0];
                    sums[d][place + SF_CROSS_SIDE * SF_CROSS_SIDE] += value * phi[1];
                }
            }
        }
    }
}

/* The sums of a scale: those of the block and of all before it. */
static void sf_load(const sf_flow *flow, uint32_t scale, sf_real terms[SF_ORDERS][SF_TERMS])
{
    uint32_t d;
    uint32_t i;
    for (d = 0u; d < SF_ORDERS; d++) {
        for (i = 0u; i < SF_TERMS; i++) {
            terms[d][i] = flow->sums[0][scale][d][i] + flow->sums[1][scale][d][i];
        }
    }
}

/* theta_a' theta_b of two candidates. */
static sf_real sf_gram(const sf_real terms[SF_TERMS], uint32_t a, uint32_t b)
{
    const uint32_t *x = SF_TERM[SF_ALONG_X[a]][SF_ALONG_X[b]];
    const uint32_t *y = SF_TERM[SF_ALONG_Y[a]][SF_ALONG_Y[b]];
    const sf_real *p = SF_WEIGHT[SF_ALONG_X[a]][SF_ALONG_X[b]];
    const sf_real *q = SF_WEIGHT[SF_ALONG_Y[a]][SF_ALONG_Y[b]];
    return p[0] * (q[0] * terms[x[0] * SF_SIDE + y[0]] + q[1] * terms[x[0] * SF_SIDE + y[1]])
           + p[1] * (q[0] * terms[x[1] * SF_SIDE + y[0]] + q[1] * terms[x[1] * SF_SIDE + y[1]]);
}

/* theta_a' Phi_c. */
static sf_real sf_cross(const sf_real terms[SF_TERMS], uint32_t a, uint32_t c)
{
    return terms[SF_CROSS + c * SF_CROSS_SIDE * SF_CROSS_SIDE + SF_ALONG_X[a] * SF_CROSS_SIDE
                 + SF_ALONG_Y[a]];
}

/*
 * min over W of |Phi - theta W|^2 by Cholesky of the columns in unit norm: theta'theta = D F F' D,
 * F Z = D^-1 theta'Phi, |theta W|^2 = |Z|^2, F' D W = Z. A column whose pivot is below SF_FLOOR is
 * one of those before it again, and has no weight.
 */
static void sf_least_squares(const sf_real terms[SF_TERMS], sf_fit *fit)
{
    sf_real factor[8][8];
    sf_real inverse[8]; /* of the factor's diagonal; 0 for a column that is left out */
    sf_real unit[8];    /* 1/|theta_a| */
    sf_real z[8][2];
    uint32_t a;
    uint32_t b;
    uint32_t c;
    uint32_t e;
    fit->explained = SF_R(0);
    fit->pivot = SF_R(1);
    for (a = 0u; a < 8u; a++) {
        const sf_real square = sf_gram(terms, a, a);
        sf_real pivot;
        unit[a] = (square > SF_R(0)) ? (SF_R(1) / ${sqrt}(square)) : SF_R(0);
        for (b = 0u; b <= a; b++) {
            sf_real value = sf_gram(terms, a, b) * unit[a] * unit[b];
            for (e = 0u; e < b; e++) {
                value -= factor[a][e] * factor[b][e];
            }
            factor[a][b] = (b < a) ? (value * inverse[b]) : value;
        }
        pivot = factor[a][a];
        if (pivot > SF_FLOOR) {
            inverse[a] = SF_R(1) / ${sqrt}(pivot);
        } else {
            inverse[a] = SF_R(0);
            pivot = SF_R(0);
        }
        if (pivot < fit->pivot) {
            fit->pivot = pivot;
        }
        for (c = 0u; c < 2u; c++) {
            sf_real value = sf_cross(terms, a, c) * unit[a];
            for (e = 0u; e < a; e++) {
                value -= factor[a][e] * z[e][c];
            }
            z[a][c] = value * inverse[a];
            fit->explained += z[a][c] * z[a][c];
        }
    }
    for (c = 0u; c < 2u; c++) {
        for (a = 8u; a-- > 0u;) {
            sf_real value = z[a][c];
            for (e = a + 1u; e < 8u; e++) {
                value -= factor[e][a] * z[e][c];
            }
            z[a][c] = value * inverse[a];
        }
        for (a = 0u; a < 8u; a++) {
            fit->weights[a][c] = z[a][c] * unit[a];
        }
    }
}

/* U0 = sqrt(2 <|w|^2>): the mean square over a cell is 1/2 of a single, 1/4 of a product. */
static sf_real sf_mean_velocity(const sf_fit *fit)
{
    sf_real singles = SF_R(0);
    sf_real products = SF_R(0);
    uint32_t a;
    uint32_t c;
    for (a = 0u; a < 4u; a++) {
        for (c = 0u; c < 2u; c++) {
            singles += fit->weights[a][c] * fit->weights[a][c];
            products += fit->weights[a + 4u][c] * fit->weights[a + 4u][c];
        }
    }
    return ${sqrt}(singles + SF_R(0.5) * products);
}

/* |Phi|^2 of all rows. */
static sf_real sf_phi_square(const sf_flow *flow)
{
    return (flow->squares[0][0] + flow->squares[1][0]) + (flow->squares[0][1] + flow->squares[1][1]);
}

/* What a fit leaves of |Phi|^2; rounding never takes it below nothing. */
static sf_real sf_left(sf_real square, sf_real explained)
{
    const sf_real left = square - explained;
    const sf_real least = SF_ROUNDING * square;
    return (left > least) ? left : least;
}

/* The larger side of the flight's bounding box [m]. */
static sf_real sf_extent(const sf_flow *flow)
{
    const sf_real x = flow->highest[0] - flow->lowest[0];
    const sf_real y = flow->highest[1] - flow->lowest[1];
    return (x > y) ? x : y;
}

