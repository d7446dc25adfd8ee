/*
 * sf_flow.c - the search and the filters of sf_flow.h. No heap, no recursion, every loop bounded.
 */
#include "sf_flow.h"

#include <string.h>
#include <tgmath.h>

#if defined(__FAST_MATH__)
#error "sf_flow.c tests for NaN and infinity: compile it without -ffast-math"
#endif

#define R(value) ((sf_real)(value))
#define N SF_STATES
#define M SF_FLOW
enum { X, Y, VX, VY, UX, UY, FLOW };        /* places in a state: the flow's parameters are last */
enum { SPEED, LENGTH, TIME, HEADING, UNEVEN, FEATURES }; /* functions of the flow's parameters */

#define PI R(3.14159265358979323846)
#define RATE R(2.0)          /* of the disturbance [1/s] */
#define FLOOR R(0.1)         /* of it that is white */
#define GATE R(25.0)         /* square of a normalised innovation that is an outlier */
#define FADE R(0.998)        /* of a log-likelihood with a sample */
#define HORIZON R(100.0)     /* samples that tests of innovations look back over */
#define SETTLED R(64.0)      /* samples that are followed before there is an answer */
#define ANNEAL R(8.0)        /* times the noise, more, that the first samples are given */
#define WALK_A R(0.002)      /* by which amplitudes may change, of themselves, in a second */
#define WALK_K R(0.0005)     /* and wavevectors */
#define LARGEST R(1e7)       /* [m], [m/s], [m/s^2] */
#define GAP R(20.0)          /* mean steps */
#define FEWEST_ROWS 24u
#define BLOCK_MOST R(64.0)   /* samples of a row */
#define REFINEMENTS 14u      /* steps of a peak */
#define EVEN R(0.03)         /* logarithm of the waves' ratio of strengths that is none */
#define EXPLAINED R(0.6)     /* share of the rows' squares that has to be, to follow */
#define EVIDENCE R(15.0)     /* log-likelihood ratio that excludes a rival */

static const sf_real LEVEL[SF_LEVELS] = {R(0.003), R(0.02), R(0.08), R(0.3)}; /* over U0 */

/* ---- sums ----------------------------------------------------------------------------------- */

static sf_real square(sf_real value) { return value * value; }

static sf_real least_of(sf_real a, sf_real b) { return a < b ? a : b; }

static sf_real most_of(sf_real a, sf_real b) { return a > b ? a : b; }

static int within(sf_real value, sf_real low, sf_real high)
{
    return (value >= low) && (value <= high); /* false of NaN */
}

static sf_real dot(uint32_t n, const sf_real *a, const sf_real *b)
{
    sf_real sum = 0;
    uint32_t i;
    for (i = 0; i < n; i++) {
        sum += a[i] * b[i];
    }
    return sum;
}

/* The matrix a (M, M) more by c b b'. */
static void add_square(sf_real a[M][M], sf_real c, const sf_real b[M])
{
    uint32_t i, j;
    for (i = 0; i < M; i++) {
        for (j = 0; j < M; j++) {
            a[i][j] += c * b[i] * b[j];
        }
    }
}

/* c = a b. */
static void product(sf_real a[M][M], const sf_real b[M], sf_real c[M])
{
    uint32_t i;
    for (i = 0; i < M; i++) {
        c[i] = dot(M, a[i], b);
    }
}

/* A symmetric matrix becomes its inverse, by Gauss and Jordan; 0 where it is not positive. */
static int invert(sf_real a[M][M])
{
    uint32_t i, j, k;
    for (k = 0; k < M; k++) {
        const sf_real pivot = a[k][k];
        if (!(pivot > 0)) {
            return 0;
        }
        a[k][k] = 1;
        for (j = 0; j < M; j++) {
            a[k][j] /= pivot;
        }
        for (i = 0; i < M; i++) {
            const sf_real share = a[i][k];
            if (i == k) {
                continue;
            }
            a[i][k] = 0;
            for (j = 0; j < M; j++) {
                a[i][j] -= share * a[k][j];
            }
        }
    }
    return 1;
}

/* A covariance p becomes t p t', t of the identity's rows below its own. */
static void carry(sf_real p[N][N], sf_real t[][N], uint32_t rows)
{
    sf_real tp[N][N];
    uint32_t i, j;
    for (i = 0; i < rows; i++) {
        for (j = 0; j < N; j++) {
            tp[i][j] = dot(N, t[i], p[j]);
        }
    }
    for (i = 0; i < rows; i++) {
        for (j = i; j < N; j++) {
            p[i][j] = p[j][i] = j < rows ? dot(N, tp[i], t[j]) : tp[i][j];
        }
    }
}

/* ---- the flow: a, b, a, b, kx, ky ----------------------------------------------------------- */

/*
 * w [m/s] of the parameters p at (x, y) [m] from where the phases count, with its gradients by the
 * place and by p.
 */
