/* Z'Z, Z'Y and the squares of Y in one pass over the rows, on CPUs with AVX-512.
 *
 * Public BLAS builds leave AVX-512 unused on AMD CPUs that have it, and never form both products
 * at once; on Intel's they are as fast as this, so there it is not `preferred`.  Rows are packed, a block at a time, into panels of 8 columns of [Z, Y] that stay in
 * cache; the kernel sums 8 x 24 products in registers (Goto and van de Geijn, ACM Trans. Math.
 * Softw. 34 (2008) 12).  On other CPUs `supported` is false and numpy's product is used.
 * The stable interface; works without the global interpreter lock.
 */
#include <Python.h>

#include <stdlib.h>
#include <string.h>

#if defined(__GNUC__) && defined(__x86_64__) && !defined(_WIN32)
#define BUILT 1
#else
#define BUILT 0
#endif

#if BUILT
#if !defined(__clang__)
#pragma GCC optimize("O3")
#endif
#define WIDE __attribute__((target("avx512f,fma")))
#define LANES 8 /* columns of a panel */
#define ACROSS 3 /* panels of a tile */
#define ROWS 128 /* of a block: a tile's three panels fill half of the first-level cache */

typedef double Lane __attribute__((vector_size(64)));
typedef double Loose __attribute__((vector_size(64), aligned(8))); /* where rows may start */

/* sums (8 x 24, rows `stride` apart) += a'b over a block: a one panel, b three. */
WIDE static void tile(const double *restrict a, const double *restrict b, Py_ssize_t rows,
                      double *restrict sums, Py_ssize_t stride)
{
    Lane s[LANES][ACROSS] = {{{0}}};
    for (Py_ssize_t r = 0; r < rows; r++) {
        const Lane b0 = *(const Lane *)(b + LANES * r);
        const Lane b1 = *(const Lane *)(b + LANES * (ROWS + r));
        const Lane b2 = *(const Lane *)(b + LANES * (2 * ROWS + r));
#pragma GCC unroll 8
        for (int i = 0; i < LANES; i++) {
            const double x = a[LANES * r + i];
            const Lane v = {x, x, x, x, x, x, x, x};
            s[i][0] += v * b0;
            s[i][1] += v * b1;
            s[i][2] += v * b2;
        }
    }
#pragma GCC unroll 8
    for (int i = 0; i < LANES; i++)
        for (int j = 0; j < ACROSS; j++)
            *(Loose *)(sums + i * stride + j * LANES) += s[i][j];
}

/* Panel `p` of the block of rows of [Z, Y]; columns beyond the last are zero. */
WIDE static void pack(const double *z, const double *y, Py_ssize_t k, Py_ssize_t n,
                      Py_ssize_t rows, Py_ssize_t p, double *restrict out)
{
    const Py_ssize_t from = p * LANES;
    if (from + LANES <= k) {
        for (Py_ssize_t r = 0; r < rows; r++)
            *(Lane *)(out + LANES * r) = *(const Loose *)(z + r * k + from);
        return;
    }
    for (Py_ssize_t r = 0; r < rows; r++)
        for (Py_ssize_t j = from; j < from + LANES; j++)
            out[LANES * r + j - from] = j < k ? z[r * k + j] : j < k + n ? y[r * n + j - k] : 0.0;
}

