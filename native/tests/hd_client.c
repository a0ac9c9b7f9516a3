/* A program for OpenHaptics' interface that the tests and benchmarks start.
 *
 *   hd_client rate S                    calls of a callback in S seconds: their number a second
 *   hd_client sphere K R X Y Z S        a sphere of stiffness K [N/mm], radius R and centre X Y Z [mm], for S seconds
 */
#include <HD/hd.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static struct {
    long calls;
    double stiffness, radius, centre[3], first, last;
} render;

static double now(void)
{
    struct timespec time;

    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static HDCallbackCode HDCALLBACK call(void *data)
{
    double p[3], force[3] = {0.0, 0.0, 0.0}, distance = 0.0;
    const HHD device = hdGetCurrentDevice();

    (void)data;
    render.calls++;
    render.last = now();
    if (render.calls == 1)
        render.first = render.last;
    hdBeginFrame(device);
    hdGetDoublev(HD_CURRENT_POSITION, p);
    for (int i = 0; i < 3; i++)
        distance = hypot(distance, p[i] - render.centre[i]);
    if (distance > 0.0 && distance < render.radius)
        for (int i = 0; i < 3; i++)
            force[i] = render.stiffness * (render.radius - distance) * (p[i] - render.centre[i]) / distance;
    hdSetDoublev(HD_CURRENT_FORCE, force);
    hdEndFrame(device);
    return HD_CALLBACK_CONTINUE;
}

int main(int count, char **words)
{
    if (count < 3)
        return 2;
    if (hdInitDevice(HD_DEFAULT_DEVICE) == HD_INVALID_HANDLE)
        return 3;
    double seconds = atof(words[2]);
    if (strcmp(words[1], "sphere") == 0 && count >= 8) {
        render.stiffness = atof(words[2]);
        render.radius = atof(words[3]);
        for (int i = 0; i < 3; i++)
            render.centre[i] = atof(words[4 + i]);
        seconds = atof(words[7]);
    }
    hdEnable(HD_FORCE_OUTPUT);
    hdScheduleAsynchronous(call, NULL, HD_DEFAULT_SCHEDULER_PRIORITY);
    hdStartScheduler();
    printf("open\n");
    fflush(stdout);
    usleep((useconds_t)(1e6 * seconds));
    hdStopScheduler();
    const HDErrorInfo error = hdGetError();
    hdDisableDevice(hdGetCurrentDevice());
    printf("rate %.2f\n", (double)(render.calls - 1) / (render.last - render.first));
    if (error.errorCode != HD_SUCCESS)
        fprintf(stderr, "%s\n", hdGetErrorString(error.errorCode));
    return error.errorCode != HD_SUCCESS;
}