static void waves(const sf_real *p, sf_real x, sf_real y, sf_real w[2], sf_real by_place[2][2],
                  sf_real by_flow[2][M])
{
    uint32_t j, r;
    memset(by_place, 0, sizeof(sf_real[2][2]));
    memset(by_flow, 0, sizeof(sf_real[2][M]));
    w[0] = w[1] = 0;
    for (j = 0; j < 2u; j++) {
        const sf_real a = p[2u * j], b = p[2u * j + 1u];
        const sf_real k = j ? -p[5] : p[4], l = j ? p[4] : p[5];
        const sf_real phase = k * x + l * y, c = cos(phase), s = sin(phase);
        const sf_real slope = b * c - a * s, height = a * c + b * s;
        for (r = 0; r < 2u; r++) {
            const sf_real normal = r ? -k : l;
            const sf_real by_k = -height * normal * x - (r ? slope : 0);
            const sf_real by_l = -height * normal * y + (r ? 0 : slope);
            w[r] += normal * slope;
            by_place[r][0] -= height * normal * k;
            by_place[r][1] -= height * normal * l;
            by_flow[r][2u * j] = -s * normal;
            by_flow[r][2u * j + 1u] = c * normal;
            by_flow[r][4] += j ? by_l : by_k;
            by_flow[r][5] += j ? -by_k : by_l;
        }
    }
}

/* An angle less the nearest multiple of a right one. */
static sf_real turned(sf_real angle)
{
    return angle - PI / 2 * floor(angle / (PI / 2) + R(0.5));
}

/*
 * U0, L, L/U0, the heading, and half the logarithm of the ratio of the waves' squared amplitudes,
 * with their gradients by p.
 */
static void features(const sf_real *p, sf_real value[FEATURES], sf_real by[FEATURES][M])
{
    const sf_real first = dot(2, p, p), second = dot(2, p + 2, p + 2), k = dot(2, p + 4, p + 4);
    uint32_t j;
    memset(by, 0, sizeof(sf_real[FEATURES][M]));
    value[SPEED] = sqrt(k * (first + second));
    value[LENGTH] = sqrt(R(2)) * PI / sqrt(k);
    value[TIME] = value[LENGTH] / value[SPEED];
    value[HEADING] = turned(atan2(p[5], p[4]) - PI / 4);
    value[UNEVEN] = log(second / first) / 2;
    for (j = 0; j < M; j++) {
        by[SPEED][j] = (j < 4u ? k : square(value[SPEED]) / k) * p[j] / value[SPEED];
        by[LENGTH][j] = j < 4u ? 0 : -value[LENGTH] * p[j] / k;
        by[TIME][j] =
            value[TIME] * (by[LENGTH][j] / value[LENGTH] - by[SPEED][j] / value[SPEED]);
        by[UNEVEN][j] = j < 2u ? -p[j] / first : j < 4u ? p[j] / second : 0;
    }
    by[HEADING][4] = -p[5] / k;
    by[HEADING][5] = p[4] / k;
}

/* The variance of a function with the gradient g. */
static sf_real variance_of(sf_real covariance[M][M], const sf_real g[M])
{
    sf_real product_of[M];
    product(covariance, g, product_of);
    return dot(M, g, product_of);
}

static sf_real speed_of(const sf_real *p)
{
    return sqrt(dot(2, p + 4, p + 4) * dot(4, p, p));
}

/* ---- the filters ---------------------------------------------------------------------------- */

/* x' and v' of a state under a thrust; the gradient of v' by the state, and dF/dr. */
static void motion(const sf_config *vehicle, const sf_real *z, const sf_real push[2],
                   sf_real rate[4], sf_real by[2][N], sf_real slope[2][2])
{
    sf_real w[2], relative[2], by_place[2][2], by_flow[2][M], speed, own, bend;
    uint32_t r, j;
    waves(z + FLOW, z[X], z[Y], w, by_place, by_flow);
    relative[0] = w[0] + z[UX] - z[VX];
    relative[1] = w[1] + z[UY] - z[VY];
    speed = sqrt(dot(2, relative, relative));
    own = 1 / vehicle->response_time + vehicle->drag_coefficient * speed;
    bend = speed > 0 ? vehicle->drag_coefficient / speed : 0;
    for (r = 0; r < 2u; r++) {
        rate[r] = z[VX + r];
        rate[2u + r] = own * relative[r] + push[r];
        slope[r][r] = own + bend * square(relative[r]);
        slope[r][1u - r] = bend * relative[0] * relative[1];
    }
    for (r = 0; r < 2u; r++) {
        for (j = 0; j < 2u; j++) {
            by[r][X + j] = slope[r][0] * by_place[0][j] + slope[r][1] * by_place[1][j];
            by[r][VX + j] = -slope[r][j];
            by[r][UX + j] = slope[r][j];
        }
        for (j = 0; j < M; j++) {
            by[r][FLOW + j] = slope[r][0] * by_flow[0][j] + slope[r][1] * by_flow[1][j];
        }
    }
}

