/* DHD's expert functions, and the settings that have no meaning here: each says why. */
#include "device.h"

#include <string.h>

#define EXPORT __attribute__((visibility("default")))

static bool expert; /* of the process, as in the interface */

EXPORT int dhdEnableExpertMode(void)
{
    __atomic_store_n(&expert, true, __ATOMIC_RELAXED);
    dhd_succeed();
    return 0;
}

EXPORT int dhdDisableExpertMode(void)
{
    __atomic_store_n(&expert, false, __ATOMIC_RELAXED);
    dhd_succeed();
    return 0;
}

EXPORT int dhdGetJointAngles(double j[DHD_MAX_DOF], char ID)
{
    struct state state;
    const int answer = dhd_read(ID, &state);

    if (answer < 0)
        return -1;
    if (j == NULL)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    if (state.joints <= 0 || state.joints > DHD_MAX_DOF)
        return dhd_fail(DHD_ERROR_NOT_AVAILABLE, "the device has no joints");
    memset(j, 0, DHD_MAX_DOF * sizeof *j);
    memcpy(j, state.joint_angles, (size_t)state.joints * sizeof *j);
    return answer;
}

static int refuse(char ID, const char *why)
{
    if (dhd_device(ID) == NULL)
        return -1;
    return dhd_fail(DHD_ERROR_NOT_AVAILABLE, why);
}

static int refuse_expert(char ID, const char *why)
{
    if (dhd_device(ID) == NULL)
        return -1;
    if (!__atomic_load_n(&expert, __ATOMIC_RELAXED))
        return dhd_fail(DHD_ERROR_EXPERT_MODE_DISABLED, "call dhdEnableExpertMode first");
    return dhd_fail(DHD_ERROR_NOT_AVAILABLE, why);
}

/* ---- motors, encoders and joints of a parallel arm ---- */

#define MOTORS(name, ...) \
    EXPORT int name(__VA_ARGS__) { return refuse_expert(ID, "the device has no such motors or encoders"); }
#define JOINTS(name, ...) \
    EXPORT int name(__VA_ARGS__) { return refuse_expert(ID, "the device has no such joints"); }
#define SETTINGS(name, ...) \
    EXPORT int name(__VA_ARGS__) { return refuse_expert(ID, "the device is set up by its file"); }

MOTORS(dhdPreset, int enc[DHD_MAX_DOF], uchar mask, char ID)
MOTORS(dhdCalibrateWrist, char ID)
MOTORS(dhdUpdateEncoders, char ID)
MOTORS(dhdGetDeltaEncoders, int *enc0, int *enc1, int *enc2, char ID)
MOTORS(dhdGetWristEncoders, int *enc0, int *enc1, int *enc2, char ID)
MOTORS(dhdGetGripperEncoder, int *enc, char ID)
MOTORS(dhdGetEncoder, int index, char ID)
MOTORS(dhdSetMotor, int index, ushort output, char ID)
MOTORS(dhdSetDeltaMotor, ushort mot0, ushort mot1, ushort mot2, char ID)
MOTORS(dhdSetWristMotor, ushort mot0, ushort mot1, ushort mot2, char ID)
MOTORS(dhdSetGripperMotor, ushort mot, char ID)
MOTORS(dhdDeltaEncoderToPosition, int enc0, int enc1, int enc2, double *px, double *py, double *pz, char ID)
MOTORS(dhdDeltaPositionToEncoder, double px, double py, double pz, int *enc0, int *enc1, int *enc2, char ID)
MOTORS(dhdDeltaMotorToForce, ushort mot0, ushort mot1, ushort mot2, int enc0, int enc1, int enc2, double *fx,
       double *fy, double *fz, char ID)
MOTORS(dhdDeltaForceToMotor, double fx, double fy, double fz, int enc0, int enc1, int enc2, ushort *mot0, ushort *mot1,
       ushort *mot2, char ID)
MOTORS(dhdWristEncoderToOrientation, int enc0, int enc1, int enc2, double *oa, double *ob, double *og, char ID)
MOTORS(dhdWristOrientationToEncoder, double oa, double ob, double og, int *enc0, int *enc1, int *enc2, char ID)
MOTORS(dhdWristMotorToTorque, ushort mot0, ushort mot1, ushort mot2, int enc0, int enc1, int enc2, double *tx,
       double *ty, double *tz, char ID)
