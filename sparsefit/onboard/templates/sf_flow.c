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
enum { X, Y, VX, VY, UX, UY, A1, B1, A2, B2, KX, KY };

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

static sf_real square(sf_real value) { return value * value; }

/* |k|^2 sum of a^2 + b^2 = U0^2. */
static sf_real speed_squared(const sf_real *p)
{
    return (square(p[4]) + square(p[5])) *
           (square(p[0]) + square(p[1]) + square(p[2]) + square(p[3]));
}

static sf_real length_of(const sf_real *p)
{
    return sqrt(R(2)) * PI / sqrt(square(p[4]) + square(p[5]));
}

/* An angle less the nearest multiple of a right one. */
static sf_real heading_of(sf_real angle)
{
    return angle - PI / 2 * floor(angle / (PI / 2) + R(0.5));
}

/*
 * w [m/s] of the parameters p at (x, y) [m] from where the phases count, with its gradients by the
 * place and by p where these are no null pointers.
 */
static void waves(const sf_real *p, sf_real x, sf_real y, sf_real w[2], sf_real (*by_place)[2],
                  sf_real (*by_flow)[M])
{
    uint32_t j, r;
    w[0] = w[1] = 0;
    for (r = 0; r < 2u; r++) {
        if (by_place) {
            by_place[r][0] = by_place[r][1] = 0;
        }
        if (by_flow) {
            by_flow[r][4] = by_flow[r][5] = 0;
        }
    }
    for (j = 0; j < 2u; j++) {
        const sf_real a = p[2u * j], b = p[2u * j + 1u];
        const sf_real k = j ? -p[5] : p[4], l = j ? p[4] : p[5];
        const sf_real phase = k * x + l * y, c = cos(phase), s = sin(phase);
        const sf_real slope = b * c - a * s, height = a * c + b * s;
        w[0] += l * slope;
        w[1] -= k * slope;
        if (by_place) {
            by_place[0][0] -= height * l * k;
            by_place[0][1] -= height * l * l;
            by_place[1][0] += height * k * k;
            by_place[1][1] += height * k * l;
        }
        if (by_flow) {
            const sf_real by_k[2] = {-height * l * x, height * k * x - slope};
            const sf_real by_l[2] = {slope - height * l * y, height * k * y};
            for (r = 0; r < 2u; r++) {
                const sf_real normal = r ? -k : l;
                by_flow[r][2u * j] = -s * normal;
                by_flow[r][2u * j + 1u] = c * normal;
                by_flow[r][4] += j ? by_l[r] : by_k[r];
                by_flow[r][5] += j ? -by_k[r] : by_l[r];
            }
        }
    }
}

/* Cholesky of a, lower, in place; 0 where it is not positive definite. */
static int factor(sf_real a[M][M])
{
    uint32_t i, j, k;
    for (i = 0; i < M; i++) {
        for (j = 0; j <= i; j++) {
            sf_real sum = a[i][j];
            for (k = 0; k < j; k++) {
                sum -= a[i][k] * a[j][k];
            }
            if (i != j) {
                a[i][j] = sum / a[j][j];
            } else if (sum > 0) {
                a[i][i] = sqrt(sum);
            } else {
                return 0;
            }
        }
    }
    return 1;
}

/* b becomes a^-1 b, by the factor of a. */
static void solve(sf_real a[M][M], sf_real b[M])
{
    uint32_t i, k;
    for (i = 0; i < M; i++) {
        for (k = 0; k < i; k++) {
            b[i] -= a[i][k] * b[k];
        }
        b[i] /= a[i][i];
    }
    for (i = M; i-- > 0u;) {
        for (k = i + 1u; k < M; k++) {
            b[i] -= a[k][i] * b[k];
        }
        b[i] /= a[i][i];
    }
}

static sf_real form(sf_real p[M][M], const sf_real g[M])
{
    sf_real sum = 0;
    uint32_t i, j;
    for (i = 0; i < M; i++) {
        for (j = 0; j < M; j++) {
            sum += g[i] * p[i][j] * g[j];
        }
    }
    return sum;
}

/* Half the logarithm of the ratio of the waves' squared amplitudes, with its gradient. */
static sf_real unevenness(const sf_real *p, sf_real g[M])
{
    const sf_real first = square(p[0]) + square(p[1]), second = square(p[2]) + square(p[3]);
    g[0] = -p[0] / first;
    g[1] = -p[1] / first;
    g[2] = p[2] / second;
    g[3] = p[3] / second;
    g[4] = g[5] = 0;
    return log(second / first) / 2;
}