/* A filter h seconds later, under a thrust and a disturbance of a level [m/s]. */
static void predict(const sf_config *vehicle, sf_filter *filter, sf_real h, const sf_real push[2],
                    sf_real level)
{
    static const sf_real AHEAD[4] = {R(0.5), R(0.5), R(1), R(0)}; /* Runge and Kutta */
    static const sf_real WEIGHT[4] = {R(1), R(2), R(2), R(1)};
    const sf_real decay = exp(-RATE * h), gust = square(level) * (1 - decay * decay);
    sf_real(*p)[N] = filter->covariance;
    sf_real z[N], rate[4], sum[4] = {0}, by[2][N], slope[2][2], t[6][N], white;
    sf_real middle_by[2][N] = {{0}}, middle_slope[2][2] = {{0}};
    uint32_t i, j, r;
    memcpy(z, filter->state, sizeof z);
    memset(t, 0, sizeof t);
    for (i = 0; i < 4u; i++) {
        motion(vehicle, z, push, rate, by, slope);
        if (i == 2u) { /* in the middle of the step */
            memcpy(middle_by, by, sizeof by);
            memcpy(middle_slope, slope, sizeof slope);
        }
        for (j = 0; j < 4u; j++) {
            sum[j] += WEIGHT[i] * rate[j];
            z[j] = filter->state[j] + AHEAD[i] * h * rate[j];
        }
    }
    for (j = 0; j < 4u; j++) {
        filter->state[j] += h / 6 * sum[j];
    }
    for (r = 0; r < 2u; r++) { /* the transition, to the second order in h */
        const sf_real *b = middle_by[r];
        filter->state[UX + r] *= decay;
        for (j = 0; j < N; j++) {
            sf_real second = b[VX] * middle_by[0][j] + b[VY] * middle_by[1][j];
            second += (j == VX) || (j == VY) ? b[j - 2u] : 0;
            second -= (j == UX) || (j == UY) ? RATE * b[j] : 0;
            t[X + r][j] = h * h / 2 * b[j];
            t[VX + r][j] = h * b[j] + h * h / 2 * second;
        }
        t[X + r][X + r] += 1;
        t[X + r][VX + r] += h;
        t[VX + r][VX + r] += 1;
        t[UX + r][UX + r] = decay;
    }
    carry(p, t, FLOW);
    white = square(FLOOR * level) * (2 / RATE) * dot(2, middle_slope[0], middle_slope[0]) * h;
    for (r = 0; r < 2u; r++) {
        p[UX + r][UX + r] += gust;
        p[VX + r][VX + r] += white;
        p[X + r][X + r] += white * h * h / 3;
        p[X + r][VX + r] += white * h / 2;
        p[VX + r][X + r] += white * h / 2;
    }
}

/* Take a measured number of the state; its normalised innovation. Outliers are left out. */
static sf_real correct(sf_filter *filter, uint32_t place, sf_real measured, sf_real variance,
                       sf_real *log_likelihood)
{
    sf_real(*p)[N] = filter->covariance;
    const sf_real spread = p[place][place] + variance;
    const sf_real innovation = measured - filter->state[place];
    const sf_real unit = innovation / sqrt(spread);
    sf_real gain[N];
    uint32_t i, j;
    *log_likelihood -= log(spread) / 2 + least_of(unit * unit, GATE) / 2;
    if (!(unit * unit < GATE)) {
        return unit > 0 ? sqrt(GATE) : -sqrt(GATE);
    }
    for (i = 0; i < N; i++) {
        gain[i] = p[i][place] / spread;
    }
    for (i = 0; i < N; i++) {
        filter->state[i] += gain[i] * innovation;
        for (j = i; j < N; j++) {
            p[i][j] = p[j][i] = p[i][j] - gain[i] * gain[j] * spread;
        }
    }
    return unit;
}

/* Count places and phases from another anchor, d away. */
static void rebase(sf_filter *filter, const sf_real d[2])
{
    sf_real *p = filter->state + FLOW;
    sf_real t[N][N];
    uint32_t i, wave;
    memset(t, 0, sizeof t);
    for (i = 0; i < N; i++) {
        t[i][i] = 1;
    }
    for (wave = 0; wave < 2u; wave++) {
        const uint32_t a = 2u * wave, b = a + 1u;
        const sf_real by[2] = {wave ? d[1] : d[0], wave ? -d[0] : d[1]};
        const sf_real turn = dot(2, p + 4, by), c = cos(turn), s = sin(turn);
        const sf_real new_a = c * p[a] + s * p[b], new_b = c * p[b] - s * p[a];
        p[a] = new_a;
        p[b] = new_b;
        t[FLOW + a][FLOW + a] = t[FLOW + b][FLOW + b] = c;
        t[FLOW + a][FLOW + b] = s;
        t[FLOW + b][FLOW + a] = -s;
        for (i = 0; i < 2u; i++) {
            t[FLOW + a][FLOW + 4u + i] = new_b * by[i];
            t[FLOW + b][FLOW + 4u + i] = -new_a * by[i];
        }
    }
    carry(filter->covariance, t, N);
    filter->state[X] -= d[0];
    filter->state[Y] -= d[1];
}

static const sf_filter *likeliest(const sf_flow *flow)
{
    const sf_filter *best = &flow->filter[0];
    uint32_t i;
    for (i = 1; i < SF_LEVELS; i++) {
        best = flow->filter[i].log_likelihood > best->log_likelihood ? &flow->filter[i] : best;
    }
    return best;
}

/* Parameters walk, and fade with a memory. */
static void forget(const sf_config *config, sf_filter *filter, sf_real h)
{
    const sf_real *p = filter->state + FLOW;
    const sf_real grow = config->memory > 0 ? exp(h / config->memory / 2) : 1;
    const sf_real power = dot(4, p, p) / 2, size = dot(2, p + 4, p + 4);
    uint32_t i, j;
    for (i = FLOW; i < N; i++) {
        for (j = 0; j < N; j++) {
            filter->covariance[i][j] *= grow;
            filter->covariance[j][i] *= grow;
        }
        filter->covariance[i][i] +=
            h * (i < FLOW + 4u ? square(WALK_A) * power : square(WALK_K) * size);
    }
}

