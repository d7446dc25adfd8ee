/* The LASSO path of homotopy.py and active_set.py, compiled: same algorithm, same tolerances.
 *
 *     minimise over w (k,):   1/2 w'G w - c'w + alpha |w|_1      at every alpha asked for
 *
 * Active weights are stored times their sign; M is the inverse of H = S G_AA S.  The names are
 * those of the Python modules, where the method and its sources are described; a change of one
 * is a change of the other.  Plain C99 without variable-length arrays, of the stable interface;
 * the whole path runs without the global interpreter lock, on memory of its own.
 */
#include <Python.h>

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("O3")
#endif
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__GLIBC__)
#define WIDE __attribute__((target_clones("avx512f", "arch=haswell", "default")))
#else
#define WIDE
#endif
#if defined(_MSC_VER)
#define RESTRICT __restrict
#else
#define RESTRICT restrict
#endif

#define REFINE_ABOVE 1e-11
#define STALE_ABOVE 1e-8
#define STALE_AGE 10
#define WRONG_ABOVE 1e-3
#define DEPENDENT_BELOW 1e-13
#define OPTIMAL_WITHIN 1e-9
#define ROUNDING 1e-13
#define FLAT 1e-16
#define FRESH_SLOPE_ABOVE 1e-11
#define NEWTON_STEPS 3
#define NEWTON_SHARE 1e-2
#define STEPS_PER_COLUMN 3
#define STEPS_AT_LEAST 50
#define HOPELESS 1e8
#define LANES 8
#define STRIP 1024 /* columns per pass: what is summed up stays in the first-level cache */

static const double CAUTION[] = {1.0, 1e2, 1e4, 1e6};

typedef enum { FINE, DEPENDENT, SINGULAR, NO_MEMORY } Outcome;

typedef struct {
    Py_ssize_t k, n, room; /* columns, active ones, room for active ones in `inverse` */
    Py_ssize_t age;        /* updates of the inverse since it was rebuilt */
    const double *gram, *cross;
    double *inverse; /* M, leading n x n block of room x room */
    double below;    /* what counts as a dependent pivot */
    Py_ssize_t *index, *waiting, waits;
    double *sign, *weights, *slope, *correlation, *descent, *open;
    double *step, *product, *error, *fix, *coefficient, *spare; /* scratch (k + 1) each */
    const double **row;                                         /* scratch (k + 1) */
    double *block;      /* scratch (2k + 2) */
    double *zero;       /* (k + 1) zeros */
} Walk;

/* ---- dense kernels ------------------------------------------------------------------------ */

/* out (width) = sum_i a_i row_i */
WIDE static void combine(const double *const *row, const double *RESTRICT a, Py_ssize_t n,
                         Py_ssize_t width, double *RESTRICT out)
{
    for (Py_ssize_t from = 0; from < width; from += STRIP) {
        Py_ssize_t w = width - from < STRIP ? width - from : STRIP, i = 0;
        double *RESTRICT o = out + from;
        for (Py_ssize_t j = 0; j < w; j++)
            o[j] = 0.0;
        for (; i + 4 <= n; i += 4) {
            const double *RESTRICT r0 = row[i] + from, *RESTRICT r1 = row[i + 1] + from;
            const double *RESTRICT r2 = row[i + 2] + from, *RESTRICT r3 = row[i + 3] + from;
            double a0 = a[i], a1 = a[i + 1], a2 = a[i + 2], a3 = a[i + 3];
            for (Py_ssize_t j = 0; j < w; j++)
                o[j] += (a0 * r0[j] + a1 * r1[j]) + (a2 * r2[j] + a3 * r3[j]);
        }
        for (; i < n; i++) {
            const double *RESTRICT r = row[i] + from;
            for (Py_ssize_t j = 0; j < w; j++)
                o[j] += a[i] * r[j];
        }
    }
}

/* y (n) += a x */
WIDE static void add(Py_ssize_t n, double a, const double *RESTRICT x, double *RESTRICT y)
{
    for (Py_ssize_t i = 0; i < n; i++)
        y[i] += a * x[i];
}

