/* HD: devices, frames, parameters and errors. */
#include "internal.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define ERRORS_MAX 32
#define MM 1e3
#define VALUES_MAX 16
#define RAMPING_RATE 1000.0 /* [N/s], until a program sets another */
#define VELOCITY_LIMIT 1e4   /* [mm/s], until a program sets another: no hand is as fast */
#define CAPABILITIES 5
#define MOTORS 6

struct device {
    struct link *link; /* NULL: never opened */
    pthread_t owner;   /* thread of the frame */
    bool framed, tripped;
    struct state now, before; /* latched by this frame and by the one before */
    double force[3], torque[3]; /* to be commanded at the end of the frame, in this interface's frame and units */
    double last_force[3], last_torque[3];
    bool enabled[CAPABILITIES];
    int64_t enabled_at;
    bool told_kinematics;  /* that the device has none: once, as drivers ask for joints in every frame */
    double velocity_limit; /* [mm/s] */
    double ramping_rate;   /* [N/s] */
};

static struct device devices[LINKS_MAX];
static HHD current = HD_INVALID_HANDLE;
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER; /* of the devices */
static HDErrorInfo errors[ERRORS_MAX];
static int error_count;
static pthread_mutex_t error_mutex = PTHREAD_MUTEX_INITIALIZER;
static pthread_once_t once = PTHREAD_ONCE_INIT;

static void forget_in_child(void)
{
    pthread_mutex_init(&mutex, NULL);
    pthread_mutex_init(&error_mutex, NULL);
}

static void prepare(void)
{
    pthread_atfork(NULL, NULL, forget_in_child);
}

/* ---- errors ---- */

void hd_push(HDerror error, int internal, HHD device)
{
    pthread_mutex_lock(&error_mutex);
    if (error_count == ERRORS_MAX) /* the oldest makes room */
        memmove(errors, errors + 1, (size_t)--error_count * sizeof *errors);
    errors[error_count++] = (HDErrorInfo){error, internal, device};
    pthread_mutex_unlock(&error_mutex);
}

EXPORT HDErrorInfo hdGetError(void)
{
    HDErrorInfo found = {HD_SUCCESS, 0, HD_INVALID_HANDLE};

    pthread_mutex_lock(&error_mutex);
    if (error_count > 0)
        found = errors[--error_count];
    pthread_mutex_unlock(&error_mutex);
    return found;
}

EXPORT HDstring hdGetErrorString(HDerror error)
{
    switch (error) {
    case HD_SUCCESS: return "no error";
    case HD_INVALID_ENUM: return "there is no such parameter";
    case HD_INVALID_VALUE: return "a value cannot be";
    case HD_INVALID_OPERATION: return "not available on this device";
    case HD_BAD_HANDLE: return "the device is not open";
    case HD_WARM_MOTORS: return "a winding is too hot; forces are off until it has cooled and a person engages";
    case HD_EXCEEDED_MAX_FORCE: return "more force was commanded than the device has; forces are off";
    case HD_EXCEEDED_MAX_FORCE_IMPULSE: return "more impulse was commanded than allowed; forces are off";
    case HD_EXCEEDED_MAX_VELOCITY: return "the tool is faster than the limit; forces are off";
    case HD_FORCE_ERROR: return "the force is none, or another program commands the device";
    case HD_DEVICE_FAULT: return "no device found, or its servo has switched off: a person must engage";
    case HD_DEVICE_ALREADY_INITIATED: return "the device is open already";
    case HD_COMM_ERROR: return "the servo has ended or does not answer";
    case HD_COMM_CONFIG_ERROR: return "the device cannot be mapped into memory";
    case HD_TIMER_ERROR: return "the scheduler's thread cannot be started or does not come back";
    case HD_ILLEGAL_BEGIN: return "a frame has begun already";
    case HD_ILLEGAL_END: return "no frame of this thread has begun";
    case HD_FRAME_ERROR: return "forces are set between hdBeginFrame and hdEndFrame";
    case HD_INVALID_PRIORITY: return "there is no such priority";
    case HD_SCHEDULER_FULL: return "the scheduler has 64 callbacks";
    case HD_INVALID_LICENSE: return "the licence is none";
    default: return "unknown error";
    }
}