/* Follow the flow with one sample z (x, y, vx, vy), h seconds after the last. */
static void follow(sf_flow *flow, const sf_real z[4], sf_real h, const sf_real push[2])
{
    const sf_real speed = speed_of(likeliest(flow)->state + FLOW);
    const sf_real rate = 1 / flow->config.response_time + 2 * flow->config.drag_coefficient * speed;
    const sf_real anneal = 1 + ANNEAL * exp(-flow->age / 50);
    const sf_real fade = 1 / (flow->age < HORIZON ? flow->age + 2 : HORIZON + 2);
    const sf_real away[2] = {z[0] - flow->anchor[0], z[1] - flow->anchor[1]};
    const int far = dot(2, away, away) > square(flow->config.lower / 2);
    const sf_real parts = 1 + floor(least_of(2 * h * rate, 15));
    sf_real least = R(HUGE_VAL);
    uint32_t outliers = 0, level, i;
    for (level = 0; level < SF_LEVELS; level++) {
        sf_filter *filter = &flow->filter[level];
        sf_real unit[4], log_likelihood = 0;
        uint32_t outlier = 0;
        for (i = 0; R(i) < parts; i++) {
            predict(&flow->config, filter, h / parts, push, LEVEL[level] * speed);
        }
        for (i = 0; i < 4u; i++) {
            unit[i] = correct(filter, i, i < 2u ? away[i] : z[i], flow->noise[i / 2u] * anneal,
                              &log_likelihood);
            outlier |= unit[i] * unit[i] >= GATE ? 1u : 0u;
        }
        outliers += outlier;
        filter->log_likelihood = FADE * filter->log_likelihood + log_likelihood;
        filter->square += fade * (dot(4, unit, unit) / 4 - filter->square);
        filter->product += fade * (dot(4, unit, filter->last) / 4 - filter->product);
        memcpy(filter->last, unit, sizeof unit);
        least = least_of(least, filter->square);
        forget(&flow->config, filter, h);
        if (far) {
            rebase(filter, away);
        }
    }
    if (far) {
        memcpy(flow->anchor, z, sizeof flow->anchor);
    }
    flow->age += 1;
    flow->gated += ((outliers >= SF_LEVELS ? R(1) : R(0)) - flow->gated) / 32;
    if ((flow->gated > R(0.3)) ||
        ((flow->age > R(150)) &&
         ((least > 2) || (flow->remaining[0] > flow->remaining[1] / 2)))) { /* lost */
        flow->following = flow->sweeping = 0;
        flow->doubt = SF_NO_FLOW;
    }
}

/* ---- the search ----------------------------------------------------------------------------- */

/* Add a sample to the block; when it is long enough, its mean and slope become a row. */
static void take_row(sf_flow *flow, const sf_real z[4], const sf_real push[2])
{
    sf_real *b = flow->block; /* n, t, tt, x, y, vx, vy, t vx, t vy, ax, ay */
    sf_real *row = flow->rows[flow->row_place];
    const sf_real t = flow->block_time, rate = 1 / flow->config.response_time;
    sf_real force[2], w[2], by_place[2][2], by_flow[2][M], moved, reach;
    uint32_t j;
    b[0] += 1;
    b[1] += t;
    b[2] += t * t;
    for (j = 0; j < 4u; j++) {
        b[3u + j] += z[j];
        b[7u + j] += j < 2u ? t * z[2u + j] : push[j - 2u];
    }
    moved = t * sqrt(dot(2, b + 5, b + 5)) / b[0];
    if ((b[0] < 4) || ((moved < flow->config.lower / 4) && (b[0] < BLOCK_MOST))) {
        return;
    }
    for (j = 0; j < 2u; j++) {
        const sf_real slope = (b[7u + j] - b[1] * b[5u + j] / b[0]) / (b[2] - b[1] * b[1] / b[0]);
        force[j] = slope - b[9u + j] / b[0];
    }
    reach = sqrt(dot(2, force, force));
    reach = rate + sqrt(rate * rate + 4 * flow->config.drag_coefficient * reach);
    for (j = 0; j < 2u; j++) {
        row[j] = b[3u + j] / b[0];
        row[2u + j] = b[5u + j] / b[0] + (reach > 0 ? 2 * force[j] / reach : 0);
    }
    memset(flow->block, 0, sizeof flow->block);
    flow->row_place = (flow->row_place + 1u) % SF_ROWS;
    flow->row_count += flow->row_count < SF_ROWS ? 1u : 0u;
    if (flow->following) {
        waves(likeliest(flow)->state + FLOW, row[0] - flow->anchor[0], row[1] - flow->anchor[1], w,
              by_place, by_flow);
        flow->remaining[0] +=
            (square(row[2] - w[0]) + square(row[3] - w[1]) - flow->remaining[0]) / 32;
        flow->remaining[1] += (dot(2, row + 2, row + 2) - flow->remaining[1]) / 32;
    }
}

static void begin_sweep(sf_flow *flow)
{
    sf_real extent = flow->config.lower;
    uint32_t i, j;
    for (j = 0; j < 2u; j++) {
        sf_real low = R(HUGE_VAL), high = -R(HUGE_VAL);
        for (i = 0; i < flow->row_count; i++) {
            low = least_of(low, flow->rows[i][j]);
            high = most_of(high, flow->rows[i][j]);
        }
        extent = most_of(extent, high - low);
    }
    flow->spacing = 2 / extent;
    flow->sweeping = 1;
    flow->radius = flow->turn = flow->peaks = flow->refining = flow->iteration = 0;
}

