/*
 * sf_flow.h - mean velocity, length scale and timescale of a cellular flow from the flight through
 * it, sample by sample, in bounded memory and time.
 *
 * Made by sparsefit ${version} from: ${source}
 *   derivative  ${derivative}
 *   library     ${library}
 *   back-end    ${backend}
 *   readout     ${readout}
 *
 * The vehicle:  v' = (w - v)/tau + a        so that the flow there is  Phi = tau (v' - a) + v.
 * The flow:     w = sum of weights times the 8 candidates sin, cos of k x and k y and their
 *               products, k = pi/L, for one L of ${scales} candidates, ${lower} m to ${upper} m.
 * U0 = sqrt(2 <|w|^2>) over a cell, tau_w = L/U0.
 *
 * RAM      ${ram} bytes: sizeof(sf_flow), asserted in sf_flow.c. Nothing else is kept.
 * Stack    ${stack}
 * Flash    ${flash}
 * Work     at most, counted from the lengths of the loops:
 *
 *                                     additions  products  quotients  roots  sin, cos, log
${work}
 *
 *          ${budget}
 *
 * sf_update is for every sample; sf_estimate for a slower task, whenever an answer is wanted.
 *
 * On board there is no repair of outliers, no correction of what smoothing takes, no interval and
 * no test of whether the flow is another than was fitted: those are of the batch estimate.
 */
#ifndef SF_FLOW_H
#define SF_FLOW_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef ${real} sf_real;

/* ---- what may be tuned: ${tunable_count} values, here or by -D ------------------------------------------- */

/* Rows before there is an answer. */
#ifndef SF_MINIMUM_ROWS
#define SF_MINIMUM_ROWS ${minimum_rows}u
#endif

/* Rows that are summed by themselves before they join the rest, which keeps rounding small. */
#ifndef SF_BLOCK
#define SF_BLOCK ${block}u
#endif

/* What is kept of all earlier sums when a block joins them: 1 is the whole flight, to which the extent
 * always belongs. */
#ifndef SF_FORGETTING
#define SF_FORGETTING 1.0
#endif

${step_tunable}${sweep_tunable}
/* ---- sizes: from the estimator, not to be changed ------------------------------------------- */

#define SF_SCALES ${scales}u /* candidate length scales */
#define SF_ORDERS ${orders}u /* Taylor coefficients in k of every sum: ${orders_why} */
#define SF_TERMS 43u /* sums of one scale: 5 x 5 of the columns, 2 x (3 x 3) with Phi */
#define SF_WINDOW ${window}u /* samples that a derivative is taken from */
#define SF_EVERY ${every}u /* every so many-th full window makes a row */
${column_sizes}#define SF_RAM_BYTES ${ram}u

typedef enum {
    SF_OK = 0,
    SF_UNIDENTIFIABLE = 1, /* sf_doubt says why */
    SF_GAP = 2,            /* the sample was taken; it begins anew after a gap or an uneven step */
    SF_BAD_SAMPLE = 3,     /* NaN, infinite or absurdly large: refused */
    SF_BAD_TIME = 4,       /* not later than the sample before: refused */
    SF_BAD_ARGUMENT = 5,   /* a null pointer, or a setting out of its range */
    SF_NOT_READY = 6       /* sf_init has not been called, or has failed */
} sf_status;

typedef enum {
    SF_NO_DOUBT = 0,
    SF_FEW_SAMPLES = 1, /* fewer rows than SF_MINIMUM_ROWS */
    SF_NO_FLOW = 2,     /* no scale explains more than a uniform wind does */
    SF_EDGE = 3,        /* the best length scale is at an end of the grid */
    SF_COARSE = 4,      /* the flight tells scales finer than the grid has them */
    SF_RIVAL = 5,       /* another length scale fits too nearly as well */
    SF_SHORT_TRACK = 6, /* less than one period, 2 L, was flown across */
    SF_DEPENDENT = 7,   /* the track, a line say, does not tell the 8 candidates apart in sf_real */
    SF_NO_WEIGHTS = 8,  /* the back-end gave every column the weight zero */
    SF_IMPRECISE = 9    /* twice the error of L is more than ${precision} L */
} sf_doubt;

typedef struct {
    sf_real response_time;     /* tau [s], > 0 */
    sf_real thrust_x;          /* a [m/s^2] */
    sf_real thrust_y;
    sf_real origin_x;          /* what positions are counted from [m]: a place near the flight */
    sf_real origin_y;
    uint32_t sample_us;        /* nominal time from sample to sample [us], > 0 */
} sf_config;

typedef struct {
    sf_status status;
    sf_doubt doubt;
    uint32_t rows;              /* taken so far */
    uint32_t refined;           /* 1 where the length scale is off the grid */
    sf_real mean_velocity;      /* U0 [m/s]; NaN where there is none, as all below */
    sf_real length_scale;       /* L [m] */
    sf_real timescale;          /* L/U0 [s] */
    sf_real grid_length_scale;  /* the candidate that it comes from [m] */
    sf_real rival;              /* the next best length scale [m], 0 without one */
    sf_real length_scale_error; /* standard error [m], by the curvature; NaN on the grid */
    sf_real unexplained;        /* share of |Phi|^2 that the fit leaves */
    sf_real certificate;        /* ${certificate} */
} sf_answer;

/* The state of one estimator. Its fields are of sf_flow.c alone. */
typedef struct {
    uint64_t time_us[SF_WINDOW];
    uint32_t ready;
    uint32_t sample_us;
    uint32_t held;    /* samples in the window */
    uint32_t skipped; /* full windows since the last row */
    uint32_t in_block;
    uint32_t rows;
    sf_real response_time;
    sf_real thrust[2];
    sf_real origin[2];
    sf_real lowest[2];  /* the flight's bounding box [m], from the origin */
    sf_real highest[2];
    sf_real window[SF_WINDOW][4]; /* x, y, vx, vy */
    sf_real squares[2][2];        /* sums of Phi_x^2, Phi_y^2: of the block, of the rest */
    sf_real sums[2][SF_SCALES][SF_ORDERS][SF_TERMS];
${column_state}} sf_flow;

/* Begin. SF_OK, or SF_BAD_ARGUMENT. */
sf_status sf_init(sf_flow *flow, const sf_config *config);

/* Take one sample: time [us], position [m], velocity [m/s]. SF_OK or SF_GAP where it was taken. */
sf_status sf_update(sf_flow *flow, uint64_t time_us, sf_real x, sf_real y, sf_real vx, sf_real vy);

/* Answer from all samples so far. The status is also in the answer. */
sf_status sf_estimate(${estimate_const}sf_flow *flow, sf_answer *answer);

#ifdef __cplusplus
}
#endif

#endif /* SF_FLOW_H */
