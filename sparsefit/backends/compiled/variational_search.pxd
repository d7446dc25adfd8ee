from sparsefit.backends.compiled cimport dense, dense_groups, linear, variational_point, variational_step
from sparsefit.backends.compiled.variational_point cimport Point, Problem

cdef double SHRINKING, POOR, NEGLIGIBLE, FLOOR, ROUNDING, NEVER
cdef Py_ssize_t ITERATIONS, HALVINGS, CHORDS, NEW_GROUPS
cdef int FINE, STUCK, NO_MEMORY

cdef class Search(Problem):
    cdef variational_step.Bounded bounded
    cdef Py_ssize_t count
    cdef double alpha, goal, gap, best_gap
    cdef double[::1] eta, width, square, spread
    cdef double[:, ::1] inner, pushed, trial, trial_correlation, weights, correlation, best, hessian
    cdef Py_ssize_t[::1] fresh

    cdef void place(self, double[:, ::1] rows, double[:, :, ::1] matrices) noexcept nogil

cdef double relative_gap(
    Search z, Point x, const double[:, ::1] weights, const double[:, ::1] correlation
) noexcept nogil
cdef void keep(
    Search z, Point x, const double[:, ::1] weights, const double[:, ::1] correlation
) noexcept nogil
cdef void predict(Search z, Point x) noexcept nogil
cdef void find_violators(Search z, Point x) noexcept nogil
cdef void enlarge(Search z, Point x, bint secular) noexcept nogil
cdef double objective(Search z, Point x) noexcept nogil
cdef int accept(Search z, Point x, Point y) noexcept nogil
cdef void hold(Search z, Point x, const double[:, ::1] weights, double gap) noexcept nogil
cdef Py_ssize_t minimise(Search z, Point x, Point y) noexcept nogil
cdef int visit(
    Search z, Point x, Point y, const double[::1] alphas, double[:, :, ::1] weights,
    Py_ssize_t[::1] iterations, double[::1] gaps
) noexcept nogil
cpdef int path(
    const double[:, ::1] gram, const double[:, ::1] cross, const Py_ssize_t[::1] starts,
    const double[::1] alphas, double tolerance, double[:, :, ::1] weights,
    Py_ssize_t[::1] iterations, double[::1] gaps
) except -1
