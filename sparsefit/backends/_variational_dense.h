/* Dense linear algebra for `_variational`: BLAS and LAPACK as scipy exports them, and the
   bound-constrained quadratic subproblem of a Newton step. All matrices are stored by columns.

   The same algorithm in Python: variational_step.py. Source: Nocedal and Wright, "Numerical
   Optimization" (2006), section 16.5. */

#ifndef SPARSEFIT_VARIATIONAL_DENSE_H
#define SPARSEFIT_VARIATIONAL_DENSE_H

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef void (*Gemm)(char *, char *, int *, int *, int *, double *, double *, int *, double *,
                     int *, double *, double *, int *);
typedef void (*Syrk)(char *, char *, int *, int *, double *, double *, int *, double *, double *,
                     int *);
typedef void (*Trsm)(char *, char *, char *, char *, int *, int *, double *, double *, int *,
                     double *, int *);
typedef void (*Gemv)(char *, int *, int *, double *, double *, int *, double *, int *, double *,
                     double *, int *);
typedef void (*Trsv)(char *, char *, char *, int *, double *, int *, double *, int *);
typedef void (*Potrf)(char *, int *, double *, int *, int *);
typedef void (*Potrs)(char *, int *, int *, double *, int *, double *, int *, int *);

enum { FEW = 4 }; /* columns up to which a product each is faster than packing the matrix */

typedef struct {
    Gemm gemm;
    Syrk syrk;
    Trsm trsm;
    Gemv gemv;
    Trsv trsv;
    Potrf potrf;
    Potrs potrs;
} Dense;

/* C = alpha op(A) B + beta C */
static void multiply(const Dense *d, char op, int m, int n, int k, double alpha, const double *a,
                     int lda, const double *b, int ldb, double beta, double *c, int ldc)
{
    char plain = 'N';
    int one = 1, rows = op == 'N' ? m : k, columns = op == 'N' ? k : m;
    if (m <= 0 || n <= 0 || k <= 0)
        return;
    if (n <= FEW)
        for (int t = 0; t < n; t++)
            d->gemv(&op, &rows, &columns, &alpha, (double *)a, &lda, (double *)b + (size_t)t * ldb,
                    &one, &beta, c + (size_t)t * ldc, &one);
    else
        d->gemm(&op, &plain, &m, &n, &k, &alpha, (double *)a, &lda, (double *)b, &ldb, &beta, c,
                &ldc);
}

/* B = L^-1 B */
static void forward(const Dense *d, int m, int n, const double *factor, int lda, double *b,
                    int ldb)
{
    char left = 'L', lower = 'L', plain = 'N', diagonal = 'N';
    double one = 1.0;
    if (m > 0 && n > 0)
        d->trsm(&left, &lower, &plain, &diagonal, &m, &n, &one, (double *)factor, &lda, b, &ldb);
}

/* LL' = A in place, lower triangle; 0 where it worked */
static int factorise(const Dense *d, int n, double *a)
{
    char lower = 'L';
    int failed = 0;
    d->potrf(&lower, &n, a, &n, &failed);
    return failed;
}

/* B = (LL')^-1 B */
static void solve(const Dense *d, int n, int columns, const double *factor, double *b)
{
    char lower = 'L', plain = 'N', transposed = 'T';
    int failed = 0, one = 1;
    if (columns > FEW) {
        d->potrs(&lower, &n, &columns, (double *)factor, &n, b, &n, &failed);
        return;
    }
    for (int t = 0; t < columns; t++) {
        double *x = b + (size_t)t * n;
        d->trsv(&lower, &plain, &plain, &n, (double *)factor, &n, x, &one);
        d->trsv(&lower, &transposed, &plain, &n, (double *)factor, &n, x, &one);
    }
}

typedef struct { /* scratch of bounded_minimum for up to `size` variables */
    double *unit, *block, *scale, *pull, *floor, *x, *target, *rhs;
    char *free;
    int *inside;
} Bounded;

