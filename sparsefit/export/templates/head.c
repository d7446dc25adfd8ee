/*
 * sf_flow.c - see sf_flow.h. Made by sparsefit ${version}; change the estimator, not this file.
 *
 * C99, no heap, no recursion, every loop bounded by a constant.
 */
#include "sf_flow.h"

#include <math.h>
#include <stddef.h>

#ifdef __FAST_MATH__
#error "-ffast-math would undo the compensated sums and the checks for NaN"
#endif
#if SF_BLOCK < 1
#error "SF_BLOCK must be 1 or more"
#endif

#define SF_R(x) ((sf_real)(x))
#define SF_READY 0x5F10F10Fu
#define SF_PI SF_R(3.14159265358979323846)

/* Pivots of columns in unit norm: one below this counts as zero. */
#define SF_FLOOR SF_R(${floor})
/* The least pivot of an answer: below it rounding takes more than the digits that are promised. */
#define SF_SAFE SF_R(${safe})
/* Positions [m], velocities [m/s], and settings in SI units: a larger one is a fault of the log. */
#define SF_LARGEST SF_R(${largest})
/* Residuals below this share of |Phi|^2 are rounding. */
#define SF_ROUNDING SF_R(${rounding})
/* Rows over which the errors of Phi correlate, at least. */
#define SF_CORRELATION SF_R(${correlation})
/* 2 ln(likelihood ratio) over a uniform wind that chance reaches in 1 of 1000 flights. */
#define SF_DETECTION SF_R(${detection})
/* The same over the next best lobe, in 1 of 100. */
#define SF_DISTINCT SF_R(${distinct})
/* Twice the error of a length scale is at most this share of it. */
#define SF_PRECISION SF_R(${precision})

/* The size that the header states; C99 has no static assertion but this. */
typedef char sf_ram_is_as_stated[(sizeof(sf_flow) <= SF_RAM_BYTES) ? 1 : -1];

/* k = pi/L of the candidates [1/m], by ascending L. */
static const sf_real SF_WAVENUMBER[SF_SCALES] = {
${wavenumbers}};

