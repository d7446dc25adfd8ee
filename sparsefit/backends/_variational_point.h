/* One point of the variational group-LASSO: objective, residual correlation and Hessian at eta.

   Notation as in variational.py, the same algorithm in variational_point.py. Arrays (k, n) and
   (c, n) are stored by columns: element (j, t) of a (k, n) array is at j + t k. */

#ifndef SPARSEFIT_VARIATIONAL_POINT_H
#define SPARSEFIT_VARIATIONAL_POINT_H

#include "_variational_dense.h"

static const double LOST = 1e-14; /* of the terms of a curvature, which may cancel */

typedef struct { /* contiguous groups of penalty weight one, |Y|^2/m = 1 */
    const Dense *dense;
    const double *gram, *cross;
    const long long *starts; /* groups + 1 of them */
    double *power;           /* tr G_gg */
    int columns, targets, groups;
} Problem;

typedef struct {
    double *eta;           /* (g) */
    int *group;            /* the groups with eta > 0, ascending: `groups` of them */
    int *label, *column;   /* of each of the `columns` columns of these groups */
    int groups, columns;
    double *root, *inner, *weights; /* (c), (c, n), (c, n) */
    double *correlation;   /* (k, n) */
    double *factor;        /* (c, c) */
    double *half;          /* (c n, groups) */
    double *hessian;       /* (groups, groups) */
    double value;
    size_t factor_room, half_room, hessian_room;
} Point;

static int first(const Problem *p, int group) { return (int)p->starts[group]; }

static int size_of(const Problem *p, int group)
{
    return (int)(p->starts[group + 1] - p->starts[group]);
}

/* Makes room for `size` numbers, contents lost; 0 where memory is out. */
static int reserve(double **array, size_t *room, size_t size)
{
    if (size <= *room)
        return 1;
    free(*array);
    *room = size + size / 2;
    *array = malloc(*room * sizeof(double));
    if (!*array)
        *room = 0;
    return *array != NULL;
}

/* Squared Frobenius norm of every group's rows, (k, n) -> (g). */
static void all_squares(const Problem *p, const double *matrix, double *square)
{
    for (int g = 0; g < p->groups; g++) {
        square[g] = 0.0;
        for (int t = 0; t < p->targets; t++)
            for (int j = first(p, g); j < first(p, g + 1); j++)
                square[g] += matrix[j + (size_t)t * p->columns]
                             * matrix[j + (size_t)t * p->columns];
    }
}

/* The same for rows (c, n) of the support. */
static void support_squares(const Problem *p, const Point *x, const double *matrix,
                            double *square)
{
    memset(square, 0, x->groups * sizeof(double));
    for (int t = 0; t < p->targets; t++)
        for (int i = 0; i < x->columns; i++) {
            double value = matrix[i + (size_t)t * x->columns];
            square[x->label[i]] += value * value;
        }
}

/* B - G W for weights (c, n) on the support: a product for every run of adjacent groups. */
static void correlate(const Problem *p, const Point *x, const double *weights, double *result)
{
    int k = p->columns, c = x->columns;
    memcpy(result, p->cross, (size_t)k * p->targets * sizeof(double));
    for (int i = 0, end; i < c; i = end) {
        for (end = i + 1; end < c && x->column[end] == x->column[end - 1] + 1; end++)
            ;
        multiply(p->dense, 'N', k, p->targets, end - i, -1.0,
                 p->gram + (size_t)x->column[i] * k, k, weights + i, c, 1.0, result, k);
    }
}

/* Columns L^-1 [0; x_g; 0] of the support's groups, one for each group and target. Rows above a
   group's own stay zero, so groups are solved in parts with what is left of L. */
static void solve_half(const Problem *p, Point *x)
{
    int c = x->columns, n = p->targets, part = x->columns > 96 ? (x->groups + 3) / 4 : x->groups;
    memset(x->half, 0, (size_t)c * n * x->groups * sizeof(double));
    for (int t = 0; t < n; t++)
        for (int i = 0; i < c; i++)
            x->half[i + (size_t)c * (t + (size_t)n * x->label[i])] = x->inner[i + (size_t)t * c];
    for (int g = 0, above = 0; g < x->groups; g += part) {
        int count = g + part < x->groups ? part : x->groups - g;
        while (x->label[above] < g)
            above++;
        forward(p->dense, c - above, n * count, x->factor + (size_t)above * (c + 1), c,
                x->half + (size_t)c * n * g + above, c);
    }
}

/* Point at x->eta, which is set: 1, or 0 if the factorisation fails, or -1 where memory is out.

   With A = I + D^1/2 G D^1/2 = LL': C = D^-1/2 A^-1 D^1/2 B on the support, and its Hessian is
   that of K = D^-1/2 (I - A^-1) D^-1/2, which needs no product with G. */
