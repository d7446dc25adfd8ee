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
 *               over (x, v, u, a, b, a, b, kx, ky); they are weighed by their likelihoods.
 *
 * First the search: velocities of the flow, averaged over a quarter of the least L, are fitted by
 * cells of every size (and heading), a few candidates with each sample; the best are refined by
 * least squares. Where one stays without a rival, the filters start from it and follow.
 *
 * The test of misfit: SF_OK needs innovations of the size that the noise (third differences of the
 * log) gives them and without memory, a flow that explains what was averaged, two waves as strong
 * as each other, a heading of 0 where that was demanded, and 95 % intervals of U0, L and L/U0
 * within the precision. Not tested: a wrong response time, and a slow drift of the pattern.
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

#define SF_STATES 12u /* x, y, vx, vy, ux, uy, a, b, a, b, kx, ky */
#define SF_FLOW 6u    /* the last six: parameters of the flow */
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
    SF_INNOVATIONS = 6, /* misfit: innovations too large or with a memory, or too much unexplained */
    SF_SHAPE = 7,       /* misfit: the two waves are not as strong as each other */
    SF_TURNED = 8,      /* misfit: the cells are turned, and a heading of 0 was demanded */
    SF_EDGE = 9         /* L is outside of what was sought */
} sf_doubt;

typedef struct {
    sf_real response_time; /* tau [s], > 0; INFINITY for quadratic drag alone */
    sf_real drag_coefficient; /* c [1/m], >= 0 */
    sf_real thrust_x;      /* a0 [m/s^2] */
    sf_real thrust_y;
    sf_real thrust_scale;  /* s, of a measured thrust */
    sf_real lower;         /* the least length scale that is sought [m] */
    sf_real upper;         /* the largest */
    sf_real precision;     /* half-width of the 95 % intervals over the value, of an answer that is OK */
    sf_real memory;        /* time in which the weight of a sample falls by e [s]; 0: all count alike */
    uint32_t any_heading;  /* 0: the cells lie along x and y */
    uint32_t candidates;   /* that are looked at with a sample while nothing is followed */
} sf_config;

typedef struct {
    sf_status status;
    sf_doubt doubt;
    uint32_t samples;             /* taken so far */
    sf_real mean_velocity;        /* U0 [m/s]; NaN where nothing is followed, as all below */
    sf_real length_scale;         /* L [m] */
    sf_real timescale;            /* L/U0 [s] */
    sf_real heading;              /* [rad], of the cells, in (-pi/4, pi/4] */
    sf_real mean_velocity_error;  /* standard errors of the four */
    sf_real length_scale_error;
    sf_real timescale_error;
    sf_real heading_error;
    sf_real innovation;           /* mean square of the normalised innovations, 1 of a right model */
    sf_real correlation;          /* their covariance from one sample to the next, 0 of a right model */
    sf_real unexplained;          /* share of the averaged flow velocity's squares */
    sf_real rival;                /* L of the rival [m], where that is the doubt */
    sf_real flow[8];              /* a, b, a, b, kx, ky, and the place that phases count from [m] */
} sf_answer;

/* One Kalman filter. */
typedef struct {
    sf_real state[SF_STATES];
    sf_real covariance[SF_STATES][SF_STATES];
    sf_real log_likelihood; /* fading */
    sf_real square;         /* mean square of the innovations, fading */
    sf_real product;        /* mean product of neighbouring innovations, fading */
    sf_real last[4];        /* innovations of the last sample */
} sf_filter;

/* One candidate of a sweep, and the least squares that refines it. */
typedef struct {
    sf_real score; /* share of the rows' squares that it explains */
    sf_real size;  /* |k| [rad/m] */
    sf_real angle; /* of k [rad] */
    sf_real parameters[SF_FLOW];
    sf_real trial[SF_FLOW];
    sf_real right[SF_FLOW];
    sf_real information[SF_FLOW][SF_FLOW];
    sf_real residual; /* of the rows */
    sf_real cost;     /* with what keeps the cells square */
    sf_real damping;
} sf_peak;

/* The state of one estimator: all the memory there is. Its fields are of sf_flow.c alone. */
typedef struct {
    sf_config config;
    uint64_t time_ns;
    uint64_t suspect_ns;
    uint32_t samples;
    uint32_t suspects;
    uint32_t following;
    uint32_t doubt;
    uint32_t recent;         /* samples that third differences have */
    uint32_t row_count;
    uint32_t row_place;
    uint32_t sweeping;
    uint32_t radius;         /* of the next candidate */
    uint32_t turn;
    uint32_t peaks;
    uint32_t refining;       /* peak that is refined, from 1; 0: the sweep goes on */
    uint32_t iteration;
    sf_real step;            /* mean time from sample to sample [s] */
    sf_real origin[2];       /* that all places count from: the first sample [m] */
    sf_real thrust[2];       /* measured with the last sample */
    sf_real history[3][4];
    sf_real counted;
    sf_real noise[2];        /* variances of position [m^2] and velocity [m^2/s^2] */
    sf_real block[11];       /* sums of the samples that become a row */
    sf_real block_time;
    sf_real rows[SF_ROWS][4]; /* place [m], flow velocity [m/s] */
    sf_real spacing;         /* of candidates [rad/m] */
    sf_real total;           /* sum of the rows' squares */
    sf_real middle[2];       /* of the rows, that the phases of peaks count from */
    sf_real rival;
    sf_peak peak[SF_PEAKS];
    sf_real anchor[2];       /* that the filters' places and phases count from */
    sf_real age;             /* samples that were followed */
    sf_real gated;           /* share of outliers, fading */
    sf_real remaining[2];    /* squares of rows less the flow, and of rows, fading */
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