/* The heading [rad], with its gradient. */
static sf_real heading(const sf_real *p, sf_real g[M])
{
    const sf_real k = square(p[4]) + square(p[5]);
    g[0] = g[1] = g[2] = g[3] = 0;
    g[4] = -p[5] / k;
    g[5] = p[4] / k;
    return heading_of(atan2(p[5], p[4]) - PI / 4);
}

/* U0, L, L/U0 and the heading of p, and their variances. */
static void parameters(const sf_real *p, sf_real covariance[M][M], sf_real value[4],
                       sf_real variance[4])
{
    const sf_real k = square(p[4]) + square(p[5]);
    sf_real g[4][M];
    uint32_t j;
    value[0] = sqrt(speed_squared(p));
    value[1] = length_of(p);
    value[2] = value[1] / value[0];
    value[3] = heading(p, g[3]);
    for (j = 0; j < M; j++) {
        g[0][j] = (j < 4u ? k : square(value[0]) / k) * p[j] / value[0];
        g[1][j] = j < 4u ? 0 : -value[1] * p[j] / k;
        g[2][j] = value[2] * (g[1][j] / value[1] - g[0][j] / value[0]);
    }
    for (j = 0; j < 4u; j++) {
        variance[j] = form(covariance, g[j]);
    }
}

/* ---- the filters ---------------------------------------------------------------------------- */

/*
 * v' [m/s^2] of a state under a thrust, with the gradients of w and dF/dr (2, 2) where these are no
 * null pointers.
 */
static void acceleration(const sf_config *vehicle, const sf_real *z, const sf_real push[2],
                         sf_real rate[2], sf_real (*by_place)[2], sf_real (*by_flow)[M],
                         sf_real (*slope)[2])
{
    sf_real w[2];
    sf_real r[2];
    sf_real speed;
    sf_real own;
    waves(z + A1, z[X], z[Y], w, by_place, by_flow);
    r[0] = w[0] + z[UX] - z[VX];
    r[1] = w[1] + z[UY] - z[VY];
    speed = sqrt(square(r[0]) + square(r[1]));
    own = 1 / vehicle->response_time + vehicle->drag_coefficient * speed;
    rate[0] = own * r[0] + push[0];
    rate[1] = own * r[1] + push[1];
    if (slope) {
        const sf_real bend = speed > 0 ? vehicle->drag_coefficient / speed : 0;
        slope[0][0] = own + bend * r[0] * r[0];
        slope[1][1] = own + bend * r[1] * r[1];
        slope[0][1] = slope[1][0] = bend * r[0] * r[1];
    }
}

/* x' and v' of a state. */
static void motion(const sf_config *vehicle, const sf_real *z, const sf_real push[2],
                   sf_real rate[4])
{
    rate[0] = z[VX];
    rate[1] = z[VY];
    acceleration(vehicle, z, push, rate + 2, NULL, NULL, NULL);
}

/* The state h seconds later by Runge and Kutta; the state in the middle of the step. */
static void step_state(const sf_config *vehicle, sf_real *state, sf_real h, const sf_real push[2],
                       sf_real middle[N])
{
    sf_real rate[4][4];
    sf_real z[N];
    uint32_t i;
    memcpy(z, state, sizeof z);
    motion(vehicle, z, push, rate[0]);
    for (i = 0; i < 4u; i++) {
        z[i] = state[i] + h / 2 * rate[0][i];
    }
    motion(vehicle, z, push, rate[1]);
    for (i = 0; i < 4u; i++) {
        z[i] = state[i] + h / 2 * rate[1][i];
    }
    memcpy(middle, z, sizeof z);
    motion(vehicle, z, push, rate[2]);
    for (i = 0; i < 4u; i++) {
        z[i] = state[i] + h * rate[2][i];
    }
    motion(vehicle, z, push, rate[3]);
    for (i = 0; i < 4u; i++) {
        state[i] += h / 6 * (rate[0][i] + 2 * rate[1][i] + 2 * rate[2][i] + rate[3][i]);
    }
}

