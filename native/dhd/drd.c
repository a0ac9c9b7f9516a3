/* DRD: a position controller on top of the commanded force, a spring no stiffer than the device renders stably. */
#include "device.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define EXPORT __attribute__((visibility("default")))
#define PERIOD_NS 1000000LL
#define PERIOD 1e-3
#define MARGIN 0.5 /* of the largest stable stiffness: the program's own thread may be late */
#define SETTLE_S 0.2
#define GUARD_RAMPING 1
#define GUARD_DERATED 3 /* and running between them: the coils may be on */

struct motion {
    double velocity, acceleration, jerk; /* greatest [m/s, m/s2, m/s3] */
};

struct regulation {
    pthread_t thread;
    pid_t process; /* that has the thread: a fork has not */
    struct device *device;
    pthread_mutex_t mutex; /* of everything below */
    pthread_cond_t ticked;
    bool running, ending, position, filter;
    int64_t ticks, started_at;
    double share;           /* of the peak force */
    struct motion move, track;
    double reference[3];    /* where the spring is fixed now */
    double goal[3], from[3];
    double duration, elapsed; /* of the move; 0: none */
    bool tracking;
    double extra[3], extra_torque[3], extra_grip; /* the program's own */
    int64_t extra_at;       /* when it commanded them last */
};

static const struct motion slow = {0.1, 1.0, 20.0}, fast = {0.5, 5.0, 100.0};

bool drd_runs(const struct device *device)
{
    const struct regulation *regulation = __atomic_load_n(&device->regulation, __ATOMIC_ACQUIRE);

    return regulation != NULL && __atomic_load_n(&regulation->running, __ATOMIC_ACQUIRE) &&
           regulation->process == getpid();
}

/* ---- the controller's own thread ---- */

/* The reference after one more period: on the way of a move with the least jerk, or after a target no faster than the
 * limits. Call it with the mutex. */
static void advance(struct regulation *r)
{
    if (r->duration > 0.0) {
        r->elapsed += PERIOD;
        const double s = fmin(1.0, r->elapsed / r->duration);
        const double share = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
        for (int i = 0; i < 3; i++)
            r->reference[i] = r->from[i] + share * (r->goal[i] - r->from[i]);
        if (s >= 1.0)
            r->duration = 0.0;
    } else if (r->tracking) {
        double step[3];
        for (int i = 0; i < 3; i++)
            step[i] = r->goal[i] - r->reference[i];
        const double size = sqrt(step[0] * step[0] + step[1] * step[1] + step[2] * step[2]);
        const double most = r->filter ? r->track.velocity * PERIOD : size;
        const double share = size > most ? most / size : 1.0;
        for (int i = 0; i < 3; i++)
            r->reference[i] += share * step[i];
        r->tracking = share < 1.0;
    }
}

static void *regulate(void *argument)
{
    struct regulation *r = argument;
    struct link *link = r->device->link;
    const struct facts *facts = link->facts;
    int64_t due = link_now();

    for (;;) {
        struct state state;
        double force[3], torque[3], grip;
        due += PERIOD_NS;
        if (link_now() > due + 20 * PERIOD_NS) /* it was stopped: do not catch up */
            due = link_now();
        link_sleep_until(due);
        const bool known = link_read(link, &state) == LINK_OK;
        const bool drives = known && state.valid && state.guard >= GUARD_RAMPING && state.guard <= GUARD_DERATED;
        pthread_mutex_lock(&r->mutex);
        const bool ending = r->ending || !known;
        if (drives) {
            advance(r);
        } else if (known && state.valid) {
            /* Without coils the hand goes where it likes: when they are on again the spring is fixed there. */
            memcpy(r->reference, state.position, sizeof r->reference);
            memcpy(r->goal, state.position, sizeof r->goal);
            r->duration = 0.0;
            r->tracking = false;
        }
        if (link_now() - r->extra_at > ALONE_NS) { /* a program that hangs pushes no longer than one without DRD */
            memset(r->extra, 0, sizeof r->extra);
            memset(r->extra_torque, 0, sizeof r->extra_torque);
            r->extra_grip = 0.0;
        }
        const double stiffness = r->position ? MARGIN * facts->stiffness_max : 0.0;
        for (int i = 0; i < 3; i++) {
            force[i] = drives ? stiffness * (r->reference[i] - state.position[i]) + r->extra[i] : 0.0;
            torque[i] = drives ? r->extra_torque[i] : 0.0;
        }
        const double size = sqrt(force[0] * force[0] + force[1] * force[1] + force[2] * force[2]);
        const double most = r->share * facts->force_max;
        for (int i = 0; i < 3 && size > most; i++)
            force[i] *= most / size;
        grip = drives ? r->extra_grip : 0.0;
        r->ticks++;
        pthread_cond_broadcast(&r->ticked);
        pthread_mutex_unlock(&r->mutex);
        if (ending)
            break;
        const enum link_result result = link_command(link, force, torque, grip);
        if (result != LINK_OK && result != LINK_SATURATED)
            break;
    }
    pthread_mutex_lock(&r->mutex);
    __atomic_store_n(&r->running, false, __ATOMIC_RELEASE);
    pthread_cond_broadcast(&r->ticked);
    pthread_mutex_unlock(&r->mutex);
    return NULL;
}

