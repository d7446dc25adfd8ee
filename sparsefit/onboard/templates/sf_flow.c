/* sf_flow.c - the search and the filters of sf_flow.h. No heap, no recursion, all loops bounded. */
#include "sf_flow.h"

#include <string.h>
#include <tgmath.h>

#if defined(__FAST_MATH__)
#error "sf_flow.c tests for NaN and infinity: compile it without -ffast-math"
#endif

#define R(value) ((sf_real)(value))
#define N SF_STATES
#define M 6u /* parameters of the flow: a, b, a, b, kx, ky */
enum { VX, VY, UX, UY, X, Y, FLOW };                     /* places in a state */
enum { SPEED, LENGTH, TIME, HEADING, UNEVEN, FEATURES }; /* functions of the flow's parameters */

#define PI R(3.14159265358979323846)
#define RATE R(2.0)        /* of the disturbance [1/s] */
#define GATE R(25.0)       /* square of a normalised innovation that is an outlier */
#define FADE R(0.998)      /* factor of a log-likelihood per sample */
#define HORIZON R(100.0)   /* samples over which the tests of innovations average */
#define SETTLED R(64.0)    /* samples that are followed before there is an answer */
#define ANNEAL R(8.0)      /* relative excess of the noise variance at first */
#define WALK_A R(0.002)    /* relative random walk of the amplitudes in a second */
#define WALK_K R(0.0005)   /* and of the wavevector */
#define LARGEST R(1e7)     /* [m], [m/s], [m/s^2] */
#define GAP R(20.0)        /* mean steps */
#define FEWEST_ROWS 24u    /* of a search */
#define CHECK_ROWS 8u      /* of the check after a gap that the flow is still where it was */
#define BLOCK_MOST R(64.0) /* samples of a row */
#define ROUNDS 8u          /* of the refinement of a candidate, each at half the step */
#define EVEN R(0.03)       /* tolerance of the logarithm of the ratio of the amplitudes */
#define UNEXPLAINED R(0.3) /* largest share of the rows' squares beside a flow that is followed */
#define EXPLAINED R(0.6)   /* least share of the rows' squares that a flow must explain */
#define EVIDENCE R(15.0)   /* logarithm of the likelihood ratio that excludes a rival */

static const sf_real LEVEL[SF_LEVELS] = {R(0.003), R(0.02), R(0.08), R(0.3)}; /* over U0 */

/* ---- vectors and covariances ---------------------------------------------------------------- */

static sf_real square(sf_real value) { return value * value; }

static int within(sf_real value, sf_real low, sf_real high)
{
    return (value >= low) && (value <= high); /* false of NaN */
}

static sf_real dot(uint32_t n, const sf_real *a, const sf_real *b)
{
    sf_real sum = 0;
    for (uint32_t i = 0; i < n; i++) {
        sum += a[i] * b[i];
    }
    return sum;
}

/* a += c b. */
static void add(uint32_t n, sf_real *a, sf_real c, const sf_real *b)
{
    for (uint32_t i = 0; i < n; i++) {
        a[i] += c * b[i];
    }
}

/* P becomes T P T', where T is the identity except for so many rows t, from `first` on. */
static void carry(sf_real p[N][N], sf_real t[][N], uint32_t first, uint32_t rows)
{
    sf_real tp[N][N] = {{0}};
    for (uint32_t i = 0; i < rows; i++) {
        for (uint32_t j = 0; j < N; j++) {
            add(N, tp[i], t[i][j], p[j]);
        }
    }
    for (uint32_t i = 0; i < rows; i++) {
        for (uint32_t j = 0; j < N; j++) {
            const int other = (j < first) || (j >= first + rows);
            p[first + i][j] = p[j][first + i] = other ? tp[i][j] : dot(N, tp[i], t[j - first]);
        }
    }
}

/* The variance h'P h of a quantity with the gradient h by n states from `first` on, and P h. */
static sf_real variance_of(const sf_filter *filter, uint32_t first, uint32_t n, const sf_real *h,
                           sf_real ph[N])
{
    memset(ph, 0, sizeof(sf_real[N]));
    for (uint32_t i = 0; i < n; i++) {
        add(N, ph, h[i], filter->covariance[first + i]);
    }
    return dot(n, h, ph + first);
}

/* Update by a reading of the quantity, or leave an outlier out; the normalised innovation. */
static sf_real correct(sf_filter *filter, uint32_t first, uint32_t n, const sf_real *h,
                       sf_real innovation, sf_real variance)
{
    sf_real ph[N], gain[N] = {0};
    const sf_real deviation = sqrt(variance_of(filter, first, n, h, ph) + variance);
    const sf_real unit = innovation / deviation;
    filter->log_likelihood -= log(deviation) + fmin(unit * unit, GATE) / 2;
    if (!(unit * unit < GATE)) {
        return copysign(sqrt(GATE), unit);
    }
    add(N, gain, 1 / deviation, ph);
    add(N, filter->state, unit, gain);
    for (uint32_t i = 0; i < N; i++) {
        add(N, filter->covariance[i], -gain[i], gain);
    }
    return unit;
}