/* ---- frames: x right, y up, z towards the user here; x towards the user, y right, z up in the file ---- */

static void from_file(const double *in, double factor, double *out)
{
    out[0] = factor * in[1];
    out[1] = factor * in[2];
    out[2] = factor * in[0];
}

static void to_file(const double *in, double factor, double *out)
{
    out[0] = factor * in[2];
    out[1] = factor * in[0];
    out[2] = factor * in[1];
}

static void make_transform(const struct state *state, double *m)
{
    static const int axis[3] = {1, 2, 0}; /* of the file, for each of this interface's */

    memset(m, 0, 16 * sizeof *m);
    for (int column = 0; column < 3; column++)
        for (int row = 0; row < 3; row++)
            m[4 * column + row] = state->rotation[3 * axis[row] + axis[column]];
    from_file(state->position, MM, m + 12);
    m[15] = 1.0;
}

/* ---- devices ---- */

/* The open device with this handle; NULL, and an error, if there is none. */
static struct device *find(HHD handle)
{
    struct device *device = handle < LINKS_MAX ? &devices[handle] : NULL;
    const struct link *link = device == NULL ? NULL : __atomic_load_n(&device->link, __ATOMIC_ACQUIRE);

    if (link == NULL || !__atomic_load_n(&link->open, __ATOMIC_ACQUIRE) || link->forked) {
        hd_push(HD_BAD_HANDLE, 0, handle);
        return NULL;
    }
    return device;
}

static bool is_named(const struct link *link, HDstring name)
{
    const char *own = link->facts->name;
    const char *last = strrchr(own, ' ');

    return strcmp(name, own) == 0 || (last != NULL && strcmp(name, last + 1) == 0);
}

EXPORT HHD hdInitDevice(HDstring name)
{
    char why[LINK_TEXT] = "", names[LINK_TEXT] = "";
    const bool any = name == NULL || name[0] == 0 || strncmp(name, "Default", 7) == 0;
    HDerror error = HD_DEVICE_FAULT;

    pthread_once(&once, prepare);
    for (HHD handle = 0; handle < LINKS_MAX; handle++) {
        struct device *device = &devices[handle];
        struct link *link;
        pthread_mutex_lock(&mutex);
        if (device->link != NULL && device->link->open && !device->link->forked) {
            if (any || is_named(device->link, name))
                error = HD_DEVICE_ALREADY_INITIATED;
            pthread_mutex_unlock(&mutex);
            continue;
        }
        char seen[LINK_TEXT];
        const enum link_result result = link_open((int)handle, LIBRARY_HD, &link, seen);
        if (result != LINK_OK) {
            if (seen[0] != 0 && handle == 0)
                snprintf(why, sizeof why, "%s", seen);
        } else if (!any && !is_named(link, name)) {
            snprintf(names + strlen(names), sizeof names - strlen(names), " '%s'", link->facts->name);
            link_close(link);
        } else {
            memset(device, 0, sizeof *device);
            device->enabled[HD_FORCE_RAMPING - HD_FORCE_OUTPUT] = true;
            device->enabled[HD_SOFTWARE_FORCE_LIMIT - HD_FORCE_OUTPUT] = true;
            device->enabled[HD_ONE_FRAME_LIMIT - HD_FORCE_OUTPUT] = true;
            device->velocity_limit = VELOCITY_LIMIT;
            device->ramping_rate = RAMPING_RATE;
            link_read(link, &device->now);
            device->before = device->now;
            __atomic_store_n(&device->link, link, __ATOMIC_RELEASE);
            pthread_mutex_unlock(&mutex);
            __atomic_store_n(&current, handle, __ATOMIC_RELAXED);
            link_greet(link);
            return handle;
        }
        pthread_mutex_unlock(&mutex);
    }
    if (names[0] != 0)
        fprintf(stderr, "libHD (haptorb): there is no device '%.60s'; there are:%s\n", name, names);
    else if (error == HD_DEVICE_FAULT)
        link_explain_once("libHD", why);
    hd_push(error, 0, HD_INVALID_HANDLE);
    return HD_INVALID_HANDLE;
}