static struct regulation *make(struct device *device)
{
    struct regulation *r = __atomic_load_n(&device->regulation, __ATOMIC_ACQUIRE);

    if (r != NULL && r->process == getpid())
        return r;
    r = calloc(1, sizeof *r);
    if (r == NULL)
        return dhd_fail(DHD_ERROR_OUT_OF_MEMORY, NULL), NULL;
    pthread_condattr_t attributes;
    pthread_condattr_init(&attributes);
    pthread_condattr_setclock(&attributes, CLOCK_MONOTONIC);
    pthread_cond_init(&r->ticked, &attributes);
    pthread_condattr_destroy(&attributes);
    pthread_mutex_init(&r->mutex, NULL);
    r->process = getpid();
    r->device = device;
    r->position = r->filter = true;
    r->share = 1.0;
    r->move = slow;
    r->track = fast;
    __atomic_store_n(&device->regulation, r, __ATOMIC_RELEASE);
    return r;
}

void drd_end(struct device *device)
{
    struct regulation *r = __atomic_load_n(&device->regulation, __ATOMIC_ACQUIRE);

    if (r == NULL || r->process != getpid())
        return;
    pthread_mutex_lock(&r->mutex);
    const bool started = r->started_at != 0 && !r->ending;
    r->ending = true;
    pthread_mutex_unlock(&r->mutex);
    if (started)
        pthread_join(r->thread, NULL);
    r->started_at = 0;
}

/* ---- start and stop ---- */

EXPORT int drdOpen(void)
{
    return dhdOpen();
}

EXPORT int drdOpenID(char ID)
{
    return dhdOpenID(ID);
}

EXPORT int drdSetDevice(char ID)
{
    return dhdSetDevice(ID);
}

EXPORT int drdGetDeviceID(void)
{
    return dhdGetDeviceID();
}

EXPORT int drdClose(char ID)
{
    return dhdClose(ID);
}

EXPORT bool drdIsSupported(char ID)
{
    const struct device *device = dhd_device(ID);

    return device != NULL && (device->link->facts->capabilities & HAS_BASE) != 0 &&
           device->link->facts->stiffness_max > 0.0;
}

EXPORT bool drdIsInitialized(char ID)
{
    return dhd_device(ID) != NULL; /* the pose is absolute */
}

EXPORT int drdAutoInit(char ID)
{
    return dhd_device(ID) == NULL ? -1 : 0;
}

EXPORT int drdCheckInit(char ID)
{
    return dhd_device(ID) == NULL ? -1 : 0;
}

EXPORT int drdPrecisionInit(char ID)
{
    return dhd_device(ID) == NULL ? -1 : 0;
}

EXPORT bool drdIsRunning(char ID)
{
    const struct device *device = dhd_device(ID);

    return device != NULL && drd_runs(device);
}