/* A filter h seconds later, under a thrust and a disturbance of a level [m/s]. */
static void predict(const sf_config *vehicle, sf_filter *filter, sf_real h, const sf_real push[2],
                    sf_real level)
{
    const sf_real decay = exp(-RATE * h);
    sf_real(*p)[N] = filter->covariance;
    sf_real middle[N];
    sf_real rate[2];
    sf_real by_place[2][2];
    sf_real by_flow[2][M];
    sf_real slope[2][2];
    sf_real jacobian[2][N]; /* of v' */
    sf_real change[4][N];   /* rows of the transition of x and v, less the identity */
    sf_real product[6][N];
    sf_real gust;
    sf_real white;
    uint32_t i, j, r;
    step_state(vehicle, filter->state, h, push, middle);
    filter->state[UX] *= decay;
    filter->state[UY] *= decay;
    acceleration(vehicle, middle, push, rate, by_place, by_flow, slope);
    for (r = 0; r < 2u; r++) {
        for (j = 0; j < 2u; j++) {
            jacobian[r][X + j] = slope[r][0] * by_place[0][j] + slope[r][1] * by_place[1][j];
            jacobian[r][VX + j] = -slope[r][j];
            jacobian[r][UX + j] = slope[r][j];
        }
        for (j = 0; j < M; j++) {
            jacobian[r][A1 + j] = slope[r][0] * by_flow[0][j] + slope[r][1] * by_flow[1][j];
        }
    }
    for (r = 0; r < 2u; r++) { /* to the second order in h */
        for (j = 0; j < N; j++) {
            sf_real second = jacobian[r][VX] * jacobian[0][j] + jacobian[r][VY] * jacobian[1][j];
            if ((j == VX) || (j == VY)) {
                second += jacobian[r][j - 2u];
            }
            if ((j == UX) || (j == UY)) {
                second -= RATE * jacobian[r][j];
            }
            change[r][j] = h * h / 2 * jacobian[r][j] + (j == VX + r ? h : 0);
            change[2u + r][j] = h * jacobian[r][j] + h * h / 2 * second;
        }
    }
    for (r = 0; r < 4u; r++) {
        for (j = 0; j < N; j++) {
            product[r][j] = p[r][j];
        }
        for (i = 0; i < N; i++) {
            for (j = 0; j < N; j++) {
                product[r][j] += change[r][i] * p[i][j];
            }
        }
    }
    for (r = UX; r < A1; r++) {
        for (j = 0; j < N; j++) {
            product[r][j] = decay * p[r][j];
        }
    }
    for (r = 0; r < A1; r++) {
        for (j = A1; j < N; j++) {
            p[r][j] = p[j][r] = product[r][j];
        }
        for (j = r; j < A1; j++) {
            sf_real sum = product[r][j];
            if (j >= UX) {
                sum *= decay;
            } else {
                for (i = 0; i < N; i++) {
                    sum += product[r][i] * change[j][i];
                }
            }
            p[r][j] = p[j][r] = sum;
        }
    }
    gust = square(level) * (1 - decay * decay);
    white = square(FLOOR * level) * (2 / RATE) * (square(slope[0][0]) + square(slope[0][1])) * h;
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
    *log_likelihood -= log(spread) / 2;
    if (!(unit * unit < GATE)) {
        *log_likelihood -= GATE / 2;
        return unit > 0 ? sqrt(GATE) : -sqrt(GATE);
    }
    *log_likelihood -= unit * unit / 2;
    for (i = 0; i < N; i++) {
        gain[i] = p[i][place] / spread;
    }
    for (i = 0; i < N; i++) {
        filter->state[i] += gain[i] * innovation;
        for (j = i; j < N; j++) {
            p[i][j] -= gain[i] * gain[j] * spread;
            p[j][i] = p[i][j];
        }
    }
    return unit;
}

/* Count places and phases from another anchor, d away. */
static void rebase(sf_filter *filter, const sf_real d[2])
{
    sf_real *z = filter->state;
    uint32_t wave, side, j;
    for (wave = 0; wave < 2u; wave++) {
        const uint32_t a = A1 + 2u * wave, b = a + 1u;
        const sf_real by_kx = wave ? d[1] : d[0], by_ky = wave ? -d[0] : d[1];
        const sf_real turn = z[KX] * by_kx + z[KY] * by_ky, c = cos(turn), s = sin(turn);
        const sf_real new_a = c * z[a] + s * z[b], new_b = c * z[b] - s * z[a];
        z[a] = new_a;
        z[b] = new_b;
        for (side = 0; side < 2u; side++) { /* rows, then columns */
            for (j = 0; j < N; j++) {
                sf_real *p = side ? filter->covariance[j] : &filter->covariance[0][j];
                const uint32_t stride = side ? 1u : N;
                const sf_real along = by_kx * p[KX * stride] + by_ky * p[KY * stride];
                const sf_real old_a = p[a * stride], old_b = p[b * stride];
                p[a * stride] = c * old_a + s * old_b + new_b * along;
                p[b * stride] = c * old_b - s * old_a - new_a * along;
            }
        }
    }
    z[X] -= d[0];
    z[Y] -= d[1];
}

static const sf_filter *likeliest(const sf_flow *flow)
{
    const sf_filter *best = &flow->filter[0];
    uint32_t i;
    for (i = 1; i < SF_LEVELS; i++) {
        if (flow->filter[i].log_likelihood > best->log_likelihood) {
            best = &flow->filter[i];
        }
    }
    return best;
}

