"""What the compiled kernels do to whole arrays; `n` entries are in use, matrices are stored by rows."""

from libc.float cimport DBL_MIN
from libc.math cimport INFINITY, fabs, sqrt
from libc.string cimport memcpy

cdef extern from "Python.h" nogil:
    ctypedef struct PyThreadState:
        pass
    PyThreadState *unlock "PyEval_SaveThread"() noexcept
    void lock "PyEval_RestoreThread"(PyThreadState *held) noexcept

cdef extern from "dense.h" nogil:
    void wide_combine(
        const double *matrix, Py_ssize_t stride, const Py_ssize_t *index, const double *sign,
        const double *a, Py_ssize_t n, Py_ssize_t width, double *out
    ) noexcept
    void wide_add(Py_ssize_t n, double a, const double *x, double *y) noexcept
    void wide_rank_one(Py_ssize_t n, double a, const double *x, double *m, Py_ssize_t stride) noexcept
    double wide_rates(
        Py_ssize_t k, const double *c, const double *d, const double *open, double alpha,
        double near, double *rate
    ) noexcept


cdef inline Py_ssize_t stride_of(const double[:, ::1] matrix) noexcept nogil:
    return matrix.strides[0] // <Py_ssize_t>sizeof(double)

cdef inline void fill(Py_ssize_t n, double value, double[::1] x) noexcept nogil:
    for i in range(n):
        x[i] = value

cdef inline void copy(Py_ssize_t n, const double[::1] x, double[::1] out) noexcept nogil:
    memcpy(&out[0], &x[0], n * sizeof(double))

cdef inline void copy_rows(
    Py_ssize_t n, Py_ssize_t rows, const double[:, ::1] x, double[:, ::1] out
) noexcept nogil:
    for t in range(rows):
        copy(n, x[t], out[t])

cdef inline void scale(Py_ssize_t n, double a, double[::1] x) noexcept nogil:
    for i in range(n):
        x[i] *= a

cdef inline void shift(Py_ssize_t n, double a, double[::1] x) noexcept nogil:
    for i in range(n):
        x[i] += a

cdef inline void add(Py_ssize_t n, double a, const double[::1] x, double[::1] y) noexcept nogil:
    wide_add(n, a, &x[0], &y[0])

cdef inline void subtract(Py_ssize_t n, const double[::1] x, double[::1] y) noexcept nogil:
    for i in range(n):
        y[i] = x[i] - y[i]

cdef inline void clip(Py_ssize_t n, double[::1] x) noexcept nogil:
    for i in range(n):
        if x[i] < 0.0:
            x[i] = 0.0

cdef inline void sizes(
    Py_ssize_t n, const double[::1] x, const double[::1] share, double[::1] out
) noexcept nogil:
    for i in range(n):
        out[i] = fabs(x[i]) * share[i]

cdef inline double square(Py_ssize_t n, const double[::1] x) noexcept nogil:
    cdef double sum = 0.0
    for i in range(n):
        sum += x[i] * x[i]
    return sum

cdef inline double largest(Py_ssize_t n, const double[::1] x) noexcept nogil:
    cdef double most = 0.0
    for i in range(n):
        if not fabs(x[i]) <= most:
            most = fabs(x[i])
        if most != most:
            break
    return most

cdef inline double least(Py_ssize_t n, const double[::1] x) noexcept nogil:
    cdef double lowest = 0.0
    for i in range(n):
        if not x[i] >= lowest:
            lowest = x[i]
        if lowest != lowest:
            break
    return lowest

cdef inline Py_ssize_t highest(Py_ssize_t n, const double[::1] x) noexcept nogil:
    cdef Py_ssize_t at = 0
    cdef double most = 0.0
    for i in range(n):
        if x[i] > most:
            most = x[i]
            at = i
    return at

cdef inline Py_ssize_t position(Py_ssize_t n, double value, const double[::1] x) noexcept nogil:
    for i in range(n):
        if x[i] == value:
            return i
    return 0

