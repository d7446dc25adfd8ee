from sparsefit.backends.compiled cimport active_set, dense, homotopy_point
from sparsefit.backends.compiled.homotopy_point cimport Walk

cdef double OPTIMAL_WITHIN, ROUNDING, FLAT, TINY, FRESH_SLOPE_ABOVE, CAUTION
cdef double NEWTON_SHARE, HOPELESS
cdef Py_ssize_t REPAIRS, NEWTON_STEPS, STEPS_PER_COLUMN, STEPS_AT_LEAST
cdef int FINE, DEPENDENT, SINGULAR, NO_MEMORY

cdef int follow(Walk walk, double alpha, double goal, Py_ssize_t limit) noexcept nogil
cdef void correlate(Walk walk, double alpha) noexcept nogil
cdef double polish(Walk walk, double alpha) noexcept nogil
cdef void freshen(Walk walk) noexcept nogil
cdef int settle(Walk walk, double alpha, Py_ssize_t limit) noexcept nogil
cdef int exchange(Walk walk, Py_ssize_t column, double sign) noexcept nogil
cdef int reach(Walk walk, double alpha, double goal, double[::1] found) noexcept nogil
cdef Py_ssize_t visit(
    Walk walk, const double[::1] alphas, double[:, ::1] weights, unsigned char[::1] complete
) noexcept nogil
cpdef Py_ssize_t path(
    const double[:, ::1] gram, const double[::1] cross, const double[::1] alphas,
    double[:, ::1] weights, unsigned char[::1] complete
) except -1
