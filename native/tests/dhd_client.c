/* A program for Force Dimension's interface that the tests and benchmarks start.
 *
 *   dhd_client cost                     times of calls [us], one line each: name and time
 *   dhd_client sphere K R X Y Z [S]     a sphere of stiffness K [N/m], radius R and centre X Y Z [m], for S seconds
 *   dhd_client spin [S]                 poses and forces without a pause, for S seconds
 *   dhd_client push F [S]               a force upwards [N], every millisecond; a line when it is felt
 */
#include <drdc.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define ROUNDS 500
#define CALLS 400 /* of a round: shorter than the turn of another program */

static double number(int count, char **words, int at, double otherwise)
{
    return at < count ? atof(words[at]) : otherwise;
}

static int cost(void)
{
    double p[3], R[3][3], least;
    const char *const names[] = {
        "dhdGetPosition", "dhdGetPositionAndOrientationFrame", "dhdSetForce", "dhdGetButtonMask",
    };

    for (int kind = 0; kind < 4; kind++) {
        least = 1e9; /* of all rounds: what the call takes when nothing else takes the processor */
        for (int round = 0; round < ROUNDS; round++) {
            const double begin = dhdGetTime();
            for (int i = 0; i < CALLS; i++) {
                if (kind == 0)
                    dhdGetPosition(&p[0], &p[1], &p[2], -1);
                else if (kind == 1)
                    dhdGetPositionAndOrientationFrame(&p[0], &p[1], &p[2], R, -1);
                else if (kind == 2)
                    dhdSetForce(0.0, 0.0, 1e-3, -1);
                else
                    dhdGetButtonMask(-1);
            }
            least = fmin(least, (dhdGetTime() - begin) / CALLS);
        }
        printf("%s %.4f\n", names[kind], 1e6 * least);
    }
    return 0;
}

static int sphere(int count, char **words)
{
    const double stiffness = atof(words[2]), radius = atof(words[3]);
    const double centre[3] = {atof(words[4]), atof(words[5]), atof(words[6])};
    const double end = dhdGetTime() + number(count, words, 7, 5.0);

    while (dhdGetTime() < end) {
        double p[3], d[3];
        if (dhdGetPosition(&p[0], &p[1], &p[2], -1) < 0)
            return 1;
        for (int i = 0; i < 3; i++)
            d[i] = p[i] - centre[i];
        const double distance = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        const double push = distance > 0.0 ? stiffness * fmax(radius - distance, 0.0) / distance : 0.0;
        if (dhdSetForce(push * d[0], push * d[1], push * d[2], -1) < 0)
            return 1;
        dhdSleep(2e-4);
    }
    return 0;
}

static int spin(double seconds)
{
    const double end = dhdGetTime() + seconds;
    double p[3];

    while (dhdGetTime() < end)
        if (dhdGetPosition(&p[0], &p[1], &p[2], -1) < 0 ||
            dhdSetForce(0.0, 0.0, 0.1 + 0.01 * sin(50.0 * dhdGetTime()), -1) < 0)
            return 1;
    return 0;
}

static int push(double force, double seconds)
{
    const double end = dhdGetTime() + seconds;
    bool contact = false;

    while (dhdGetTime() < end) {
        double f[3];
        if (dhdSetForce(0.0, 0.0, force, -1) < 0 || dhdGetForce(&f[0], &f[1], &f[2], -1) < 0)
            return 1;
        if (!contact && f[2] > 0.9 * force) {
            contact = true;
            printf("contact\n");
            fflush(stdout);
        }
        dhdSleep(1e-3);
    }
    return 0;
}

int main(int count, char **words)
{
    int answer = 2;

    if (count < 2)
        return 2;
    if (dhdOpen() < 0 || dhdSetTimeGuard(0, -1) < 0)
        return fprintf(stderr, "%s\n", dhdErrorGetLastStr()), 3;
    printf("open\n");
    fflush(stdout);
    if (strcmp(words[1], "cost") == 0)
        answer = cost();
    else if (strcmp(words[1], "sphere") == 0 && count >= 7)
        answer = sphere(count, words);
    else if (strcmp(words[1], "spin") == 0)
        answer = spin(number(count, words, 2, 5.0));
    else if (strcmp(words[1], "push") == 0)
        answer = push(number(count, words, 2, 0.5), number(count, words, 3, 60.0));
    if (answer == 1)
        fprintf(stderr, "%s\n", dhdErrorGetLastStr());
    dhdClose(-1);
    return answer;
}
