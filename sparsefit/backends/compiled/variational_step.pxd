cimport cython

from sparsefit.backends.compiled cimport dense, dense_groups, linear

cdef double RIDGE, ROUNDING, FIRST_RIDGE
cdef Py_ssize_t RIDGES, TURNS

cdef class Bounded:
    cdef double[::1] drive, lower, step, scale, pull, floor, free, fixed, x, target, ones
    cdef double[:, ::1] right, unit, block
    cdef Py_ssize_t[::1] inside

    cdef void share_out(self, double[:, ::1] rows) noexcept nogil
    cdef void minimise(self, Py_ssize_t n, const double[:, ::1] hessian) noexcept nogil
    cdef void search(self, Py_ssize_t n) noexcept nogil
    cdef void face(self, Py_ssize_t n) noexcept nogil