MOTORS(dhdWristTorqueToMotor, double ta, double tb, double tg, int enc0, int enc1, int enc2, ushort *mot0,
       ushort *mot1, ushort *mot2, char ID)
MOTORS(dhdGripperEncoderToAngleRad, int enc, double *a, char ID)
MOTORS(dhdGripperEncoderToGap, int enc, double *g, char ID)
MOTORS(dhdGripperAngleRadToEncoder, double a, int *enc, char ID)
MOTORS(dhdGripperGapToEncoder, double g, int *enc, char ID)
MOTORS(dhdGripperMotorToForce, ushort mot, double *f, int e[4], char ID)
MOTORS(dhdGripperForceToMotor, double f, ushort *mot, int e[4], char ID)
MOTORS(dhdSetMot, ushort mot[DHD_MAX_DOF], uchar mask, char ID)
MOTORS(dhdPreloadMot, ushort mot[DHD_MAX_DOF], uchar mask, char ID)
MOTORS(dhdGetEnc, int enc[DHD_MAX_DOF], uchar mask, char ID)
MOTORS(dhdGetEncVelocities, double v[DHD_MAX_DOF], char ID)
MOTORS(dhdGetEncRange, int least[DHD_MAX_DOF], int most[DHD_MAX_DOF], char ID)
MOTORS(dhdSetBrk, uchar mask, char ID)

JOINTS(dhdSetJointTorques, double t[DHD_MAX_DOF], uchar mask, char ID)
JOINTS(dhdGetDeltaJointAngles, double *j0, double *j1, double *j2, char ID)
JOINTS(dhdGetDeltaJacobian, double jacobian[3][3], char ID)
JOINTS(dhdDeltaJointAnglesToJacobian, double j0, double j1, double j2, double jacobian[3][3], char ID)
JOINTS(dhdDeltaJointTorquesExtrema, double j0, double j1, double j2, double least[3], double most[3], char ID)
JOINTS(dhdDeltaGravityJointTorques, double j0, double j1, double j2, double *q0, double *q1, double *q2, char ID)
JOINTS(dhdSetDeltaJointTorques, double t0, double t1, double t2, char ID)
JOINTS(dhdDeltaEncodersToJointAngles, int enc0, int enc1, int enc2, double *j0, double *j1, double *j2, char ID)
JOINTS(dhdDeltaJointAnglesToEncoders, double j0, double j1, double j2, int *enc0, int *enc1, int *enc2, char ID)
JOINTS(dhdGetWristJointAngles, double *j0, double *j1, double *j2, char ID)
JOINTS(dhdGetWristJacobian, double jacobian[3][3], char ID)
JOINTS(dhdWristJointAnglesToJacobian, double j0, double j1, double j2, double jacobian[3][3], char ID)
JOINTS(dhdWristJointTorquesExtrema, double j0, double j1, double j2, double least[3], double most[3], char ID)
JOINTS(dhdWristGravityJointTorques, double j0, double j1, double j2, double *q0, double *q1, double *q2, char ID)
JOINTS(dhdSetWristJointTorques, double t0, double t1, double t2, char ID)
JOINTS(dhdSetForceAndWristJointTorques, double fx, double fy, double fz, double t0, double t1, double t2, char ID)
JOINTS(dhdSetForceAndWristJointTorquesAndGripperForce, double fx, double fy, double fz, double t0, double t1,
       double t2, double fg, char ID)
JOINTS(dhdWristEncodersToJointAngles, int enc0, int enc1, int enc2, double *j0, double *j1, double *j2, char ID)
JOINTS(dhdWristJointAnglesToEncoders, double j0, double j1, double j2, int *enc0, int *enc1, int *enc2, char ID)
JOINTS(dhdGetJointVelocities, double w[DHD_MAX_DOF], char ID)
JOINTS(dhdGetJointAngleRange, double least[DHD_MAX_DOF], double most[DHD_MAX_DOF], char ID)
JOINTS(dhdJointAnglesToInertiaMatrix, double j[DHD_MAX_DOF], double inertia[6][6], char ID)
JOINTS(dhdJointAnglesToGravityJointTorques, double j[DHD_MAX_DOF], double q[DHD_MAX_DOF], uchar mask, char ID)