/* ---- the flow: a, b, a, b, kx, ky ----------------------------------------------------------- */

/*
 * w [m/s] at a place [m] from where phases count, and if wanted its gradient by x, y and by p. The
 * second wave is the first one turned by a right angle: its phase is k . (y, -x).
 */
static void waves(const sf_real *p, const sf_real place[2], sf_real w[2], sf_real (*by)[2u + M])
{
    const sf_real turned[2][2] = {{place[0], place[1]}, {place[1], -place[0]}};
    const sf_real normal[2][2] = {{p[5], -p[4]}, {p[4], p[5]}};
    sf_real c[2], s[2], slope[2];
    for (uint32_t j = 0; j < 2u; j++) {
        const sf_real phase = dot(2, p + 4, turned[j]);
        c[j] = cos(phase);
        s[j] = sin(phase);
        slope[j] = p[2u * j + 1u] * c[j] - p[2u * j] * s[j];
    }
    for (uint32_t r = 0; r < 2u; r++) {
        w[r] = normal[0][r] * slope[0] + normal[1][r] * slope[1];
        if (by != NULL) {
            memset(by[r], 0, sizeof by[r]);
            for (uint32_t j = 0; j < 2u; j++) {
                const sf_real across = normal[j][r];
                const sf_real pull = -across * (p[2u * j] * c[j] + p[2u * j + 1u] * s[j]);
                by[r][0] -= pull * normal[j][1];
                by[r][1] += pull * normal[j][0];
                by[r][2u + 2u * j] = -across * s[j];
                by[r][3u + 2u * j] = across * c[j];
                add(2, by[r] + 6, pull, turned[j]);
            }
            by[r][6u + r] += slope[1];
            by[r][7u - r] += r == 0u ? slope[0] : -slope[0];
        }
    }
}

/* An angle reduced by the nearest multiple of a right angle. */
static sf_real turned(sf_real angle)
{
    return angle - PI / 2 * floor(angle / (PI / 2) + R(0.5));
}

static sf_real speed_of(const sf_real *p) { return sqrt(dot(2, p + 4, p + 4) * dot(4, p, p)); }

/* U0, L, L/U0, the heading and log(second/first amplitude) of a flow p, and their gradients. */
static void features(const sf_real *p, sf_real value[FEATURES], sf_real by[FEATURES][M])
{
    const sf_real k = dot(2, p + 4, p + 4), speed = speed_of(p), length = sqrt(2 / k) * PI;
    const sf_real first = dot(2, p, p), second = dot(2, p + 2, p + 2);
    memset(by, 0, sizeof(sf_real[FEATURES][M]));
    value[SPEED] = speed;
    value[LENGTH] = length;
    value[TIME] = length / speed;
    value[HEADING] = turned(atan2(p[5], p[4]) - PI / 4);
    value[UNEVEN] = log(second / first) / 2;
    add(4, by[SPEED], k / speed, p);
    add(2, by[SPEED] + 4, speed / k, p + 4);
    add(2, by[LENGTH] + 4, -length / k, p + 4);
    add(M, by[TIME], 1 / speed, by[LENGTH]);
    add(M, by[TIME], -length / square(speed), by[SPEED]);
    by[HEADING][4] = -p[5] / k;
    by[HEADING][5] = p[4] / k;
    add(2, by[UNEVEN], -1 / first, p);
    add(2, by[UNEVEN] + 2, 1 / second, p + 2);
}

/* ---- the filters ---------------------------------------------------------------------------- */

/* The rates of v, u and x in a state under a thrust, and if wanted their gradient by the state. */
static void motion(const sf_config *vehicle, const sf_real *z, const sf_real push[2],
                   sf_real rate[FLOW], sf_real (*by)[N])
{
    sf_real w[2], by_flow[2][2u + M];
    waves(z + FLOW, z + X, w, by == NULL ? NULL : by_flow);
    const sf_real relative[2] = {w[0] + z[UX] - z[VX], w[1] + z[UY] - z[VY]};
    const sf_real speed = sqrt(dot(2, relative, relative));
    const sf_real own = 1 / vehicle->response_time + vehicle->drag_coefficient * speed;
    const sf_real bend = speed > 0 ? vehicle->drag_coefficient / speed : 0;
    for (uint32_t r = 0; r < 2u; r++) {
        rate[VX + r] = own * relative[r] + push[r];
        rate[UX + r] = 0; /* the decay is added in closed form */
        rate[X + r] = z[VX + r];
        for (uint32_t i = 0; (i < 2u) && (by != NULL); i++) { /* of the relative wind */
            const sf_real slope = (r == i ? own : 0) + bend * relative[r] * relative[i];
            by[VX + r][VX + i] = -slope;
            by[VX + r][UX + i] = slope;
            add(2u + M, by[VX + r] + X, slope, by_flow[i]);
            by[UX + r][UX + r] = -RATE;
            by[X + r][VX + r] = 1;
        }
    }
}