EXPORT int drdStart(char ID)
{
    struct device *device = dhd_device(ID);
    struct state state;

    if (device == NULL)
        return -1;
    if (!drdIsSupported(ID))
        return dhd_fail(DHD_ERROR_NOT_AVAILABLE, "the device cannot hold a position");
    if (drd_runs(device))
        return 0;
    const enum link_result result = link_read(device->link, &state);
    if (result != LINK_OK)
        return dhd_fail_link(result);
    drd_end(device); /* one that ended by itself */
    struct regulation *r = make(device);
    if (r == NULL)
        return -1;
    pthread_mutex_lock(&r->mutex);
    memcpy(r->reference, state.position, sizeof r->reference);
    memcpy(r->goal, state.position, sizeof r->goal);
    r->duration = 0.0;
    r->tracking = r->ending = false;
    memset(r->extra, 0, sizeof r->extra);
    memset(r->extra_torque, 0, sizeof r->extra_torque);
    r->extra_grip = 0.0;
    r->ticks = 0;
    r->started_at = link_now();
    __atomic_store_n(&r->running, true, __ATOMIC_RELEASE);
    const bool failed = pthread_create(&r->thread, NULL, regulate, r) != 0;
    if (failed) {
        r->started_at = 0;
        __atomic_store_n(&r->running, false, __ATOMIC_RELEASE);
    }
    pthread_mutex_unlock(&r->mutex);
    return failed ? dhd_fail(DHD_ERROR, "the system gives no more threads") : 0;
}

EXPORT int drdStop(bool keep_forces, char ID)
{
    struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    drd_end(device); /* programs stop what drdAutoInit starts, too, which starts nothing here */
    if (!keep_forces) {
        const double none[3] = {0.0, 0.0, 0.0};
        link_command(device->link, none, none, 0.0);
    }
    return 0;
}

/* The running controller behind `ID`; NULL, and the error. */
static struct regulation *running(char ID)
{
    struct device *device = dhd_device(ID);

    if (device == NULL)
        return NULL;
    if (!drd_runs(device))
        return dhd_fail(DHD_ERROR_NO_REGULATION, "call drdStart first"), NULL;
    return device->regulation;
}

/* Its settings, which may be set before it runs. */
static struct regulation *settings(char ID)
{
    struct device *device = dhd_device(ID);

    return device == NULL ? NULL : make(device);
}

EXPORT bool drdIsMoving(char ID)
{
    const struct device *device = dhd_device(ID);

    if (device == NULL || !drd_runs(device))
        return false;
    struct regulation *r = device->regulation;
    pthread_mutex_lock(&r->mutex);
    const bool moving = r->duration > 0.0 || r->tracking;
    pthread_mutex_unlock(&r->mutex);
    return moving;
}

EXPORT bool drdIsFiltering(char ID)
{
    const struct regulation *r = settings(ID);

    return r != NULL && r->filter;
}

EXPORT int drdEnableFilter(bool on, char ID)
{
    struct regulation *r = settings(ID);

    if (r == NULL)
        return -1;
    r->filter = on;
    return 0;
}

EXPORT int drdRegulatePos(bool on, char ID)
{
    struct regulation *r = settings(ID);

    if (r == NULL)
        return -1;
    if (on && !drdIsSupported(ID))
        return dhd_fail(DHD_ERROR_NOT_AVAILABLE, "the device cannot hold a position");
    r->position = on;
    return 0;
}

static int refuse(char ID, const char *why)
{
    return dhd_device(ID) == NULL ? -1 : dhd_fail(DHD_ERROR_NOT_AVAILABLE, why);
}

#define NO_ROTATION "orientations are not regulated: programs command forces"
#define NO_GRIP "grippers are not regulated: programs command forces"
#define NO_ENCODERS "the device has no encoders that a program could move"
#define NO_GAINS "the spring is half the stiffness that the device renders stably"

EXPORT int drdRegulateRot(bool on, char ID)
{
    return on ? refuse(ID, NO_ROTATION) : dhd_device(ID) == NULL ? -1 : 0;
}

EXPORT int drdRegulateGrip(bool on, char ID)
{
    return on ? refuse(ID, NO_GRIP) : dhd_device(ID) == NULL ? -1 : 0;
}

EXPORT int drdHold(char ID)
{
    struct regulation *r = running(ID);
    struct state state;

    if (r == NULL)
        return -1;
    const enum link_result result = link_read(r->device->link, &state);
    if (result != LINK_OK)
        return dhd_fail_link(result);
    pthread_mutex_lock(&r->mutex);
    memcpy(r->reference, state.position, sizeof r->reference);
    r->duration = 0.0;
    r->tracking = false;
    pthread_mutex_unlock(&r->mutex);
    return 0;
}

