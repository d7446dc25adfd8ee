/* The loop of the group-LASSO path, without the interpreter lock; variational.py is the same
   algorithm in Python and the reference of the tests. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "_variational_search.h"

/* The address in a capsule of scipy whose arguments have the kinds given: c(har), i(nt),
   d(ouble). A scipy with 64-bit integers would be called wrongly, so its names are read. */
static void *routine(PyObject *table, const char *name, const char *kinds)
{
    PyObject *capsule = PyMapping_GetItemString(table, name);
    if (!capsule) {
        PyErr_Format(PyExc_ImportError, "scipy has no %s", name);
        return NULL;
    }
    const char *signature = PyCapsule_GetName(capsule), *at = signature;
    int fits = signature && strncmp(signature, "void (", 6) == 0;
    for (at += fits ? 6 : 0; fits && *kinds; kinds++) {
        const char *end = at + strcspn(at, "*");
        if (*kinds == 'd')
            fits = end - at > 2 && (strncmp(end - 3, "_d ", 3) == 0 || strncmp(at, "double", 6) == 0);
        else
            fits = strncmp(at, *kinds == 'c' ? "char *" : "int *", end - at + 1) == 0;
        at = end + strcspn(end, ",)");
        fits = fits && *at == (kinds[1] ? ',' : ')');
        at += *at == ',' ? 2 : 0;
    }
    void *found = fits ? PyCapsule_GetPointer(capsule, signature) : NULL;
    if (!fits)
        PyErr_Format(PyExc_ImportError, "scipy's %s has another signature: %s", name,
                     signature ? signature : "none");
    Py_DECREF(capsule);
    return found;
}

static int connect(Dense *d, PyObject *blas, PyObject *lapack)
{
    d->gemm = (Gemm)routine(blas, "dgemm", "cciiiddididdi");
    d->syrk = d->gemm ? (Syrk)routine(blas, "dsyrk", "cciiddiddi") : NULL;
    d->trsm = d->syrk ? (Trsm)routine(blas, "dtrsm", "cccciiddidi") : NULL;
    d->gemv = d->trsm ? (Gemv)routine(blas, "dgemv", "ciiddididdi") : NULL;
    d->trsv = d->gemv ? (Trsv)routine(blas, "dtrsv", "cccididi") : NULL;
    d->potrf = d->trsv ? (Potrf)routine(lapack, "dpotrf", "cidii") : NULL;
    d->potrs = d->potrf ? (Potrs)routine(lapack, "dpotrs", "ciididii") : NULL;
    return d->potrs != NULL;
}

/* Raises ImportError where scipy's routines are not those this module was written for. */
static PyObject *check(PyObject *self, PyObject *args)
{
    PyObject *blas, *lapack;
    Dense dense;
    (void)self;
    if (!PyArg_ParseTuple(args, "OO", &blas, &lapack) || !connect(&dense, blas, lapack))
        return NULL;
    return Py_NewRef(Py_None);
}

static PyObject *path(PyObject *self, PyObject *args)
{
    PyObject *blas, *lapack, *answer = NULL;
    Py_buffer gram, cross, starts, alphas, weights, iterations, gaps;
    double tolerance;
    (void)self;
    if (!PyArg_ParseTuple(args, "OOy*y*y*y*dw*w*w*", &blas, &lapack, &gram, &cross, &starts,
                          &alphas, &tolerance, &weights, &iterations, &gaps))
        return NULL;
    Dense dense = {0};
    Problem p = {0};
    double side = sqrt((double)gram.len / sizeof(double));
    p.columns = side < 46340.0 ? (int)(side + 0.5) : 0; /* BLAS counts in int */
    p.groups = (int)(starts.len / sizeof(long long)) - 1;
    size_t row = p.columns * sizeof(double), points = alphas.len / sizeof(double);
    p.targets = row ? (int)(cross.len / row) : 0;
    p.dense = &dense;
    p.gram = gram.buf;
    p.cross = cross.buf;
    p.starts = starts.buf;
    if (!row || p.groups < 1 || p.targets < 1 || (size_t)gram.len != row * p.columns
        || (size_t)cross.len != row * p.targets || p.starts[0] != 0
        || p.starts[p.groups] != p.columns || (size_t)weights.len != cross.len * points
        || (size_t)gaps.len != points * sizeof(double)
        || (size_t)iterations.len != points * sizeof(long long)) {
        PyErr_SetString(PyExc_ValueError, "the arrays of a group path do not fit each other");
        goto done;
    }
    p.power = calloc(p.groups, sizeof(double));
    if (!connect(&dense, blas, lapack))
        goto done;
    if (!p.power) {
        PyErr_NoMemory();
        goto done;
    }
    int fine;
    Py_BEGIN_ALLOW_THREADS
    for (int g = 0; g < p.groups; g++)
        for (int j = first(&p, g); j < first(&p, g + 1); j++)
            p.power[g] += p.gram[(size_t)j * (p.columns + 1)];
    fine = solve_path(&p, alphas.buf, (int)points, tolerance, weights.buf, iterations.buf,
                      gaps.buf);
    Py_END_ALLOW_THREADS
    answer = fine ? Py_NewRef(Py_None) : PyErr_NoMemory();
done:
    free(p.power);
    PyBuffer_Release(&gram);
    PyBuffer_Release(&cross);
    PyBuffer_Release(&starts);
    PyBuffer_Release(&alphas);
    PyBuffer_Release(&weights);
    PyBuffer_Release(&iterations);
    PyBuffer_Release(&gaps);
    return answer;
}

static PyMethodDef methods[] = {
    {"check", check, METH_VARARGS, "check(blas, lapack)"},
    {"path", path, METH_VARARGS,
     "path(blas, lapack, gram, cross, starts, alphas, tolerance, weights, iterations, gaps)"},
    {NULL, NULL, 0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_variational", "The compiled group-LASSO path.", 0, methods,
    NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__variational(void) { return PyModuleDef_Init(&definition); }
