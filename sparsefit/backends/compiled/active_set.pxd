from sparsefit.backends.compiled cimport dense

cdef double REFINE_ABOVE, STALE_ABOVE, WRONG_ABOVE, DEPENDENT_BELOW, TINY
cdef Py_ssize_t STALE_AGE, ROOM
cdef int FINE, DEPENDENT, SINGULAR, NO_MEMORY, EARLY

cdef class ActiveSet:
    cdef Py_ssize_t k, n, age
    cdef double below, pivot
    cdef const double[:, ::1] gram
    cdef double[:, ::1] inverse
    cdef Py_ssize_t[::1] index
    cdef double[::1] sign, step, product, error, fix, spare, change

    cdef void share_out(self, double[:, ::1] rows) noexcept nogil
    cdef void product_of(self, const double[::1] x, Py_ssize_t n, double[::1] out) noexcept nogil
    cdef void solve(self, const double[::1] x, double[::1] out) noexcept nogil
    cdef void gather(self, const double[::1] full, double[::1] out) noexcept nogil
    cdef bint grown(self) noexcept with gil
    cdef int rebuilt(self, double error) noexcept nogil
    cdef int corrected(self, Py_ssize_t count, Py_ssize_t position, double scale) noexcept nogil
    cdef int entering(self, Py_ssize_t column, double sign) noexcept nogil
    cdef int enter(self) noexcept nogil
    cdef int leaving(self, Py_ssize_t position) noexcept nogil
    cdef void leave(self, Py_ssize_t position) noexcept nogil