EXPORT int drdLock(uchar mask, bool initialize, char ID)
{
    return mask == 0 ? (dhd_device(ID) == NULL ? -1 : 0) : refuse(ID, "the device has no locks");
}

/* ---- motion ---- */

static int check_goal(const struct regulation *r, const double goal[3])
{
    const double *box = r->device->link->facts->workspace;

    for (int i = 0; i < 3; i++) {
        if (!isfinite(goal[i]))
            return dhd_fail(DHD_ERROR_INVALID, "a position must be finite");
        if (goal[i] < box[i] || goal[i] > box[i + 3])
            return dhd_fail(DHD_ERROR_INVALID, "the position is outside of the device's workspace");
    }
    return r->position ? 0 : dhd_fail(DHD_ERROR_NO_REGULATION, "positions are not regulated: call drdRegulatePos");
}

static int move_to(double px, double py, double pz, bool block, char ID)
{
    struct regulation *r = running(ID);
    const double goal[3] = {px, py, pz};

    if (r == NULL || check_goal(r, goal) < 0)
        return -1;
    pthread_mutex_lock(&r->mutex);
    double way = 0.0;
    for (int i = 0; i < 3; i++) {
        r->from[i] = r->reference[i];
        r->goal[i] = goal[i];
        way = hypot(way, goal[i] - r->from[i]);
    }
    /* Greatest velocity, acceleration and jerk of a move with the least jerk over `way` in `duration`: 15/8 way/d,
     * 10/sqrt(3) way/d^2, 60 way/d^3. */
    r->duration = fmax(fmax(1.875 * way / r->move.velocity, sqrt(5.7735 * way / r->move.acceleration)),
                       cbrt(60.0 * way / r->move.jerk));
    r->elapsed = 0.0;
    r->tracking = false;
    const int64_t latest = link_now() + (int64_t)(1e9 * (r->duration + SETTLE_S));
    while (block && r->duration > 0.0 && r->running && link_now() < latest) {
        const struct timespec until = {latest / 1000000000LL, latest % 1000000000LL};
        pthread_cond_timedwait(&r->ticked, &r->mutex, &until);
    }
    const bool runs = r->running;
    pthread_mutex_unlock(&r->mutex);
    return runs ? 0 : dhd_fail(DHD_ERROR_NO_REGULATION, "the regulation ended during the move");
}

EXPORT int drdMoveToPos(double px, double py, double pz, bool block, char ID)
{
    return move_to(px, py, pz, block, ID);
}

EXPORT int drdMoveTo(double p[DHD_MAX_DOF], bool block, char ID)
{
    return p == NULL ? dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL) : move_to(p[0], p[1], p[2], block, ID);
}

EXPORT int drdMoveToRot(double oa, double ob, double og, bool block, char ID)
{
    return refuse(ID, NO_ROTATION);
}

EXPORT int drdMoveToGrip(double pg, bool block, char ID)
{
    return refuse(ID, NO_GRIP);
}

EXPORT int drdMoveToEnc(int enc0, int enc1, int enc2, bool block, char ID)
{
    return refuse(ID, NO_ENCODERS);
}

EXPORT int drdMoveToAllEnc(int enc[DHD_MAX_DOF], bool block, char ID)
{
    return refuse(ID, NO_ENCODERS);
}

static int track(double px, double py, double pz, char ID)
{
    struct regulation *r = running(ID);
    const double goal[3] = {px, py, pz};

    if (r == NULL || check_goal(r, goal) < 0)
        return -1;
    pthread_mutex_lock(&r->mutex);
    memcpy(r->goal, goal, sizeof goal);
    r->duration = 0.0;
    r->tracking = true;
    pthread_mutex_unlock(&r->mutex);
    return 0;
}

EXPORT int drdTrackPos(double px, double py, double pz, char ID)
{
    return track(px, py, pz, ID);
}

EXPORT int drdTrack(double p[DHD_MAX_DOF], char ID)
{
    return p == NULL ? dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL) : track(p[0], p[1], p[2], ID);
}