/* Share of the rows' squares that two waves at a right angle explain, as strong as each other. */
static sf_real explained(const sf_flow *flow, sf_real size, sf_real angle)
{
    sf_real share = 0, weight[2], amplitude[2];
    uint32_t wave, i;
    for (wave = 0; wave < 2u; wave++) {
        const sf_real k = size * (wave ? -sin(angle) : cos(angle));
        const sf_real l = size * (wave ? cos(angle) : sin(angle));
        sf_real ss = 0, sc = 0, cc = 0, sp = 0, cp = 0, determinant, of_sine, of_cosine;
        for (i = 0; i < flow->row_count; i++) {
            const sf_real *row = flow->rows[i];
            const sf_real phase = k * row[0] + l * row[1], s = sin(phase), c = cos(phase);
            const sf_real across = (l * row[2] - k * row[3]) / size;
            ss += R(1.01) * s * s; /* a little ridge */
            sc += s * c;
            cc += R(1.01) * c * c;
            sp += s * across;
            cp += c * across;
        }
        determinant = ss * cc - sc * sc;
        of_sine = (cc * sp - sc * cp) / determinant;
        of_cosine = (ss * cp - sc * sp) / determinant;
        share += of_sine * sp + of_cosine * cp;
        weight[wave] = 2 * determinant / (ss + cc);
        amplitude[wave] = sqrt(square(of_sine) + square(of_cosine));
    }
    share -= weight[0] * weight[1] / (weight[0] + weight[1]) * square(amplitude[0] - amplitude[1]);
    return share / flow->total;
}

/* Hold a candidate that is the best of its lobe, and among the best of all. */
static void hold(sf_flow *flow, sf_real score, sf_real size, sf_real angle)
{
    uint32_t place = flow->peaks, i;
    for (i = flow->peaks; i-- > 0u;) {
        const sf_peak *peak = &flow->peak[i];
        const sf_real turn = turned(angle - peak->angle);
        if (square(size - peak->size) + square(turn * size) < square(R(2.6) * flow->spacing)) {
            place = i;
        }
    }
    if (place == SF_PEAKS) {
        for (i = 1, place = 0; i < SF_PEAKS; i++) {
            place = flow->peak[i].score < flow->peak[place].score ? i : place;
        }
    }
    if ((place == flow->peaks) || (score > flow->peak[place].score)) {
        flow->peaks += place == flow->peaks ? 1u : 0u;
        flow->peak[place].score = score;
        flow->peak[place].size = size;
        flow->peak[place].angle = angle;
    }
}

/* Look at the next candidate; 0 where the sweep is at its end. */
static int look(sf_flow *flow)
{
    const sf_real around = sqrt(R(2)) * PI;
    const int any = flow->config.any_heading != 0u;
    const sf_real step = any ? flow->spacing : flow->spacing / 2;
    const sf_real size = around / flow->config.upper + step * R(flow->radius);
    const uint32_t turns = any ? (uint32_t)ceil(PI / 2 * size / step) : 1u;
    const sf_real angle = any ? PI / 2 * R(flow->turn) / R(turns) : PI / 4;
    if (size > around / flow->config.lower + step) {
        return 0;
    }
    hold(flow, explained(flow, size, angle), size, angle);
    flow->turn = flow->turn + 1u < turns ? flow->turn + 1u : 0u;
    flow->radius += flow->turn == 0u ? 1u : 0u;
    return 1;
}

/* A step of Levenberg and Marquardt for a peak, on all rows; 0 where there is none. */
static int refine(sf_flow *flow, sf_peak *peak, int first)
{
    const sf_real weight = flow->total / (20 * R(flow->row_count)) / square(EVEN);
    const uint32_t ties = first ? 0u : flow->config.any_heading ? 1u : 2u;
    sf_real normal[M][M], right[M] = {0}, value[FEATURES], by[FEATURES][M];
    sf_real residual = 0, cost = 0;
    uint32_t i, j, r;
    memset(normal, 0, sizeof normal);
    for (i = 0; i < flow->row_count; i++) {
        const sf_real *row = flow->rows[i];
        sf_real w[2], by_place[2][2], by_flow[2][M];
        waves(peak->trial, row[0] - flow->middle[0], row[1] - flow->middle[1], w, by_place,
              by_flow);
        for (r = 0; r < 2u; r++) {
            const sf_real error = row[2u + r] - w[r];
            residual += square(error);
            add_square(normal, 1, by_flow[r]);
            for (j = 0; j < M; j++) {
                right[j] += by_flow[r][j] * error;
            }
        }
    }
    features(peak->trial, value, by);
    for (i = 0; i < ties; i++) { /* the waves are as strong as each other, and lie along the axes */
        const uint32_t tie = i ? HEADING : UNEVEN;
        cost += weight * square(value[tie]);
        add_square(normal, weight, by[tie]);
        for (j = 0; j < M; j++) {
            right[j] -= weight * by[tie][j] * value[tie];
        }
    }
    cost += residual;
    if (first || (cost < peak->cost)) {
        memcpy(peak->parameters, peak->trial, sizeof peak->trial);
        memcpy(peak->information, normal, sizeof normal);
        memcpy(peak->right, right, sizeof right);
        peak->residual = residual;
        peak->cost = first ? R(HUGE_VAL) : cost;
        peak->damping = first ? R(0.01) : peak->damping / 4;
    } else {
        peak->damping *= 6;
    }
    memcpy(normal, peak->information, sizeof normal);
    for (j = 0; j < M; j++) {
        normal[j][j] = normal[j][j] * (1 + peak->damping) + R(1e-9);
    }
    if (!invert(normal)) {
        return 0;
    }
    for (j = 0; j < M; j++) {
        peak->trial[j] = peak->parameters[j] + dot(M, normal[j], peak->right);
    }
    return 1;
}

