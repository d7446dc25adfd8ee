/*
 * sf_flow.c - see sf_flow.h. Made by sparsefit ${version}; change the estimator, not this file.
 *
 * C99, no heap, no recursion, every loop bounded by a constant.
 */
#include "sf_flow.h"

#include <math.h>
#include <stddef.h>

#define SF_R(x) ((sf_real)(x))
#define SF_READY 0x5F10F10Fu
#define SF_PI SF_R(3.14159265358979323846)
#define SF_FLOOR SF_R(${floor})      /* pivots of unit columns below it count as zero */
#define SF_ROUNDING SF_R(${rounding})   /* of |Phi|^2: residuals below it are rounding */
#define SF_CORRELATION SF_R(${correlation}) /* rows over which errors of Phi correlate, at least */
#define SF_DETECTION SF_R(${detection})   /* 2 ln(likelihood ratio) that chance reaches in 1 of 1000 */
#define SF_DISTINCT SF_R(${distinct})    /* the same of a false lobe, in 1 of 100 */
#define SF_PRECISION SF_R(${precision})  /* of the length scale: twice its error is at most this share */

/* The size that the header states; C99 has no static assertion but this. */
typedef char sf_ram_is_as_stated[(sizeof(sf_flow) <= SF_RAM_BYTES) ? 1 : -1];

/* k = pi/L of the candidates [1/m], by ascending L. */
static const sf_real SF_WAVENUMBER[SF_SCALES] = {
${wavenumbers}};

