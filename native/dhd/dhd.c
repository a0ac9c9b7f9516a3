/* DHD: open, identify, read and command a device. */
#include "device.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))
#define TIME_GUARD_NS 500000 /* default of the interface */
#define TIME_GUARD_MAX_US 1000000
#define SMOOTHING 0.05       /* of the time between commands */
#define DEGREES (180.0 / M_PI)
#define GRAVITY_MAX 30.0     /* [m/s2] */

static struct device devices[LINKS_MAX];
static int current = -1; /* device behind ID -1 */
static pthread_once_t once = PTHREAD_ONCE_INIT;

/* ---- errors ---- */

static _Thread_local int last_error;
static _Thread_local char last_text[LINK_TEXT + 64];

int dhd_fail(int error, const char *why)
{
    last_error = error;
    if (why == NULL)
        why = "";
    snprintf(last_text, sizeof last_text, "%s%s%s", dhdErrorGetStr(error), why[0] != 0 ? ": " : "", why);
    return -1;
}

void dhd_succeed(void)
{
    last_error = DHD_NO_ERROR;
}

int dhd_fail_link(enum link_result result)
{
    switch (result) {
    case LINK_NO_DEVICE: return dhd_fail(DHD_ERROR_NO_DEVICE_FOUND, NULL);
    case LINK_NO_MEMORY: return dhd_fail(DHD_ERROR_OUT_OF_MEMORY, link_text(result));
    case LINK_FORKED: return dhd_fail(DHD_ERROR_DEVICE_NOT_READY, link_text(result));
    case LINK_SILENT: return dhd_fail(DHD_ERROR_COM, link_text(result));
    case LINK_IN_USE: return dhd_fail(DHD_ERROR_DEVICE_IN_USE, link_text(result));
    case LINK_NOT_ENABLED: return dhd_fail(DHD_ERROR_NOT_ENABLED, link_text(result));
    case LINK_NOT_FINITE: return dhd_fail(DHD_ERROR_INVALID, link_text(result));
    default: return dhd_fail(DHD_ERROR_DEVICE_NOT_READY, link_text(result));
    }
}

EXPORT int dhdErrorGetLast(void)
{
    return last_error;
}

EXPORT const char *dhdErrorGetLastStr(void)
{
    return last_error == DHD_NO_ERROR ? dhdErrorGetStr(DHD_NO_ERROR) : last_text;
}

EXPORT const char *dhdErrorGetStr(int error)
{
    static const char *const texts[] = {
        "no error", "error", "communication error", "device controller busy", "no driver found", "no device found",
        "not available", "timeout", "geometry error", "expert mode is disabled", "not implemented", "out of memory",
        "device not ready", "file not found", "configuration error", "invalid index", "deprecated", "null argument",
        "redundant encoder failure", "not enabled", "device in use", "invalid argument", "no regulation",
    };

    return error >= 0 && error < (int)(sizeof texts / sizeof *texts) ? texts[error] : "unknown error";
}

/* ---- devices ---- */

static void forget_in_child(void)
{
    for (int i = 0; i < LINKS_MAX; i++)
        pthread_mutex_init(&devices[i].mutex, NULL);
}

static void prepare(void)
{
    forget_in_child();
    pthread_atfork(NULL, NULL, forget_in_child);
}

int dhd_number(char ID)
{
    return ID == -1 || ID == (char)-1 ? __atomic_load_n(&current, __ATOMIC_RELAXED) : (int)(signed char)ID;
}

struct device *dhd_device(char ID)
{
    const int number = dhd_number(ID);

    if (number < 0 && ID == (char)-1)
        return dhd_fail(DHD_ERROR_DEVICE_NOT_READY, "no device is open: call dhdOpen first"), NULL;
    if (number < 0 || number >= LINKS_MAX)
        return dhd_fail(DHD_ERROR_INVALID_INDEX, "there is no device with this ID"), NULL;
    struct device *device = &devices[number];
    struct link *link = __atomic_load_n(&device->link, __ATOMIC_ACQUIRE);
    if (link == NULL || !__atomic_load_n(&link->open, __ATOMIC_ACQUIRE))
        return dhd_fail(DHD_ERROR_DEVICE_NOT_READY, "the device is not open"), NULL;
    if (link->forked)
        return dhd_fail_link(LINK_FORKED), NULL;
    dhd_succeed();
    return device;
}

