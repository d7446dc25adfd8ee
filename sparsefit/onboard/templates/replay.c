/*
 * replay.c - replays a recorded flight through sf_flow.c, and compares with a reference.
 *
 *     replay FLIGHT.csv                       prints an answer every 50 samples, as CSV
 *     replay FLIGHT.csv REFERENCE.csv TOL     compares each of them with a line of the reference
 *
 * FLIGHT.csv, as sparsefit writes it: lines "# response_time=0.5", the header time,x,y,vx,vy (and
 * ax,ay: a measured thrust), and a line a sample. Exit code: 0 where all answers agree, 1 where one
 * does not, 2 where a file cannot be read. This program is for a desk, not for flight.
 */
#include "sf_flow.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define EVERY 50
#define VALUES 9

/* Standard errors, tests and the heading count absolutely, by these; the doubt has to be equal. */
static const double LEAST[VALUES] = {0, 0, 0, 0, 1, 1, 1, 10, 10};

static sf_flow flow;

static sf_real setting(const char *text, const char *key, double value)
{
    const char *place = strstr(text, key);
    return (sf_real)(place ? strtod(place + strlen(key), NULL) : value);
}

/* The largest difference of an answer from a line of the reference. */
static double difference(const char *line, long sample, const double values[VALUES])
{
    char *place;
    double worst = strtol(line, &place, 10) == sample ? 0 : HUGE_VAL;
    int i;
    for (i = 0; i < VALUES; i++) {
        const double wanted = strtod(place + 1, &place);
        const double apart = fabs(values[i] - wanted) / (LEAST[i] + fabs(wanted));
        if (i == 0 && values[0] != wanted) {
            return HUGE_VAL;
        }
        worst = apart > worst ? apart : worst; /* NaN of both, where nothing is followed, agrees */
    }
    return worst;
}

int main(int count, char **names)
{
    const double tolerance = count > 3 ? strtod(names[3], NULL) : HUGE_VAL;
    FILE *flight = count > 1 ? fopen(names[1], "r") : NULL;
    FILE *reference = count > 3 ? fopen(names[2], "r") : NULL;
    char line[1024], head[8192] = "\n";
    sf_config config = {.thrust_scale = 1, SF_SETTINGS};
    double begin = 0, worst = 0;
    long sample = 0;
    int thrust = 0, i;
    if ((flight == NULL) || ((count > 2) && (reference == NULL))) {
        (void)fprintf(stderr, "replay FLIGHT.csv [REFERENCE.csv TOLERANCE]: cannot be read\n");
        return 2;
    }
    while ((fgets(line, (int)sizeof line, flight) != NULL) && (line[0] == '#')) {
        (void)strncat(head, line + 2, sizeof head - strlen(head) - 1u);
    }
    thrust = strstr(line, ",ax,ay") != NULL;
    config.response_time = setting(head, "\nresponse_time=", HUGE_VAL);
    config.drag_coefficient = setting(head, "\ndrag=", 0);
    config.thrust_x = setting(head, "\nthrust_ax=", 0);
    config.thrust_y = setting(head, "\nthrust_ay=", 0);
    config.thrust_scale = setting(head, "\nthrust_scale=", 1);
    if (sf_init(&flow, &config) != SF_OK) {
        (void)fprintf(stderr, "%s: no vehicle\n", names[1]);
        return 2;
    }
    (void)puts("sample,doubt,mean_velocity,length_scale,timescale,heading,mean_velocity_error,"
               "length_scale_error,innovation,unexplained");
    if ((reference != NULL) && (fgets(line, (int)sizeof line, reference) == NULL)) {
        (void)fprintf(stderr, "%s: empty\n", names[2]);
        return 2;
    }
    while (fgets(line, (int)sizeof line, flight) != NULL) {
        double n[7] = {0};
        char *place = line;
        sf_real z[6];
        for (i = 0; i < (thrust ? 7 : 5); i++) {
            n[i] = strtod(place + (i > 0), &place);
            z[i > 0 ? i - 1 : 0] = (sf_real)n[i];
        }
        begin = sample == 0 ? n[0] : begin;
        (void)sf_update(&flow, (uint64_t)floor((n[0] - begin) * 1e9 + 0.5), z, z + 2,
                        thrust ? z + 4 : NULL);
        sample++;
        if (sample % EVERY == 0) {
            sf_answer a;
            (void)sf_estimate(&flow, &a);
            const double values[VALUES] = {
                a.doubt, a.mean_velocity, a.length_scale, a.timescale, a.heading,
                a.mean_velocity_error, a.length_scale_error, a.innovation, a.unexplained};
            (void)printf("%ld,%d", sample, (int)a.doubt);
            for (i = 1; i < VALUES; i++) {
                (void)printf(",%.9g", values[i]);
            }
            (void)puts("");
            if ((reference != NULL) && (fgets(line, (int)sizeof line, reference) != NULL)) {
                worst = fmax(worst, difference(line, sample, values));
            }
        }
    }
    (void)fclose(flight);
    if (reference != NULL) {
        (void)fclose(reference);
        (void)printf("largest difference %.2g\n", worst);
    }
    return worst <= tolerance ? 0 : 1;
}