/* M (n x n) += a x x' */
WIDE static void rank_one(double *RESTRICT m, Py_ssize_t room, Py_ssize_t n, double a,
                          const double *RESTRICT x)
{
    for (Py_ssize_t i = 0; i < n; i++) {
        double *RESTRICT line = m + i * room;
        double ax = a * x[i];
        for (Py_ssize_t j = 0; j < n; j++)
            line[j] += ax * x[j];
    }
}

/* Events per unit of alpha of columns outside: the largest, and rates (2k) to find whose it is. */
WIDE static double entry_rates(const Walk *walk, double alpha, double near, double *RESTRICT rate)
{
    const Py_ssize_t k = walk->k;
    const double *RESTRICT c = walk->correlation, *RESTRICT d = walk->descent;
    const double *RESTRICT open = walk->open;
    double *RESTRICT down = rate + k, best[LANES] = {0}, most = 0.0;
    Py_ssize_t j = 0;
    for (; j < k; j++) {
        double upper = alpha - c[j], lower = alpha + c[j];
        upper = upper > near ? upper : near;
        lower = lower > near ? lower : near;
        rate[j] = (1.0 - d[j]) / upper * open[j];
        down[j] = (1.0 + d[j]) / lower * open[j];
    }
    for (j = 0; j + LANES <= 2 * k; j += LANES)
        for (int l = 0; l < LANES; l++)
            best[l] = rate[j + l] > best[l] ? rate[j + l] : best[l];
    for (; j < 2 * k; j++)
        most = rate[j] > most ? rate[j] : most;
    for (int l = 0; l < LANES; l++)
        most = best[l] > most ? best[l] : most;
    return most;
}

static double largest(const double *x, Py_ssize_t n)
{
    double most = 0.0;
    for (Py_ssize_t i = 0; i < n; i++) {
        double size = fabs(x[i]);
        if (!(size <= most))
            most = size; /* a NaN stays */
        if (isnan(most))
            return most;
    }
    return most;
}

/* ---- the active set ----------------------------------------------------------------------- */

/* G x (k,) of signed active weights x (n,) */
static void product_of(Walk *walk, const double *x, Py_ssize_t n, double *out)
{
    for (Py_ssize_t i = 0; i < n; i++) {
        walk->row[i] = walk->gram + walk->index[i] * walk->k;
        walk->coefficient[i] = walk->sign[i] * x[i];
    }
    combine(walk->row, walk->coefficient, n, walk->k, out);
}

/* M x (n,) */
static void solve(Walk *walk, const double *x, double *out)
{
    for (Py_ssize_t i = 0; i < walk->n; i++)
        walk->row[i] = walk->inverse + i * walk->room;
    combine(walk->row, x, walk->n, walk->n, out);
}

static void gather(const Walk *walk, const double *full, double *out)
{
    for (Py_ssize_t i = 0; i < walk->n; i++)
        out[i] = full[walk->index[i]] * walk->sign[i];
}

/* Room for one more active column. */
static Outcome grow(Walk *walk)
{
    if (walk->n < walk->room)
        return FINE;
    Py_ssize_t room = walk->room ? 2 * walk->room : 64;
    room = room < walk->k ? room : walk->k;
    double *fresh = malloc((size_t)room * (size_t)room * sizeof(double));
    if (!fresh)
        return NO_MEMORY;
    for (Py_ssize_t i = 0; i < walk->n; i++)
        memcpy(fresh + i * room, walk->inverse + i * walk->room, (size_t)walk->n * sizeof(double));
    free(walk->inverse);
    walk->inverse = fresh;
    walk->room = room;
    return FINE;
}