EXPORT int drdTrackRot(double oa, double ob, double og, char ID)
{
    return refuse(ID, NO_ROTATION);
}

EXPORT int drdTrackGrip(double pg, char ID)
{
    return refuse(ID, NO_GRIP);
}

EXPORT int drdTrackEnc(int enc0, int enc1, int enc2, char ID)
{
    return refuse(ID, NO_ENCODERS);
}

EXPORT int drdTrackAllEnc(int enc[DHD_MAX_DOF], char ID)
{
    return refuse(ID, NO_ENCODERS);
}

EXPORT int drdSetForceAndTorqueAndGripperForce(double fx, double fy, double fz, double tx, double ty, double tz,
                                               double fg, char ID)
{
    struct regulation *r = running(ID);

    if (r == NULL)
        return -1;
    if (!isfinite(fx + fy + fz + tx + ty + tz + fg))
        return dhd_fail(DHD_ERROR_INVALID, "a force must be a finite number");
    pthread_mutex_lock(&r->mutex);
    memcpy(r->extra, (double[]){fx, fy, fz}, sizeof r->extra);
    memcpy(r->extra_torque, (double[]){tx, ty, tz}, sizeof r->extra_torque);
    r->extra_grip = fg;
    r->extra_at = link_now();
    pthread_mutex_unlock(&r->mutex);
    return 0;
}

EXPORT int drdSetForceAndWristJointTorquesAndGripperForce(double fx, double fy, double fz, double t0, double t1,
                                                          double t2, double fg, char ID)
{
    return refuse(ID, "the device has no wrist joints");
}

/* ---- read ---- */

EXPORT int drdGetPositionAndOrientation(double *px, double *py, double *pz, double *oa, double *ob, double *og,
                                        double *pg,
                                        double matrix[3][3], char ID)
{
    struct state state;
    double angles[3];
    const struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    const enum link_result result = link_read(device->link, &state);
    if (result != LINK_OK)
        return dhd_fail_link(result);
    if (px == NULL || py == NULL || pz == NULL || oa == NULL || ob == NULL || og == NULL || pg == NULL ||
        matrix == NULL)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    dhd_angles(state.rotation, angles);
    *px = state.position[0];
    *py = state.position[1];
    *pz = state.position[2];
    *oa = angles[0];
    *ob = angles[1];
    *og = angles[2];
    *pg = 2.0 * device->link->facts->grip_length * sin(0.5 * state.grip_angle);
    memcpy(matrix, state.rotation, sizeof state.rotation);
    return 0;
}

EXPORT int drdGetVelocity(double *vx, double *vy, double *vz, double *wx, double *wy, double *wz, double *vg, char ID)
{
    struct state state;
    const struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    const enum link_result result = link_read(device->link, &state);
    if (result != LINK_OK)
        return dhd_fail_link(result);
    if (vx == NULL || vy == NULL || vz == NULL || wx == NULL || wy == NULL || wz == NULL || vg == NULL)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    *vx = state.velocity[0];
    *vy = state.velocity[1];
    *vz = state.velocity[2];
    *wx = state.angular_velocity[0];
    *wy = state.angular_velocity[1];
    *wz = state.angular_velocity[2];
    *vg = device->link->facts->grip_length * cos(0.5 * state.grip_angle) * state.grip_velocity;
    return 0;
}

EXPORT void drdWaitForTick(char ID)
{
    struct regulation *r = running(ID);

    if (r == NULL) {
        link_sleep_until(link_now() + PERIOD_NS);
        return;
    }
    pthread_mutex_lock(&r->mutex);
    const int64_t ticks = r->ticks, latest = link_now() + 100 * PERIOD_NS;
    const struct timespec until = {latest / 1000000000LL, latest % 1000000000LL};
    while (r->running && r->ticks == ticks && link_now() < latest)
        pthread_cond_timedwait(&r->ticked, &r->mutex, &until);
    pthread_mutex_unlock(&r->mutex);
}