int dhd_open_number(int number)
{
    char why[LINK_TEXT] = "";
    struct link *link = NULL;

    pthread_once(&once, prepare);
    const enum link_result result = link_open(number, LIBRARY_DHD, &link, why);
    if (result != LINK_OK) {
        char seen[LINK_TEXT];
        if (link_count(seen) == 0)
            link_explain_once("libdhd", seen);
        return dhd_fail(result == LINK_NO_MEMORY ? DHD_ERROR_OUT_OF_MEMORY : DHD_ERROR_NO_DEVICE_FOUND,
                        why[0] ? why : "start one: haptorb run omni --serve native");
    }
    struct device *device = &devices[number];
    pthread_mutex_lock(&device->mutex);
    device->read_at = 0;
    device->guard_ns = TIME_GUARD_NS;
    device->commanded_at = 0;
    device->command_period = 0.0;
    device->force_limit = device->torque_limit = device->grip_limit = INFINITY;
    device->mass = link->facts->mass;
    device->gravity = true;
    device->emulated_button = device->grip_off = false;
    device->force_at = device->torque_at = 0;
    __atomic_store_n(&device->link, link, __ATOMIC_RELEASE);
    pthread_mutex_unlock(&device->mutex);
    link_greet(link);
    __atomic_store_n(&current, number, __ATOMIC_RELAXED);
    dhd_succeed();
    return number;
}

static bool is_open(int number)
{
    const struct link *link = number < 0 ? NULL : __atomic_load_n(&devices[number].link, __ATOMIC_ACQUIRE);

    return link != NULL && link->open && !link->forked;
}

/* The first device that is not open yet here, of a type or serial number if these are not negative. */
static int open_first(int type, int serial)
{
    int refused = -1;

    for (int number = 0; number < LINKS_MAX; number++) {
        struct link *link;
        char why[LINK_TEXT];
        if (is_open(number))
            continue;
        if (link_open(number, LIBRARY_DHD, &link, why) != LINK_OK)
            continue;
        if ((type < 0 || link->facts->type == type) && (serial < 0 || link->facts->serial == serial))
            return dhd_open_number(number);
        link_close(link);
        refused = number;
    }
    if (refused >= 0)
        return dhd_fail(DHD_ERROR_NO_DEVICE_FOUND, type >= 0 ? "none of this type" : "none with this serial number");
    for (int number = 0; number < LINKS_MAX; number++)
        if (is_open(number) && type < 0 && serial < 0)
            return dhd_open_number(number); /* all are open: the same once more, as the maker's library does */
    return dhd_open_number(0);
}

EXPORT void dhdEnableSimulator(bool on)
{
    (void)on; /* which devices there are is for the servos to say */
}

EXPORT int dhdGetDeviceCount(void)
{
    char why[LINK_TEXT];
    const int count = link_count(why);

    dhd_succeed();
    if (count == 0)
        link_explain_once("libdhd", why);
    return count;
}

EXPORT int dhdGetAvailableCount(void)
{
    int available = 0;

    for (int number = 0; number < LINKS_MAX; number++) {
        struct link *link;
        char why[LINK_TEXT], who[LINK_TEXT];
        if (is_open(number) || link_open(number, LIBRARY_DHD, &link, why) != LINK_OK)
            continue;
        available += !link_is_taken(link, who);
        link_close(link);
    }
    dhd_succeed();
    return available;
}

EXPORT int dhdSetDevice(char ID)
{
    const int number = (int)(signed char)ID;

    if (number < 0 || number >= LINKS_MAX || !is_open(number))
        return dhd_fail(DHD_ERROR_INVALID_INDEX, "no open device has this ID");
    __atomic_store_n(&current, number, __ATOMIC_RELAXED);
    dhd_succeed();
    return 0;
}

EXPORT int dhdGetDeviceID(void)
{
    const int number = __atomic_load_n(&current, __ATOMIC_RELAXED);

    return number < 0 ? dhd_fail(DHD_ERROR_DEVICE_NOT_READY, "no device is open") : number;
}

EXPORT int dhdOpen(void)
{
    return open_first(-1, -1);
}

EXPORT int dhdOpenType(int type)
{
    return open_first(type < 0 ? 0 : type, -1);
}

EXPORT int dhdOpenSerial(int serial)
{
    return open_first(-1, serial < 0 ? 0 : serial);
}

EXPORT int dhdOpenID(char ID)
{
    return ID == (char)-1 ? open_first(-1, -1) : dhd_open_number((int)(signed char)ID);
}