/* A fresh inverse by Gauss-Jordan steps, largest diagonal first; DEPENDENT: too early to gain. */
static Outcome rebuilt(Walk *walk, double error)
{
    const Py_ssize_t n = walk->n, k = walk->k;
    if (walk->age < (error < WRONG_ABOVE ? STALE_AGE : 1))
        return DEPENDENT;
    double *m = walk->inverse, *line = walk->fix, *done = walk->spare;
    for (Py_ssize_t i = 0; i < n; i++) {
        const double *row = walk->gram + walk->index[i] * k;
        for (Py_ssize_t j = 0; j < n; j++)
            m[i * walk->room + j] = row[walk->index[j]] * walk->sign[i] * walk->sign[j];
        done[i] = 0.0;
    }
    /* The sweep: after the step at p, rows and columns that were swept hold -inverse. */
    for (Py_ssize_t turn = 0; turn < n; turn++) {
        Py_ssize_t p = -1;
        for (Py_ssize_t i = 0; i < n; i++)
            if (done[i] == 0.0 && (p < 0 || m[i * walk->room + i] > m[p * walk->room + p]))
                p = i;
        double pivot = m[p * walk->room + p];
        if (!(pivot > 0.0) || !(pivot < HUGE_VAL))
            return SINGULAR;
        memcpy(line, m + p * walk->room, (size_t)n * sizeof(double));
        rank_one(m, walk->room, n, -1.0 / pivot, line);
        for (Py_ssize_t i = 0; i < n; i++)
            m[p * walk->room + i] = m[i * walk->room + p] = line[i] / pivot;
        m[p * walk->room + p] = -1.0 / pivot;
        done[p] = 1.0;
    }
    for (Py_ssize_t i = 0; i < n; i++)
        for (Py_ssize_t j = 0; j < n; j++)
            m[i * walk->room + j] = -m[i * walk->room + j];
    walk->age = 0;
    return FINE;
}

/* x in `step`, G x in `product`; the active correlations should be `unit` at `position` (or 0). */
static double corrected(Walk *walk, Py_ssize_t count, Py_ssize_t position, double scale,
                        Outcome *outcome)
{
    const Py_ssize_t n = walk->n;
    product_of(walk, walk->step, count, walk->product);
    gather(walk, walk->product, walk->error);
    if (position >= 0)
        walk->error[position] -= 1.0;
    double worst = largest(walk->error, n) / scale;
    *outcome = FINE;
    if (!(worst < STALE_ABOVE)) {
        *outcome = rebuilt(walk, worst);
        if (*outcome != DEPENDENT)
            return worst; /* FINE: a fresh inverse, start again; or singular */
    }
    *outcome = DEPENDENT;
    if (worst > REFINE_ABOVE) {
        solve(walk, walk->error, walk->fix);
        add(n, -1.0, walk->fix, walk->step);
        product_of(walk, walk->fix, n, walk->spare);
        add(walk->k, -1.0, walk->spare, walk->product);
    }
    return worst;
}

/* One unit of a new column, the others reacting so that their correlations stay. */
static Outcome entering(Walk *walk, Py_ssize_t column, double sign, double *pivot)
{
    const Py_ssize_t n = walk->n;
    const double *row = walk->gram + column * walk->k;
    Outcome outcome;
    if (n == walk->k)
        return SINGULAR;
    walk->index[n] = column;
    walk->sign[n] = sign;
    do {
        for (Py_ssize_t i = 0; i < n; i++)
            walk->error[i] = -sign * walk->sign[i] * row[walk->index[i]];
        solve(walk, walk->error, walk->step);
        walk->step[n] = 1.0;
        corrected(walk, n + 1, -1, 1.0, &outcome);
    } while (outcome == FINE);
    if (outcome == SINGULAR)
        return SINGULAR;
    *pivot = sign * walk->product[column];
    if (!(*pivot <= 2.0 * row[column] + DEPENDENT_BELOW))
        return SINGULAR;
    double size = 0.0;
    for (Py_ssize_t i = 0; i <= n; i++)
        size += walk->step[i] * walk->step[i];
    return *pivot <= walk->below * size ? DEPENDENT : FINE;
}