/* Place and velocity of a filter, d from its anchor, are as measured at z, and it forgets a gust. */
static void settle(const sf_flow *flow, sf_filter *filter, uint32_t level, const sf_real d[2],
                   const sf_real z[4])
{
    const sf_real gust = square(LEVEL[level] * speed_of(filter->state + FLOW));
    uint32_t i, j;
    for (i = 0; i < FLOW; i++) {
        for (j = 0; j < N; j++) {
            filter->covariance[i][j] = filter->covariance[j][i] = 0;
        }
        filter->state[i] = i < 2u ? d[i] : i < 4u ? z[i] : 0;
        filter->covariance[i][i] = i < 4u ? flow->noise[i / 2u] : gust;
    }
    rebase(filter, d);
}

/* Start the filters from a peak, at the last sample z. */
static sf_doubt start(sf_flow *flow, const sf_peak *peak, const sf_real z[4])
{
    const sf_real variance = peak->residual / (2 * R(flow->row_count) - R(M));
    const sf_real d[2] = {z[0] - flow->middle[0], z[1] - flow->middle[1]};
    sf_real inverse[M][M], value[FEATURES], by[FEATURES][M];
    uint32_t i, j, level;
    memcpy(inverse, peak->information, sizeof inverse);
    for (i = 0; i < M; i++) {
        inverse[i][i] = inverse[i][i] * R(1.0001) + R(1e-12);
    }
    if (!invert(inverse)) {
        return SF_NO_FLOW;
    }
    features(peak->parameters, value, by);
    if (square(value[UNEVEN]) > 40 * variance * variance_of(inverse, by[UNEVEN])) {
        return SF_SHAPE;
    }
    if (!(variance * variance_of(inverse, by[SPEED]) < square(R(0.03) * value[SPEED])) ||
        !(variance * variance_of(inverse, by[LENGTH]) < square(R(0.01) * value[LENGTH]))) {
        return SF_IMPRECISE;
    }
    for (level = 0; level < SF_LEVELS; level++) {
        sf_filter *filter = &flow->filter[level];
        memset(filter, 0, sizeof *filter);
        for (i = 0; i < M; i++) {
            filter->state[FLOW + i] = peak->parameters[i];
            for (j = 0; j < M; j++) {
                filter->covariance[FLOW + i][FLOW + j] = 4 * variance * inverse[i][j];
            }
        }
        filter->square = 1;
        settle(flow, filter, level, d, z);
    }
    memcpy(flow->anchor, z, sizeof flow->anchor);
    flow->following = 1;
    flow->age = flow->gated = flow->remaining[0] = flow->remaining[1] = 0;
    return SF_SETTLING;
}

/* All peaks are refined: start from the best one, where it explains the rows and has no rival. */
static sf_doubt decide(sf_flow *flow, const sf_real z[4])
{
    const sf_peak *best = &flow->peak[0];
    sf_real rival = R(HUGE_VAL);
    uint32_t i;
    for (i = 1; i < flow->peaks; i++) {
        best = flow->peak[i].residual < best->residual ? &flow->peak[i] : best;
    }
    for (i = 0; i < flow->peaks; i++) {
        const sf_peak *peak = &flow->peak[i];
        const sf_real k = dot(2, peak->parameters + 4, peak->parameters + 4);
        const sf_real ratio = sqrt(dot(2, best->parameters + 4, best->parameters + 4) / k);
        if (!within(ratio, R(0.97), R(1.03)) && (peak->residual < rival)) {
            rival = peak->residual;
            flow->rival = sqrt(R(2)) * PI / sqrt(k);
        }
    }
    if (!(best->residual < (1 - EXPLAINED) * flow->total)) {
        return SF_NO_FLOW;
    }
    if (R(flow->row_count) * log(rival / best->residual) < EVIDENCE) {
        return SF_RIVAL;
    }
    return start(flow, best, z);
}

/* The work of one sample while nothing is followed. */
static void search(sf_flow *flow, const sf_real z[4])
{
    sf_peak *peak;
    uint32_t i;
    if (flow->row_count < FEWEST_ROWS) {
        flow->doubt = SF_FEW_SAMPLES;
        return;
    }
    if (!flow->sweeping) {
        begin_sweep(flow);
    }
    flow->total = 0;
    for (i = 0; i < flow->row_count; i++) {
        flow->total += dot(2, flow->rows[i] + 2, flow->rows[i] + 2);
    }
    if (!flow->refining) {
        for (i = 0; (i < flow->config.candidates) && !flow->refining; i++) {
            flow->refining = look(flow) ? 0u : 1u;
        }
        flow->middle[0] = flow->middle[1] = 0;
        for (i = 0; i < flow->row_count; i++) {
            flow->middle[0] += flow->rows[i][0] / R(flow->row_count);
            flow->middle[1] += flow->rows[i][1] / R(flow->row_count);
        }
        return;
    }
    peak = &flow->peak[flow->refining - 1u];
    if (flow->iteration == 0u) {
        memset(peak->trial, 0, sizeof peak->trial);
        peak->trial[4] = peak->size * cos(peak->angle);
        peak->trial[5] = peak->size * sin(peak->angle);
    }
    if (!refine(flow, peak, flow->iteration == 0u)) {
        peak->residual = R(HUGE_VAL);
        flow->iteration = REFINEMENTS;
    }
    flow->iteration++;
    if (flow->iteration >= REFINEMENTS) {
        flow->iteration = 0;
        flow->refining++;
    }
    if (flow->refining > flow->peaks) {
        flow->sweeping = 0;
        flow->doubt = (uint32_t)decide(flow, z);
    }
}