/* Returns 0 where there is no memory. */
WIDE static int sum_up(const double *z, const double *y, Py_ssize_t m, Py_ssize_t k, Py_ssize_t n,
                       double *gram, double *cross, double *square)
{
    const Py_ssize_t tiles = (k + n + LANES * ACROSS - 1) / (LANES * ACROSS);
    const Py_ssize_t panels = tiles * ACROSS, stride = panels * LANES;
    const size_t packed = (size_t)panels * LANES * ROWS, summed = (size_t)stride * (size_t)stride;
    double *block = aligned_alloc(64, packed * sizeof(double));
    double *sums = aligned_alloc(64, summed * sizeof(double));
    if (block && sums) {
        memset(sums, 0, summed * sizeof(double));
        for (Py_ssize_t from = 0; from < m; from += ROWS) {
            const Py_ssize_t rows = m - from < ROWS ? m - from : ROWS;
            for (Py_ssize_t p = 0; p < panels; p++)
                pack(z + from * k, y + from * n, k, n, rows, p, block + p * LANES * ROWS);
            for (Py_ssize_t t = 0; t < tiles; t++)
                for (Py_ssize_t p = 0; p < ACROSS * (t + 1); p++)
                    tile(block + p * LANES * ROWS, block + t * ACROSS * LANES * ROWS, rows,
                         sums + p * LANES * stride + t * LANES * ACROSS, stride);
        }
        for (Py_ssize_t i = 0; i < k; i++) {
            for (Py_ssize_t j = i; j < k; j++)
                gram[i * k + j] = gram[j * k + i] = sums[i * stride + j];
            for (Py_ssize_t j = 0; j < n; j++)
                cross[i * n + j] = sums[i * stride + k + j];
        }
        for (Py_ssize_t j = 0; j < n; j++)
            square[j] = sums[(k + j) * stride + k + j];
    }
    const int done = block && sums;
    free(block);
    free(sums);
    return done;
}
#endif

static int cpu_has_it(void)
{
#if BUILT
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("fma");
#else
    return 0;
#endif
}

static PyObject *supported(PyObject *module, PyObject *nothing)
{
    (void)module, (void)nothing;
    return PyBool_FromLong(cpu_has_it());
}

static PyObject *preferred(PyObject *module, PyObject *nothing)
{
    (void)module, (void)nothing;
#if BUILT
    return PyBool_FromLong(cpu_has_it() && __builtin_cpu_is("amd"));
#else
    Py_RETURN_FALSE;
#endif
}

static PyObject *products(PyObject *module, PyObject *arguments)
{
    PyObject *objects[5];
    Py_buffer views[5];
    int got = 0, done = 0;
    (void)module;
    if (!PyArg_UnpackTuple(arguments, "products", 5, 5, &objects[0], &objects[1], &objects[2],
                           &objects[3], &objects[4]))
        return NULL;
    for (; got < 5; got++)
        if (PyObject_GetBuffer(objects[got], &views[got],
                               got < 2 ? PyBUF_C_CONTIGUOUS : PyBUF_C_CONTIGUOUS | PyBUF_WRITABLE))
            goto release;
    {
        const Py_ssize_t width = (Py_ssize_t)sizeof(double);
        const Py_ssize_t m = views[0].shape && views[0].ndim == 2 ? views[0].shape[0] : -1;
        const Py_ssize_t n = views[4].len / width;
        const Py_ssize_t k = views[0].ndim == 2 ? views[0].shape[1] : -1;
        if (m < 0 || views[0].len != m * k * width || views[1].len != m * n * width ||
            views[2].len != k * k * width || views[3].len != k * n * width) {
            PyErr_SetString(PyExc_ValueError,
                            "products wants theta (m, k), target (m, n), gram (k, k), cross "
                            "(k, n) and square (n,) of float64");
            goto release;
        }
        if (!cpu_has_it()) {
            PyErr_SetString(PyExc_RuntimeError, "this CPU has no AVX-512: use numpy's product");
            goto release;
        }
#if BUILT
        Py_BEGIN_ALLOW_THREADS
        done = sum_up(views[0].buf, views[1].buf, m, k, n, views[2].buf, views[3].buf,
                      views[4].buf);
        Py_END_ALLOW_THREADS
#endif
        if (!done)
            PyErr_NoMemory();
    }
release:
    while (got)
        PyBuffer_Release(&views[--got]);
    if (!done)
        return NULL;
    Py_RETURN_NONE;
}

static PyMethodDef methods[] = {
    {"supported", supported, METH_NOARGS, "supported() -> whether this CPU has AVX-512."},
    {"preferred", preferred, METH_NOARGS, "preferred() -> whether it beats the BLAS here."},
    {"products", products, METH_VARARGS,
     "products(theta, target, gram, cross, square): Z'Z, Z'Y and |y_t|^2, into the last three."},
    {NULL, NULL, 0, NULL}};

static PyModuleDef_Slot slots[] = {{0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_gram", "Gram matrices, compiled.", 0, methods, slots,
    NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__gram(void)
{
    return PyModuleDef_Init(&definition);
}