static int evaluate(const Problem *p, Point *x)
{
    int k = p->columns, n = p->targets, c = 0, s = 0;
    for (int g = 0; g < p->groups; g++)
        if (x->eta[g] > 0.0) {
            for (int j = first(p, g); j < first(p, g + 1); j++, c++) {
                x->label[c] = s;
                x->column[c] = j;
                x->root[c] = sqrt(x->eta[g]);
            }
            x->group[s++] = g;
        }
    x->groups = s;
    x->columns = c;
    x->value = 0.0;
    if (!reserve(&x->factor, &x->factor_room, (size_t)c * c + 1)
        || !reserve(&x->half, &x->half_room, (size_t)c * n * s + 1)
        || !reserve(&x->hessian, &x->hessian_room, (size_t)s * s + 1))
        return -1;
    for (int j = 0; j < c; j++) {
        const double *row = p->gram + (size_t)x->column[j] * k;
        double *below = x->factor + (size_t)j * c;
        for (int i = j, end; i < c; i = end) { /* a group's columns are adjacent */
            const double *from = row + x->column[i] - i;
            double scale = x->root[i] * x->root[j];
            end = i + (int)p->starts[x->group[x->label[i]] + 1] - x->column[i];
            for (int to = i; to < end; to++)
                below[to] = from[to] * scale;
        }
        below[j] += 1.0;
    }
    if (c && factorise(p->dense, c, x->factor))
        return 0;
    for (int t = 0; t < n; t++)
        for (int i = 0; i < c; i++)
            x->inner[i + (size_t)t * c] =
                x->root[i] * p->cross[x->column[i] + (size_t)t * k];
    if (c)
        solve(p->dense, c, n, x->factor, x->inner);
    for (int t = 0; t < n; t++)
        for (int i = 0; i < c; i++) {
            size_t at = i + (size_t)t * c;
            x->weights[at] = x->root[i] * x->inner[at];
            x->inner[at] /= x->root[i];
            x->value -= 0.5 * p->cross[x->column[i] + (size_t)t * k] * x->weights[at];
        }
    correlate(p, x, x->weights, x->correlation);
    if (!c)
        return 1;
    solve_half(p, x);
    char lower = 'L', transposed = 'T';
    int rows = c * n;
    double minus = -1.0, zero = 0.0;
    p->dense->syrk(&lower, &transposed, &s, &rows, &minus, x->half, &rows, &zero, x->hessian, &s);
    for (int i = 0; i < c; i++)
        for (int t = 0; t < n; t++)
            x->hessian[(size_t)x->label[i] * (s + 1)] +=
                (1.0 + LOST) * x->inner[i + (size_t)t * c] * x->inner[i + (size_t)t * c];
    for (int a = 0; a < s; a++)
        for (int b = a; b < s; b++)
            x->hessian[(size_t)a * s + b] = x->hessian[(size_t)b * s + a] =
                x->hessian[(size_t)a * s + b] / sqrt(x->eta[x->group[a]]) / sqrt(x->eta[x->group[b]]);
    return 1;
}

/* Hessian on the support and `count` new groups: K = G - V'V there, V = L^-1 D^1/2 G.
   products: (k, n, count) scratch; coupling: (c n, count) scratch; total = groups + count. */
static void bordered(const Problem *p, const Point *x, const int *new, int count,
                     double *products, double *coupling, double *hessian)
{
    int k = p->columns, n = p->targets, c = x->columns, s = x->groups, total = s + count;
    for (int h = 0; h < count; h++) {
        double *product = products + (size_t)k * n * h;
        multiply(p->dense, 'N', k, n, size_of(p, new[h]), 1.0,
                 p->gram + (size_t)first(p, new[h]) * k, k, x->correlation + first(p, new[h]), k,
                 0.0, product, k);
        for (int t = 0; t < n; t++)
            for (int i = 0; i < c; i++)
                coupling[i + (size_t)c * (t + (size_t)n * h)] =
                    x->root[i] * product[x->column[i] + (size_t)t * k];
    }
    forward(p->dense, c, n * count, x->factor, c, coupling, c);
    for (int a = 0; a < s; a++)
        memcpy(hessian + (size_t)a * total, x->hessian + (size_t)a * s, s * sizeof(double));
    multiply(p->dense, 'T', count, s, c * n, 1.0, coupling, c * n, x->half, c * n, 0.0,
             hessian + s, total);
    for (int h = 0; h < count; h++)
        for (int g = 0; g < count; g++) {
            double sum = 0.0;
            for (int t = 0; t < n; t++)
                for (int j = first(p, new[g]); j < first(p, new[g] + 1); j++)
                    sum += x->correlation[j + (size_t)t * k]
                           * products[j + (size_t)k * (t + (size_t)n * h)];
            hessian[(size_t)(s + h) * total + s + g] = sum;
        }
    multiply(p->dense, 'T', count, count, c * n, -1.0, coupling, c * n, coupling, c * n, 1.0,
             hessian + (size_t)s * total + s, total);
    for (int a = 0; a < s; a++)
        for (int h = 0; h < count; h++)
            hessian[(size_t)(s + h) * total + a] = hessian[(size_t)a * total + s + h] /=
                sqrt(x->eta[x->group[a]]);
}

#endif
