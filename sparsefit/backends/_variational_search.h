/* The search along the path: Newton and chord steps on eta. The same algorithm in Python, where
   every step is explained, is variational.py. */

#ifndef SPARSEFIT_VARIATIONAL_SEARCH_H
#define SPARSEFIT_VARIATIONAL_SEARCH_H

#include "_variational_point.h"

enum { NEW_GROUPS = 8, ITERATIONS = 80, CHORDS = 8, HALVINGS = 30 };
static const double NEGLIGIBLE = 1e-11, FLOOR = 1e-15, POOR = 1e-3;

typedef struct {
    const Problem *problem;
    double alpha, goal;
    Point points[2];
    int now; /* which of the two is the present point */
    Bounded bounded;
    double *inner, *pushed, *trial_weights, *trial_correlation; /* of a chord step */
    double *weights, *correlation, *eta;                        /* of the best chord step */
    double gap;
    double *best_weights; /* (k, n), of the best at this penalty */
    double best_gap;
    double *square, *all_square, *drive, *lower, *step, *width;
    double *products, *coupling, *hessian;
    int fresh[NEW_GROUPS], count; /* groups about to enter */
    double *numbers;
    int *integers;
    char *flags;
} Search;

/* Relative duality gap of W with dual point s R: (1-s)^2 R'R + 2 (alpha |W| - s <C, W>). */
static double relative_gap(const Search *z, const Point *x, const double *weights,
                           const double *correlation)
{
    const Problem *p = z->problem;
    double top = 0.0, product = 0.0, explained = 0.0, norm = 0.0;
    all_squares(p, correlation, z->all_square);
    for (int g = 0; g < p->groups; g++)
        top = z->all_square[g] > top || z->all_square[g] != z->all_square[g] ? z->all_square[g]
                                                                             : top;
    top = sqrt(top);
    double shrink = top <= z->alpha ? 1.0 : z->alpha / top;
    for (int t = 0; t < p->targets; t++)
        for (int i = 0; i < x->columns; i++) {
            double weight = weights[i + (size_t)t * x->columns];
            size_t at = x->column[i] + (size_t)t * p->columns;
            product += weight * correlation[at];
            explained += weight * p->cross[at];
        }
    support_squares(p, x, weights, z->square);
    for (int a = 0; a < x->groups; a++)
        norm += sqrt(z->square[a]);
    double residual = fmax(0.0, 1.0 - explained - product);
    double gap = residual * (1.0 - shrink) * (1.0 - shrink)
                 + 2.0 * (z->alpha * norm - shrink * product);
    return gap < 0.0 ? 0.0 : gap;
}

/* Right-hand side of the Newton system for 1/||C|| = 1/alpha, or of the gradient of f. */
static double drive_of(double square, double alpha, int secular)
{
    return secular ? square * (sqrt(square) / alpha - 1.0) : 0.5 * (square - alpha * alpha);
}

/* What rounding left just above the bound is zero. */
static double moved(const Problem *p, int group, double value)
{
    return value * p->power[group] > NEGLIGIBLE ? value : 0.0;
}

static void scatter(const Problem *p, const Point *x, const double *rows, double *full)
{
    memset(full, 0, (size_t)p->columns * p->targets * sizeof(double));
    for (int t = 0; t < p->targets; t++)
        for (int i = 0; i < x->columns; i++)
            full[x->column[i] + (size_t)t * p->columns] = rows[i + (size_t)t * x->columns];
}

static void keep(Search *z, const Point *x, const double *weights, const double *correlation)
{
    const Problem *p = z->problem;
    scatter(p, x, weights, z->weights);
    memcpy(z->correlation, correlation, (size_t)p->columns * p->targets * sizeof(double));
}

/* Newton step on the support, then chord steps on the same factor while they pay. */
static void predict(Search *z)
{
    const Problem *p = z->problem;
    const Point *x = &z->points[z->now];
    int c = x->columns, n = p->targets, s = x->groups;
    memcpy(z->eta, x->eta, p->groups * sizeof(double));
    keep(z, x, x->weights, x->correlation);
    z->gap = s ? INFINITY : relative_gap(z, x, x->weights, x->correlation);
    memcpy(z->inner, x->inner, (size_t)c * n * sizeof(double));
    for (int a = 0; a < s; a++)
        z->width[a] = x->eta[x->group[a]];
    for (int chord = 0; s && chord <= CHORDS; chord++) {
        support_squares(p, x, z->inner, z->square);
        for (int a = 0; a < s; a++) {
            z->drive[a] = drive_of(z->square[a], z->alpha, 1);
            z->lower[a] = -z->width[a];
        }
        bounded_minimum(p->dense, &z->bounded, s, x->hessian, z->drive, z->lower, z->step);
        for (int t = 0; t < n; t++)
            for (int i = 0; i < c; i++) {
                size_t at = i + (size_t)t * c;
                z->pushed[at] = z->step[x->label[i]] * z->inner[at] / x->root[i];
                z->inner[at] -= z->pushed[at] / x->root[i];
            }
        solve(p->dense, c, n, x->factor, z->pushed);
        for (int a = 0; a < s; a++)
            z->width[a] = fmax(z->width[a] + z->step[a], 0.0);
        for (int t = 0; t < n; t++)
            for (int i = 0; i < c; i++) {
                size_t at = i + (size_t)t * c;
                z->inner[at] += z->pushed[at] / x->root[i];
                z->trial_weights[at] = z->width[x->label[i]] * z->inner[at];
            }
        correlate(p, x, z->trial_weights, z->trial_correlation);
        double gap = relative_gap(z, x, z->trial_weights, z->trial_correlation);
        if (!(gap < 0.4 * z->gap))
            break;
        keep(z, x, z->trial_weights, z->trial_correlation);
        z->gap = gap;
        for (int a = 0; a < s; a++)
            z->eta[x->group[a]] = moved(p, x->group[a], z->width[a]);
        if (gap <= z->goal || gap > POOR)
            break;
        for (int t = 0; t < n; t++)
            for (int i = 0; i < c; i++) {
                size_t at = i + (size_t)t * c;
                double defect = z->correlation[x->column[i] + (size_t)t * p->columns];
                z->pushed[at] = x->root[i] * (defect - z->inner[at]);
            }
        solve(p->dense, c, n, x->factor, z->pushed);
        for (int t = 0; t < n; t++)
            for (int i = 0; i < c; i++)
                z->inner[i + (size_t)t * c] += z->pushed[i + (size_t)t * c] / x->root[i];
    }
}