/* Minimiser over the free coordinates, the others fixed; a larger ridge where singular. */
static void face_minimum(const Dense *d, const Bounded *w, int n)
{
    int count = 0, failed;
    double ridge = 1e-12, added = 0.0;
    for (int i = 0; i < n; i++)
        if (w->free[i])
            w->inside[count++] = i;
    if (!count)
        return;
    do {
        for (int a = 0; a < count; a++) {
            const double *column = w->unit + (size_t)w->inside[a] * n;
            double sum = w->pull[w->inside[a]];
            for (int i = 0; i < n; i++)
                if (!w->free[i])
                    sum -= column[i] * w->x[i];
            w->rhs[a] = sum;
            for (int b = a; b < count; b++)
                w->block[(size_t)a * count + b] = column[w->inside[b]];
            w->block[(size_t)a * count + a] += added;
        }
        failed = factorise(d, count, w->block);
        added += ridge;
        ridge *= 10.0;
    } while (failed && ridge <= 10.0);
    if (!failed)
        solve(d, count, 1, w->block, w->rhs);
    for (int a = 0; a < count; a++)
        w->target[w->inside[a]] = w->rhs[a];
}

/* Primal active set: move towards each face's minimiser, stop at the first bound met. */
static void active_set(const Dense *d, const Bounded *w, int n)
{
    double peak = 0.0;
    for (int i = 0; i < n; i++) {
        w->x[i] = 0.0;
        peak = fmax(peak, fabs(w->pull[i]));
    }
    for (int turn = 0; turn < 10 * n + 10; turn++) {
        double reach = INFINITY;
        memcpy(w->target, w->x, n * sizeof(double));
        face_minimum(d, w, n);
        for (int i = 0; i < n; i++)
            if (w->free[i] && w->target[i] < w->floor[i])
                reach = fmin(reach, (w->floor[i] - w->x[i]) / (w->target[i] - w->x[i]));
        if (reach < INFINITY) {
            for (int i = 0; i < n; i++) {
                double move = w->target[i] - w->x[i];
                int hit = w->free[i] && w->target[i] < w->floor[i]
                          && (w->floor[i] - w->x[i]) / move <= reach;
                w->x[i] = hit ? w->floor[i] : w->x[i] + reach * move;
                if (hit)
                    w->free[i] = 0;
            }
            continue;
        }
        memcpy(w->x, w->target, n * sizeof(double));
        int worst = -1;
        double most = 1e-13 * peak;
        for (int i = 0; i < n; i++) {
            if (w->free[i])
                continue;
            double pull = w->pull[i];
            for (int j = 0; j < n; j++)
                pull -= w->unit[(size_t)i * n + j] * w->x[j];
            if (pull > most) {
                most = pull;
                worst = i;
            }
        }
        if (worst < 0)
            break;
        w->free[worst] = 1;
    }
}

/* Minimise x'Hx/2 - drive'x over x >= lower (lower <= 0). Unit diagonal and a ridge of rounding
   size: duplicated groups make H singular. */
static void bounded_minimum(const Dense *d, const Bounded *w, int n, const double *hessian,
                            const double *drive, const double *lower, double *x)
{
    int inside = 1;
    if (n <= 0) /* LAPACK refuses an empty matrix aloud */
        return;
    for (int i = 0; i < n; i++) {
        w->scale[i] = 1.0 / sqrt(fmax(hessian[(size_t)i * n + i], DBL_MIN));
        w->pull[i] = w->target[i] = drive[i] * w->scale[i];
        w->floor[i] = lower[i] / w->scale[i];
    }
    for (int j = 0; j < n; j++) {
        for (int i = 0; i < n; i++)
            w->unit[(size_t)j * n + i] = hessian[(size_t)j * n + i] * (w->scale[i] * w->scale[j]);
        w->unit[(size_t)j * n + j] += 1e-13;
    }
    memcpy(w->block, w->unit, (size_t)n * n * sizeof(double));
    int failed = factorise(d, n, w->block);
    if (!failed) {
        solve(d, n, 1, w->block, w->target);
        for (int i = 0; i < n; i++)
            inside = inside && w->target[i] >= w->floor[i];
    }
    if (failed || !inside) {
        for (int i = 0; i < n; i++)
            w->free[i] = w->floor[i] < 0.0 || (failed ? drive[i] > 0.0 : w->target[i] > 0.0);
        active_set(d, w, n);
        memcpy(w->target, w->x, n * sizeof(double));
    }
    for (int i = 0; i < n; i++)
        x[i] = w->target[i] * w->scale[i];
}

#endif