/* Advance a filter by h seconds, under a thrust and a disturbance of this rms [m/s]. */
static void predict(const sf_config *vehicle, sf_filter *filter, sf_real h, const sf_real push[2],
                    sf_real level)
{
    static const sf_real AHEAD[4] = {R(0.5), R(0.5), R(1), R(0)}; /* Runge and Kutta */
    static const sf_real WEIGHT[4] = {R(1), R(2), R(2), R(1)};
    const sf_real decay = exp(-RATE * h);
    sf_real z[N], sum[FLOW] = {0}, rate[FLOW], by[FLOW][N] = {{0}}, t[FLOW][N] = {{0}};
    memcpy(z, filter->state, sizeof z);
    for (uint32_t i = 0; i < 4u; i++) {
        motion(vehicle, z, push, rate, i == 2u ? by : NULL); /* the gradient in mid-step */
        memcpy(z, filter->state, sizeof z);
        add(FLOW, z, AHEAD[i] * h, rate);
        add(FLOW, sum, WEIGHT[i], rate);
    }
    add(FLOW, filter->state, h / 6, sum);
    for (uint32_t r = 0; r < FLOW; r++) { /* the transition, to the second order in h */
        t[r][r] = 1;
        add(N, t[r], h, by[r]);
        for (uint32_t j = 0; j < FLOW; j++) {
            add(N, t[r], h * h / 2 * by[r][j], by[j]);
        }
    }
    t[UX][UX] = t[UY][UY] = decay;
    carry(filter->covariance, t, 0, FLOW);
    for (uint32_t r = UX; r <= UY; r++) {
        filter->state[r] *= decay;
        filter->covariance[r][r] += square(level) * (1 - decay * decay);
    }
}

/* Move the anchor, from which all filters count positions and phases. */
static void rebase(sf_flow *flow, const sf_real anchor[2])
{
    const sf_real d[2] = {anchor[0] - flow->anchor[0], anchor[1] - flow->anchor[1]};
    const sf_real by[2][2] = {{d[0], d[1]}, {d[1], -d[0]}};
    for (uint32_t level = 0; level < SF_LEVELS; level++) {
        sf_filter *filter = &flow->filter[level];
        sf_real *p = filter->state + FLOW;
        sf_real t[4][N] = {{0}};
        for (uint32_t a = 0; a < 4u; a += 2u) {
            const sf_real *place = by[a / 2u];
            const sf_real turn = dot(2, p + 4, place), c = cos(turn), s = sin(turn);
            const sf_real new_a = c * p[a] + s * p[a + 1u];
            p[a + 1u] = c * p[a + 1u] - s * p[a];
            p[a] = new_a;
            t[a][FLOW + a] = t[a + 1u][FLOW + a + 1u] = c;
            t[a][FLOW + a + 1u] = s;
            t[a + 1u][FLOW + a] = -s;
            add(2, t[a] + FLOW + 4, p[a + 1u], place);
            add(2, t[a + 1u] + FLOW + 4, -p[a], place);
        }
        carry(filter->covariance, t, FLOW, 4);
        add(2, filter->state + X, -1, d);
    }
    memcpy(flow->anchor, anchor, sizeof flow->anchor);
}

/* Restart the motion of all filters at a measured sample; their estimates of the flow stay. */
static void settle(sf_flow *flow, const sf_real z[4])
{
    for (uint32_t level = 0; level < SF_LEVELS; level++) {
        sf_filter *filter = &flow->filter[level];
        const sf_real gust = square(LEVEL[level] * speed_of(filter->state + FLOW));
        const sf_real state[FLOW] = {z[2], z[3], 0, 0, z[0] - flow->anchor[0],
                                     z[1] - flow->anchor[1]};
        const sf_real variance[3] = {flow->noise[1], gust, flow->noise[0]};
        memcpy(filter->state, state, sizeof state);
        for (uint32_t i = 0; i < FLOW; i++) {
            for (uint32_t j = 0; j < N; j++) {
                filter->covariance[i][j] = filter->covariance[j][i] = 0;
            }
            filter->covariance[i][i] = variance[i / 2u];
        }
    }
    rebase(flow, z);
}

