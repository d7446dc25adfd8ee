/*
 * replay.c - replays a recorded flight through sf_flow.c, and compares with a reference.
 *
 *     replay FLIGHT.csv                       prints an answer every 50 samples, as CSV
 *     replay FLIGHT.csv REFERENCE.csv TOL     compares with the answers that sparsefit wrote
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
#define VALUES 8

static const char *const HEADER =
    "sample,doubt,mean_velocity,length_scale,timescale,heading,mean_velocity_error,"
    "length_scale_error,innovation,unexplained";
/* Standard errors, tests and the heading count absolutely, by these. */
static const double LEAST[VALUES] = {0, 0, 0, 1, 1, 1, 10, 10};

static sf_flow flow;

static double setting(const char *text, const char *key, double value)
{
    const char *place = strstr(text, key);
    return place ? strtod(place + strlen(key), NULL) : value;
}

static int answer_of(double values[VALUES])
{
    sf_answer a;
    (void)sf_estimate(&flow, &a);
    values[0] = (double)a.mean_velocity;
    values[1] = (double)a.length_scale;
    values[2] = (double)a.timescale;
    values[3] = (double)a.heading;
    values[4] = (double)a.mean_velocity_error;
    values[5] = (double)a.length_scale_error;
    values[6] = (double)a.innovation;
    values[7] = (double)a.unexplained;
    return (int)a.doubt;
}

/* The next reference; 0 at its end. */
static int reference_of(FILE *file, long *sample, int *doubt, double values[VALUES])
{
    char line[1024];
    char *place = line;
    int i;
    if ((fgets(line, (int)sizeof line, file) == NULL) || (strchr(line, ',') == NULL)) {
        return 0;
    }
    *sample = strtol(place, &place, 10);
    *doubt = (int)strtol(place + 1, &place, 10);
    for (i = 0; i < VALUES; i++) {
        values[i] = strtod(place + 1, &place);
    }
    return 1;
}

int main(int count, char **names)
{
    const double tolerance = count > 3 ? strtod(names[3], NULL) : 0;
    FILE *flight = count > 1 ? fopen(names[1], "r") : NULL;
    FILE *reference = count > 3 ? fopen(names[2], "r") : NULL;
    char line[1024], head[8192] = "\n";
    sf_config config = {.thrust_scale = 1, SF_SETTINGS};
    double begin = 0, worst = 0, wanted[VALUES], values[VALUES];
    long sample = 0, next = 0;
    int doubt = 0, i, started = 0, thrust = 0, differs = 0;
    if ((flight == NULL) || ((count > 2) && (reference == NULL))) {
        (void)fprintf(stderr, "replay FLIGHT.csv [REFERENCE.csv TOLERANCE]: cannot be read\n");
        return 2;
    }
    if (reference != NULL) {
        (void)fgets(line, (int)sizeof line, reference);
        (void)reference_of(reference, &next, &doubt, wanted);
    } else {
        (void)puts(HEADER);
    }
    while (fgets(line, (int)sizeof line, flight) != NULL) {
        double n[7] = {0};
        char *place = line;
        sf_real position[2], velocity[2], push[2];
        if (!started) {
            if (line[0] == '#') {
                (void)strncat(head, line + 2, sizeof head - strlen(head) - 1u);
                continue;
            }
            thrust = strstr(line, ",ax,ay") != NULL;
            config.response_time = (sf_real)setting(head, "\nresponse_time=", HUGE_VAL);
            config.drag_coefficient = (sf_real)setting(head, "\ndrag=", 0);
            config.thrust_x = (sf_real)setting(head, "\nthrust_ax=", 0);
            config.thrust_y = (sf_real)setting(head, "\nthrust_ay=", 0);
            config.thrust_scale = (sf_real)setting(head, "\nthrust_scale=", 1);
            if (sf_init(&flow, &config) != SF_OK) {
                (void)fprintf(stderr, "%s: no vehicle\n", names[1]);
                return 2;
            }
            started = 1;
            continue;
        }
        for (i = 0; i < (thrust ? 7 : 5); i++) {
            n[i] = strtod(place + (i > 0), &place);
        }
        begin = sample == 0 ? n[0] : begin;
        for (i = 0; i < 2; i++) {
            position[i] = (sf_real)n[1 + i];
            velocity[i] = (sf_real)n[3 + i];
            push[i] = (sf_real)n[5 + i];
        }
        (void)sf_update(&flow, (uint64_t)floor((n[0] - begin) * 1e9 + 0.5), position, velocity,
                        thrust ? push : NULL);
        sample++;
        if ((reference == NULL) && (sample % EVERY == 0)) {
            (void)printf("%ld,%d", sample, answer_of(values));
            for (i = 0; i < VALUES; i++) {
                (void)printf(",%.9g", values[i]);
            }
            (void)puts("");
        }
        if ((reference != NULL) && (sample == next)) {
            const int own = answer_of(values);
            for (i = 0; (i < VALUES) && (own == doubt) && isfinite(wanted[0]); i++) {
                const double size = LEAST[i] + fabs(wanted[i]);
                worst = fmax(worst, fabs(values[i] - wanted[i]) / size);
            }
            if (own != doubt) {
                (void)printf("sample %ld: doubt %d, reference %d\n", sample, own, doubt);
                differs = 1;
            }
            if (!reference_of(reference, &next, &doubt, wanted)) {
                next = -1;
            }
        }
    }
    (void)fclose(flight);
    if (reference != NULL) {
        (void)fclose(reference);
        (void)printf("largest difference %.2g\n", worst);
    }
    return (reference != NULL) && (differs || !(worst <= tolerance)) ? 1 : 0;
}