/* ---- the interface -------------------------------------------------------------------------- */

/* Levels of the noise from third differences, whose variance is 20 times as large. */
static void measure_noise(sf_flow *flow, const sf_real z[4])
{
    uint32_t i, j;
    flow->counted += (flow->recent >= 3u) && (flow->counted < 500) ? R(1) : R(0);
    for (i = 0; (i < 2u) && (flow->recent >= 3u); i++) {
        sf_real third = 0;
        for (j = 2u * i; j < 2u * i + 2u; j++) {
            third += square(z[j] - 3 * flow->history[2][j] + 3 * flow->history[1][j] -
                            flow->history[0][j]) / 40;
        }
        third = flow->counted > 20 ? least_of(third, 25 * flow->noise[i]) : third;
        flow->noise[i] = most_of(flow->noise[i] + (third - flow->noise[i]) / flow->counted,
                                 square(R(1e-4) * flow->config.lower));
    }
    memmove(flow->history[0], flow->history[1], 2u * sizeof flow->history[0]);
    memcpy(flow->history[2], z, sizeof flow->history[2]);
    flow->recent += flow->recent < 3u ? 1u : 0u;
}

/* Go on after a gap or from another clock: the flow is known, place and velocity are measured. */
static void resume(sf_flow *flow, const sf_real z[4])
{
    const sf_real away[2] = {z[0] - flow->anchor[0], z[1] - flow->anchor[1]};
    uint32_t level;
    flow->recent = 0;
    memset(flow->block, 0, sizeof flow->block);
    for (level = 0; flow->following && (level < SF_LEVELS); level++) {
        settle(flow, &flow->filter[level], level, away, z);
    }
    memcpy(flow->anchor, z, sizeof flow->anchor);
}

sf_status sf_init(sf_flow *flow, const sf_config *config)
{
    if ((flow == NULL) || (config == NULL)) {
        return SF_BAD_ARGUMENT;
    }
    memset(flow, 0, sizeof *flow);
    if (!(config->response_time > 0) || !within(config->drag_coefficient, 0, LARGEST) ||
        !(1 / config->response_time + config->drag_coefficient > 0) ||
        !within(config->thrust_x, -LARGEST, LARGEST) ||
        !within(config->thrust_y, -LARGEST, LARGEST) ||
        !within(config->thrust_scale, -LARGEST, LARGEST) || !(config->lower > 0) ||
        !within(config->upper, config->lower, LARGEST) || !within(config->precision, 0, LARGEST) ||
        !within(config->memory, 0, LARGEST) || (config->candidates == 0u)) {
        return SF_BAD_ARGUMENT;
    }
    flow->config = *config;
    flow->doubt = SF_FEW_SAMPLES;
    return SF_OK;
}

static int begun(const sf_flow *flow) { return flow->config.candidates > 0u; }

static sf_real seconds(uint64_t from, uint64_t to)
{
    return to > from ? R((double)(to - from) * 1e-9) : 0;
}

sf_status sf_update(sf_flow *flow, uint64_t time_ns, const sf_real position[2],
                    const sf_real velocity[2], const sf_real *thrust)
{
    sf_real z[4], push[2], h;
    sf_status status = SF_OK;
    uint32_t i;
    if ((flow == NULL) || (position == NULL) || (velocity == NULL) || !begun(flow)) {
        return SF_BAD_ARGUMENT;
    }
    for (i = 0; i < 4u; i++) {
        z[i] = i < 2u ? position[i] : velocity[i - 2u];
        if (!within(z[i], -LARGEST, LARGEST) ||
            ((thrust != NULL) && (i < 2u) && !within(thrust[i], -LARGEST, LARGEST))) {
            return SF_BAD_SAMPLE;
        }
    }
    if (flow->samples == 0u) {
        flow->time_ns = time_ns;
        memcpy(flow->origin, z, sizeof flow->origin);
    }
    h = seconds(flow->time_ns, time_ns);
    if ((flow->samples > 0u) &&
        (!(h > 0) || ((flow->step > 0) && (h > GAP * flow->step)))) { /* out of line */
        const sf_real since = seconds(flow->suspect_ns, time_ns);
        const int later = (flow->suspects > 0u) && (since > 0);
        if (!later || ((since > GAP * flow->step) && (flow->suspects < 2u))) {
            flow->suspects = later ? flow->suspects + 1u : 1u;
            flow->suspect_ns = time_ns;
            return SF_BAD_TIME;
        }
        h = flow->step = since; /* the last one and this: a new clock */
        status = SF_GAP;
    } else if (flow->samples > 0u) {
        flow->step += (h - flow->step) / (flow->step > 0 ? R(16) : R(1));
    }
    flow->suspects = 0;
    flow->time_ns = time_ns;
    flow->samples++;
    push[0] = flow->config.thrust_x;
    push[1] = flow->config.thrust_y;
    for (i = 0; i < 2u; i++) {
        z[i] -= flow->origin[i];
        if (thrust != NULL) {
            const sf_real before = flow->samples > 1u ? flow->thrust[i] : thrust[i];
            push[i] += flow->config.thrust_scale * (before + thrust[i]) / 2;
            flow->thrust[i] = thrust[i];
        }
    }
    flow->recent = h > R(1.5) * flow->step ? 0u : flow->recent;
    if (status == SF_GAP) {
        resume(flow, z);
    }
    measure_noise(flow, z);
    flow->block_time = flow->block[0] > 0 ? flow->block_time + h : 0;
    take_row(flow, z, push);
    if (!flow->following) {
        search(flow, z);
    } else if (status == SF_OK) {
        follow(flow, z, h, push);
    }
    return status;
}