EXPORT int dhdClose(char ID)
{
    struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    drd_end(device);
    link_close(device->link);
    if (__atomic_load_n(&current, __ATOMIC_RELAXED) == (int)(device - devices)) {
        int next = -1;
        for (int number = 0; number < LINKS_MAX && next < 0; number++)
            next = is_open(number) ? number : -1;
        __atomic_store_n(&current, next, __ATOMIC_RELAXED);
    }
    dhd_succeed();
    return 0;
}

EXPORT int dhdStop(char ID)
{
    struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    drd_end(device);
    return link_enable(device->link, false) == LINK_OK ? 0 : -1;
}

EXPORT int dhdCheckControllerMemory(char ID)
{
    return dhd_device(ID) == NULL ? -1 : 0;
}

EXPORT int dhdReset(char ID)
{
    return dhd_device(ID) == NULL ? -1 : 0; /* the pose is absolute: there is nothing to initialize */
}

EXPORT int dhdResetWrist(char ID)
{
    return dhd_device(ID) == NULL ? -1 : 0;
}

EXPORT int dhdWaitForReset(int timeout, char ID)
{
    (void)timeout;
    return dhd_device(ID) == NULL ? -1 : 0;
}

/* ---- identity ---- */

static bool has(char ID, int64_t bit)
{
    const struct device *device = dhd_device(ID);

    return device != NULL && (device->link->facts->capabilities & bit) != 0;
}

EXPORT int dhdGetSystemType(char ID)
{
    const struct device *device = dhd_device(ID);

    return device == NULL ? -1 : (int)device->link->facts->type;
}

EXPORT int dhdGetSystemRev(char ID)
{
    return dhd_device(ID) == NULL ? -1 : 0;
}

EXPORT const char *dhdGetSystemName(char ID)
{
    const struct device *device = dhd_device(ID);

    return device == NULL ? NULL : device->link->facts->name;
}

EXPORT int dhdGetSerialNumber(ushort *sn, char ID)
{
    const struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    if (sn == NULL)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    *sn = (ushort)device->link->facts->serial;
    return 0;
}

EXPORT int dhdGetVersion(double *version, char ID)
{
    const struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    if (version == NULL)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    *version = (double)device->link->facts->version;
    return 0;
}

static int copy_text(char *out, size_t size, const char *text)
{
    if (out == NULL || size == 0)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    snprintf(out, size, "%s", text);
    return 0;
}

EXPORT int dhdGetVersionStr(char *version, size_t size, char ID)
{
    const struct device *device = dhd_device(ID);

    return device == NULL ? -1 : copy_text(version, size, device->link->facts->version_text);
}

EXPORT int dhdGetComponentVersionStr(uint32_t component, char *version, size_t size, char ID)
{
    (void)component; /* server, servo and library are one version */
    return dhdGetVersionStr(version, size, ID);
}

EXPORT void dhdGetSDKVersion(int *major, int *minor, int *release, int *revision)
{
    /* The interface's version that programs ask for, not one of haptorb. */
    if (major != NULL)
        *major = 3;
    if (minor != NULL)
        *minor = 16;
    if (release != NULL)
        *release = 0;
    if (revision != NULL)
        *revision = 0;
}

EXPORT const char *dhdGetSDKVersionStr(void)
{
    return "3.16.0-haptorb";
}

EXPORT bool dhdIsLeftHanded(char ID)
{
    return has(ID, IS_LEFT_HANDED);
}

EXPORT bool dhdHasBase(char ID)
{
    return has(ID, HAS_BASE);
}

EXPORT bool dhdHasWrist(char ID)
{
    return has(ID, HAS_WRIST);
}

EXPORT bool dhdHasActiveWrist(char ID)
{
    return has(ID, HAS_ACTIVE_WRIST);
}

EXPORT bool dhdHasGripper(char ID)
{
    return has(ID, HAS_GRIPPER);
}

EXPORT bool dhdHasActiveGripper(char ID)
{
    return has(ID, HAS_ACTIVE_GRIPPER);
}

/* Why the coils are off, by the servo's trip codes: stopped by hand 1, pose lost 2 and 3, host silent 10, device failed
 * 11. */
