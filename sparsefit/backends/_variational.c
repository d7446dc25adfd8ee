/* The loop of the group-LASSO path, without the interpreter lock; variational.py is the same
   algorithm in Python and the reference of the tests. */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "_variational_search.h"

static double *take(double **from, size_t count)
{
    double *taken = *from;
    *from += count;
    return taken;
}

static int prepare(Search *z)
{
    size_t k = z->problem->columns, n = z->problem->targets, g = z->problem->groups;
    size_t room = k * n * (13 + 2 * NEW_GROUPS) + 2 * k + 3 * g * g + 15 * g;
    double *at = z->numbers = calloc(room, sizeof(double));
    int *slot = z->integers = calloc(4 * k + 3 * g, sizeof(int));
    z->bounded.free = z->flags = calloc(g, 1);
    if (!z->numbers || !z->integers || !z->flags)
        return 0;
    for (int i = 0; i < 2; i++) {
        Point *x = &z->points[i];
        x->eta = take(&at, g);
        x->root = take(&at, k);
        x->inner = take(&at, k * n);
        x->weights = take(&at, k * n);
        x->correlation = take(&at, k * n);
        x->group = slot;
        x->label = slot + g;
        x->column = slot + g + k;
        slot += g + 2 * k;
    }
    z->bounded.inside = slot;
    double **rows[] = {&z->inner,   &z->pushed,      &z->trial_weights, &z->trial_correlation,
                       &z->weights, &z->correlation, &z->best_weights};
    double **groups[] = {&z->eta,           &z->square,       &z->all_square,   &z->drive,
                         &z->lower,         &z->step,         &z->width,        &z->bounded.scale,
                         &z->bounded.pull,  &z->bounded.floor, &z->bounded.x,
                         &z->bounded.target, &z->bounded.rhs};
    double **squares[] = {&z->hessian, &z->bounded.unit, &z->bounded.block};
    for (size_t i = 0; i < sizeof(rows) / sizeof(*rows); i++)
        *rows[i] = take(&at, k * n);
    for (size_t i = 0; i < sizeof(groups) / sizeof(*groups); i++)
        *groups[i] = take(&at, g);
    for (size_t i = 0; i < sizeof(squares) / sizeof(*squares); i++)
        *squares[i] = take(&at, g * g);
    z->products = take(&at, k * n * NEW_GROUPS);
    z->coupling = take(&at, k * n * NEW_GROUPS);
    return 1;
}

/* The path: weights (p, n, k), iterations (p), gaps (p); 0 where memory is out. */
static int solve_path(const Problem *problem, const double *alphas, int points, double tolerance,
                      double *weights, long long *iterations, double *gaps)
{
    Search z;
    memset(&z, 0, sizeof z);
    z.problem = problem;
    z.goal = fmax(tolerance, FLOOR);
    size_t block = (size_t)problem->columns * problem->targets;
    int fine = prepare(&z) && evaluate(problem, &z.points[0]) >= 0;
    for (int i = 0; fine && i < points; i++) {
        z.alpha = alphas[i];
        int spent = minimise(&z);
        fine = spent >= 0;
        iterations[i] = spent;
        gaps[i] = z.best_gap;
        memcpy(weights + block * i, z.best_weights, block * sizeof(double));
    }
    for (int i = 0; i < 2; i++) {
        free(z.points[i].factor);
        free(z.points[i].half);
        free(z.points[i].hessian);
    }
    free(z.numbers);
    free(z.integers);
    free(z.flags);
    return fine;
}

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

static int ascending(const Problem *p)
{
    for (int g = 0; g < p->groups; g++)
        if (p->starts[g] >= p->starts[g + 1])
            return 0;
    return 1;
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
        || p.starts[p.groups] != p.columns || !ascending(&p) || (size_t)weights.len != cross.len * points
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
