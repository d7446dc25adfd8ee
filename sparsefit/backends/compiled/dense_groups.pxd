"""What the group-LASSO's loop alone does to whole arrays, compiled: dense_groups.py says what."""

from libc.float cimport DBL_MIN
from libc.math cimport INFINITY, sqrt

from sparsefit.backends.compiled.dense cimport fill


cdef inline void add_ratio(
    Py_ssize_t n, double a, const double[::1] x, const double[::1] by, double[::1] y
) noexcept nogil:
    for i in range(n):
        y[i] += a * x[i] / by[i]

cdef inline void opposite(Py_ssize_t n, const double[::1] x, double[::1] out) noexcept nogil:
    for i in range(n):
        out[i] = 1.0 - x[i]

cdef inline double root_sum(Py_ssize_t n, const double[::1] x) noexcept nogil:
    cdef double sum = 0.0
    for i in range(n):
        sum += sqrt(x[i])
    return sum

cdef inline double picked_product(
    Py_ssize_t n, const double[::1] full, const Py_ssize_t[::1] index, const double[::1] x
) noexcept nogil:
    cdef double sum = 0.0
    for i in range(n):
        sum += full[index[i]] * x[i]
    return sum

cdef inline void add_diagonal(
    Py_ssize_t n, double a, const double[::1] x, double[:, ::1] matrix
) noexcept nogil:
    for i in range(n):
        matrix[i, i] += a * x[i]

cdef inline void mirror(
    Py_ssize_t first, Py_ssize_t last, const double[::1] width, double[:, ::1] matrix
) noexcept nogil:
    for i in range(first, last):
        for j in range(i + 1):
            matrix[i, j] = matrix[j, i] = matrix[i, j] / (width[i] * width[j])

cdef inline void unit_scale(
    Py_ssize_t n, const double[:, ::1] matrix, double[::1] out
) noexcept nogil:
    for i in range(n):
        out[i] = 1.0 / sqrt(matrix[i, i] if matrix[i, i] > DBL_MIN else DBL_MIN)

cdef inline void scaled(
    Py_ssize_t n, const double[::1] x, const double[:, ::1] matrix, double[:, ::1] out
) noexcept nogil:
    for i in range(n):
        for j in range(n):
            out[i, j] = matrix[i, j] * (x[i] * x[j])

cdef inline bint all_above(
    Py_ssize_t n, const double[::1] floor, const double[::1] x
) noexcept nogil:
    for i in range(n):
        if not x[i] >= floor[i]:
            return False
    return True

cdef inline void start_free(
    Py_ssize_t n, const double[::1] floor, const double[::1] x, double[::1] out
) noexcept nogil:
    for i in range(n):
        out[i] = 1.0 if floor[i] < 0.0 or x[i] > 0.0 else 0.0

cdef inline Py_ssize_t chosen(
    Py_ssize_t n, const double[::1] x, Py_ssize_t[::1] out
) noexcept nogil:
    cdef Py_ssize_t count = 0
    for i in range(n):
        if x[i] > 0.0:
            out[count] = i
            count += 1
    return count

cdef inline Py_ssize_t first_bound(
    Py_ssize_t n, const double[::1] free, const double[::1] floor, const double[::1] x,
    const double[::1] target
) noexcept nogil:
    cdef Py_ssize_t first = -1
    cdef double least = INFINITY, ratio
    for i in range(n):
        if free[i] > 0.0 and target[i] < floor[i]:
            ratio = (floor[i] - x[i]) / (target[i] - x[i])
            if ratio < least:
                least = ratio
                first = i
    return first

cdef inline void advance(
    Py_ssize_t n, double reach, const double[::1] target, const double[::1] floor,
    double[::1] free, double[::1] x
) noexcept nogil:
    cdef double move
    for i in range(n):
        move = target[i] - x[i]
        if free[i] > 0.0 and target[i] < floor[i] and (floor[i] - x[i]) / move <= reach:
            x[i] = floor[i]
            free[i] = 0.0
        else:
            x[i] += reach * move

cdef inline Py_ssize_t support(
    Py_ssize_t n, const double[::1] eta, const Py_ssize_t[::1] starts, Py_ssize_t[::1] group,
    Py_ssize_t[::1] begin, Py_ssize_t[::1] label, Py_ssize_t[::1] column
) noexcept nogil:
    cdef Py_ssize_t s = 0, c = 0
    for g in range(n):
        if eta[g] > 0.0:
            group[s] = g
            begin[s] = c
            for j in range(starts[g], starts[g + 1]):
                label[c] = s
                column[c] = j
                c += 1
            s += 1
    begin[s] = c
    return s

cdef inline void spread(
    Py_ssize_t n, Py_ssize_t width, Py_ssize_t t, const Py_ssize_t[::1] label,
    const double[::1] x, double[:, :, ::1] out
) noexcept nogil:
    for g in range(n):
        fill(width, 0.0, out[g, t])
    for i in range(width):
        out[label[i], t, i] = x[i]

cdef inline double inner_product(
    Py_ssize_t first, Py_ssize_t last, const double[:, ::1] x, const double[:, ::1] y
) noexcept nogil:
    cdef double sum = 0.0
    for t in range(x.shape[0]):
        for j in range(first, last):
            sum += x[t, j] * y[t, j]
    return sum

cdef inline void group_products(
    Py_ssize_t n, const Py_ssize_t[::1] starts, const double[:, ::1] x, const double[:, ::1] y,
    double[::1] out
) noexcept nogil:
    for g in range(n):
        out[g] = inner_product(starts[g], starts[g + 1], x, y)

cdef inline void secular_drive(
    Py_ssize_t n, const double[::1] square, double alpha, double[::1] out
) noexcept nogil:
    for i in range(n):
        out[i] = square[i] * (sqrt(square[i]) / alpha - 1.0)

cdef inline void plain_drive(
    Py_ssize_t n, const double[::1] square, double alpha, double[::1] out
) noexcept nogil:
    for i in range(n):
        out[i] = 0.5 * (square[i] - alpha * alpha)

cdef inline void violations(
    Py_ssize_t n, const double[::1] eta, double level, double[::1] square
) noexcept nogil:
    for i in range(n):
        if eta[i] > 0.0 or not square[i] > level:
            square[i] = 0.0

cdef inline void drop_negligible(
    Py_ssize_t n, double least, const double[::1] power, double[::1] eta
) noexcept nogil:
    for i in range(n):
        if not eta[i] * power[i] > least:
            eta[i] = 0.0