static const sf_filter *likeliest(const sf_flow *flow)
{
    const sf_filter *best = &flow->filter[0];
    for (uint32_t i = 1; i < SF_LEVELS; i++) {
        best = flow->filter[i].log_likelihood > best->log_likelihood ? &flow->filter[i] : best;
    }
    return best;
}

static void forget_rows(sf_flow *flow)
{
    memset(flow->block, 0, sizeof flow->block);
    flow->row_count = flow->row_place = flow->sweeping = 0;
    flow->doubt = SF_FEW_SAMPLES;
}

/* Follow the flow with one sample z (x, y, vx, vy), h seconds after the last. */
static void follow(sf_flow *flow, const sf_real z[4], sf_real h, const sf_real push[2])
{
    static const uint32_t PLACE[4] = {X, Y, VX, VY};
    static const sf_real ITSELF = 1; /* the gradient of a state by itself */
    const sf_real speed = speed_of(likeliest(flow)->state + FLOW);
    const sf_real rate = 1 / flow->config.response_time + 2 * flow->config.drag_coefficient * speed;
    const sf_real parts = 1 + floor(fmin(2 * h * rate, R(15)));
    const sf_real anneal = 1 + ANNEAL * exp(-flow->age / 50);
    const sf_real fade = 1 / (2 + fmin(flow->age, HORIZON));
    const sf_real away[2] = {z[0] - flow->anchor[0], z[1] - flow->anchor[1]};
    const sf_real measured[4] = {away[0], away[1], z[2], z[3]};
    const sf_real memory = flow->config.memory, grow = memory > 0 ? exp(h / memory / 2) : 1;
    sf_real least = R(HUGE_VAL);
    for (uint32_t level = 0; level < SF_LEVELS; level++) {
        sf_filter *filter = &flow->filter[level];
        const sf_real *p = filter->state + FLOW;
        sf_real unit[4];
        for (uint32_t i = 0; R(i) < parts; i++) {
            predict(&flow->config, filter, h / parts, push, LEVEL[level] * speed);
        }
        filter->log_likelihood *= FADE;
        for (uint32_t i = 0; i < 4u; i++) {
            unit[i] = correct(filter, PLACE[i], 1, &ITSELF, measured[i] - filter->state[PLACE[i]],
                              flow->noise[i / 2u] * anneal);
        }
        filter->square += fade * (dot(4, unit, unit) / 4 - filter->square);
        filter->product += fade * (dot(4, unit, filter->last) / 4 - filter->product);
        memcpy(filter->last, unit, sizeof unit);
        least = fmin(least, filter->square);
        for (uint32_t i = FLOW; i < N; i++) { /* the flow walks, and samples fade with a memory */
            for (uint32_t j = 0; j < N; j++) {
                filter->covariance[i][j] *= grow;
                filter->covariance[j][i] *= grow;
            }
            filter->covariance[i][i] += h * (i < FLOW + 4u ? square(WALK_A) / 2 * dot(4, p, p)
                                                           : square(WALK_K) * dot(2, p + 4, p + 4));
        }
    }
    if (dot(2, away, away) > square(flow->config.lower / 2)) {
        rebase(flow, z);
    }
    flow->age += 1;
    if ((flow->age > R(150)) &&
        ((least > 2) || (flow->remaining[0] > flow->remaining[1] / 2))) { /* lost */
        flow->following = 0;
        forget_rows(flow);
    }
}

/* ---- the search ----------------------------------------------------------------------------- */

/* Add a sample to the block; when it is long enough, its mean and slope become a row. */
static void take_row(sf_flow *flow, const sf_real z[4], sf_real h, const sf_real push[2])
{
    sf_real *b = flow->block;
    sf_real *row = flow->rows[flow->row_place];
    const sf_real rate = 1 / flow->config.response_time, t = b[0] > 0 ? flow->block_time + h : 0;
    sf_real mean[6] = {0}, force[2];
    const sf_real sample[11] = {1, t, t * t, z[0], z[1], z[2], z[3], push[0], push[1],
                                t * z[2], t * z[3]};
    flow->block_time = t;
    add(11, b, 1, sample);
    add(6, mean, 1 / b[0], b + 3);
    const sf_real moved = t * sqrt(dot(2, mean + 2, mean + 2));
    if ((b[0] < 4) || ((moved < flow->config.lower / 4) && (b[0] < BLOCK_MOST))) {
        return;
    }
    for (uint32_t j = 0; j < 2u; j++) { /* v' less the thrust */
        force[j] = (b[9u + j] - b[1] * mean[2u + j]) / (b[2] - b[1] * b[1] / b[0]) - mean[4u + j];
    }
    const sf_real pull = 4 * flow->config.drag_coefficient * sqrt(dot(2, force, force));
    const sf_real reach = rate + sqrt(rate * rate + pull);
    memcpy(row, mean, sizeof flow->rows[0]);
    add(2, row + 2, reach > 0 ? 2 / reach : 0, force);
    memset(flow->block, 0, sizeof flow->block);
    flow->row_place = (flow->row_place + 1u) % SF_ROWS;
    flow->row_count += flow->row_count < SF_ROWS ? 1u : 0u;
    if (flow->following) {
        const sf_real place[2] = {row[0] - flow->anchor[0], row[1] - flow->anchor[1]};
        sf_real w[2];
        waves(likeliest(flow)->state + FLOW, place, w, NULL);
        add(2, w, -1, row + 2);
        flow->remaining[0] += (dot(2, w, w) - flow->remaining[0]) / 32;
        flow->remaining[1] += (dot(2, row + 2, row + 2) - flow->remaining[1]) / 32;
    }
}

