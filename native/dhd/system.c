/* DHD's functions of the operating system. */
#include "device.h"

#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define EXPORT __attribute__((visibility("default")))
#define SLEEP_MAX 1e6 /* [s] */

EXPORT double dhdGetTime(void)
{
    return 1e-9 * (double)link_now();
}

EXPORT double drdGetTime(void)
{
    return dhdGetTime();
}

EXPORT ulong dhdGetSystemCounter(void)
{
    return (ulong)(link_now() / 1000); /* [us] */
}

EXPORT void dhdSleep(double seconds)
{
    if (!(seconds > 0.0))
        return;
    if (seconds > SLEEP_MAX)
        seconds = SLEEP_MAX;
    struct timespec left = {(time_t)seconds, (long)(1e9 * (seconds - (double)(time_t)seconds))};
    while (nanosleep(&left, &left) < 0 && errno == EINTR) {
    }
}

EXPORT void drdSleep(double seconds)
{
    dhdSleep(seconds);
}

/* Keys are read as they are pressed, for the moment of the call only: a program that is killed leaves its terminal as
 * it was. */
static int poll_key(bool take)
{
    struct termios before, raw;
    struct pollfd input = {STDIN_FILENO, POLLIN, 0};
    const bool terminal = tcgetattr(STDIN_FILENO, &before) == 0;
    char key = 0;
    int found;

    if (terminal) {
        raw = before;
        raw.c_lflag &= ~(tcflag_t)(ICANON | ECHO);
        tcsetattr(STDIN_FILENO, TCSANOW, &raw);
    }
    found = poll(&input, 1, take ? -1 : 0) == 1;
    if (found && take)
        found = read(STDIN_FILENO, &key, 1) == 1;
    if (terminal)
        tcsetattr(STDIN_FILENO, TCSANOW, &before);
    return take ? (found ? (unsigned char)key : 0) : found;
}

EXPORT bool dhdKbHit(void)
{
    return poll_key(false) != 0;
}

EXPORT char dhdKbGet(void)
{
    return (char)poll_key(true);
}

EXPORT int dhdStartThread(void *function(void *), void *argument, int priority)
{
    pthread_t thread;

    (void)priority; /* the loop runs in a process of its own, before all threads of programs */
    if (function == NULL)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    if (pthread_create(&thread, NULL, function, argument) != 0)
        return dhd_fail(DHD_ERROR, "the system gives no more threads");
    pthread_detach(thread);
    dhd_succeed();
    return 0;
}
