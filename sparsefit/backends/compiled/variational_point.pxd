from sparsefit.backends.compiled cimport dense, dense_groups, linear

cdef double LOST
cdef Py_ssize_t NEW_GROUPS, ROOM, PARTS, LARGE
cdef int FINE, FAILED, NO_MEMORY

cdef class Problem:
    cdef Py_ssize_t targets, columns, groups
    cdef const double[:, ::1] gram, cross
    cdef const Py_ssize_t[::1] starts
    cdef double[::1] power

cdef class Point:
    cdef Py_ssize_t s, c
    cdef double value
    cdef double[::1] eta, width, square, root, spread
    cdef double[:, ::1] inner, weights, correlation, factor, hessian
    cdef double[:, :, ::1] half
    cdef Py_ssize_t[::1] group, begin, label, column

    cdef void share_out(
        self, double[:, ::1] rows, double[:, :, ::1] matrices, Py_ssize_t[:, ::1] integers
    ) noexcept nogil
    cdef bint grown(self) noexcept with gil

cdef void exchange(Point x, Point y) noexcept nogil
cdef void correlate(
    Problem problem, Point x, const double[:, ::1] weights, double[:, ::1] out
) noexcept nogil
cdef int evaluate(Problem problem, Point x) noexcept nogil
cdef void curve(Problem problem, Point x) noexcept nogil
cdef void bordered(
    Problem problem, Point x, const Py_ssize_t[::1] new, Py_ssize_t count,
    double[:, ::1] product, double[:, ::1] out
) noexcept nogil
