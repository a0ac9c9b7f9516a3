/* What the coils do with their duties: haptorb's own simulated device over a socket, or, alone, coils that obey
 * L di/dt = V - R i, Hall sensors proportional to the currents, and a boundary that warms by i2.
 *
 * On the socket (Unix stream, native double) the emulator says {t, duty x y z} every millisecond and
 * hears {current x y z [A], Hall inputs 0..1 of the reference, 9 for each axis x y z, boundary x y z [degC]}.
 */
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "emulator.h"

#define PERIOD 1e-3

uint64_t physics_late;

struct said { double t, duty[CHANNELS]; };
struct heard { double current[CHANNELS], hall[HALL_AXES][HALL_SENSORS], temperature[CHANNELS]; };

static int fd = -1;
static bool wait_for_answer, asked;
static double next_time;
static struct heard heard, before, after; /* what comes in; between these two the world moves in a straight line */
static size_t heard_bytes;
static bool known;

bool physics_connect(const char *socket_path, bool lockstep)
{
    struct sockaddr_un address = {.sun_family = AF_UNIX};

    snprintf(address.sun_path, sizeof address.sun_path, "%s", socket_path);
    fd = socket(AF_UNIX, SOCK_STREAM, 0);
    wait_for_answer = lockstep;
    return fd >= 0 && connect(fd, (struct sockaddr *)&address, sizeof address) == 0;
}

static void alone(double seconds)
{
    static const double gain[HALL_SENSORS][CHANNELS] = {
        {0.02, 0, 0}, {0, 0.02, 0}, {0, 0, 0.02}, {0.014, 0.014, 0}, {0.014, -0.014, 0},
        {0.014, 0, 0.014}, {0.014, 0, -0.014}, {0, 0.014, 0.014}, {0, 0.014, -0.014}};

    for (int i = 0; i < CHANNELS; i++) {
        const double settled = world.supply * world.duty[i] / world.resistance[i];
        const double keep = exp(-seconds * world.resistance[i] / world.inductance);
        world.current[i] = settled + (world.current[i] - settled) * keep;
        /* 17 W hold the boundary 40 K above the room, with a time constant of two minutes */
        const double power = world.current[i] * world.current[i] * world.resistance[i];
        world.temperature[i] += seconds / 120 * (25 + power * 40 / 17 - world.temperature[i]);
    }
    for (int axis = 0; axis < HALL_AXES; axis++)
        for (int k = 0; k < HALL_SENSORS; k++) {
            world.hall[axis][k] = 0.5;
            for (int i = 0; i < CHANNELS; i++)
                world.hall[axis][k] += gain[k][i] * world.current[i] / (1 + axis);
        }
}

static void lost(void)
{
    fprintf(stderr, "the physics has gone: no current flows from now on\n");
    close(fd);
    fd = -1;
    known = false;
    memset(world.current, 0, sizeof world.current);
}

/* Returns whether a whole answer has come. */
static bool listen_(bool wait)
{
    while (heard_bytes < sizeof heard) {
        const ssize_t n = recv(fd, (char *)&heard + heard_bytes, sizeof heard - heard_bytes, wait ? 0 : MSG_DONTWAIT);
        if (n > 0) {
            heard_bytes += (size_t)n;
        } else if (n < 0 && (errno == EAGAIN || errno == EINTR)) {
            if (!wait)
                return false;
        } else {
            lost();
            return false;
        }
    }
    heard_bytes = 0;
    before = after;
    after = heard;
    if (!known)
        before = after;
    known = true;
    return true;
}

/* Steps of a millisecond would let the Hall sensors see a current that the current sensors have not seen yet. */
static void move(double share)
{
    const double *from = (const double *)&before, *to = (const double *)&after;
    struct heard now;

    if (!known)
        return;
    for (size_t i = 0; i < sizeof now / sizeof(double); i++)
        ((double *)&now)[i] = from[i] + share * (to[i] - from[i]);
    memcpy(world.current, now.current, sizeof world.current);
    memcpy(world.hall, now.hall, sizeof world.hall);
    memcpy(world.temperature, now.temperature, sizeof world.temperature);
}

void physics_step(double t, double seconds)
{
    if (fd < 0) {
        alone(seconds);
        return;
    }
    if (t < next_time) {
        move(1 - (next_time - t) / PERIOD);
        return;
    }
    next_time += PERIOD;
    if (asked && !listen_(wait_for_answer)) { /* the answer to the last question is reached one period from now */
        physics_late++;
        return;
    }
    move(0);
    struct said said = {.t = t};
    memcpy(said.duty, world.duty, sizeof said.duty);
    asked = send(fd, &said, sizeof said, MSG_NOSIGNAL) == (ssize_t)sizeof said;
    if (!asked)
        lost();
}
