from sparsefit.backends.compiled cimport active_set, dense

cdef int FINE, DEPENDENT, SINGULAR

cdef class Walk(active_set.ActiveSet):
    cdef Py_ssize_t waits, steps
    cdef const double[::1] cross
    cdef Py_ssize_t[::1] waiting
    cdef double[::1] weights, slope, correlation, descent, open, known, rates

    cdef void place(self, double[:, ::1] rows) noexcept nogil

cdef int enter(Walk walk, Py_ssize_t column, double sign) noexcept nogil
cdef int leave(Walk walk, Py_ssize_t position) noexcept nogil
cdef void start(Walk walk, double caution) noexcept nogil
cdef int start_at(Walk walk, const double[::1] weights, double caution) noexcept nogil
cdef void full(Walk walk, double[::1] out) noexcept nogil
