/*
 * replay.c - replays a recorded flight through sf_flow.c, and compares with a reference.
 *
 *     replay FLIGHT.csv                       prints an answer every 100 samples
 *     replay FLIGHT.csv REFERENCE.csv TOL     compares with the answers that sparsefit wrote
 *
 * FLIGHT.csv, as sparsefit writes it: lines "# response_time=0.5", "# thrust_ax=5", "# thrust_ay=3", then the header
 * time,x,y,vx,vy [s, m, m, m/s, m/s] and a line a sample. Exit code: 0 where all answers agree, 1
 * where one does not, 2 where a file cannot be read. This program is for a desk, not for flight.
 */
#include "sf_flow.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LINE 512
#define VALUES 8 /* of a reference, after sample, status, doubt, rows and refined */

static sf_flow flow;

static const char *const NAMES[VALUES] = {"mean_velocity", "length_scale",  "timescale",
                                          "grid_length_scale", "rival", "length_scale_error",
                                          "unexplained", "certificate"};
/*
 * Of what the last two are shares of: their errors count absolutely. The rival is the place of a
 * shallow minimum, and the error a root of what is left: rounding moves them a hundred times as far.
 */
static const double LEAST[VALUES] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0};
static const double WIDER[VALUES] = {1.0, 1.0, 1.0, 1.0, 100.0, 100.0, 1.0, 1.0};

/* One setting of the flight's first lines; 0 where the line is none. */
static int setting(const char *line, const char *key, double *value)
{
    const char *place = strstr(line, key);
    if ((line[0] != '#') || (place == NULL) || (place[strlen(key)] != '=')) {
        return 0;
    }
    *value = strtod(place + strlen(key) + 1u, NULL);
    return 1;
}

/* Comma-separated numbers; how many there were. */
static int numbers(const char *line, double *values, int most)
{
    int count = 0;
    while (count < most) {
        char *end = NULL;
        values[count] = strtod(line, &end);
        if (end == line) {
            break;
        }
        count++;
        if (*end != ',') {
            break;
        }
        line = end + 1;
    }
    return count;
}

static void values_of(const sf_answer *answer, double values[VALUES])
{
    values[0] = (double)answer->mean_velocity;
    values[1] = (double)answer->length_scale;
    values[2] = (double)answer->timescale;
    values[3] = (double)answer->grid_length_scale;
    values[4] = (double)answer->rival;
    values[5] = (double)answer->length_scale_error;
    values[6] = (double)answer->unexplained;
    values[7] = (double)answer->certificate;
}

static void print(long sample, const sf_answer *answer)
{
    double values[VALUES];
    int i;
    values_of(answer, values);
    (void)printf("%ld,%d,%d,%lu,%lu", sample, (int)answer->status, (int)answer->doubt,
                 (unsigned long)answer->rows, (unsigned long)answer->refined);
    for (i = 0; i < VALUES; i++) {
        (void)printf(",%.17g", values[i]);
    }
    (void)printf("\n");
}

/*
 * The largest relative difference, NaN agreeing with NaN alone; -1 where states differ. Of an
 * answer that is not SF_OK only the state counts: its numbers are not told by the flight.
 */
static double difference(const sf_answer *answer, const double expected[5 + VALUES])
{
    double values[VALUES];
    double largest = 0.0;
    int i;
    if (((int)answer->status != (int)expected[1]) || ((int)answer->doubt != (int)expected[2])
        || ((double)answer->rows != expected[3]) || ((double)answer->refined != expected[4])) {
        return -1.0;
    }
    if (answer->status != SF_OK) {
        return 0.0;
    }
    values_of(answer, values);
    for (i = 0; i < VALUES; i++) {
        const double wanted = expected[5 + i];
        const double size = (fabs(wanted) > LEAST[i]) ? fabs(wanted) : LEAST[i];
        double away = fabs(values[i] - wanted);
        if ((isnan(wanted) != 0) != (isnan(values[i]) != 0)) {
            (void)fprintf(stderr, "%s: %.9g, not %.9g\n", NAMES[i], values[i], wanted);
            return -1.0;
        }
        if (isnan(wanted) || !(away > 0.0)) {
            continue;
        }
        away = ((size > 0.0) ? (away / size) : away) / WIDER[i];
        if (away > largest) {
            largest = away;
        }
    }
    return largest;
}