/* Let a column in with weight zero and bend the slope; a dependent one has to wait. */
static Outcome enter(Walk *walk, Py_ssize_t column, double sign)
{
    double pivot;
    walk->open[column] = 0.0;
    Outcome outcome = entering(walk, column, sign, &pivot);
    if (outcome == DEPENDENT)
        walk->waiting[walk->waits++] = column;
    if (outcome != FINE)
        return outcome;
    if (grow(walk) != FINE)
        return NO_MEMORY;
    const Py_ssize_t n = walk->n, room = walk->room;
    double amount = (1.0 - sign * walk->descent[column]) / pivot;
    for (Py_ssize_t i = 0; i <= n; i++)
        walk->inverse[n * room + i] = walk->inverse[i * room + n] = 0.0;
    rank_one(walk->inverse, room, n + 1, 1.0 / pivot, walk->step);
    walk->weights[n] = walk->slope[n] = 0.0;
    walk->n++;
    walk->age++;
    add(n + 1, amount, walk->step, walk->slope);
    add(walk->k, amount, walk->product, walk->descent);
    return FINE;
}

/* Take a column out at weight zero and bend the slope; those that waited may try again. */
static Outcome leave(Walk *walk, Py_ssize_t position)
{
    const Py_ssize_t last = walk->n - 1, room = walk->room, column = walk->index[position];
    double *m = walk->inverse;
    Outcome outcome;
    do {
        memcpy(walk->step, m + position * room, (size_t)walk->n * sizeof(double));
        corrected(walk, walk->n, position, fabs(walk->step[position]), &outcome);
    } while (outcome == FINE);
    double pivot = walk->step[position];
    if (outcome == SINGULAR || !(pivot > 0.1))
        return SINGULAR;
    double amount = walk->slope[position] / pivot;
    add(walk->n, -amount, walk->step, walk->slope);
    add(walk->k, -amount, walk->product, walk->descent);
    rank_one(m, room, walk->n, -1.0 / pivot, walk->step);
    walk->index[position] = walk->index[last];
    walk->sign[position] = walk->sign[last];
    walk->weights[position] = walk->weights[last];
    walk->slope[position] = walk->slope[last];
    for (Py_ssize_t i = 0; i <= last; i++)
        m[position * room + i] = m[last * room + i];
    for (Py_ssize_t i = 0; i <= last; i++)
        m[i * room + position] = m[i * room + last];
    walk->n = last;
    walk->age++;
    walk->open[column] = 1.0;
    while (walk->waits)
        walk->open[walk->waiting[--walk->waits]] = 1.0;
    return FINE;
}

/* ---- the path ----------------------------------------------------------------------------- */

/* Back to no active column, as at w = 0. */
static void start(Walk *walk, double caution)
{
    walk->n = walk->age = walk->waits = 0;
    walk->below = caution * DEPENDENT_BELOW;
    for (Py_ssize_t j = 0; j < walk->k; j++) {
        walk->correlation[j] = walk->cross[j];
        walk->descent[j] = 0.0;
        walk->open[j] = 1.0;
    }
}

typedef struct {
    double size;
    Py_ssize_t column;
} Sized;

static int by_size(const void *left, const void *right)
{
    const Sized *a = left, *b = right;
    if (a->size != b->size)
        return a->size > b->size ? -1 : 1;
    return a->column < b->column ? -1 : 1;
}

/* Start at `weights` (k,), entered largest first and without those that depend on others. */
static Outcome start_at(Walk *walk, const double *weights, double caution)
{
    Sized *order = (Sized *)walk->block;
    Py_ssize_t used = 0;
    start(walk, caution);
    for (Py_ssize_t j = 0; j < walk->k; j++)
        if (weights[j] != 0.0) {
            order[used].size = fabs(weights[j]);
            order[used++].column = j;
        }
    qsort(order, (size_t)used, sizeof(Sized), by_size);
    for (Py_ssize_t i = 0; i < used; i++) {
        Outcome outcome = enter(walk, order[i].column, weights[order[i].column] > 0 ? 1.0 : -1.0);
        if (outcome == SINGULAR || outcome == NO_MEMORY)
            return outcome;
        if (outcome == FINE)
            walk->weights[walk->n - 1] = order[i].size;
    }
    return FINE;
}

