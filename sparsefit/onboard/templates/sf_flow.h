/*
 * sf_flow.h - mean velocity U0, length scale L and heading of a cellular flow, from the flight
 * through it, sample by sample, in constant memory and bounded time.
 *
 * @origin@
 *
 * The vehicle:  x' = v,  v' = F(w + u - v) + a,  F(r) = (1/tau + c |r|) r,  a = a0 + s m(t).
 * The flow:     w = (dpsi/dy, -dpsi/dx),  psi = sum over two waves of a cos(k.x) + b sin(k.x), the
 *               wavevectors (kx, ky) and (-ky, kx): square cells of any heading, L = sqrt(2) pi/|k|,
 *               U0 = |k| sqrt(sum of a^2 + b^2).
 * The disturbance: u' = -2 u + white noise, at four levels, each with a Kalman filter of its own
 *               over (v, u, x, a, b, a, b, kx, ky); the answer is that of the likeliest.
 *
 * The README describes the search and the test of misfit, and names what is not tested.
 *
 * @costs@
 */
#ifndef SF_FLOW_H
#define SF_FLOW_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifndef SF_REAL
#define SF_REAL double
#endif
typedef SF_REAL sf_real;

/* @settings@ */

#define SF_STATES 12u /* vx, vy, ux, uy, x, y, a, b, a, b, kx, ky */
#define SF_LEVELS 4u  /* of the disturbance: filters */
#define SF_ROWS 192u  /* averaged flow velocities that the search holds */
#define SF_PEAKS 5u   /* candidates of a sweep that are refined */

typedef enum {
    SF_OK = 0,
    SF_UNIDENTIFIABLE = 1, /* sf_doubt says why */
    SF_MISFIT = 2,         /* there is a flow, but not the one assumed: sf_doubt says why */
    SF_GAP = 3,            /* the sample was taken; the clock or the place went on from another one */
    SF_BAD_SAMPLE = 4,     /* NaN, infinite or absurdly large: left out */
    SF_BAD_TIME = 5,       /* out of line with the samples before: left out, the next one decides */
    SF_BAD_ARGUMENT = 6    /* a null pointer, a setting out of its range, or no sf_init before */
} sf_status;

typedef enum {
    SF_NO_DOUBT = 0,
    SF_FEW_SAMPLES = 1, /* too few for a search */
    SF_NO_FLOW = 2,     /* no cells explain the flight */
    SF_RIVAL = 3,       /* cells of another length scale explain it nearly as well */
    SF_SETTLING = 4,    /* the filters have just started */
    SF_IMPRECISE = 5,   /* an interval is wider than the precision */
    SF_INNOVATIONS = 6, /* misfit: innovations too large or correlated, or too much unexplained */
    SF_SHAPE = 7,       /* misfit: the amplitudes of the two waves differ */
    SF_TURNED = 8,      /* misfit: the cells are turned, and a heading of 0 was demanded */
    SF_EDGE = 9         /* L is outside of the bounds */
} sf_doubt;

typedef struct {
    sf_real response_time;    /* tau [s], > 0; INFINITY for quadratic drag alone */
    sf_real drag_coefficient; /* c [1/m], >= 0 */
    sf_real thrust_x, thrust_y; /* a0 [m/s^2] */
    sf_real thrust_scale;     /* s, of a measured thrust */
    sf_real lower, upper;     /* bounds of L [m] */
    sf_real precision;        /* largest half-width of the 95 % intervals over the value, if SF_OK */
    sf_real memory;           /* time in which the weight of a sample falls by e [s]; 0: never */
    uint32_t any_heading;     /* 0: the cells lie along x and y */
    uint32_t candidates;      /* evaluated with a sample while no flow is followed */
} sf_config;

typedef struct {
    sf_status status;
    sf_doubt doubt;
    uint32_t samples;            /* taken so far */
    sf_real mean_velocity;       /* U0 [m/s]; NaN while no flow is followed, as the next three */
    sf_real length_scale;        /* L [m] */
    sf_real timescale;           /* L/U0 [s] */
    sf_real heading;             /* of the cells [rad], -pi/4 to pi/4 */
    sf_real mean_velocity_error, length_scale_error, timescale_error, heading_error; /* standard */
    sf_real innovation;          /* mean square of the normalised innovations, 1 of a right model */
    sf_real correlation;         /* of successive innovations, 0 of a right model */
    sf_real unexplained;         /* share of the squares of the averaged flow velocities */
    sf_real rival;               /* L of the rival [m], where that is the doubt */
    sf_real flow[8];             /* a, b, a, b, kx, ky, and the place phases count from [m] */
} sf_answer;

/* One Kalman filter. */
typedef struct {
    sf_real state[SF_STATES];
    sf_real covariance[SF_STATES][SF_STATES];
    sf_real log_likelihood; /* fading, as the next two */
    sf_real square;         /* mean square of the normalised innovations */
    sf_real product;        /* mean product of successive ones */
    sf_real last[4];        /* innovations of the last sample */
} sf_filter;

/* One candidate of a sweep. */
typedef struct {
    sf_real score, size, angle; /* share of the rows' squares; |k| [rad/m] and its angle [rad] */
    sf_real waves[6];           /* by least squares: a, b, a, b, kx, ky */
} sf_peak;

/* The state of one estimator: all the memory there is. Its fields are for sf_flow.c alone. */
typedef struct {
    sf_config config;
    uint64_t time_ns;                   /* of the last sample */
    uint64_t suspect_ns;                /* of the last sample that was out of line */
    uint32_t samples, suspects;         /* taken; out of line, in succession */
    uint32_t following, waiting, doubt; /* waiting: for rows, after a gap */
    uint32_t recent;                    /* samples without a gap, 3 at most */
    uint32_t row_count, row_place;
    uint32_t sweeping, radius, turn;    /* the next candidate: its |k| and heading, in steps */
    uint32_t rounds;                    /* of refinement, begun; 0: the sweep goes on */
    sf_real step;                       /* mean time between samples [s] */
    sf_real origin[2];                  /* the first position, from which all others count [m] */
    sf_real thrust[2];                  /* measured with the last sample */
    sf_real last[3][4];                 /* samples, the oldest first */
    sf_real noise_count, noise[2];      /* variances of position [m^2] and velocity [m^2/s^2] */
    sf_real block[11], block_time;      /* sums of the samples that become a row */
    sf_real rows[SF_ROWS][4];           /* position [m], flow velocity [m/s] */
    sf_real total, middle[2];           /* sum of the rows' squares; their middle [m] */
    sf_real spacing;                    /* of candidates [rad/m] */
    sf_peak peak[SF_PEAKS];
    sf_real rival;                      /* its L [m] */
    sf_real anchor[2];                  /* from which the filters' positions and phases count [m] */
    sf_real age;                        /* samples that were followed */
    sf_real remaining[2];               /* mean squares of rows less the flow, and of rows, fading */
    sf_filter filter[SF_LEVELS];
} sf_flow;

/* Begin. SF_OK, or SF_BAD_ARGUMENT. */
sf_status sf_init(sf_flow *flow, const sf_config *config);

/*
 * Take one sample: time [ns], position [m], velocity [m/s], measured thrust [m/s^2] or a null
 * pointer. SF_OK or SF_GAP where it was taken.
 */
sf_status sf_update(sf_flow *flow, uint64_t time_ns, const sf_real position[2],
                    const sf_real velocity[2], const sf_real *thrust);

/* Answer from all samples so far, at any time. The status is also in the answer. */
sf_status sf_estimate(const sf_flow *flow, sf_answer *answer);

#ifdef __cplusplus
}
#endif

#endif /* SF_FLOW_H */
