/* Every status of the interface, and that what is refused changes nothing. Exit code: the line. */
#include "sf_flow.h"

#include <math.h>
#include <string.h>

#define CHECK(x) \
    if (!(x)) { \
        return __LINE__ % 256; \
    }

static sf_flow flow;
static sf_flow before;

int main(void)
{
    sf_config config = {(sf_real)0.5, 5, 3, 0, 0, 10000u};
    sf_config bad;
    sf_answer answer;
    uint32_t i;
    CHECK(sf_init(NULL, &config) == SF_BAD_ARGUMENT)
    CHECK(sf_init(&flow, NULL) == SF_BAD_ARGUMENT)
    CHECK(sf_update(NULL, 0u, 0, 0, 0, 0) == SF_BAD_ARGUMENT)
    CHECK(sf_estimate(NULL, &answer) == SF_BAD_ARGUMENT)
    CHECK(sf_estimate(&flow, NULL) == SF_BAD_ARGUMENT)
    CHECK(sf_update(&flow, 0u, 0, 0, 0, 0) == SF_NOT_READY)
    CHECK((sf_estimate(&flow, &answer) == SF_NOT_READY) && isnan(answer.mean_velocity))
    for (i = 0u; i < 6u; i++) {
        bad = config;
        bad.response_time = (i == 0u) ? (sf_real)0 : (i == 1u) ? (sf_real)NAN : bad.response_time;
        bad.thrust_x = (i == 2u) ? (sf_real)INFINITY : bad.thrust_x;
        bad.origin_y = (i == 3u) ? (sf_real)NAN : bad.origin_y;
        bad.sample_us = (i == 4u) ? 0u : bad.sample_us;
        bad.response_time = (i == 5u) ? (sf_real)INFINITY : bad.response_time;
        CHECK(sf_init(&flow, &bad) == SF_BAD_ARGUMENT)
        CHECK(sf_update(&flow, 0u, 0, 0, 0, 0) == SF_NOT_READY)
    }
    CHECK(sf_init(&flow, &config) == SF_OK)
    for (i = 0u; i < 60u; i++) {
        const sf_real s = (sf_real)i / 10;
        CHECK(sf_update(&flow, 1000u + 10000u * i, s, 2 * s, 1, 2) == SF_OK)
    }
    before = flow;
    CHECK(sf_update(&flow, 700000u, (sf_real)NAN, 0, 0, 0) == SF_BAD_SAMPLE)
    CHECK(sf_update(&flow, 700000u, 0, (sf_real)INFINITY, 0, 0) == SF_BAD_SAMPLE)
    CHECK(sf_update(&flow, 700000u, 0, 0, -(sf_real)INFINITY, 0) == SF_BAD_SAMPLE)
    CHECK(sf_update(&flow, 700000u, 0, 0, 0, (sf_real)NAN) == SF_BAD_SAMPLE)
    CHECK(sf_update(&flow, 700000u, 0, (sf_real)-1e20, 0, 0) == SF_BAD_SAMPLE)
    CHECK(sf_update(&flow, 591000u, 6, 12, 1, 2) == SF_BAD_TIME)
    CHECK(sf_update(&flow, 5u, 6, 12, 1, 2) == SF_BAD_TIME)
    CHECK(sf_estimate(&flow, &answer) == SF_UNIDENTIFIABLE)
    CHECK((answer.doubt == SF_FEW_SAMPLES) && (answer.rows == 60u - SF_WINDOW + 1u))
    CHECK(isnan(answer.length_scale))
    CHECK(memcmp(&before, &flow, sizeof(flow)) == 0)
    CHECK(sf_update(&flow, 900000u, 6, 12, 1, 2) == SF_GAP)
    CHECK((flow.held == 1u) && (flow.rows == 60u - SF_WINDOW + 1u))
    CHECK(sf_update(&flow, UINT64_MAX, 6, 12, 1, 2) == SF_GAP)
    return 0;
}
