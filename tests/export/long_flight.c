/*
 * A million samples through cells of 15 m/s and 4.2 m, along a path that crosses many of them again
 * and again: a vehicle that follows the flow at once, so that Phi is the flow. Prints the answer.
 */
#include "sf_flow.h"

#include <math.h>
#include <stdio.h>

static sf_flow flow;

int main(void)
{
    const sf_config config = {(sf_real)1e-9, 0, 0, 0, 0, 10000u};
    const double k = 3.14159265358979323846 / 4.2;
    sf_answer answer;
    uint32_t i;
    if (sf_init(&flow, &config) != SF_OK) {
        return 2;
    }
    for (i = 0u; i < 1000000u; i++) {
        const double t = 0.01 * (double)i;
        const double x = 9.0 * sin(0.71 * t) + 4.0 * sin(2.3 * t + 1.0);
        const double y = 9.0 * cos(0.53 * t) + 4.0 * sin(1.9 * t);
        const double u = 15.0 * sin(k * x) * cos(k * y) + 0.5 * sin(37.0 * t);
        const double v = -15.0 * cos(k * x) * sin(k * y) + 0.5 * cos(41.0 * t);
        if (sf_update(&flow, (uint64_t)i * 10000u, (sf_real)x, (sf_real)y, (sf_real)u, (sf_real)v)
            != SF_OK) {
            return 3;
        }
    }
    (void)sf_estimate(&flow, &answer);
    (void)printf("%d %lu %.12g %.12g\n", (int)answer.status, (unsigned long)answer.rows,
                 (double)answer.mean_velocity, (double)answer.length_scale);
    return 0;
}