SETTINGS(dhdControllerSetDevice, int device, char ID)
SETTINGS(dhdReadConfigFromFile, char *path, char ID)

#undef MOTORS
#undef JOINTS
#undef SETTINGS

/* ---- settings without a meaning ---- */

EXPORT int dhdSetBrakes(int on, char ID)
{
    return on ? refuse(ID, "the device has no brakes") : dhd_device(ID) == NULL ? -1 : 0;
}

EXPORT int dhdSetVibration(double frequency, double amplitude, int type, char ID)
{
    return refuse(ID, "the device vibrates by the forces that are commanded, and in no other way");
}

EXPORT int dhdSetOutput(uint output, char ID)
{
    return refuse(ID, "the device has no outputs");
}

#define FIXED "the servo's own limits apply, which a program cannot change"

EXPORT int dhdSetVelocityThreshold(uint value, char ID)
{
    return refuse(ID, FIXED);
}

EXPORT int dhdGetVelocityThreshold(uint *value, char ID)
{
    return refuse(ID, FIXED);
}

EXPORT int dhdSetWatchdog(uchar value, char ID)
{
    return refuse(ID, "a force lasts 50 ms after the last command and fades within 20 ms; this cannot be changed");
}

EXPORT int dhdGetWatchdog(uchar *value, char ID)
{
    return refuse(ID, "a force lasts 50 ms after the last command and fades within 20 ms; this cannot be changed");
}

EXPORT int dhdSetComMode(int mode, char ID)
{
    return refuse(ID, "the state lies in shared memory: there is no other mode");
}

EXPORT int dhdSetComModePriority(int priority, char ID)
{
    return refuse(ID, "the state lies in shared memory: no thread of the library communicates");
}

/* ---- where the device stands: upright, as its file says ---- */

static int set_angle(double angle, char ID)
{
    if (dhd_device(ID) == NULL)
        return -1;
    return angle == 0.0 ? 0 : dhd_fail(DHD_ERROR_NOT_AVAILABLE, "the device stands as its file says: the angle is 0");
}

static int get_angle(double *angle, char ID)
{
    if (dhd_device(ID) == NULL)
        return -1;
    if (angle == NULL)
        return dhd_fail(DHD_ERROR_NULL_ARGUMENT, NULL);
    *angle = 0.0;
    return 0;
}

EXPORT int dhdSetDeviceAngleRad(double angle, char ID)
{
    return set_angle(angle, ID);
}

EXPORT int dhdGetDeviceAngleRad(double *angle, char ID)
{
    return get_angle(angle, ID);
}

EXPORT int dhdSetDeviceAngleDeg(double angle, char ID)
{
    return set_angle(angle, ID);
}

EXPORT int dhdGetDeviceAngleDeg(double *angle, char ID)
{
    return get_angle(angle, ID);
}

EXPORT int dhdSetBaseAngleXRad(double angle, char ID)
{
    return set_angle(angle, ID);
}

EXPORT int dhdGetBaseAngleXRad(double *angle, char ID)
{
    return get_angle(angle, ID);
}

EXPORT int dhdSetBaseAngleXDeg(double angle, char ID)
{
    return set_angle(angle, ID);
}

EXPORT int dhdGetBaseAngleXDeg(double *angle, char ID)
{
    return get_angle(angle, ID);
}

EXPORT int dhdSetBaseAngleZRad(double angle, char ID)
{
    return set_angle(angle, ID);
}

EXPORT int dhdGetBaseAngleZRad(double *angle, char ID)
{
    return get_angle(angle, ID);
}

EXPORT int dhdSetBaseAngleZDeg(double angle, char ID)
{
    return set_angle(angle, ID);
}

EXPORT int dhdGetBaseAngleZDeg(double *angle, char ID)
{
    return get_angle(angle, ID);
}