/* The filters weighed by their likelihoods: parameters, their covariance, and the tests. */
static void mixture(const sf_flow *flow, sf_real p[M], sf_real covariance[M][M], sf_answer *answer)
{
    const sf_real top = likeliest(flow)->log_likelihood;
    sf_real share[SF_LEVELS], sum = 0, apart[M];
    uint32_t level, i, j;
    for (level = 0; level < SF_LEVELS; level++) {
        share[level] = exp(flow->filter[level].log_likelihood - top);
        sum += share[level];
    }
    memset(p, 0, sizeof(sf_real[M]));
    memset(covariance, 0, sizeof(sf_real[M][M]));
    for (level = 0; level < SF_LEVELS; level++) {
        const sf_filter *filter = &flow->filter[level];
        share[level] /= sum;
        answer->innovation += share[level] * filter->square;
        answer->correlation += share[level] * filter->product;
        for (i = 0; i < M; i++) {
            p[i] += share[level] * filter->state[FLOW + i];
            for (j = 0; j < M; j++) {
                covariance[i][j] += share[level] * filter->covariance[FLOW + i][FLOW + j];
            }
        }
    }
    for (level = 0; level < SF_LEVELS; level++) {
        for (i = 0; i < M; i++) {
            apart[i] = flow->filter[level].state[FLOW + i] - p[i];
        }
        add_square(covariance, share[level], apart);
    }
}

sf_status sf_estimate(const sf_flow *flow, sf_answer *answer)
{
    sf_real p[M], covariance[M][M], gain[M], value[FEATURES], by[FEATURES][M], error[4];
    sf_real uneven, spread, least;
    uint32_t i, j;
    if ((flow == NULL) || (answer == NULL) || !begun(flow)) {
        return SF_BAD_ARGUMENT;
    }
    memset(answer, 0, sizeof *answer);
    answer->mean_velocity = answer->length_scale = answer->timescale = answer->heading = R(NAN);
    answer->status = SF_UNIDENTIFIABLE;
    answer->samples = flow->samples;
    answer->doubt = (sf_doubt)flow->doubt;
    if (!flow->following) {
        answer->rival = flow->doubt == SF_RIVAL ? flow->rival : 0;
        return answer->status;
    }
    mixture(flow, p, covariance, answer);
    features(p, value, by); /* both waves are as strong: a condition on the parameters */
    uneven = value[UNEVEN];
    spread = variance_of(covariance, by[UNEVEN]);
    product(covariance, by[UNEVEN], gain);
    add_square(covariance, -1 / spread, gain);
    for (i = 0; i < M; i++) {
        p[i] -= gain[i] / spread * uneven;
        for (j = 0; j < M; j++) { /* innovations that are too large widen the intervals */
            covariance[i][j] *= most_of(answer->innovation, 1);
        }
    }
    features(p, value, by);
    for (i = 0; i < 4u; i++) {
        error[i] = sqrt(most_of(variance_of(covariance, by[i]), 0));
    }
    answer->mean_velocity = value[SPEED];
    answer->length_scale = value[LENGTH];
    answer->timescale = value[TIME];
    answer->heading = value[HEADING];
    answer->mean_velocity_error = error[SPEED];
    answer->length_scale_error = error[LENGTH];
    answer->timescale_error = error[TIME];
    answer->heading_error = error[HEADING];
    answer->unexplained = flow->remaining[1] > 0 ? flow->remaining[0] / flow->remaining[1] : 1;
    memcpy(answer->flow, p, sizeof p);
    answer->flow[6] = flow->anchor[0] + flow->origin[0];
    answer->flow[7] = flow->anchor[1] + flow->origin[1];
    least = flow->config.precision / R(1.96);
    answer->doubt = SF_NO_DOUBT;
    if (flow->age < SETTLED) {
        answer->doubt = SF_SETTLING;
    } else if (!(answer->innovation < R(1.6)) || (answer->correlation > R(0.5)) ||
               (answer->unexplained > R(0.3))) {
        answer->doubt = SF_INNOVATIONS;
    } else if (!flow->config.any_heading &&
               (fabs(value[HEADING]) > R(0.02) + 3 * error[HEADING])) {
        answer->doubt = SF_TURNED;
    } else if ((uneven * uneven > 16 * spread) && (fabs(uneven) > EVEN)) {
        answer->doubt = SF_SHAPE;
    } else if (!(error[SPEED] < least * value[SPEED]) ||
               !(error[LENGTH] < least * value[LENGTH]) || !(error[TIME] < least * value[TIME])) {
        answer->doubt = SF_IMPRECISE;
    } else if (!within(value[LENGTH], flow->config.lower, flow->config.upper)) {
        answer->doubt = SF_EDGE;
    }
    if (answer->doubt == SF_NO_DOUBT) {
        answer->status = SF_OK;
    } else if ((answer->doubt >= SF_INNOVATIONS) && (answer->doubt <= SF_TURNED)) {
        answer->status = SF_MISFIT;
    }
    return answer->status;
}