EXPORT double drdGetCtrlFreq(char ID)
{
    struct regulation *r = running(ID);

    if (r == NULL)
        return -1.0;
    pthread_mutex_lock(&r->mutex);
    const double time = 1e-9 * (double)(link_now() - r->started_at);
    const double rate = time > 0.0 ? 1e-3 * (double)r->ticks / time : 0.0; /* [kHz] */
    pthread_mutex_unlock(&r->mutex);
    return rate;
}

/* ---- settings ---- */

EXPORT int drdGetPriorities(int *priority, int *control_priority, char ID)
{
    if (dhd_device(ID) == NULL)
        return -1;
    if (priority == NULL || control_priority == NULL)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    *priority = *control_priority = 0;
    return 0;
}

EXPORT int drdSetPriorities(int priority, int control_priority, char ID)
{
    return refuse(ID, "the system's own priorities apply");
}

EXPORT int drdSetMotRatioMax(double share, char ID)
{
    struct regulation *r = settings(ID);

    if (r == NULL)
        return -1;
    if (!(share >= 0.0 && share <= 1.0))
        return dhd_fail(DHD_ERROR_INVALID, "a share is 0 to 1");
    r->share = share;
    return 0;
}

EXPORT double drdGetMotRatioMax(char ID)
{
    const struct regulation *r = settings(ID);

    return r == NULL ? -1.0 : r->share;
}

#define GAIN(letter)                                                                                                   \
    EXPORT int drdSetEnc##letter##Gain(double gain, char ID)                                                           \
    {                                                                                                                  \
        return refuse(ID, NO_GAINS);                                                                                   \
    }                                                                                                                  \
    EXPORT double drdGetEnc##letter##Gain(char ID)                                                                     \
    {                                                                                                                  \
        return (double)refuse(ID, NO_GAINS);                                                                           \
    }
GAIN(P)
GAIN(I)
GAIN(D)

static int set_motion(struct regulation *r, struct motion *motion, double velocity, double acceleration, double jerk)
{
    if (!(velocity > 0.0 && acceleration > 0.0 && jerk > 0.0) || !isfinite(velocity + acceleration + jerk))
        return dhd_fail(DHD_ERROR_INVALID, "velocity, acceleration and jerk must be above 0");
    pthread_mutex_lock(&r->mutex);
    *motion = (struct motion){velocity, acceleration, jerk};
    pthread_mutex_unlock(&r->mutex);
    return 0;
}

static int get_motion(const struct motion *motion, double *velocity, double *acceleration, double *jerk)
{
    if (velocity == NULL || acceleration == NULL || jerk == NULL)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    *velocity = motion->velocity;
    *acceleration = motion->acceleration;
    *jerk = motion->jerk;
    return 0;
}

#define POSITION_PARAMETERS(name, member)                                                                              \
    EXPORT int drdSet##name(double velocity, double acceleration, double jerk, char ID)                                \
    {                                                                                                                  \
        struct regulation *r = settings(ID);                                                                           \
        return r == NULL ? -1 : set_motion(r, &r->member, velocity, acceleration, jerk);                               \
    }                                                                                                                  \
    EXPORT int drdGet##name(double *velocity, double *acceleration, double *jerk, char ID)                             \
    {                                                                                                                  \
        const struct regulation *r = settings(ID);                                                                     \
        return r == NULL ? -1 : get_motion(&r->member, velocity, acceleration, jerk);                                  \
    }
#define NO_PARAMETERS(name, why)                                                                                       \
    EXPORT int drdSet##name(double velocity, double acceleration, double jerk, char ID)                                \
    {                                                                                                                  \
        return refuse(ID, why);                                                                                        \
    }                                                                                                                  \
    EXPORT int drdGet##name(double *velocity, double *acceleration, double *jerk, char ID)                             \
    {                                                                                                                  \
        return refuse(ID, why);                                                                                        \
    }
POSITION_PARAMETERS(PosMoveParam, move)
POSITION_PARAMETERS(PosTrackParam, track)
NO_PARAMETERS(EncMoveParam, NO_ENCODERS)
NO_PARAMETERS(EncTrackParam, NO_ENCODERS)
NO_PARAMETERS(RotMoveParam, NO_ROTATION)
NO_PARAMETERS(RotTrackParam, NO_ROTATION)
NO_PARAMETERS(GripMoveParam, NO_GRIP)
NO_PARAMETERS(GripTrackParam, NO_GRIP)