EXPORT void hdDisableDevice(HHD handle)
{
    struct device *device = find(handle);

    if (device == NULL)
        return;
    link_close(device->link);
    HHD own = handle;
    __atomic_compare_exchange_n(&current, &own, HD_INVALID_HANDLE, false, __ATOMIC_RELAXED, __ATOMIC_RELAXED);
}

EXPORT void hdMakeCurrentDevice(HHD handle)
{
    if (find(handle) != NULL)
        __atomic_store_n(&current, handle, __ATOMIC_RELAXED);
}

EXPORT HHD hdGetCurrentDevice(void)
{
    return __atomic_load_n(&current, __ATOMIC_RELAXED);
}

/* ---- forces off ---- */

static void switch_off(struct device *device, HDerror error, int internal)
{
    device->enabled[0] = false;
    link_enable(device->link, false);
    hd_push(error, internal, (HHD)(device - devices));
}

/* The servo's own trips appear as this interface's: too hot 8, device failed 11, host silent 10. Call it locked. */
static void note_trip(struct device *device)
{
    const bool tripped = device->now.guard == 4;

    if (tripped && !device->tripped && device->enabled[0]) {
        const int code = (int)device->now.trip;
        const HDerror lost = code == 10 || code == 11 ? HD_COMM_ERROR : HD_DEVICE_FAULT;
        switch_off(device, code == 8 ? HD_WARM_MOTORS : lost, code);
    }
    device->tripped = tripped;
}