/* Parameters walk, and fade with a memory. */
static void forget(const sf_config *config, sf_filter *filter, sf_real h)
{
    const sf_real *p = filter->state + A1;
    const sf_real power = (square(p[0]) + square(p[1]) + square(p[2]) + square(p[3])) / 2;
    const sf_real size = square(p[4]) + square(p[5]);
    uint32_t i, j;
    if (config->memory > 0) {
        const sf_real grow = exp(h / config->memory / 2);
        for (i = A1; i < N; i++) {
            for (j = 0; j < N; j++) {
                filter->covariance[i][j] *= grow;
                filter->covariance[j][i] *= grow;
            }
        }
    }
    for (i = 0; i < M; i++) {
        filter->covariance[A1 + i][A1 + i] +=
            h * (i < 4u ? square(WALK_A) * power : square(WALK_K) * size);
    }
}

/* Follow the flow with one sample z (x, y, vx, vy), h seconds after the last. */
static void follow(sf_flow *flow, const sf_real z[4], sf_real h, const sf_real push[2])
{
    const sf_real speed = sqrt(speed_squared(likeliest(flow)->state + A1));
    const sf_real rate = 1 / flow->config.response_time + 2 * flow->config.drag_coefficient * speed;
    const sf_real anneal = 1 + ANNEAL * exp(-flow->age / 50);
    const sf_real fade = 1 / (flow->age < HORIZON ? flow->age + 2 : HORIZON + 2);
    const sf_real away[2] = {z[0] - flow->anchor[0], z[1] - flow->anchor[1]};
    const int far = square(away[0]) + square(away[1]) > square(flow->config.lower / 2);
    const sf_real parts = 1 + floor(2 * h * rate < 15 ? 2 * h * rate : 15);
    sf_real least = R(HUGE_VAL);
    uint32_t outliers = 0;
    uint32_t level, i;
    for (level = 0; level < SF_LEVELS; level++) {
        sf_filter *filter = &flow->filter[level];
        sf_real log_likelihood = 0, mean_square = 0, product = 0;
        int outlier = 0;
        for (i = 0; R(i) < parts; i++) {
            predict(&flow->config, filter, h / parts, push, LEVEL[level] * speed);
        }
        for (i = 0; i < 4u; i++) {
            const sf_real unit = correct(filter, i, i < 2u ? away[i] : z[i],
                                         flow->noise[i / 2u] * anneal, &log_likelihood);
            mean_square += unit * unit / 4;
            product += unit * filter->last[i] / 4;
            filter->last[i] = unit;
            outlier |= unit * unit >= GATE;
        }
        outliers += outlier ? 1u : 0u;
        filter->log_likelihood = FADE * filter->log_likelihood + log_likelihood;
        filter->square += fade * (mean_square - filter->square);
        filter->product += fade * (product - filter->product);
        least = filter->square < least ? filter->square : least;
        forget(&flow->config, filter, h);
        if (far) {
            rebase(filter, away);
        }
    }
    if (far) {
        flow->anchor[0] = z[0];
        flow->anchor[1] = z[1];
    }
    flow->age += 1;
    flow->gated += ((outliers >= SF_LEVELS ? R(1) : R(0)) - flow->gated) / 32;
    if ((flow->gated > R(0.3)) ||
        ((flow->age > R(150)) &&
         ((least > 2) || (flow->remaining[0] > flow->remaining[1] / 2)))) { /* lost */
        flow->following = 0;
        flow->sweeping = 0;
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
    sf_real force[2];
    sf_real w[2];
    sf_real moved;
    sf_real reach;
    uint32_t j;
    b[0] += 1;
    b[1] += t;
    b[2] += t * t;
    for (j = 0; j < 4u; j++) {
        b[3u + j] += z[j];
    }
    for (j = 0; j < 2u; j++) {
        b[7u + j] += t * z[2u + j];
        b[9u + j] += push[j];
    }
    moved = t * sqrt(square(b[5]) + square(b[6])) / b[0];
    if ((b[0] < 4) || ((moved < flow->config.lower / 4) && (b[0] < BLOCK_MOST))) {
        return;
    }
    for (j = 0; j < 2u; j++) {
        const sf_real slope = (b[7u + j] - b[1] * b[5u + j] / b[0]) / (b[2] - b[1] * b[1] / b[0]);
        force[j] = slope - b[9u + j] / b[0];
    }
    reach = sqrt(square(force[0]) + square(force[1]));
    reach = rate + sqrt(rate * rate + 4 * flow->config.drag_coefficient * reach);
    for (j = 0; j < 2u; j++) {
        row[j] = b[3u + j] / b[0];
        row[2u + j] = b[5u + j] / b[0] + (reach > 0 ? 2 * force[j] / reach : 0);
    }
    memset(flow->block, 0, sizeof flow->block);
    flow->row_place = (flow->row_place + 1u) % SF_ROWS;
    flow->row_count += flow->row_count < SF_ROWS ? 1u : 0u;
    if (flow->following) {
        const sf_real *p = likeliest(flow)->state + A1;
        waves(p, row[0] - flow->anchor[0], row[1] - flow->anchor[1], w, NULL, NULL);
        flow->remaining[0] +=
            (square(row[2] - w[0]) + square(row[3] - w[1]) - flow->remaining[0]) / 32;
        flow->remaining[1] += (square(row[2]) + square(row[3]) - flow->remaining[1]) / 32;
    }
}

static void begin_sweep(sf_flow *flow)
{
    sf_real low[2] = {R(HUGE_VAL), R(HUGE_VAL)}, high[2] = {-R(HUGE_VAL), -R(HUGE_VAL)};
    sf_real extent = flow->config.lower;
    uint32_t i, j;
    for (j = 0; j < 2u; j++) {
        for (i = 0; i < flow->row_count; i++) {
            low[j] = flow->rows[i][j] < low[j] ? flow->rows[i][j] : low[j];
            high[j] = flow->rows[i][j] > high[j] ? flow->rows[i][j] : high[j];
        }
        extent = high[j] - low[j] > extent ? high[j] - low[j] : extent;
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
            ss += s * s;
            sc += s * c;
            cc += c * c;
            sp += s * across;
            cp += c * across;
        }
        ss *= R(1.01); /* a little ridge */
        cc *= R(1.01);
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
    uint32_t place = flow->peaks;
    uint32_t i;
    for (i = 0; i < flow->peaks; i++) {
        const sf_peak *peak = &flow->peak[i];
        const sf_real turn = heading_of(angle - peak->angle);
        if (square(size - peak->size) + square(turn * size) < square(R(2.6) * flow->spacing)) {
            place = i;
            break;
        }
    }
    if (place == SF_PEAKS) {
        for (i = 1, place = 0; i < SF_PEAKS; i++) {
            place = flow->peak[i].score < flow->peak[place].score ? i : place;
        }
    }
    if (place == flow->peaks) {
        flow->peaks++;
    } else if (!(score > flow->peak[place].score)) {
        return;
    }
    flow->peak[place].score = score;
    flow->peak[place].size = size;
    flow->peak[place].angle = angle;
}

/* Look at the next candidate; 0 where the sweep is at its end. */
static int look(sf_flow *flow)
{
    const sf_real around = sqrt(R(2)) * PI;
    const sf_real step = flow->config.any_heading ? flow->spacing : flow->spacing / 2;
    const sf_real size = around / flow->config.upper + step * R(flow->radius);
    uint32_t turns = 1;
    sf_real angle = PI / 4;
    if (size > around / flow->config.lower + step) {
        return 0;
    }
    if (flow->config.any_heading) {
        turns = (uint32_t)ceil(PI / 2 * size / step);
        angle = PI / 2 * R(flow->turn) / R(turns);
    }
    hold(flow, explained(flow, size, angle), size, angle);
    flow->turn++;
    if (flow->turn >= turns) {
        flow->turn = 0;
        flow->radius++;
    }
    return 1;
}

/* A step of Levenberg and Marquardt for a peak, on all rows; 0 where there is none. */
static int refine(sf_flow *flow, sf_peak *peak, int first)
{
    const sf_real weight = flow->total / (20 * R(flow->row_count)) / square(EVEN);
    sf_real normal[M][M], right[M], by_flow[2][M], g[M], w[2], residual = 0, cost;
    uint32_t i, j, k;
    memset(normal, 0, sizeof normal);
    memset(right, 0, sizeof right);
    for (i = 0; i < flow->row_count; i++) {
        const sf_real *row = flow->rows[i];
        sf_real e[2];
        waves(peak->trial, row[0] - flow->middle[0], row[1] - flow->middle[1], w, NULL, by_flow);
        e[0] = row[2] - w[0];
        e[1] = row[3] - w[1];
        residual += square(e[0]) + square(e[1]);
        for (j = 0; j < M; j++) {
            right[j] += by_flow[0][j] * e[0] + by_flow[1][j] * e[1];
            for (k = 0; k <= j; k++) {
                normal[j][k] += by_flow[0][j] * by_flow[0][k] + by_flow[1][j] * by_flow[1][k];
            }
        }
    }
    cost = residual;
    for (i = 0; !first && (i < (flow->config.any_heading ? 1u : 2u)); i++) {
        const sf_real value = i ? heading(peak->trial, g) : unevenness(peak->trial, g);
        cost += weight * value * value;
        for (j = 0; j < M; j++) {
            right[j] -= weight * g[j] * value;
            for (k = 0; k <= j; k++) {
                normal[j][k] += weight * g[j] * g[k];
            }
        }
    }
    if (first || (cost < peak->cost)) {
        for (j = 0; j < M; j++) {
            for (k = 0; k < j; k++) {
                normal[k][j] = normal[j][k];
            }
        }
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
    memcpy(right, peak->right, sizeof right);
    for (j = 0; j < M; j++) {
        normal[j][j] = normal[j][j] * (1 + peak->damping) + R(1e-9);
    }
    if (!factor(normal)) {
        return 0;
    }
    solve(normal, right);
    for (j = 0; j < M; j++) {
        peak->trial[j] = peak->parameters[j] + right[j];
    }
    return 1;
}

/* Start the filters from a peak, at the last sample z. */
static sf_doubt start(sf_flow *flow, const sf_peak *peak, const sf_real z[4])
{
    const sf_real variance = peak->residual / (2 * R(flow->row_count) - R(M));
    sf_real a[M][M], inverse[M][M], g[M], value[4], error[4], uneven;
    const sf_real d[2] = {z[0] - flow->middle[0], z[1] - flow->middle[1]};
    uint32_t i, j, level;
    memcpy(a, peak->information, sizeof a);
    for (i = 0; i < M; i++) {
        a[i][i] = a[i][i] * R(1.0001) + R(1e-12);
    }
    if (!factor(a)) {
        return SF_NO_FLOW;
    }
    for (i = 0; i < M; i++) {
        for (j = 0; j < M; j++) {
            inverse[i][j] = i == j ? variance : 0;
        }
        solve(a, inverse[i]);
    }
    uneven = unevenness(peak->parameters, g);
    if (uneven * uneven > 40 * form(inverse, g)) {
        return SF_SHAPE;
    }
    parameters(peak->parameters, inverse, value, error);
    if (!(error[0] < square(R(0.03) * value[0])) || !(error[1] < square(R(0.01) * value[1]))) {
        return SF_IMPRECISE;
    }
    for (level = 0; level < SF_LEVELS; level++) {
        sf_filter *filter = &flow->filter[level];
        memset(filter, 0, sizeof *filter);
        for (i = 0; i < 4u; i++) {
            filter->state[i] = i < 2u ? d[i] : z[i];
            filter->covariance[i][i] = flow->noise[i / 2u];
        }
        filter->covariance[UX][UX] = square(LEVEL[level] * value[0]);
        filter->covariance[UY][UY] = square(LEVEL[level] * value[0]);
        for (i = 0; i < M; i++) {
            filter->state[A1 + i] = peak->parameters[i];
            for (j = 0; j < M; j++) {
                filter->covariance[A1 + i][A1 + j] = 4 * inverse[i][j];
            }
        }
        filter->square = 1;
        rebase(filter, d);
    }
    flow->anchor[0] = z[0];
    flow->anchor[1] = z[1];
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
        const sf_real length = length_of(flow->peak[i].parameters);
        const sf_real ratio = length / length_of(best->parameters);
        if (((ratio > R(1.03)) || (ratio < R(0.97))) && (flow->peak[i].residual < rival)) {
            rival = flow->peak[i].residual;
            flow->rival = length;
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
        flow->total += square(flow->rows[i][2]) + square(flow->rows[i][3]);
    }
    if (!flow->refining) {
        for (i = 0; i < flow->config.candidates; i++) {
            if (!look(flow)) {
                flow->refining = 1;
                flow->iteration = 0;
                break;
            }
        }
        return;
    }
    peak = &flow->peak[flow->refining - 1u];
    if (flow->iteration == 0u) {
        memset(peak->trial, 0, sizeof peak->trial);
        peak->trial[4] = peak->size * cos(peak->angle);
        peak->trial[5] = peak->size * sin(peak->angle);
        if (flow->refining == 1u) {
            flow->middle[0] = flow->middle[1] = 0;
            for (i = 0; i < flow->row_count; i++) {
                flow->middle[0] += flow->rows[i][0] / R(flow->row_count);
                flow->middle[1] += flow->rows[i][1] / R(flow->row_count);
            }
        }
    }
    if (!refine(flow, peak, flow->iteration == 0u)) {
        peak->residual = R(HUGE_VAL);
        flow->iteration = REFINEMENTS;
    }
    flow->iteration++;
    if (flow->iteration < REFINEMENTS) {
        return;
    }
    flow->iteration = 0;
    flow->refining++;
    if (flow->refining > flow->peaks) {
        flow->sweeping = 0;
        flow->doubt = (uint32_t)decide(flow, z);
    }
}

/* ---- the interface -------------------------------------------------------------------------- */

/* Levels of the noise from third differences, whose variance is 20 times as large. */
static void measure_noise(sf_flow *flow, const sf_real z[4])
{
    const sf_real least = square(R(1e-4) * flow->config.lower);
    uint32_t i, j;
    if (flow->recent >= 3u) {
        flow->counted += flow->counted < 500 ? R(1) : R(0);
        for (i = 0; i < 2u; i++) {
            sf_real third = 0;
            const sf_real most = flow->counted > 20 ? 25 * flow->noise[i] : R(HUGE_VAL);
            for (j = 2u * i; j < 2u * i + 2u; j++) {
                third += square(z[j] - 3 * flow->history[2][j] + 3 * flow->history[1][j] -
                                flow->history[0][j]) / 40;
            }
            third = third < most ? third : most;
            flow->noise[i] += (third - flow->noise[i]) / flow->counted;
            flow->noise[i] = flow->noise[i] > least ? flow->noise[i] : least;
        }
    }
    memmove(flow->history[0], flow->history[1], 2u * sizeof flow->history[0]);
    memcpy(flow->history[2], z, sizeof flow->history[2]);
    flow->recent += flow->recent < 3u ? 1u : 0u;
}

/* Go on after a gap or from another clock: the flow is known, place and velocity are measured. */
static void resume(sf_flow *flow, const sf_real z[4])
{
    const sf_real away[2] = {z[0] - flow->anchor[0], z[1] - flow->anchor[1]};
    uint32_t level, i, j;
    flow->recent = 0;
    flow->restarts++;
    memset(flow->block, 0, sizeof flow->block);
    for (level = 0; flow->following && (level < SF_LEVELS); level++) {
        sf_filter *filter = &flow->filter[level];
        const sf_real gust = square(LEVEL[level]) * speed_squared(filter->state + A1);
        for (i = 0; i < A1; i++) {
            for (j = 0; j < N; j++) {
                filter->covariance[i][j] = filter->covariance[j][i] = 0;
            }
            filter->state[i] = i < 2u ? away[i] : i < 4u ? z[i] : 0;
            filter->covariance[i][i] = i < 4u ? flow->noise[i / 2u] : gust;
        }
        rebase(filter, away);
    }
    flow->anchor[0] = z[0];
    flow->anchor[1] = z[1];
}

static int within(sf_real value, sf_real low, sf_real high)
{
    return (value >= low) && (value <= high); /* false of NaN */
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
    flow->ready = 1;
    flow->doubt = SF_FEW_SAMPLES;
    return SF_OK;
}

sf_status sf_update(sf_flow *flow, uint64_t time_ns, const sf_real position[2],
                    const sf_real velocity[2], const sf_real *thrust)
{
    sf_real z[4], push[2], h;
    sf_status status = SF_OK;
    uint32_t i;
    if ((flow == NULL) || (position == NULL) || (velocity == NULL)) {
        return SF_BAD_ARGUMENT;
    }
    if (!flow->ready) {
        return SF_NOT_READY;
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
        flow->origin[0] = z[0];
        flow->origin[1] = z[1];
    }
    h = time_ns > flow->time_ns ? R((double)(time_ns - flow->time_ns) * 1e-9) : 0;
    if ((flow->samples > 0u) &&
        (!(h > 0) || ((flow->step > 0) && (h > GAP * flow->step)))) { /* out of line */
        const sf_real since = time_ns > flow->suspect_ns
                                  ? R((double)(time_ns - flow->suspect_ns) * 1e-9)
                                  : 0;
        const int later = (flow->suspects > 0u) && (since > 0);
        if (!later || ((since > GAP * flow->step) && (flow->suspects < 2u))) {
            flow->suspects = later ? flow->suspects + 1u : 1u;
            flow->suspect_ns = time_ns;
            return SF_BAD_TIME;
        }
        h = since; /* the last one and this: a new clock */
        flow->step = h;
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
    if (h > R(1.5) * flow->step) {
        flow->recent = 0;
    }
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
    sf_real weight[SF_LEVELS], sum = 0;
    uint32_t level, i, j;
    for (level = 0; level < SF_LEVELS; level++) {
        weight[level] = exp(flow->filter[level].log_likelihood - top);
        sum += weight[level];
    }
    for (i = 0; i < M; i++) {
        p[i] = 0;
        for (level = 0; level < SF_LEVELS; level++) {
            p[i] += weight[level] / sum * flow->filter[level].state[A1 + i];
        }
    }
    memset(covariance, 0, sizeof(sf_real[M][M]));
    for (level = 0; level < SF_LEVELS; level++) {
        const sf_filter *filter = &flow->filter[level];
        const sf_real share = weight[level] / sum;
        answer->innovation += share * filter->square;
        answer->correlation += share * filter->product;
        answer->disturbance += share * LEVEL[level];
        for (i = 0; i < M; i++) {
            for (j = 0; j < M; j++) {
                const sf_real apart =
                    (filter->state[A1 + i] - p[i]) * (filter->state[A1 + j] - p[j]);
                covariance[i][j] += share * (filter->covariance[A1 + i][A1 + j] + apart);
            }
        }
    }
}

sf_status sf_estimate(const sf_flow *flow, sf_answer *answer)
{
    sf_real p[M], covariance[M][M], g[M], gain[M], value[4], error[4], uneven, spread, widest;
    uint32_t i, j;
    if ((flow == NULL) || (answer == NULL)) {
        return SF_BAD_ARGUMENT;
    }
    memset(answer, 0, sizeof *answer);
    answer->mean_velocity = answer->length_scale = answer->timescale = answer->heading = R(NAN);
    answer->status = SF_UNIDENTIFIABLE;
    answer->samples = flow->samples;
    if (!flow->ready) {
        answer->status = SF_NOT_READY;
        return SF_NOT_READY;
    }
    answer->doubt = (sf_doubt)flow->doubt;
    if (!flow->following) {
        answer->rival = flow->doubt == SF_RIVAL ? flow->rival : 0;
        return answer->status;
    }
    mixture(flow, p, covariance, answer);
    uneven = unevenness(p, g); /* both waves are as strong: a condition on the parameters */
    spread = form(covariance, g);
    for (i = 0; i < M; i++) {
        gain[i] = 0;
        for (j = 0; j < M; j++) {
            gain[i] += covariance[i][j] * g[j] / spread;
        }
    }
    for (i = 0; i < M; i++) {
        p[i] -= gain[i] * uneven;
        for (j = 0; j < M; j++) { /* innovations that are too large widen the intervals */
            covariance[i][j] = (covariance[i][j] - gain[i] * gain[j] * spread) *
                               (answer->innovation > 1 ? answer->innovation : 1);
        }
    }
    parameters(p, covariance, value, error);
    for (i = 0; i < 4u; i++) {
        error[i] = sqrt(error[i] > 0 ? error[i] : 0);
    }
    answer->mean_velocity = value[0];
    answer->length_scale = value[1];
    answer->timescale = value[2];
    answer->heading = value[3];
    answer->mean_velocity_error = error[0];
    answer->length_scale_error = error[1];
    answer->timescale_error = error[2];
    answer->heading_error = error[3];
    answer->unexplained = flow->remaining[1] > 0 ? flow->remaining[0] / flow->remaining[1] : 1;
    memcpy(answer->flow, p, sizeof p);
    answer->flow[6] = flow->anchor[0] + flow->origin[0];
    answer->flow[7] = flow->anchor[1] + flow->origin[1];
    widest = flow->config.precision / R(1.96);
    answer->doubt = SF_NO_DOUBT;
    if (flow->age < SETTLED) {
        answer->doubt = SF_SETTLING;
    } else if (!(answer->innovation < R(1.6)) || (answer->correlation > R(0.5)) ||
               (answer->unexplained > R(0.3))) {
        answer->doubt = SF_INNOVATIONS;
    } else if (!flow->config.any_heading && (fabs(value[3]) > R(0.02) + 3 * error[3])) {
        answer->doubt = SF_TURNED;
    } else if ((uneven * uneven > 16 * spread) && (fabs(uneven) > EVEN)) {
        answer->doubt = SF_SHAPE;
    } else if (!(error[0] < widest * value[0]) || !(error[1] < widest * value[1]) ||
               !(error[2] < widest * value[2])) {
        answer->doubt = SF_IMPRECISE;
    } else if (!within(value[1], flow->config.lower, flow->config.upper)) {
        answer->doubt = SF_EDGE;
    }
    answer->status = answer->doubt == SF_NO_DOUBT ? SF_OK
                     : (answer->doubt == SF_INNOVATIONS) || (answer->doubt == SF_TURNED) ||
                             (answer->doubt == SF_SHAPE)
                         ? SF_MISFIT
                         : SF_UNIDENTIFIABLE;
    return answer->status;
}