static int force_off_cause(const struct state *state, const struct link *link)
{
    if (state->guard == 1 || state->guard == 2 || state->guard == 3)
        return link->disabled ? DHD_FORCEOFF_SOFTWARE : DHD_FORCEOFF_NONE;
    switch (state->trip) {
    case 0: return DHD_FORCEOFF_SOFTWARE;
    case 1: return DHD_FORCEOFF_BUTTON;
    case 2:
    case 3: return DHD_FORCEOFF_DEADMAN;
    case 10: return DHD_FORCEOFF_WATCHDOG;
    case 11: return DHD_FORCEOFF_USBDISCN;
    default: return DHD_FORCEOFF_SOFTWARE;
    }
}

static bool coils_run(const struct state *state)
{
    return state->guard >= 1 && state->guard <= 3;
}

EXPORT int dhdGetStatus(int status[DHD_MAX_STATUS], char ID)
{
    struct device *device = dhd_device(ID);
    struct state state;

    if (device == NULL)
        return -1;
    if (status == NULL)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    memset(status, 0, DHD_MAX_STATUS * sizeof *status);
    const bool answers = link_read(device->link, &state) == LINK_OK;
    const int64_t able = device->link->facts->capabilities;
    status[DHD_STATUS_CONNECTED] = status[DHD_STATUS_POWER] = answers;
    status[DHD_STATUS_STARTED] = status[DHD_STATUS_RESET] = answers;
    status[DHD_STATUS_FORCE] = answers && coils_run(&state) && !device->link->disabled;
    status[DHD_STATUS_IDLE] = !status[DHD_STATUS_FORCE];
    status[DHD_STATUS_TORQUE] = status[DHD_STATUS_FORCE] && (able & HAS_ACTIVE_WRIST) != 0;
    status[DHD_STATUS_WRIST_DETECTED] = status[DHD_STATUS_WRIST_INIT] = (able & HAS_WRIST) != 0;
    status[DHD_STATUS_ERROR] = !answers || state.guard == 4;
    status[DHD_STATUS_GRAVITY] = device->gravity;
    status[DHD_STATUS_TIMEGUARD] = device->guard_ns > 0;
    status[DHD_STATUS_FORCEOFFCAUSE] = answers ? force_off_cause(&state, device->link) : DHD_FORCEOFF_USBDISCN;
    return 0;
}

EXPORT int dhdGetComMode(char ID)
{
    const struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    return (device->link->facts->capabilities & IS_SIMULATED) != 0 ? DHD_COM_MODE_VIRTUAL : DHD_COM_MODE_ASYNC;
}

EXPORT double dhdGetComFreq(char ID)
{
    struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1.0;
    pthread_mutex_lock(&device->mutex);
    const double period = device->command_period;
    pthread_mutex_unlock(&device->mutex);
    return period > 0.0 ? 1e-3 / period : 0.0; /* [kHz] */
}

/* ---- read ---- */

int dhd_read(char ID, struct state *state)
{
    struct device *device = dhd_device(ID);
    int answer = 0;

    if (device == NULL)
        return -1;
    pthread_mutex_lock(&device->mutex);
    const int64_t now = link_now();
    if (device->guard_ns > 0 && device->read_at != 0 && now - device->read_at < device->guard_ns) {
        *state = device->last;
        answer = DHD_TIMEGUARD;
    } else {
        const enum link_result result = link_read(device->link, state);
        if (result == LINK_OK) {
            device->last = *state;
            device->read_at = now;
        } else {
            answer = dhd_fail_link(result);
        }
    }
    pthread_mutex_unlock(&device->mutex);
    return answer;
}

/* Angles of three joints about x, y and z, one after the other: R = Rx(a) Ry(b) Rz(c). */
void dhd_angles(const double rotation[9], double angles[3])
{
    const double s = fmax(-1.0, fmin(1.0, rotation[2]));

    angles[1] = asin(s);
    if (fabs(s) < 1.0 - 1e-12) {
        angles[0] = atan2(-rotation[5], rotation[8]);
        angles[2] = atan2(-rotation[1], rotation[0]);
    } else { /* only their sum matters */
        angles[0] = atan2(rotation[7], rotation[4]);
        angles[2] = 0.0;
    }
}

static int give_vector(int answer, const double vector[3], double factor, double *x, double *y, double *z)
{
    if (answer < 0)
        return -1;
    if (x == NULL || y == NULL || z == NULL)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    *x = factor * vector[0];
    *y = factor * vector[1];
    *z = factor * vector[2];
    return answer;
}