/* Fit a candidate's waves to the rows by least squares, with a ridge of 1 %. */
static void fit(const sf_flow *flow, sf_peak *peak)
{
    const sf_real size = peak->size;
    sf_real *p = peak->waves;
    peak->score = 0;
    p[4] = size * cos(peak->angle);
    p[5] = size * sin(peak->angle);
    for (uint32_t wave = 0; wave < 2u; wave++) {
        const sf_real k = wave ? -p[5] : p[4], l = wave ? p[4] : p[5];
        sf_real *a = p + 2u * wave, ss = 0, sc = 0, cc = 0, sw = 0, cw = 0;
        for (uint32_t i = 0; i < flow->row_count; i++) {
            const sf_real *row = flow->rows[i];
            const sf_real phase = k * (row[0] - flow->middle[0]) + l * (row[1] - flow->middle[1]);
            const sf_real s = -size * sin(phase), c = size * cos(phase);
            const sf_real along = (l * row[2] - k * row[3]) / size;
            ss += R(1.01) * s * s;
            sc += s * c;
            cc += R(1.01) * c * c;
            sw += s * along;
            cw += c * along;
        }
        const sf_real determinant = ss * cc - sc * sc;
        a[0] = (cc * sw - sc * cw) / determinant;
        a[1] = (ss * cw - sc * sw) / determinant;
        peak->score += (a[0] * sw + a[1] * cw) / flow->total;
    }
}

/* Evaluate the next candidate and keep it if it is among the best; 0 at the end of the sweep. */
static int look(sf_flow *flow)
{
    const int any = flow->config.any_heading != 0u;
    const sf_real step = any ? flow->spacing : flow->spacing / 2, around = sqrt(R(2)) * PI;
    const sf_real size = around / flow->config.upper + step * R(flow->radius);
    const uint32_t turns = any ? (uint32_t)ceil(PI / 2 * size / step) : 1u;
    sf_peak candidate = {0, size, PI / 4 + PI / 2 * R(flow->turn) / R(turns), {0}};
    uint32_t place = 0; /* that of the candidate of the same lobe, or else of the worst */
    if (size > around / flow->config.lower + step) {
        return 0;
    }
    fit(flow, &candidate);
    for (uint32_t i = 1; i < SF_PEAKS; i++) {
        place = flow->peak[i].score < flow->peak[place].score ? i : place;
    }
    for (uint32_t i = 0; i < SF_PEAKS; i++) {
        const sf_real radial = size - flow->peak[i].size;
        const sf_real across = turned(candidate.angle - flow->peak[i].angle) * size;
        place = square(radial) + square(across) < square(R(2.6) * flow->spacing) ? i : place;
    }
    if (candidate.score > flow->peak[place].score) {
        flow->peak[place] = candidate;
    }
    flow->turn = flow->turn + 1u < turns ? flow->turn + 1u : 0u;
    flow->radius += flow->turn == 0u ? 1u : 0u;
    return 1;
}

/* Improve a candidate by a step of its wavevector: longer, shorter and, if allowed, turned. */
static void refine(const sf_flow *flow, sf_peak *peak, sf_real step)
{
    const uint32_t ways = flow->config.any_heading ? 4u : 2u;
    fit(flow, peak); /* to the rows as they are now */
    for (uint32_t i = 0; i < ways; i++) {
        const sf_real way = i % 2u ? -step : step;
        sf_peak moved = *peak;
        moved.size += i < 2u ? way : 0;
        moved.angle += i < 2u ? 0 : way / peak->size;
        fit(flow, &moved);
        *peak = moved.score > peak->score ? moved : *peak;
    }
}

