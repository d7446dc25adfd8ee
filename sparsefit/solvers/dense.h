/* The loops over whole arrays that are worth the widest vectors the processor has: GCC makes a
 * form for each and picks one at run time.
 */
#ifndef SPARSEFIT_DENSE_H
#define SPARSEFIT_DENSE_H

#include <stddef.h>

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("O3")
#endif
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__GLIBC__)
#define WIDE __attribute__((unused, target_clones("avx512f", "arch=haswell", "default")))
#elif defined(__GNUC__)
#define WIDE __attribute__((unused))
#else
#define WIDE
#endif
#if defined(_MSC_VER)
#define RESTRICT __restrict
#else
#define RESTRICT restrict
#endif

enum { LANES = 8, STRIP = 1024 }; /* columns per pass: the sum stays in the first-level cache */

/* out (width) = sum_i a_i sign_i row_i, with rows `index` of the matrix; without: all, sign 1 */
WIDE static void wide_combine(const double *matrix, Py_ssize_t stride, const Py_ssize_t *index,
                              const double *sign, const double *a, Py_ssize_t n,
                              Py_ssize_t width, double *RESTRICT out)
{
#define ROW(i) (matrix + (index ? index[i] : (i)) * stride + from)
#define SHARE(i) (sign ? a[i] * sign[i] : a[i])
    for (Py_ssize_t from = 0; from < width; from += STRIP) {
        Py_ssize_t w = width - from < STRIP ? width - from : STRIP, i = 0;
        double *RESTRICT o = out + from;
        for (Py_ssize_t j = 0; j < w; j++)
            o[j] = 0.0;
        for (; i + 4 <= n; i += 4) {
            const double *RESTRICT r0 = ROW(i), *RESTRICT r1 = ROW(i + 1);
            const double *RESTRICT r2 = ROW(i + 2), *RESTRICT r3 = ROW(i + 3);
            double a0 = SHARE(i), a1 = SHARE(i + 1), a2 = SHARE(i + 2), a3 = SHARE(i + 3);
            for (Py_ssize_t j = 0; j < w; j++)
                o[j] += (a0 * r0[j] + a1 * r1[j]) + (a2 * r2[j] + a3 * r3[j]);
        }
        for (; i < n; i++) {
            const double *RESTRICT r = ROW(i);
            double a0 = SHARE(i);
            for (Py_ssize_t j = 0; j < w; j++)
                o[j] += a0 * r[j];
        }
    }
#undef ROW
#undef SHARE
}

/* y (n) += a x */
WIDE static void wide_add(Py_ssize_t n, double a, const double *RESTRICT x, double *RESTRICT y)
{
    for (Py_ssize_t i = 0; i < n; i++)
        y[i] += a * x[i];
}

/* M (n x n) += a x x' */
WIDE static void wide_rank_one(Py_ssize_t n, double a, const double *RESTRICT x,
                               double *RESTRICT m, Py_ssize_t stride)
{
    for (Py_ssize_t i = 0; i < n; i++) {
        double *RESTRICT line = m + i * stride;
        double ax = a * x[i];
        for (Py_ssize_t j = 0; j < n; j++)
            line[j] += ax * x[j];
    }
}

/* Events per unit of alpha of columns outside, at +alpha and at -alpha (2k); the largest. */
WIDE static double wide_rates(Py_ssize_t k, const double *RESTRICT c, const double *RESTRICT d,
                              const double *RESTRICT open, double alpha, double near,
                              double *RESTRICT rate)
{
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

#endif
