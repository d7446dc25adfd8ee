/*
 * replay.c - replays a recorded flight through sf_flow.c, and compares with a reference.
 *
 *     replay FLIGHT.csv                       prints an answer every 50 samples, as CSV
 *     replay FLIGHT.csv REFERENCE.csv TOL     compares each of them with a line of the reference
 *
 * FLIGHT.csv, as sparsefit writes it: lines "# response_time=0.5", the header time,x,y,vx,vy (and
 * ax,ay: a measured thrust), and a line per sample. Exit code: 0 where all answers agree, 1 where
 * one does not, 2 where a file cannot be read. This program is for a desk, not for flight.
 */
#include "sf_flow.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define EVERY 50
#define COLUMNS 10

/* Added to the reference in relative differences: none to the sample and the doubt. */
static const double SCALE[COLUMNS] = {0, 0, 0, 0, 0, 1, 1, 1, 10, 10};

static sf_flow flow;
static sf_config config = {.response_time = (sf_real)HUGE_VAL, .thrust_scale = 1, SF_SETTINGS};
static const struct {
    const char *name;
    sf_real *value;
} SETTING[] = {{"# response_time=", &config.response_time}, {"# drag=", &config.drag_coefficient},
               {"# thrust_ax=", &config.thrust_x}, {"# thrust_ay=", &config.thrust_y},
               {"# thrust_scale=", &config.thrust_scale}};

/* Read a line of numbers with commas between them; 0 where there is none. */
static int numbers(FILE *file, int count, double *value)
{
    char line[1024], *place = line;
    if (fgets(line, (int)sizeof line, file) == NULL) {
        return 0;
    }
    for (int i = 0; i < count; i++) {
        value[i] = strtod(place, &place);
        place += *place == ',';
    }
    return 1;
}

int main(int count, char **names)
{
    const double tolerance = count > 3 ? strtod(names[3], NULL) : HUGE_VAL;
    FILE *flight = count > 1 ? fopen(names[1], "r") : NULL;
    FILE *reference = count > 3 ? fopen(names[2], "r") : NULL;
    char line[1024] = "";
    double row[7] = {0}, wanted[COLUMNS] = {0}, begin = 0, worst = 0;
    long sample = 0;
    if ((flight == NULL) || ((count > 2) && (reference == NULL))) {
        (void)fprintf(stderr, "replay FLIGHT.csv [REFERENCE.csv TOLERANCE]: cannot be read\n");
        return 2;
    }
    while ((fgets(line, (int)sizeof line, flight) != NULL) && (line[0] == '#')) {
        for (int i = 0; i < (int)(sizeof SETTING / sizeof SETTING[0]); i++) {
            const size_t length = strlen(SETTING[i].name);
            if (strncmp(line, SETTING[i].name, length) == 0) {
                *SETTING[i].value = (sf_real)strtod(line + length, NULL);
            }
        }
    }
    const int columns = strstr(line, ",ax,ay") != NULL ? 7 : 5;
    if ((sf_init(&flow, &config) != SF_OK) ||
        ((reference != NULL) && (fgets(line, (int)sizeof line, reference) == NULL))) {
        (void)fprintf(stderr, "replay: no vehicle in %s, or an empty reference\n", names[1]);
        return 2;
    }
    (void)puts("sample,doubt,mean_velocity,length_scale,timescale,heading,mean_velocity_error,"
               "length_scale_error,innovation,unexplained");
    while (numbers(flight, columns, row)) {
        sf_real z[6];
        for (int i = 0; i < 6; i++) {
            z[i] = (sf_real)row[i + 1];
        }
        begin = sample == 0 ? row[0] : begin;
        (void)sf_update(&flow, (uint64_t)floor((row[0] - begin) * 1e9 + 0.5), z, z + 2,
                        columns == 7 ? z + 4 : NULL);
        sample++;
        if (sample % EVERY == 0) {
            sf_answer a;
            (void)sf_estimate(&flow, &a);
            const double value[COLUMNS] = {
                (double)sample, a.doubt, a.mean_velocity, a.length_scale, a.timescale, a.heading,
                a.mean_velocity_error, a.length_scale_error, a.innovation, a.unexplained};
            if ((reference != NULL) && !numbers(reference, COLUMNS, wanted)) {
                worst = HUGE_VAL; /* the reference is shorter */
            }
            for (int i = 0; i < COLUMNS; i++) { /* NaN of both agrees */
                (void)printf(i < COLUMNS - 1 ? "%.9g," : "%.9g\n", value[i]);
                worst = fmax(worst, fabs(value[i] - wanted[i]) / (SCALE[i] + fabs(wanted[i])));
            }
        }
    }
    (void)fclose(flight);
    if (reference != NULL) {
        worst = numbers(reference, 1, wanted) ? HUGE_VAL : worst; /* the flight is shorter */
        (void)fclose(reference);
        (void)printf("largest difference %.2g\n", worst);
    }
    return worst <= tolerance ? 0 : 1;
}