/* Start the filters from a refined candidate: its waves, updated by every row. */
static sf_doubt start(sf_flow *flow, sf_peak *peak, const sf_real z[4])
{
    const sf_real variance = (1 - peak->score) * flow->total / (2 * R(flow->row_count) - R(M));
    sf_filter *filter = &flow->filter[0];
    const sf_real *p = peak->waves;
    sf_real value[FEATURES], by[FEATURES][M], ph[N];
    fit(flow, peak); /* to the rows as they are now */
    memset(filter, 0, sizeof *filter);
    memcpy(filter->state + FLOW, p, sizeof peak->waves);
    for (uint32_t i = 0; i < M; i++) {
        filter->covariance[FLOW + i][FLOW + i] = i < 4u ? dot(4, p, p) : square(flow->spacing);
    }
    for (uint32_t i = 0; i < flow->row_count; i++) {
        const sf_real *row = flow->rows[i];
        const sf_real place[2] = {row[0] - flow->middle[0], row[1] - flow->middle[1]};
        sf_real w[2], by_flow[2][2u + M];
        waves(p, place, w, by_flow);
        for (uint32_t r = 0; r < 2u; r++) {
            const sf_real *slope = by_flow[r] + 2;
            w[r] += dot(M, slope, filter->state + FLOW) - dot(M, slope, p);
            (void)correct(filter, FLOW, M, slope, row[2u + r] - w[r], 4 * variance);
        }
    }
    features(filter->state + FLOW, value, by);
    if (!(variance_of(filter, FLOW, M, by[SPEED], ph) < square(R(0.06) * value[SPEED])) ||
        !(variance_of(filter, FLOW, M, by[LENGTH], ph) < square(R(0.02) * value[LENGTH]))) {
        return SF_IMPRECISE;
    }
    if (fabs(value[UNEVEN]) > 10 * EVEN) {
        return SF_SHAPE;
    }
    filter->log_likelihood = 0;
    filter->square = 1;
    for (uint32_t i = 1; i < SF_LEVELS; i++) {
        flow->filter[i] = *filter;
    }
    memcpy(flow->anchor, flow->middle, sizeof flow->anchor);
    settle(flow, z);
    flow->following = 1;
    flow->age = flow->remaining[0] = flow->remaining[1] = 0;
    return SF_SETTLING;
}

/* The sweep is at its end: start from the best candidate if it explains the rows alone. */
static sf_doubt decide(sf_flow *flow, const sf_real z[4])
{
    sf_peak *best = &flow->peak[0];
    sf_real rival = 0;
    for (uint32_t i = 1; i < SF_PEAKS; i++) {
        best = flow->peak[i].score > best->score ? &flow->peak[i] : best;
    }
    for (uint32_t i = 0; i < SF_PEAKS; i++) {
        const sf_peak *peak = &flow->peak[i];
        if ((fabs(log(best->size / peak->size)) > R(0.03)) && (peak->score > rival)) {
            rival = peak->score;
            flow->rival = sqrt(R(2)) * PI / peak->size;
        }
    }
    if (!(best->score > EXPLAINED)) {
        return SF_NO_FLOW;
    }
    if (R(flow->row_count) * log((1 - rival) / (1 - best->score)) < EVIDENCE) {
        return SF_RIVAL;
    }
    return start(flow, best, z);
}

/* The work of one sample while no flow is followed. */
static void search(sf_flow *flow, const sf_real z[4])
{
    sf_real extent = flow->config.lower / 2;
    if (flow->row_count < FEWEST_ROWS) {
        return;
    }
    flow->total = flow->middle[0] = flow->middle[1] = 0;
    for (uint32_t i = 0; i < flow->row_count; i++) {
        add(2, flow->middle, 1 / R(flow->row_count), flow->rows[i]);
        flow->total += dot(2, flow->rows[i] + 2, flow->rows[i] + 2);
    }
    if (!flow->sweeping) {
        for (uint32_t i = 0; i < flow->row_count; i++) {
            extent = fmax(extent, fabs(flow->rows[i][0] - flow->middle[0]));
            extent = fmax(extent, fabs(flow->rows[i][1] - flow->middle[1]));
        }
        flow->spacing = 1 / extent;
        flow->sweeping = 1;
        flow->radius = flow->turn = flow->rounds = 0;
        memset(flow->peak, 0, sizeof flow->peak);
    }
    if (flow->rounds == 0u) {
        for (uint32_t i = 0; (i < flow->config.candidates) && (flow->rounds == 0u); i++) {
            flow->rounds = look(flow) ? 0u : 1u;
        }
    } else if (flow->rounds <= SF_PEAKS * ROUNDS) {
        const uint32_t done = flow->rounds - 1u;
        sf_peak *peak = &flow->peak[done / ROUNDS];
        if (peak->size > 0) { /* else there were fewer candidates */
            refine(flow, peak, flow->spacing / R(2u << (done % ROUNDS)));
        }
        flow->rounds++;
    } else {
        flow->sweeping = 0;
        flow->doubt = (uint32_t)decide(flow, z);
    }
}