static double size_of(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

EXPORT void hdBeginFrame(HHD handle)
{
    struct device *device = find(handle);
    struct state state;

    if (device == NULL)
        return;
    pthread_mutex_lock(&mutex);
    if (device->framed) {
        pthread_mutex_unlock(&mutex);
        hd_push(HD_ILLEGAL_BEGIN, 0, handle);
        return;
    }
    device->framed = true;
    device->owner = pthread_self();
    memset(device->force, 0, sizeof device->force);
    memset(device->torque, 0, sizeof device->torque);
    const enum link_result result = link_read(device->link, &state);
    if (result == LINK_OK) {
        device->before = device->now;
        device->now = state;
        note_trip(device);
        if (device->enabled[0] && MM * size_of(state.velocity) > device->velocity_limit)
            switch_off(device, HD_EXCEEDED_MAX_VELOCITY, 0);
    }
    pthread_mutex_unlock(&mutex);
    if (result != LINK_OK)
        hd_push(HD_COMM_ERROR, 0, handle);
    __atomic_store_n(&current, handle, __ATOMIC_RELAXED);
}

/* Send what the frame has set. Call it locked. */
static void send(struct device *device)
{
    const struct facts *facts = device->link->facts;
    double force[3], torque[3];
    bool finite = true;

    for (int i = 0; i < 3; i++)
        finite = finite && isfinite(device->force[i]) && isfinite(device->torque[i]);
    if (!finite) {
        const double none[3] = {0.0, 0.0, 0.0};
        link_command(device->link, none, none, 0.0);
        hd_push(HD_FORCE_ERROR, 0, (HHD)(device - devices));
        return;
    }
    to_file(device->force, 1.0, force);
    to_file(device->torque, 1.0 / MM, torque);
    const double size = hypot(hypot(force[0], force[1]), force[2]);
    const double turn = hypot(hypot(torque[0], torque[1]), torque[2]);
    double most = INFINITY, most_turn = INFINITY;
    if ((size > facts->force_max || (turn > facts->torque_max && facts->torque_max > 0.0)) &&
        !device->enabled[HD_MAX_FORCE_CLAMPING - HD_FORCE_OUTPUT] &&
        device->enabled[HD_SOFTWARE_FORCE_LIMIT - HD_FORCE_OUTPUT]) {
        switch_off(device, HD_EXCEEDED_MAX_FORCE, 0);
        return;
    }
    if (device->enabled[HD_FORCE_RAMPING - HD_FORCE_OUTPUT]) {
        most = device->ramping_rate * 1e-9 * (double)(link_now() - device->enabled_at);
        most_turn = most * facts->torque_max / facts->force_max;
    }
    for (int i = 0; i < 3 && size > most; i++)
        force[i] *= most / size;
    for (int i = 0; i < 3 && turn > most_turn; i++)
        torque[i] *= most_turn / turn;
    const enum link_result result = link_command(device->link, force, torque, 0.0);
    if (result == LINK_IN_USE)
        hd_push(HD_FORCE_ERROR, 0, (HHD)(device - devices));
    else if (result != LINK_OK && result != LINK_SATURATED)
        hd_push(HD_COMM_ERROR, 0, (HHD)(device - devices));
}

EXPORT void hdEndFrame(HHD handle)
{
    struct device *device = find(handle);

    if (device == NULL)
        return;
    pthread_mutex_lock(&mutex);
    if (!device->framed || !pthread_equal(device->owner, pthread_self())) {
        pthread_mutex_unlock(&mutex);
        hd_push(HD_ILLEGAL_END, 0, handle);
        return;
    }
    device->framed = false;
    if (device->enabled[0])
        send(device);
    memcpy(device->last_force, device->force, sizeof device->force);
    memcpy(device->last_torque, device->torque, sizeof device->torque);
    pthread_mutex_unlock(&mutex);
}

void hd_abandon_frames(void)
{
    pthread_mutex_lock(&mutex);
    for (int i = 0; i < LINKS_MAX; i++)
        if (devices[i].framed && pthread_equal(devices[i].owner, pthread_self()))
            devices[i].framed = false;
    pthread_mutex_unlock(&mutex);
}

/* ---- capabilities ---- */

static struct device *find_capability(HDenum capability)
{
    if (capability < HD_FORCE_OUTPUT || capability >= HD_FORCE_OUTPUT + CAPABILITIES) {
        hd_push(HD_INVALID_ENUM, 0, hdGetCurrentDevice());
        return NULL;
    }
    return find(hdGetCurrentDevice());
}

static void set_capability(HDenum capability, bool on)
{
    struct device *device = find_capability(capability);

    if (device == NULL)
        return;
    pthread_mutex_lock(&mutex);
    bool *enabled = &device->enabled[capability - HD_FORCE_OUTPUT];
    if (capability == HD_FORCE_OUTPUT && on != *enabled) {
        link_enable(device->link, on);
        device->enabled_at = link_now();
        device->tripped = false; /* a trip that lasts is told at the next frame */
    }
    *enabled = on;
    pthread_mutex_unlock(&mutex);
}

EXPORT void hdEnable(HDenum capability)
{
    set_capability(capability, true);
}

EXPORT void hdDisable(HDenum capability)
{
    set_capability(capability, false);
}

EXPORT HDboolean hdIsEnabled(HDenum capability)
{
    struct device *device = find_capability(capability);

    if (device == NULL)
        return HD_FALSE;
    pthread_mutex_lock(&mutex);
    const bool on = device->enabled[capability - HD_FORCE_OUTPUT];
    pthread_mutex_unlock(&mutex);
    return on;
}

/* ---- parameters ---- */

static void give_workspace(const struct facts *facts, double *v)
{
    from_file(facts->workspace, MM, v);
    from_file(facts->workspace + 3, MM, v + 3);
}

/* Angles of a gimbal's three joints: R = Ry(a) Rx(b) Rz(c) in this interface's frame. */
static void give_gimbal(const struct state *state, double *v)
{
    double m[16];

    make_transform(state, m);
    v[1] = asin(fmax(-1.0, fmin(1.0, -m[4 * 2 + 1])));
    v[0] = atan2(m[4 * 2 + 0], m[4 * 2 + 2]);
    v[2] = atan2(m[4 * 0 + 1], m[4 * 1 + 1]);
}

static int give_joints(const struct state *state, double *v)
{
    for (int i = 0; i < 3; i++)
        v[i] = i < state->joints ? state->joint_angles[i] : 0.0;
    return state->joints >= 3 ? 3 : -1;
}

/* The values of `parameter` in the device's locked state; their number, 0 if there is no such parameter, -1 if this
 * device has none. */
static int read_parameter(const struct device *device, HDenum parameter, double *v)
{
    const struct facts *facts = device->link->facts;
    const bool last = parameter >= HD_LAST_BUTTONS && parameter < HD_VERSION;
    const struct state *state = last ? &device->before : &device->now;

    v[0] = 0.0;
    switch (last ? parameter - (HD_LAST_BUTTONS - HD_CURRENT_BUTTONS) : parameter) {
    case HD_CURRENT_BUTTONS: v[0] = (double)(state->buttons & 0xF); return 1;
    case HD_CURRENT_SAFETY_SWITCH: v[0] = 1.0; return 1;
    case HD_CURRENT_INKWELL_SWITCH: return 1;
    case HD_CURRENT_POSITION: from_file(state->position, MM, v); return 3;
    case HD_CURRENT_VELOCITY: from_file(state->velocity, MM, v); return 3;
    case HD_CURRENT_TRANSFORM: make_transform(state, v); return 16;
    case HD_CURRENT_ANGULAR_VELOCITY: from_file(state->angular_velocity, 1.0, v); return 3;
    case HD_CURRENT_JOINT_ANGLES: return give_joints(state, v);
    case HD_CURRENT_GIMBAL_ANGLES: give_gimbal(state, v); return 3;
    case HD_CURRENT_ENCODER_VALUES:
    case HD_CURRENT_JACOBIAN:
    case HD_CURRENT_PINCH_VALUE:
    case HD_LAST_PINCH_VALUE: return -1;
    case HD_MAX_WORKSPACE_DIMENSIONS:
    case HD_USABLE_WORKSPACE_DIMENSIONS: give_workspace(facts, v); return 6;
    case HD_TABLETOP_OFFSET: v[0] = MM * facts->workspace[2]; return 1;
    case HD_INPUT_DOF: v[0] = (facts->capabilities & HAS_WRIST) != 0 ? 6.0 : 3.0; return 1;
    case HD_OUTPUT_DOF: v[0] = (facts->capabilities & HAS_ACTIVE_WRIST) != 0 ? 6.0 : 3.0; return 1;
    case HD_CALIBRATION_STYLE: v[0] = HD_CALIBRATION_AUTO; return 1;
    case HD_UPDATE_RATE: v[0] = hd_rate(); return 1;
    case HD_INSTANTANEOUS_UPDATE_RATE: v[0] = hd_instantaneous_rate(); return 1;
    case HD_NOMINAL_MAX_STIFFNESS: v[0] = facts->stiffness_max / MM; return 1; /* [N/mm] */
    case HD_NOMINAL_MAX_DAMPING: return -1;
    case HD_NOMINAL_MAX_FORCE: v[0] = facts->force_max; return 1;
    case HD_NOMINAL_MAX_CONTINUOUS_FORCE: v[0] = facts->force_continuous; return 1;
    case HD_NOMINAL_MAX_TORQUE_FORCE:
    case HD_NOMINAL_MAX_TORQUE_CONTINUOUS_FORCE: v[0] = MM * facts->torque_max; return 1;
    case HD_NOMINAL_MAX_TORQUE_STIFFNESS:
    case HD_NOMINAL_MAX_TORQUE_DAMPING: return -1;
    case HD_MOTOR_TEMPERATURE:
        for (int i = 0; i < MOTORS; i++)
            v[i] = state->warmth;
        return MOTORS;
    case HD_SOFTWARE_VELOCITY_LIMIT: v[0] = device->velocity_limit; return 1;
    case HD_SOFTWARE_FORCE_IMPULSE_LIMIT: return -1;
    case HD_FORCE_RAMPING_RATE: v[0] = device->ramping_rate; return 1;
    case HD_CURRENT_FORCE: memcpy(v, device->force, sizeof device->force); return 3;
    case HD_CURRENT_TORQUE: memcpy(v, device->torque, sizeof device->torque); return 3;
    case HD_LAST_FORCE: memcpy(v, device->last_force, sizeof device->last_force); return 3;
    case HD_LAST_TORQUE: memcpy(v, device->last_torque, sizeof device->last_torque); return 3;
    case HD_JOINT_ANGLE_REFERENCES:
    case HD_CURRENT_JOINT_TORQUE:
    case HD_CURRENT_GIMBAL_TORQUE:
    case HD_LAST_JOINT_TORQUE:
    case HD_LAST_GIMBAL_TORQUE:
    case HD_USER_STATUS_LIGHT: return -1;
    default: return 0;
    }
}

/* How many numbers describe an arm's kinematics; 0: it is another parameter. A device without any gives zeros: programs
 * read them without looking at the error. */
static int count_kinematics(HDenum parameter)
{
    switch (parameter) {
    case HD_CURRENT_JOINT_ANGLES:
    case HD_LAST_JOINT_ANGLES: return 3;
    case HD_CURRENT_ENCODER_VALUES:
    case HD_LAST_ENCODER_VALUES: return MOTORS;
    default: return 0;
    }
}

/* As hdGet...v wants them: how many values there are; none, and an error, where they cannot be had. */
static int get(HDenum parameter, double *values, const void *out)
{
    const HHD handle = hdGetCurrentDevice();
    struct device *device = find(handle);

    if (device == NULL)
        return 0;
    if (out == NULL) {
        hd_push(HD_INVALID_VALUE, 0, handle);
        return 0;
    }
    pthread_mutex_lock(&mutex);
    int found = parameter >= HD_FORCE_OUTPUT && parameter < HD_FORCE_OUTPUT + CAPABILITIES
                          ? (values[0] = device->enabled[parameter - HD_FORCE_OUTPUT], 1)
                          : read_parameter(device, parameter, values);
    const int asked = count_kinematics(parameter);
    if (found < 0 && asked > 0) {
        memset(values, 0, VALUES_MAX * sizeof *values);
        found = device->told_kinematics ? asked : -asked;
        device->told_kinematics = true;
    }
    pthread_mutex_unlock(&mutex);
    if (found <= 0)
        hd_push(found == 0 ? HD_INVALID_ENUM : HD_INVALID_OPERATION, 0, handle);
    return asked > 0 ? asked : found > 0 ? found : 0;
}

#define GETTER(name, type, convert)                                                                                    \
    EXPORT void name(HDenum parameter, type *values)                                                                   \
    {                                                                                                                  \
        double found[VALUES_MAX];                                                                                      \
        const int number = get(parameter, found, values);                                                              \
        for (int i = 0; i < number; i++)                                                                               \
            values[i] = (type)convert(found[i]);                                                                       \
    }
#define SAME(x) (x)
GETTER(hdGetBooleanv, HDboolean, 0.0 !=)
GETTER(hdGetIntegerv, HDint, lrint)
GETTER(hdGetLongv, HDlong, lrint)
GETTER(hdGetFloatv, HDfloat, SAME)
GETTER(hdGetDoublev, HDdouble, SAME)

EXPORT HDstring hdGetString(HDenum parameter)
{
    static const char version[] = "3.40.0-haptorb";
    const struct device *device;

    if (parameter == HD_VERSION)
        return version;
    if (parameter < HD_VERSION || parameter > HD_DEVICE_FIRMWARE_VERSION) {
        hd_push(HD_INVALID_ENUM, 0, hdGetCurrentDevice());
        return "";
    }
    device = find(hdGetCurrentDevice());
    if (device == NULL)
        return "";
    static _Thread_local char serial[32];
    switch (parameter) {
    case HD_DEVICE_MODEL_TYPE: return device->link->facts->name;
    case HD_DEVICE_VENDOR: return device->link->facts->maker;
    case HD_DEVICE_SERIAL_NUMBER:
        snprintf(serial, sizeof serial, "%lld", (long long)device->link->facts->serial);
        return serial;
    default: return device->link->facts->version_text;
    }
}

/* How many values `parameter` takes; 0: it cannot be set. */
static int count_values(HDenum parameter)
{
    switch (parameter) {
    case HD_CURRENT_FORCE:
    case HD_CURRENT_TORQUE: return 3;
    case HD_SOFTWARE_VELOCITY_LIMIT:
    case HD_FORCE_RAMPING_RATE: return 1;
    default: return 0;
    }
}

static void set(HDenum parameter, const double *v)
{
    const HHD handle = hdGetCurrentDevice();
    struct device *device = find(handle);
    HDerror error = HD_SUCCESS;

    if (device == NULL)
        return;
    pthread_mutex_lock(&mutex);
    const bool framed = device->framed && pthread_equal(device->owner, pthread_self());
    switch (parameter) {
    case HD_CURRENT_FORCE:
    case HD_CURRENT_TORQUE:
        if (!framed)
            error = HD_FRAME_ERROR;
        else if (parameter == HD_CURRENT_TORQUE && device->link->facts->torque_max == 0.0 &&
                 (v[0] != 0.0 || v[1] != 0.0 || v[2] != 0.0))
            error = HD_INVALID_OPERATION; /* the device renders no torque; many programs always set one of zero */
        else
            memcpy(parameter == HD_CURRENT_FORCE ? device->force : device->torque, v, 3 * sizeof *v);
        break;
    default:
        if (!(v[0] > 0.0))
            error = HD_INVALID_VALUE;
        else if (parameter == HD_SOFTWARE_VELOCITY_LIMIT)
            device->velocity_limit = v[0];
        else
            device->ramping_rate = v[0];
    }
    pthread_mutex_unlock(&mutex);
    if (error != HD_SUCCESS)
        hd_push(error, 0, handle);
}

static void refuse_to_set(HDenum parameter)
{
    switch (parameter) {
    case HD_CURRENT_JOINT_TORQUE:
    case HD_CURRENT_GIMBAL_TORQUE:
    case HD_JOINT_ANGLE_REFERENCES:
    case HD_SOFTWARE_FORCE_IMPULSE_LIMIT:
    case HD_USER_STATUS_LIGHT: hd_push(HD_INVALID_OPERATION, 0, hdGetCurrentDevice()); break;
    default: hd_push(HD_INVALID_ENUM, 0, hdGetCurrentDevice());
    }
}

#define SETTER(name, type)                                                                                             \
    EXPORT void name(HDenum parameter, const type *values)                                                             \
    {                                                                                                                  \
        double numbers[3];                                                                                             \
        const int number = count_values(parameter);                                                                    \
        if (number == 0) {                                                                                             \
            refuse_to_set(parameter);                                                                                  \
        } else if (values == NULL) {                                                                                   \
            hd_push(HD_INVALID_VALUE, 0, hdGetCurrentDevice());                                                        \
        } else {                                                                                                       \
            for (int i = 0; i < number; i++)                                                                           \
                numbers[i] = (double)values[i];                                                                        \
            set(parameter, numbers);                                                                                   \
        }                                                                                                              \
    }
SETTER(hdSetBooleanv, HDboolean)
SETTER(hdSetIntegerv, HDint)
SETTER(hdSetFloatv, HDfloat)
SETTER(hdSetDoublev, HDdouble)
SETTER(hdSetLongv, HDlong)

/* ---- calibration and licence: the pose is absolute, and nothing is licensed ---- */

EXPORT HDenum hdCheckCalibration(void)
{
    return find(hdGetCurrentDevice()) == NULL ? HD_CALIBRATION_NEEDS_MANUAL_INPUT : HD_CALIBRATION_OK;
}

EXPORT HDenum hdCheckCalibrationStyle(void)
{
    return HD_CALIBRATION_AUTO;
}

EXPORT void hdUpdateCalibration(HDenum style)
{
    if (style != HD_CALIBRATION_AUTO && style != HD_CALIBRATION_INKWELL && style != HD_CALIBRATION_ENCODER_RESET)
        hd_push(HD_INVALID_ENUM, 0, hdGetCurrentDevice());
}

EXPORT HDboolean hdDeploymentLicense(HDstring vendor, HDstring application, HDstring password)
{
    return HD_TRUE;
}