static int give_angles(int answer, const double rotation[9], double factor, double *a, double *b, double *c)
{
    double angles[3];

    if (answer < 0)
        return -1;
    dhd_angles(rotation, angles);
    return give_vector(answer, angles, factor, a, b, c);
}

static int give_frame(int answer, const double rotation[9], double matrix[3][3])
{
    if (answer < 0)
        return -1;
    if (matrix == NULL)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    memcpy(matrix, rotation, 9 * sizeof(double));
    return answer;
}

EXPORT int dhdGetPosition(double *px, double *py, double *pz, char ID)
{
    struct state state;

    return give_vector(dhd_read(ID, &state), state.position, 1.0, px, py, pz);
}

EXPORT int dhdGetOrientationRad(double *oa, double *ob, double *og, char ID)
{
    struct state state;

    return give_angles(dhd_read(ID, &state), state.rotation, 1.0, oa, ob, og);
}

EXPORT int dhdGetOrientationDeg(double *oa, double *ob, double *og, char ID)
{
    struct state state;

    return give_angles(dhd_read(ID, &state), state.rotation, DEGREES, oa, ob, og);
}

EXPORT int dhdGetOrientationFrame(double matrix[3][3], char ID)
{
    struct state state;

    return give_frame(dhd_read(ID, &state), state.rotation, matrix);
}

EXPORT int dhdGetPositionAndOrientationRad(double *px, double *py, double *pz, double *oa, double *ob, double *og,
                                           char ID)
{
    struct state state;
    const int answer = give_vector(dhd_read(ID, &state), state.position, 1.0, px, py, pz);

    return give_angles(answer, state.rotation, 1.0, oa, ob, og);
}

EXPORT int dhdGetPositionAndOrientationDeg(double *px, double *py, double *pz, double *oa, double *ob, double *og,
                                           char ID)
{
    struct state state;
    const int answer = give_vector(dhd_read(ID, &state), state.position, 1.0, px, py, pz);

    return give_angles(answer, state.rotation, DEGREES, oa, ob, og);
}

EXPORT int dhdGetPositionAndOrientationFrame(double *px, double *py, double *pz, double matrix[3][3], char ID)
{
    struct state state;
    const int answer = give_vector(dhd_read(ID, &state), state.position, 1.0, px, py, pz);

    return give_frame(answer, state.rotation, matrix);
}

/* The newest state without the time guard: for what may be read at any time. */
static int read_now(char ID, struct state *state)
{
    struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    const enum link_result result = link_read(device->link, state);
    return result == LINK_OK ? 0 : dhd_fail_link(result);
}

EXPORT int dhdGetLinearVelocity(double *vx, double *vy, double *vz, char ID)
{
    struct state state;

    return give_vector(read_now(ID, &state), state.velocity, 1.0, vx, vy, vz);
}

EXPORT int dhdGetAngularVelocityRad(double *wx, double *wy, double *wz, char ID)
{
    struct state state;

    return give_vector(read_now(ID, &state), state.angular_velocity, 1.0, wx, wy, wz);
}

EXPORT int dhdGetAngularVelocityDeg(double *wx, double *wy, double *wz, char ID)
{
    struct state state;

    return give_vector(read_now(ID, &state), state.angular_velocity, DEGREES, wx, wy, wz);
}

static int refuse_velocity_window(int mode, char ID)
{
    if (dhd_device(ID) == NULL)
        return -1;
    if (mode != DHD_VELOCITY_WINDOWING)
        return dhd_fail(DHD_ERROR_INVALID, "the only mode is windowing");
    return dhd_fail(DHD_ERROR_NOT_AVAILABLE, "velocities are the servo's own estimate, which has no window");
}

EXPORT int dhdConfigLinearVelocity(int ms, int mode, char ID)
{
    (void)ms;
    return refuse_velocity_window(mode, ID);
}

EXPORT int dhdConfigAngularVelocity(int ms, int mode, char ID)
{
    (void)ms;
    return refuse_velocity_window(mode, ID);
}

EXPORT int dhdConfigGripperVelocity(int ms, int mode, char ID)
{
    (void)ms;
    return refuse_velocity_window(mode, ID);
}

EXPORT uint dhdGetButtonMask(char ID)
{
    struct state state;

    if (read_now(ID, &state) < 0)
        return 0;
    const struct device *device = dhd_device(ID);
    return (uint)state.buttons | (device != NULL && device->emulated_button ? 1u : 0u);
}

