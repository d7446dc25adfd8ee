/*
 * Seeded samples of every odd kind, for the sanitizers: gaps, uneven and tiny steps, standing
 * still, NaN, 1e300, states that jump about by 1e-6 to 1e5. Exit code 1 where an answer that is
 * SF_OK has a number that is none.
 */
#include "sf_flow.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static sf_flow flow;

static double random_share(void)
{
    return (double)rand() / RAND_MAX;
}

int main(void)
{
    const sf_config config = {(sf_real)0.5, 5, 3, 0, 0, 10000u};
    long ok = 0;
    long doubted = 0;
    int flight;
    srand(3);
    for (flight = 0; flight < 12; flight++) {
        const double jump = pow(10.0, flight - 6);
        double state[4] = {0.0, 0.0, 1.0, 1.0};
        uint64_t time = 0u;
        int kind = 0;
        int i;
        if (sf_init(&flow, &config) != SF_OK) {
            return 2;
        }
        for (i = 0; i < 3000; i++) {
            double x;
            if (random_share() < 0.01) {
                kind = rand() % 8;
            }
            time += (kind == 1) ? (uint64_t)(20000.0 * random_share())
                    : (kind == 2) ? 1u
                    : ((kind == 3) && (random_share() < 0.1)) ? 5000000000u : 10000u;
            if (kind == 4) {
                int c;
                for (c = 0; c < 4; c++) {
                    state[c] = jump * (random_share() - 0.5);
                }
            } else if (kind != 5) {
                state[0] += 0.1 * random_share();
                state[1] += 0.07 * random_share() * sin(state[0]);
                state[2] = 10.0 * sin(0.7 * state[0]) * cos(0.7 * state[1]);
                state[3] = -10.0 * cos(0.7 * state[0]) * sin(0.7 * state[1]);
            }
            x = ((kind < 6) || (random_share() > 0.2)) ? state[0] : (kind == 6) ? NAN : 1e30;
            (void)sf_update(&flow, time, (sf_real)x, (sf_real)state[1], (sf_real)state[2],
                            (sf_real)state[3]);
            if (i % 50 == 0) {
                sf_answer answer;
                if (sf_estimate(&flow, &answer) != SF_OK) {
                    doubted++;
                } else if (isfinite(answer.mean_velocity) && isfinite(answer.length_scale)
                           && (answer.timescale > (sf_real)0)) {
                    ok++;
                } else {
                    return 1;
                }
            }
        }
    }
    (void)printf("%ld %ld\n", ok, doubted);
    return 0;
}