/* Walk from event to event until alpha is `goal`; adds the events, at most `limit`, to `steps`. */
static Outcome follow(Walk *walk, double alpha, double goal, Py_ssize_t limit, Py_ssize_t *steps)
{
    const Py_ssize_t k = walk->k;
    for (Py_ssize_t step = 0; step < limit; step++, ++*steps) {
        double near = FLAT * alpha + 1e-300, exit = 0.0;
        double entry = entry_rates(walk, alpha, near, walk->block);
        Py_ssize_t position = 0;
        for (Py_ssize_t i = 0; i < walk->n; i++) {
            double held = walk->weights[i] > near ? walk->weights[i] : near;
            double shrinking = -walk->slope[i] / held;
            if (shrinking > exit) {
                exit = shrinking;
                position = i;
            }
        }
        double soonest = entry > exit ? entry : exit;
        int arrived = !(soonest * (alpha - goal) > 1.0); /* a NaN ends the walk too */
        double length = arrived ? alpha - goal : 1.0 / soonest;
        add(walk->n, length, walk->slope, walk->weights);
        add(k, -length, walk->descent, walk->correlation);
        if (arrived)
            return FINE;
        alpha -= length;
        Outcome outcome;
        if (exit >= entry) {
            outcome = leave(walk, position);
        } else {
            Py_ssize_t first = 0;
            while (first < 2 * k - 1 && walk->block[first] != entry)
                first++;
            outcome = enter(walk, first % k, first < k ? 1.0 : -1.0);
        }
        if (outcome == SINGULAR || outcome == NO_MEMORY)
            return outcome;
    }
    return FINE;
}

/* correlation = c - G w, and `error` = active correlations - alpha. */
static void correlate(Walk *walk, double alpha)
{
    product_of(walk, walk->weights, walk->n, walk->correlation);
    for (Py_ssize_t j = 0; j < walk->k; j++)
        walk->correlation[j] = walk->cross[j] - walk->correlation[j];
    gather(walk, walk->correlation, walk->error);
    for (Py_ssize_t i = 0; i < walk->n; i++)
        walk->error[i] -= alpha;
}

/* Newton steps from exact correlations; the breach of optimality left, in units of the margin. */
static Outcome polish(Walk *walk, double alpha, double *breach)
{
    double margin = OPTIMAL_WITHIN * alpha + ROUNDING, slack = 0.0, smallest = 0.0, most = 0.0;
    correlate(walk, alpha);
    for (int turn = 0; turn < NEWTON_STEPS; turn++) {
        solve(walk, walk->error, walk->fix);
        add(walk->n, 1.0, walk->fix, walk->weights);
        correlate(walk, alpha);
        slack = largest(walk->error, walk->n);
        if (slack <= NEWTON_SHARE * margin)
            break;
        if (rebuilt(walk, HUGE_VAL) == SINGULAR)
            return SINGULAR;
    }
    /* The slope, where the updates have worn it: H slope = 1. */
    gather(walk, walk->descent, walk->error);
    for (Py_ssize_t i = 0; i < walk->n; i++)
        walk->error[i] = 1.0 - walk->error[i];
    if (!(largest(walk->error, walk->n) < FRESH_SLOPE_ABOVE)) {
        solve(walk, walk->error, walk->fix);
        add(walk->n, 1.0, walk->fix, walk->slope);
        product_of(walk, walk->slope, walk->n, walk->descent);
    }
    for (Py_ssize_t i = 0; i < walk->n; i++) {
        smallest = walk->weights[i] < smallest ? walk->weights[i] : smallest;
        most = walk->weights[i] > most ? walk->weights[i] : most;
        if (!(walk->weights[i] > 0.0) && !isnan(walk->weights[i]))
            walk->weights[i] = 0.0; /* an exit that lies within rounding of this alpha */
    }
    double excess = (largest(walk->correlation, walk->k) - alpha) / margin;
    double wrong = smallest < 0.0 ? -smallest / (ROUNDING * most) : 0.0;
    slack /= margin;
    *breach = slack >= 0.0 && excess == excess && wrong == wrong ? slack : HUGE_VAL;
    *breach = excess > *breach ? excess : *breach;
    *breach = wrong > *breach ? wrong : *breach;
    return FINE;
}