/* ---- the interface -------------------------------------------------------------------------- */

/* Variances of the noise, from third differences, whose variances are 20 times as large. */
static void measure_noise(sf_flow *flow, const sf_real z[4])
{
    sf_real third[4];
    for (uint32_t i = 0; i < 4u; i++) {
        third[i] = z[i] - 3 * flow->last[2][i] + 3 * flow->last[1][i] - flow->last[0][i];
    }
    memmove(flow->last, flow->last + 1, sizeof(sf_real[2][4]));
    memcpy(flow->last[2], z, sizeof flow->last[2]);
    if (flow->recent < 3u) {
        flow->recent++;
        return;
    }
    flow->noise_count += flow->noise_count < 500 ? R(1) : R(0);
    for (uint32_t i = 0; i < 2u; i++) {
        const sf_real most = flow->noise_count > 20 ? 25 * flow->noise[i] : R(HUGE_VAL);
        const sf_real now = fmin(dot(2, third + 2u * i, third + 2u * i) / 40, most);
        flow->noise[i] += (now - flow->noise[i]) / flow->noise_count;
        flow->noise[i] = fmax(flow->noise[i], square(R(1e-4) * flow->config.lower));
    }
}

sf_status sf_init(sf_flow *flow, const sf_config *config)
{
    if ((flow == NULL) || (config == NULL)) {
        return SF_BAD_ARGUMENT;
    }
    memset(flow, 0, sizeof *flow);
    if (!(config->response_time > 0) || !within(config->drag_coefficient, 0, LARGEST) ||
        !(1 / config->response_time + config->drag_coefficient > 0) ||
        !(fabs(config->thrust_x) <= LARGEST) || !(fabs(config->thrust_y) <= LARGEST) ||
        !(fabs(config->thrust_scale) <= LARGEST) || !within(config->precision, 0, LARGEST) ||
        !(config->lower > 0) || !within(config->upper, config->lower, LARGEST) ||
        !within(config->memory, 0, LARGEST) || (config->candidates == 0u)) {
        return SF_BAD_ARGUMENT;
    }
    flow->config = *config;
    flow->doubt = SF_FEW_SAMPLES;
    return SF_OK;
}

static sf_real seconds(uint64_t from, uint64_t to)
{
    return to > from ? R((double)(to - from) * 1e-9) : 0;
}

/*
 * The time h [s] since the last sample. A sample out of line is left out; if the next one
 * continues from it, the clock was set, and h is the time between the two.
 */
static sf_status advance(sf_flow *flow, uint64_t time_ns, sf_real *h)
{
    sf_status status = SF_OK;
    *h = flow->samples > 0u ? seconds(flow->time_ns, time_ns) : 0;
    if ((flow->samples > 0u) && (!(*h > 0) || ((flow->step > 0) && (*h > GAP * flow->step)))) {
        const sf_real since = seconds(flow->suspect_ns, time_ns);
        const int later = (flow->suspects > 0u) && (since > 0);
        if (!later || ((since > GAP * flow->step) && (flow->suspects < 2u))) {
            flow->suspects = later ? flow->suspects + 1u : 1u;
            flow->suspect_ns = time_ns;
            return SF_BAD_TIME;
        }
        *h = flow->step = since;
        status = SF_GAP;
    }
    flow->step += (*h - flow->step) / (flow->step > 0 ? R(16) : R(1));
    flow->suspects = 0;
    flow->time_ns = time_ns;
    flow->samples++;
    return status;
}