cdef inline Py_ssize_t soonest(
    Py_ssize_t n, const double[::1] move, const double[::1] weights, double near
) noexcept nogil:
    cdef Py_ssize_t first = -1
    cdef double most = 0.0, rate
    for i in range(n):
        rate = -move[i] / (weights[i] if weights[i] > near else near)
        if rate > most:
            most = rate
            first = i
    return first

cdef inline double rates(
    Py_ssize_t n, const double[::1] correlation, const double[::1] descent,
    const double[::1] share, double alpha, double near, double[::1] out
) noexcept nogil:
    return wide_rates(n, &correlation[0], &descent[0], &share[0], alpha, near, &out[0])

cdef inline void gather(
    Py_ssize_t n, const double[::1] full, const Py_ssize_t[::1] index, const double[::1] sign,
    double[::1] out
) noexcept nogil:
    for i in range(n):
        out[i] = sign[i] * full[index[i]]

cdef inline void combine(
    Py_ssize_t n, const double[:, ::1] matrix, const Py_ssize_t[::1] index,
    const double[::1] sign, const double[::1] x, double[::1] out
) noexcept nogil:
    wide_combine(
        &matrix[0, 0], stride_of(matrix), &index[0], &sign[0], &x[0], n, matrix.shape[1], &out[0]
    )

cdef inline void apply(
    Py_ssize_t n, const double[:, ::1] matrix, const double[::1] x, double[::1] out
) noexcept nogil:
    wide_combine(&matrix[0, 0], stride_of(matrix), NULL, NULL, &x[0], n, n, &out[0])

cdef inline void block(
    Py_ssize_t n, const double[:, ::1] matrix, const Py_ssize_t[::1] index,
    const double[::1] sign, double[:, ::1] out
) noexcept nogil:
    for i in range(n):
        for j in range(n):
            out[i, j] = matrix[index[i], index[j]] * (sign[i] * sign[j])

cdef inline void rank_one(
    Py_ssize_t n, double a, const double[::1] x, double[:, ::1] matrix
) noexcept nogil:
    wide_rank_one(n, a, &x[0], &matrix[0, 0], stride_of(matrix))

cdef inline void border(
    Py_ssize_t n, Py_ssize_t position, const double[::1] line, double[:, ::1] matrix
) noexcept nogil:
    for i in range(n):
        matrix[position, i] = matrix[i, position] = line[i]

cdef inline void negate(Py_ssize_t n, double[:, ::1] matrix) noexcept nogil:
    for i in range(n):
        for j in range(n):
            matrix[i, j] = -matrix[i, j]

cdef inline Py_ssize_t highest_diagonal(
    Py_ssize_t n, const double[:, ::1] matrix, const double[::1] left
) noexcept nogil:
    cdef Py_ssize_t at = -1
    for i in range(n):
        if left[i] > 0.0 and (at < 0 or matrix[i, i] > matrix[at, at]):
            at = i
    return at

cdef inline void multiply(
    Py_ssize_t n, const double[::1] x, const double[::1] y, double[::1] out
) noexcept nogil:
    for i in range(n):
        out[i] = x[i] * y[i]

cdef inline void divide(
    Py_ssize_t n, const double[::1] by, const double[::1] x, double[::1] out
) noexcept nogil:
    for i in range(n):
        out[i] = x[i] / by[i]

cdef inline double total(Py_ssize_t n, const double[::1] x) noexcept nogil:
    cdef double sum = 0.0
    for i in range(n):
        sum += x[i]
    return sum

cdef inline void take(
    Py_ssize_t n, const double[::1] full, const Py_ssize_t[::1] index, double[::1] out
) noexcept nogil:
    for i in range(n):
        out[i] = full[index[i]]

cdef inline void put(
    Py_ssize_t n, const double[::1] x, const Py_ssize_t[::1] index, double[::1] out
) noexcept nogil:
    for i in range(n):
        out[index[i]] = x[i]

