"""Factors and products of the compiled kernels by scipy's BLAS and LAPACK.

Matrices are stored by rows, which to these libraries is their transpose; leading entries are in
use, `n` is the order, `count` a number of rows. A factor U, with A = U'U, is the upper triangle.
"""

from scipy.linalg.cython_blas cimport dgemm, dgemv, dsyrk, dtrsm, dtrsv
from scipy.linalg.cython_lapack cimport dpotrf, dpotrs

from sparsefit.solvers.dense cimport stride_of

cdef enum:
    FEW = 4  # rows up to which a product each is faster than packing the matrix


cdef inline void times(
    int count, int rows, int columns, double a, const double *matrix, int stride,
    const double *x, int x_stride, double b, double *out, int out_stride
) noexcept nogil:
    """out (count, columns) = a x (count, rows) M (rows, columns) + b out."""
    cdef int one = 1
    if count <= 0 or rows <= 0 or columns <= 0:
        return
    if count > FEW:
        dgemm(
            "N", "N", &columns, &count, &rows, &a, <double *>matrix, &stride, <double *>x, &x_stride,
            &b, out, &out_stride
        )
        return
    for t in range(count):
        dgemv(
            "N", &columns, &rows, &a, <double *>matrix, &stride, <double *>x + t * x_stride, &one,
            &b, out + t * out_stride, &one
        )

cdef inline bint factorised(int n, double[:, ::1] a) noexcept nogil:
    """Cholesky's U of A, whose upper triangle is given, in its place; false where it fails."""
    cdef int failed = 0, stride = stride_of(a)
    if n > 0:  # LAPACK refuses an empty matrix aloud
        dpotrf("L", &n, &a[0, 0], &stride, &failed)
    return not failed

cdef inline void solve(int n, int count, const double[:, ::1] factor, double[:, ::1] x) noexcept nogil:
    """x = x A^-1 for the rows of x (count, n)."""
    cdef int failed = 0, one = 1, stride = stride_of(factor), x_stride = stride_of(x)
    cdef double *u = <double *>&factor[0, 0]
    if n <= 0:
        return
    if count > FEW:
        dpotrs("L", &n, &count, u, &stride, &x[0, 0], &x_stride, &failed)
        return
    for t in range(count):
        dtrsv("L", "N", "N", &n, u, &stride, &x[t, 0], &one)
        dtrsv("L", "T", "N", &n, u, &stride, &x[t, 0], &one)

cdef inline void forward(
    int n, int above, int first, int last, const double[:, ::1] factor, double[:, :, ::1] x
) noexcept nogil:
    """x = x U^-1 for rows of x[first:last], whose entries before `above` are zero."""
    cdef int size = n - above, count = (last - first) * x.shape[1], stride = stride_of(factor)
    cdef int x_stride = x.shape[2]
    cdef double one = 1.0
    if size > 0 and count > 0:
        dtrsm(
            "L", "L", "N", "N", &size, &count, &one, <double *>&factor[above, above], &stride,
            &x[first, 0, above], &x_stride
        )

cdef inline void less_overlaps(
    int n, int first, int last, int t, const double[:, :, ::1] x, double[:, ::1] out
) noexcept nogil:
    """out -= x x' of the rows x[:last, t], in rows first ... last - 1, up to the diagonal."""
    cdef int count = last - first, stride = x.shape[1] * x.shape[2], out_stride = stride_of(out)
    cdef double minus = -1.0, one = 1.0
    if n <= 0 or count <= 0:
        return
    if first == 0:
        dsyrk(
            "U", "T", &last, &n, &minus, <double *>&x[0, t, 0], &stride, &one, &out[0, 0], &out_stride
        )
    else:
        dgemm(
            "T", "N", &last, &count, &n, &minus, <double *>&x[0, t, 0], &stride,
            <double *>&x[first, t, 0], &stride, &one, &out[first, 0], &out_stride
        )

cdef inline void less_product(
    int n, const Py_ssize_t[::1] index, const double[:, ::1] matrix, const double[:, ::1] x,
    double[:, ::1] out
) noexcept nogil:
    """out -= x times the rows `index`, ascending, of the matrix, for every row of x."""
    cdef int start = 0, end  # of a run of adjacent rows
    while start < n:
        end = start + 1
        while end < n and index[end] == index[end - 1] + 1:
            end += 1
        times(
            x.shape[0], end - start, matrix.shape[1], -1.0, &matrix[index[start], 0],
            stride_of(matrix), &x[0, start], stride_of(x), 1.0, &out[0, 0], stride_of(out)
        )
        start = end

cdef inline void product(
    int first, int last, const double[:, ::1] matrix, const double[:, ::1] x, double[:, ::1] out
) noexcept nogil:
    """out = x times the matrix, for every row of x, of which entries first ... last - 1 count."""
    times(
        x.shape[0], last - first, matrix.shape[1], 1.0, &matrix[first, 0], stride_of(matrix),
        &x[0, first], stride_of(x), 0.0, &out[0, 0], stride_of(out)
    )