EXPORT int dhdGetButton(int index, char ID)
{
    if (dhd_device(ID) == NULL)
        return -1;
    if (index < 0 || index >= DHD_MAX_BUTTONS)
        return dhd_fail(DHD_ERROR_INVALID_INDEX, "a button has a number from 0 to 31");
    return dhdGetButtonMask(ID) >> index & 1u ? DHD_ON : DHD_OFF;
}

EXPORT int dhdEmulateButton(uchar on, char ID)
{
    struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    device->emulated_button = on != 0;
    return 0;
}

static int read_gripper(char ID, struct state *state)
{
    if (dhd_device(ID) == NULL)
        return -1;
    if (!has(ID, HAS_GRIPPER))
        return dhd_fail(DHD_ERROR_NOT_AVAILABLE, "the device has no gripper");
    return dhd_read(ID, state);
}

static int give_number(int answer, double value, double *out)
{
    if (answer < 0)
        return -1;
    if (out == NULL)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    *out = value;
    return answer;
}

static double grip_length(char ID)
{
    const struct device *device = dhd_device(ID);

    return device == NULL ? 0.0 : device->link->facts->grip_length;
}

EXPORT int dhdGetGripperAngleRad(double *a, char ID)
{
    struct state state;
    const int answer = read_gripper(ID, &state);

    return answer < 0 ? -1 : give_number(answer, state.grip_angle, a);
}

EXPORT int dhdGetGripperAngleDeg(double *a, char ID)
{
    struct state state;
    const int answer = read_gripper(ID, &state);

    return answer < 0 ? -1 : give_number(answer, DEGREES * state.grip_angle, a);
}

EXPORT int dhdGetGripperGap(double *g, char ID)
{
    struct state state;
    const int answer = read_gripper(ID, &state);

    return answer < 0 ? -1 : give_number(answer, 2.0 * grip_length(ID) * sin(0.5 * state.grip_angle), g);
}

/* Thumb and finger lie ahead of the wrist's centre, half the gap to either side along its y axis. */
static int give_fingertip(double side, double *px, double *py, double *pz, char ID)
{
    struct state state;
    double tip[3];
    const int answer = read_gripper(ID, &state);

    if (answer < 0)
        return -1;
    const double length = grip_length(ID);
    const double ahead = -length * cos(0.5 * state.grip_angle), aside = side * length * sin(0.5 * state.grip_angle);
    for (int i = 0; i < 3; i++)
        tip[i] = state.position[i] + state.rotation[3 * i] * ahead + state.rotation[3 * i + 1] * aside;
    return give_vector(answer, tip, 1.0, px, py, pz);
}

EXPORT int dhdGetGripperThumbPos(double *px, double *py, double *pz, char ID)
{
    return give_fingertip(-1.0, px, py, pz, ID);
}

EXPORT int dhdGetGripperFingerPos(double *px, double *py, double *pz, char ID)
{
    return give_fingertip(1.0, px, py, pz, ID);
}

EXPORT int dhdGetGripperAngularVelocityRad(double *wg, char ID)
{
    struct state state;
    const int answer = read_gripper(ID, &state);

    return answer < 0 ? -1 : give_number(answer, state.grip_velocity, wg);
}

EXPORT int dhdGetGripperAngularVelocityDeg(double *wg, char ID)
{
    struct state state;
    const int answer = read_gripper(ID, &state);

    return answer < 0 ? -1 : give_number(answer, DEGREES * state.grip_velocity, wg);
}

EXPORT int dhdGetGripperLinearVelocity(double *vg, char ID)
{
    struct state state;
    const int answer = read_gripper(ID, &state);

    return answer < 0 ? -1
                      : give_number(answer, grip_length(ID) * cos(0.5 * state.grip_angle) * state.grip_velocity, vg);
}

EXPORT int dhdGetForce(double *fx, double *fy, double *fz, char ID)
{
    struct state state;

    return give_vector(read_now(ID, &state), state.force, 1.0, fx, fy, fz);
}

EXPORT int dhdGetForceAndTorque(double *fx, double *fy, double *fz, double *tx, double *ty, double *tz, char ID)
{
    struct state state;
    const int answer = give_vector(read_now(ID, &state), state.force, 1.0, fx, fy, fz);

    return give_vector(answer, state.torque, 1.0, tx, ty, tz);
}