/* Groups at eta = 0 whose correlation exceeds alpha, the worst few, ascending. */
static void find_violators(Search *z)
{
    const Problem *p = z->problem;
    const double *eta = z->points[z->now].eta, *square = z->all_square;
    all_squares(p, z->correlation, z->all_square);
    z->count = 0;
    for (int g = 0; g < p->groups; g++) {
        if (eta[g] > 0.0 || !(square[g] > z->alpha * z->alpha))
            continue;
        if (z->count == NEW_GROUPS) { /* the least of them makes way */
            int least = 0;
            for (int i = 1; i < NEW_GROUPS; i++)
                if (square[z->fresh[i]] <= square[z->fresh[least]])
                    least = i;
            if (square[z->fresh[least]] >= square[g])
                continue;
            for (int i = least; i + 1 < NEW_GROUPS; i++)
                z->fresh[i] = z->fresh[i + 1];
            z->count--;
        }
        z->fresh[z->count++] = g;
    }
}

/* z->eta: after the bounded Newton step on the support and the fresh groups together. */
static void enlarge(Search *z, int secular)
{
    const Problem *p = z->problem;
    const Point *x = &z->points[z->now];
    int s = x->groups, total = s + z->count;
    const double *hessian = x->hessian;
    if (z->count) {
        bordered(p, x, z->fresh, z->count, z->products, z->coupling, z->hessian);
        hessian = z->hessian;
    }
    support_squares(p, x, x->inner, z->square);
    all_squares(p, x->correlation, z->all_square);
    for (int a = 0; a < total; a++) {
        double square = a < s ? z->square[a] : z->all_square[z->fresh[a - s]];
        z->drive[a] = drive_of(square, z->alpha, secular);
        z->lower[a] = a < s ? -x->eta[x->group[a]] : 0.0;
    }
    bounded_minimum(p->dense, &z->bounded, total, hessian, z->drive, z->lower, z->step);
    memcpy(z->eta, x->eta, p->groups * sizeof(double));
    for (int a = 0; a < total; a++) {
        int g = a < s ? x->group[a] : z->fresh[a - s];
        z->eta[g] = moved(p, g, x->eta[g] + z->step[a]);
    }
}

static double objective(const Search *z, const Point *x)
{
    double sum = 0.0;
    for (int g = 0; g < z->problem->groups; g++)
        sum += x->eta[g];
    return x->value + 0.5 * z->alpha * z->alpha * sum;
}

/* The point at z->eta if f does not rise there, else at a halved plain Newton step: 1; 0 where
   there is none, -1 where memory is out. */
static int accept(Search *z)
{
    const Problem *p = z->problem;
    const Point *x = &z->points[z->now];
    Point *next = &z->points[1 - z->now];
    double bound = objective(z, x), share = 1.0;
    int plain = 0;
    bound += 1e-13 * fabs(bound);
    for (int trial = 0; trial < HALVINGS; trial++) {
        for (int g = 0; g < p->groups; g++)
            next->eta[g] = x->eta[g] + share * (z->eta[g] - x->eta[g]);
        int done = evaluate(p, next);
        if (done < 0)
            return -1;
        if (done && objective(z, next) <= bound) {
            z->now = 1 - z->now;
            return 1;
        }
        if (plain)
            share *= 0.5;
        else /* only the plain step is sure to descend */
            enlarge(z, 0);
        plain = 1;
    }
    return 0;
}

/* Newton steps on eta until weights certified to the goal are found: factorisations spent. */
static int minimise(Search *z)
{
    const Problem *p = z->problem;
    size_t bytes = (size_t)p->columns * p->targets * sizeof(double);
    int iteration, stuck = 0;
    z->best_gap = INFINITY;
    for (iteration = 0; iteration < ITERATIONS && !stuck; iteration++) {
        predict(z);
        if (iteration == 0 || z->gap < z->best_gap) {
            z->best_gap = z->gap;
            memcpy(z->best_weights, z->weights, bytes);
        }
        if (z->best_gap <= z->goal)
            return iteration;
        find_violators(z);
        if (z->count)
            enlarge(z, 1);
        int moved_on = accept(z);
        if (moved_on < 0)
            return -1;
        stuck = !moved_on;
    }
    const Point *x = &z->points[z->now];
    double gap = relative_gap(z, x, x->weights, x->correlation);
    if (gap < z->best_gap) {
        z->best_gap = gap;
        scatter(p, x, x->weights, z->best_weights);
    }
    return iteration;
}

#endif