/* The next line of a reference; its sample, or -1 at the end. Also the nominal step [us] it names. */
static long next_expected(FILE *file, double expected[5 + VALUES], double *sample_us)
{
    char line[LINE];
    while ((file != NULL) && (fgets(line, LINE, file) != NULL)) {
        (void)setting(line, "sample_us", sample_us);
        if (numbers(line, expected, 5 + VALUES) == 5 + VALUES) {
            return (long)expected[0];
        }
    }
    return -1;
}

/* The time from the first sample to the second [us]: the nominal step where no reference names it. */
static double first_step(FILE *flight)
{
    char line[LINE];
    double values[5];
    double time[2] = {0.0, 0.0};
    int held = 0;
    while ((held < 2) && (fgets(line, LINE, flight) != NULL)) {
        if (numbers(line, values, 5) == 5) {
            time[held] = values[0];
            held++;
        }
    }
    rewind(flight);
    return (time[1] - time[0]) * 1e6;
}

int main(int argc, char **argv)
{
    char line[LINE];
    double settings[3] = {0.0, 0.0, 0.0};
    double sample_us = 0.0;
    double expected[5 + VALUES];
    double first = 0.0;
    double worst = 0.0;
    const double tolerance = (argc > 3) ? strtod(argv[3], NULL) : 0.0;
    FILE *flight = (argc > 1) ? fopen(argv[1], "r") : NULL;
    FILE *reference = (argc > 3) ? fopen(argv[2], "r") : NULL;
    long sample = 0;
    long compared = 0;
    long failed = 0;
    long wanted;
    sf_config config;

    if ((flight == NULL) || ((argc > 2) && (reference == NULL))) {
        (void)fprintf(stderr, "usage: replay FLIGHT.csv [REFERENCE.csv TOLERANCE]\n");
        return 2;
    }
    sample_us = first_step(flight);
    wanted = next_expected(reference, expected, &sample_us);
    while (fgets(line, LINE, flight) != NULL) {
        double values[5];
        sf_answer answer;
        sf_status status;
        if ((setting(line, "response_time", &settings[0]) != 0)
            || (setting(line, "thrust_ax", &settings[1]) != 0)
            || (setting(line, "thrust_ay", &settings[2]) != 0)
            || (numbers(line, values, 5) < 5)) {
            continue;
        }
        if (sample == 0) {
            first = values[0];
            config.response_time = (sf_real)settings[0];
            config.thrust_x = (sf_real)settings[1];
            config.thrust_y = (sf_real)settings[2];
            config.origin_x = (sf_real)0;
            config.origin_y = (sf_real)0;
            config.sample_us = (uint32_t)llround(sample_us);
            if (sf_init(&flow, &config) != SF_OK) {
                (void)fprintf(stderr, "the flight has no vehicle: no # response_time= line\n");
                return 2;
            }
        }
        status = sf_update(&flow, (uint64_t)llround((values[0] - first) * 1e6), (sf_real)values[1],
                           (sf_real)values[2], (sf_real)values[3], (sf_real)values[4]);
        if ((status != SF_OK) && (status != SF_GAP)) {
            (void)fprintf(stderr, "sample %ld refused: status %d\n", sample, (int)status);
        }
        if ((reference == NULL) ? (sample % 100 == 99) : (sample == wanted)) {
            (void)sf_estimate(&flow, &answer);
            print(sample, &answer);
            if (reference != NULL) {
                const double away = difference(&answer, expected);
                compared++;
                if ((away < 0.0) || (away > tolerance)) {
                    failed++;
                    (void)fprintf(stderr, "sample %ld: off by %.3g (-1: another state)\n", sample,
                                  away);
                }
                worst = (away > worst) ? away : worst;
                wanted = next_expected(reference, expected, &sample_us);
            }
        }
        sample++;
    }
    (void)fclose(flight);
    if (reference != NULL) {
        (void)fclose(reference);
        (void)fprintf(stderr, "%ld answers compared, largest difference %.3g, %ld beyond %.3g\n",
                      compared, worst, failed, tolerance);
        return ((compared > 0) && (failed == 0) && (wanted < 0)) ? 0 : 1;
    }
    return 0;
}