EXPORT int dhdGetForceAndTorqueAndGripperForce(double *fx, double *fy, double *fz, double *tx, double *ty, double *tz,
                                               double *fg, char ID)
{
    struct state state;
    int answer = give_vector(read_now(ID, &state), state.force, 1.0, fx, fy, fz);

    answer = give_vector(answer, state.torque, 1.0, tx, ty, tz);
    return give_number(answer, state.grip_force, fg);
}

/* ---- command ---- */

/* A limit of the program's own keeps the direction. */
static bool shorten(double vector[3], double most)
{
    const double size = hypot(hypot(vector[0], vector[1]), vector[2]);

    if (!(size > most)) /* numbers that are not finite are refused further down */
        return false;
    for (int i = 0; i < 3; i++)
        vector[i] *= most / size;
    return true;
}

int dhd_command(struct device *device, const double force[3], const double torque[3], double grip)
{
    double f[3], t[3];
    bool less = false;

    memcpy(f, force, sizeof f);
    memcpy(t, torque, sizeof t);
    pthread_mutex_lock(&device->mutex);
    if (isfinite(device->force_limit))
        less = shorten(f, device->force_limit) || less;
    if (isfinite(device->torque_limit))
        less = shorten(t, device->torque_limit) || less;
    if (device->grip_off)
        grip = isfinite(grip) ? 0.0 : grip;
    if (fabs(grip) > device->grip_limit) {
        grip = copysign(device->grip_limit, grip);
        less = true;
    }
    const int64_t now = link_now();
    if (device->commanded_at != 0) {
        const double period = 1e-9 * (double)(now - device->commanded_at);
        device->command_period = device->command_period > 0.0 && period < 1.0
                                     ? device->command_period + SMOOTHING * (period - device->command_period)
                                     : period;
    }
    device->commanded_at = now;
    pthread_mutex_unlock(&device->mutex);
    const enum link_result result = link_command(device->link, f, t, grip);
    if (result == LINK_IN_USE) {
        char who[LINK_TEXT];
        return link_is_taken(device->link, who) ? dhd_fail(DHD_ERROR_DEVICE_IN_USE, who) : dhd_fail_link(result);
    }
    if (result != LINK_OK && result != LINK_SATURATED)
        return dhd_fail_link(result);
    return less || result == LINK_SATURATED ? DHD_MOTOR_SATURATED : 0;
}

static int set_all(double fx, double fy, double fz, double tx, double ty, double tz, double fg, char ID)
{
    struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    if (drd_runs(device))
        return dhd_fail(DHD_ERROR_DEVICE_IN_USE,
                        "regulation runs: use drdSetForceAndTorqueAndGripperForce, or drdStop");
    pthread_mutex_lock(&device->mutex);
    device->force_at = device->torque_at = 0;
    pthread_mutex_unlock(&device->mutex);
    return dhd_command(device, (double[]){fx, fy, fz}, (double[]){tx, ty, tz}, fg);
}

/* Programs call dhdSetForce and dhdSetTorque one after the other: each leaves what the other commanded last. */
static int set_one(bool turns, double x, double y, double z, char ID)
{
    struct device *device = dhd_device(ID);
    double force[3] = {0.0, 0.0, 0.0}, torque[3] = {0.0, 0.0, 0.0};

    if (device == NULL)
        return -1;
    if (!isfinite(x) || !isfinite(y) || !isfinite(z) || drd_runs(device))
        return turns ? set_all(0.0, 0.0, 0.0, x, y, z, 0.0, ID) : set_all(x, y, z, 0.0, 0.0, 0.0, 0.0, ID);
    pthread_mutex_lock(&device->mutex);
    const int64_t now = link_now();
    memcpy(turns ? device->torque : device->force, (double[]){x, y, z}, sizeof force);
    *(turns ? &device->torque_at : &device->force_at) = now;
    if (device->force_at != 0 && now - device->force_at < ALONE_NS)
        memcpy(force, device->force, sizeof force);
    if (device->torque_at != 0 && now - device->torque_at < ALONE_NS)
        memcpy(torque, device->torque, sizeof torque);
    pthread_mutex_unlock(&device->mutex);
    return dhd_command(device, force, torque, 0.0);
}

EXPORT int dhdSetForce(double fx, double fy, double fz, char ID)
{
    return set_one(false, fx, fy, fz, ID);
}

EXPORT int dhdSetTorque(double tx, double ty, double tz, char ID)
{
    return set_one(true, tx, ty, tz, ID);
}