/* Let a dependent column in for the active one that its entering drives to zero first. */
static Outcome exchange(Walk *walk, Py_ssize_t column, double sign)
{
    double pivot, most = 0.0;
    Py_ssize_t position = -1;
    Outcome outcome = entering(walk, column, sign, &pivot);
    if (outcome == SINGULAR)
        return SINGULAR;
    for (Py_ssize_t i = 0; i < walk->n; i++) {
        double held = walk->weights[i] > 1e-300 ? walk->weights[i] : 1e-300;
        double ratio = -walk->step[i] / held;
        if (ratio > most) {
            most = ratio;
            position = i;
        }
    }
    if (position < 0)
        return FINE;
    add(walk->n, 1.0 / most, walk->step, walk->weights);
    outcome = leave(walk, position);
    if (outcome == FINE)
        outcome = enter(walk, column, sign);
    if (outcome == FINE)
        walk->weights[walk->n - 1] = 1.0 / most;
    return outcome;
}

/* Primal active set at one `alpha` from any weights: descends until no column objects. */
static Outcome settle(Walk *walk, double alpha, Py_ssize_t limit, Py_ssize_t *steps)
{
    const double enough = alpha * (1.0 + 0.1 * OPTIMAL_WITHIN) + 0.1 * ROUNDING;
    for (Py_ssize_t step = 0; step < limit; step++, ++*steps) {
        double most = 0.0, excess = 0.0;
        Py_ssize_t position = 0, column = 0;
        Outcome outcome;
        correlate(walk, alpha);
        solve(walk, walk->error, walk->fix);
        for (Py_ssize_t i = 0; i < walk->n; i++) {
            double near = FLAT * alpha + 1e-300;
            double held = walk->weights[i] > near ? walk->weights[i] : near;
            double ratio = -walk->fix[i] / held;
            if (ratio > most) {
                most = ratio;
                position = i;
            }
        }
        if (most > 1.0) {
            add(walk->n, 1.0 / most, walk->fix, walk->weights);
            outcome = leave(walk, position);
        } else {
            add(walk->n, 1.0, walk->fix, walk->weights);
            correlate(walk, alpha);
            for (Py_ssize_t j = 0; j < walk->k; j++) {
                double size = fabs(walk->correlation[j]) * walk->open[j];
                if (size > excess) {
                    excess = size;
                    column = j;
                }
            }
            if (!(excess > enough && excess > 0.0)) /* none objects, NaN or alpha < 0 */
                return FINE;
            double sign = walk->correlation[column] > 0.0 ? 1.0 : -1.0;
            outcome = enter(walk, column, sign);
            if (outcome == DEPENDENT)
                outcome = exchange(walk, column, sign);
        }
        if (outcome == SINGULAR || outcome == NO_MEMORY)
            return outcome;
    }
    return FINE;
}

static void full(const Walk *walk, double *weights)
{
    memset(weights, 0, (size_t)walk->k * sizeof(double));
    for (Py_ssize_t i = 0; i < walk->n; i++)
        weights[walk->index[i]] = walk->weights[i] * walk->sign[i];
}

/* Follow the path to `goal`; where it breaks, settle there, at last from the `known` weights.
 * `found` (k,) becomes the optimum, or else what the attempt that came closest gave. */
static Outcome reach(Walk *walk, double alpha, double goal, const double *known, double *found,
                     Py_ssize_t *steps, char *complete)
{
    const int cautions = (int)(sizeof CAUTION / sizeof CAUTION[0]);
    Py_ssize_t limit = STEPS_PER_COLUMN * walk->k + STEPS_AT_LEAST;
    double least = HOPELESS, breach;
    memcpy(found, known, (size_t)walk->k * sizeof(double));
    for (int attempt = -2; attempt < cautions; attempt++) {
        Outcome outcome = FINE;
        if (attempt == -2) {
            outcome = follow(walk, alpha, goal, limit, steps);
        } else {
            if (attempt >= 0)
                outcome = start_at(walk, known, CAUTION[attempt]);
            if (outcome == FINE)
                outcome = settle(walk, goal, limit, steps);
        }
        if (outcome == FINE)
            outcome = polish(walk, goal, &breach);
        if (outcome == NO_MEMORY)
            return NO_MEMORY;
        if (outcome != FINE)
            continue;
        if (breach < least) {
            full(walk, found);
            least = breach;
        }
        if (breach <= 1.0) {
            *complete = 1;
            return FINE;
        }
    }
    return FINE;
}