sf_status sf_update(sf_flow *flow, uint64_t time_ns, const sf_real position[2],
                    const sf_real velocity[2], const sf_real *thrust)
{
    if ((flow == NULL) || (position == NULL) || (velocity == NULL) ||
        (flow->config.candidates == 0u)) {
        return SF_BAD_ARGUMENT;
    }
    for (uint32_t i = 0; i < 2u; i++) {
        if (!(fabs(position[i]) <= LARGEST) || !(fabs(velocity[i]) <= LARGEST) ||
            ((thrust != NULL) && !(fabs(thrust[i]) <= LARGEST))) { /* true of NaN */
            return SF_BAD_SAMPLE;
        }
    }
    sf_real z[4], h, push[2] = {flow->config.thrust_x, flow->config.thrust_y};
    const sf_status status = advance(flow, time_ns, &h);
    if (status == SF_BAD_TIME) {
        return status;
    }
    for (uint32_t i = 0; i < 2u; i++) {
        flow->origin[i] = flow->samples == 1u ? position[i] : flow->origin[i];
        z[i] = position[i] - flow->origin[i];
        z[2u + i] = velocity[i];
        if (thrust != NULL) {
            const sf_real before = flow->samples == 1u ? thrust[i] : flow->thrust[i];
            push[i] += flow->config.thrust_scale * (before + thrust[i]) / 2;
            flow->thrust[i] = thrust[i];
        }
    }
    flow->recent = (status == SF_GAP) || (h > R(1.5) * flow->step) ? 0u : flow->recent;
    if (status == SF_GAP) { /* positions may count from another place now */
        forget_rows(flow);
        flow->remaining[0] = flow->remaining[1] = 0;
        flow->waiting = flow->following;
    }
    measure_noise(flow, z);
    take_row(flow, z, h, push);
    if (!flow->following) {
        search(flow, z);
    } else if (!flow->waiting) {
        follow(flow, z, h, push);
    } else if (flow->row_count == CHECK_ROWS) {
        settle(flow, z);
        flow->waiting = 0;
        flow->following = flow->remaining[0] < UNEXPLAINED / 2 * flow->remaining[1] ? 1u : 0u;
    }
    return status;
}

sf_status sf_estimate(const sf_flow *flow, sf_answer *answer)
{
    if ((flow == NULL) || (answer == NULL) || (flow->config.candidates == 0u)) {
        return SF_BAD_ARGUMENT;
    }
    *answer = (sf_answer){.status = SF_UNIDENTIFIABLE, .doubt = (sf_doubt)flow->doubt,
                          .samples = flow->samples, .mean_velocity = R(NAN),
                          .length_scale = R(NAN), .timescale = R(NAN), .heading = R(NAN),
                          .rival = flow->doubt == SF_RIVAL ? flow->rival : 0};
    if (!flow->following) {
        return answer->status;
    }
    sf_filter filter = *likeliest(flow);
    const sf_real *p = filter.state + FLOW;
    sf_real value[FEATURES], by[FEATURES][M], error[4], ph[N];
    features(p, value, by); /* both amplitudes are equal: taken as a reading */
    const sf_real uneven = value[UNEVEN];
    const sf_real different = correct(&filter, FLOW, M, by[UNEVEN], -uneven, 0);
    features(p, value, by);
    for (uint32_t i = 0; i < 4u; i++) { /* innovations that are too large widen the intervals */
        error[i] = sqrt(fmax(filter.square, R(1)) * variance_of(&filter, FLOW, M, by[i], ph));
    }
    *answer = (sf_answer){
        .status = SF_UNIDENTIFIABLE, .doubt = SF_NO_DOUBT, .samples = flow->samples,
        .mean_velocity = value[SPEED], .mean_velocity_error = error[SPEED],
        .length_scale = value[LENGTH], .length_scale_error = error[LENGTH],
        .timescale = value[TIME], .timescale_error = error[TIME],
        .heading = value[HEADING], .heading_error = error[HEADING],
        .innovation = filter.square, .correlation = filter.product,
        .unexplained = flow->remaining[1] > 0 ? flow->remaining[0] / flow->remaining[1] : 1,
        .flow = {p[0], p[1], p[2], p[3], p[4], p[5], flow->anchor[0] + flow->origin[0],
                 flow->anchor[1] + flow->origin[1]}};
    const sf_real most = flow->config.precision / R(1.96);
    if ((flow->age < SETTLED) || flow->waiting) {
        answer->doubt = SF_SETTLING;
    } else if (!(filter.square < R(1.6)) || (filter.product > R(0.5)) ||
               (answer->unexplained > UNEXPLAINED)) {
        answer->doubt = SF_INNOVATIONS;
    } else if (!flow->config.any_heading &&
               (fabs(value[HEADING]) > R(0.02) + 3 * error[HEADING])) {
        answer->doubt = SF_TURNED;
    } else if ((fabs(different) > 4) && (fabs(uneven) > EVEN)) {
        answer->doubt = SF_SHAPE;
    } else if (!(error[SPEED] < most * value[SPEED]) || !(error[LENGTH] < most * value[LENGTH]) ||
               !(error[TIME] < most * value[TIME])) {
        answer->doubt = SF_IMPRECISE;
    } else if (!within(value[LENGTH], flow->config.lower, flow->config.upper)) {
        answer->doubt = SF_EDGE;
    }
    answer->status = answer->doubt == SF_NO_DOUBT ? SF_OK : SF_UNIDENTIFIABLE;
    if ((answer->doubt >= SF_INNOVATIONS) && (answer->doubt <= SF_TURNED)) {
        answer->status = SF_MISFIT;
    }
    return answer->status;
}