EXPORT int dhdSetForceAndTorque(double fx, double fy, double fz, double tx, double ty, double tz, char ID)
{
    return set_all(fx, fy, fz, tx, ty, tz, 0.0, ID);
}

EXPORT int dhdSetForceAndGripperForce(double fx, double fy, double fz, double fg, char ID)
{
    return set_all(fx, fy, fz, 0.0, 0.0, 0.0, fg, ID);
}

EXPORT int dhdSetForceAndTorqueAndGripperForce(double fx, double fy, double fz, double tx, double ty, double tz,
                                               double fg, char ID)
{
    return set_all(fx, fy, fz, tx, ty, tz, fg, ID);
}

EXPORT int dhdEnableForce(uchar on, char ID)
{
    struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    const enum link_result result = link_enable(device->link, on != 0);
    return result == LINK_OK ? 0 : dhd_fail_link(result);
}

EXPORT int dhdEnableGripperForce(uchar on, char ID)
{
    struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    if (on && !has(ID, HAS_ACTIVE_GRIPPER))
        return dhd_fail(DHD_ERROR_NOT_AVAILABLE, "the device has no active gripper");
    pthread_mutex_lock(&device->mutex);
    device->grip_off = on == 0; /* from the next command on */
    pthread_mutex_unlock(&device->mutex);
    return 0;
}

static int set_limit(double most, double *limit)
{
    if (isnan(most))
        return dhd_fail(DHD_ERROR_INVALID, "a limit must be a number");
    *limit = most < 0.0 ? INFINITY : most; /* negative: no limit but the device's */
    return 0;
}

EXPORT int dhdSetMaxForce(double most, char ID)
{
    struct device *device = dhd_device(ID);

    return device == NULL ? -1 : set_limit(most, &device->force_limit);
}

EXPORT int dhdSetMaxTorque(double most, char ID)
{
    struct device *device = dhd_device(ID);

    return device == NULL ? -1 : set_limit(most, &device->torque_limit);
}

EXPORT int dhdSetMaxGripperForce(double most, char ID)
{
    struct device *device = dhd_device(ID);

    return device == NULL ? -1 : set_limit(most, &device->grip_limit);
}

EXPORT double dhdGetMaxForce(char ID)
{
    const struct device *device = dhd_device(ID);

    return device == NULL ? -1.0 : isfinite(device->force_limit) ? device->force_limit : -1.0;
}

EXPORT double dhdGetMaxTorque(char ID)
{
    const struct device *device = dhd_device(ID);

    return device == NULL ? -1.0 : isfinite(device->torque_limit) ? device->torque_limit : -1.0;
}

EXPORT double dhdGetMaxGripperForce(char ID)
{
    const struct device *device = dhd_device(ID);

    return device == NULL ? -1.0 : isfinite(device->grip_limit) ? device->grip_limit : -1.0;
}

EXPORT int dhdSetStandardGravity(double g, char ID)
{
    if (dhd_device(ID) == NULL)
        return -1;
    if (!(g >= 0.0 && g <= GRAVITY_MAX))
        return dhd_fail(DHD_ERROR_INVALID, "gravity is 0 to 30 m/s2");
    return 0; /* the device's own weight is not felt: there is nothing to compensate */
}

EXPORT int dhdSetGravityCompensation(int on, char ID)
{
    struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    device->gravity = on != 0;
    return 0;
}

EXPORT int dhdSetEffectorMass(double mass, char ID)
{
    struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    if (!(mass >= 0.0 && mass <= 10.0))
        return dhd_fail(DHD_ERROR_INVALID, "the mass of an end effector is 0 to 10 kg");
    device->mass = mass;
    return 0;
}

EXPORT int dhdGetEffectorMass(double *mass, char ID)
{
    const struct device *device = dhd_device(ID);

    return device == NULL ? -1 : give_number(0, device->mass, mass);
}

EXPORT int dhdSetTimeGuard(int us, char ID)
{
    struct device *device = dhd_device(ID);

    if (device == NULL)
        return -1;
    if (us < -1 || us > TIME_GUARD_MAX_US)
        return dhd_fail(DHD_ERROR_INVALID, "the time guard is 0 (none) to 1000000 us, or -1 for the default");
    device->guard_ns = us < 0 ? TIME_GUARD_NS : 1000LL * us;
    return 0;
}