/* Every penalty in turn: weights (p, k), complete (p,). */
static Outcome visit(Walk *walk, const double *alphas, Py_ssize_t points, double *weights,
                     char *complete, Py_ssize_t *steps)
{
    double alpha = largest(walk->cross, walk->k);
    const double *known = NULL;
    for (Py_ssize_t p = 0; p < points; p++) {
        double *found = weights + p * walk->k;
        if (!known) {
            if (alphas[p] >= alpha) {
                complete[p] = 1; /* `weights` came as zeros */
                continue;
            }
            known = walk->zero;
        }
        Outcome outcome = reach(walk, alpha, alphas[p], known, found, steps, complete + p);
        if (outcome != FINE)
            return outcome;
        alpha = alphas[p];
        known = complete[p] ? found : known;
    }
    return FINE;
}

/* Room for everything but the inverse, in one piece. */
static double *furnish(Walk *walk)
{
    const size_t each = (size_t)walk->k + 1, width = sizeof(double);
    double *whole = calloc(18 * each, width);
    double *at = whole;
    if (!whole)
        return NULL;
    double **arrays[] = {&walk->sign,  &walk->weights, &walk->slope, &walk->correlation,
                         &walk->descent, &walk->open,  &walk->step,  &walk->product,
                         &walk->error, &walk->fix,     &walk->coefficient, &walk->spare,
                         &walk->zero};
    for (size_t i = 0; i < sizeof arrays / sizeof arrays[0]; i++, at += each)
        *arrays[i] = at;
    walk->block = at, at += 2 * each;
    walk->index = (Py_ssize_t *)at, at += each;
    walk->waiting = (Py_ssize_t *)at, at += each;
    walk->row = (const double **)at;
    return whole;
}

/* ---- Python -------------------------------------------------------------------------------- */

static PyObject *path(PyObject *module, PyObject *arguments)
{
    PyObject *objects[5];
    Py_buffer views[5];
    int got = 0;
    (void)module;
    if (!PyArg_UnpackTuple(arguments, "path", 5, 5, &objects[0], &objects[1], &objects[2],
                           &objects[3], &objects[4]))
        return NULL;
    for (; got < 5; got++)
        if (PyObject_GetBuffer(objects[got], &views[got],
                               got < 3 ? PyBUF_C_CONTIGUOUS : PyBUF_C_CONTIGUOUS | PyBUF_WRITABLE))
            goto release;
    {
        const Py_ssize_t width = (Py_ssize_t)sizeof(double);
        Py_ssize_t k = views[1].len / width, points = views[2].len / width, steps = 0;
        Outcome outcome = NO_MEMORY;
        Walk walk = {0};
        if (views[0].len != k * k * width || views[3].len != points * k * width ||
            views[4].len != points) {
            PyErr_SetString(PyExc_ValueError,
                            "path wants gram (k, k), cross (k,), alphas (p,), weights (p, k) of "
                            "float64 and complete (p,) of bool");
            goto release;
        }
        walk.k = k;
        walk.gram = views[0].buf;
        walk.cross = views[1].buf;
        Py_BEGIN_ALLOW_THREADS
        double *room = furnish(&walk);
        if (room) {
            start(&walk, 1.0);
            outcome = visit(&walk, views[2].buf, points, views[3].buf, views[4].buf, &steps);
        }
        free(walk.inverse);
        free(room);
        Py_END_ALLOW_THREADS
        while (got)
            PyBuffer_Release(&views[--got]);
        return outcome == FINE ? PyLong_FromSsize_t(steps) : PyErr_NoMemory();
    }
release:
    while (got)
        PyBuffer_Release(&views[--got]);
    return NULL;
}

static PyMethodDef methods[] = {
    {"path", path, METH_VARARGS,
     "path(gram, cross, alphas, weights, complete) -> steps; weights and complete, given as\n"
     "zeros, are filled in."},
    {NULL, NULL, 0, NULL}};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_homotopy", "The LASSO path, compiled.", 0, methods, slots,
    NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__homotopy(void)
{
    return PyModuleDef_Init(&definition);
}
