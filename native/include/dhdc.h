/* Force Dimension's programming interface DHD, as libdrd and libdhd of haptorb provide it.
 *
 * Names, arguments and numbers are those that programs for that interface use; none of this text is the maker's. Every
 * `ID` is the number of a device, -1 the default one. Functions return 0 or a positive number on success, -1 on an
 * error that dhdErrorGetLastStr explains. Lengths in m, forces in N, torques in N·m. Frame: x towards the user, y to the
 * right, z up, origin in the middle of the workspace; rotations are row-major 3 x 3. */
#ifndef DHDC_H
#define DHDC_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#ifdef __cplusplus
#define DHD_DEFAULT(value) = value
extern "C" {
#else
#define DHD_DEFAULT(value)
#endif

#if defined(__GNUC__)
#define DHD_API __attribute__((visibility("default")))
#else
#define DHD_API
#endif

#define __SDK

typedef unsigned char uchar;

enum dhd_errors {
    DHD_NO_ERROR = 0,
    DHD_ERROR,
    DHD_ERROR_COM,
    DHD_ERROR_DHC_BUSY,
    DHD_ERROR_NO_DRIVER_FOUND,
    DHD_ERROR_NO_DEVICE_FOUND,
    DHD_ERROR_NOT_AVAILABLE,
    DHD_ERROR_TIMEOUT,
    DHD_ERROR_GEOMETRY,
    DHD_ERROR_EXPERT_MODE_DISABLED,
    DHD_ERROR_NOT_IMPLEMENTED,
    DHD_ERROR_OUT_OF_MEMORY,
    DHD_ERROR_DEVICE_NOT_READY,
    DHD_ERROR_FILE_NOT_FOUND,
    DHD_ERROR_CONFIGURATION,
    DHD_ERROR_INVALID_INDEX,
    DHD_ERROR_DEPRECATED,
    DHD_ERROR_NULL_ARGUMENT,
    DHD_ERROR_REDUNDANT_FAIL,
    DHD_ERROR_NOT_ENABLED,
    DHD_ERROR_DEVICE_IN_USE,
    DHD_ERROR_INVALID,
    DHD_ERROR_NO_REGULATION
};

#define DHD_ON 1
#define DHD_OFF 0
#define DHD_UNDEFINED -1

#define DHD_DEVICE_NONE 0
#define DHD_DEVICE_3DOF 31
#define DHD_DEVICE_OMEGA 32
#define DHD_DEVICE_6DOF 61
#define DHD_DEVICE_6DOF_500 62
#define DHD_DEVICE_DELTA3 63
#define DHD_DEVICE_DELTA6 64
#define DHD_DEVICE_OMEGA3 33
#define DHD_DEVICE_OMEGA6 34
#define DHD_DEVICE_OMEGA6_LEFT 36
#define DHD_DEVICE_OMEGA7 35
#define DHD_DEVICE_OMEGA7_LEFT 37
#define DHD_DEVICE_OMEGA33 34
#define DHD_DEVICE_OMEGA33_LEFT 36
#define DHD_DEVICE_OMEGA331 35
#define DHD_DEVICE_OMEGA331_LEFT 37
#define DHD_DEVICE_FALCON 60
#define DHD_DEVICE_CONTROLLER 81
#define DHD_DEVICE_CONTROLLER_HR 82
#define DHD_DEVICE_CUSTOM 91
#define DHD_DEVICE_SIGMA3 206
#define DHD_DEVICE_SIGMA7 104
#define DHD_DEVICE_SIGMA7_LEFT 105
#define DHD_DEVICE_SIGMA331 104
#define DHD_DEVICE_SIGMA331_LEFT 105
#define DHD_DEVICE_SIGMA33P 106
#define DHD_DEVICE_SIGMA33P_LEFT 107
#define DHD_DEVICE_LAMBDA3 203
#define DHD_DEVICE_LAMBDA7 108
#define DHD_DEVICE_LAMBDA7_LEFT 109
#define DHD_DEVICE_LAMBDA331 108
#define DHD_DEVICE_LAMBDA331_LEFT 109

#define DHD_MAX_DEVICE 16
#define DHD_MAX_DOF 8
#define DHD_MAX_BUTTONS 32
#define DHD_MAX_STATUS 17

#define DHD_STATUS_POWER 0
#define DHD_STATUS_CONNECTED 1
#define DHD_STATUS_STARTED 2
#define DHD_STATUS_RESET 3
#define DHD_STATUS_IDLE 4
#define DHD_STATUS_FORCE 5
#define DHD_STATUS_BRAKE 6
#define DHD_STATUS_TORQUE 7
#define DHD_STATUS_WRIST_DETECTED 8
#define DHD_STATUS_ERROR 9
#define DHD_STATUS_GRAVITY 10
#define DHD_STATUS_TIMEGUARD 11
#define DHD_STATUS_WRIST_INIT 12
#define DHD_STATUS_REDUNDANCY 13
#define DHD_STATUS_FORCEOFFCAUSE 14
#define DHD_STATUS_LOCKS 15
#define DHD_STATUS_AXIS_CHECKED 16

#define DHD_FORCEOFF_NONE 0
#define DHD_FORCEOFF_BUTTON 1
#define DHD_FORCEOFF_VELOCITY 2
#define DHD_FORCEOFF_WATCHDOG 3
#define DHD_FORCEOFF_SOFTWARE 4
#define DHD_FORCEOFF_USBDISCN 5
#define DHD_FORCEOFF_DEADMAN 6

#define DHD_TIMEGUARD 1
#define DHD_MOTOR_SATURATED 2

#define DHD_VELOCITY_WINDOWING 0
#define DHD_VELOCITY_AVERAGING 1
#define DHD_VELOCITY_WINDOW 20

#define DHD_COM_MODE_SYNC 0
#define DHD_COM_MODE_ASYNC 1
#define DHD_COM_MODE_VIRTUAL 3
#define DHD_COM_MODE_NETWORK 4

#define DHD_THREAD_PRIORITY_DEFAULT 0
#define DHD_THREAD_PRIORITY_HIGH 1
#define DHD_THREAD_PRIORITY_LOW 2

#define DHD_DELTA_MOTOR_0 0
#define DHD_DELTA_MOTOR_1 1
#define DHD_DELTA_MOTOR_2 2
#define DHD_DELTA_ENC_0 0
#define DHD_DELTA_ENC_1 1
#define DHD_DELTA_ENC_2 2
#define DHD_WRIST_MOTOR_0 3
#define DHD_WRIST_MOTOR_1 4
#define DHD_WRIST_MOTOR_2 5
#define DHD_WRIST_ENC_0 3
#define DHD_WRIST_ENC_1 4
#define DHD_WRIST_ENC_2 5
#define DHD_GRIP_MOTOR_0 6
#define DHD_GRIP_ENC_0 6

#define DHD_ID char ID DHD_DEFAULT(-1)

/* Errors: of the last call of this thread. */
DHD_API int dhdErrorGetLast(void);
DHD_API const char *dhdErrorGetLastStr(void);
DHD_API const char *dhdErrorGetStr(int error);

/* Open and close. */
DHD_API void dhdEnableSimulator(bool on);
DHD_API int dhdGetDeviceCount(void);
DHD_API int dhdGetAvailableCount(void);
DHD_API int dhdSetDevice(char ID);
DHD_API int dhdGetDeviceID(void);
DHD_API int dhdGetSerialNumber(ushort *sn, DHD_ID);
DHD_API int dhdOpen(void);
DHD_API int dhdOpenType(int type);
DHD_API int dhdOpenSerial(int serial);
DHD_API int dhdOpenID(char ID);
DHD_API int dhdClose(DHD_ID);
DHD_API int dhdCheckControllerMemory(DHD_ID);
DHD_API int dhdStop(DHD_ID);
DHD_API int dhdReset(DHD_ID);
DHD_API int dhdResetWrist(DHD_ID);
DHD_API int dhdWaitForReset(int timeout DHD_DEFAULT(0), DHD_ID);

/* Identity. */
DHD_API int dhdGetSystemType(DHD_ID);
DHD_API int dhdGetSystemRev(DHD_ID);
DHD_API const char *dhdGetSystemName(DHD_ID);
DHD_API int dhdGetVersion(double *version, DHD_ID);
DHD_API int dhdGetVersionStr(char *version, size_t size, DHD_ID);
DHD_API void dhdGetSDKVersion(int *major, int *minor, int *release, int *revision);
DHD_API const char *dhdGetSDKVersionStr(void);
DHD_API int dhdGetComponentVersionStr(uint32_t component, char *version, size_t size, DHD_ID);
DHD_API bool dhdIsLeftHanded(DHD_ID);
DHD_API bool dhdHasBase(DHD_ID);
DHD_API bool dhdHasWrist(DHD_ID);
DHD_API bool dhdHasActiveWrist(DHD_ID);
DHD_API bool dhdHasGripper(DHD_ID);
DHD_API bool dhdHasActiveGripper(DHD_ID);
DHD_API int dhdGetStatus(int status[DHD_MAX_STATUS], DHD_ID);
DHD_API int dhdGetComMode(DHD_ID);
DHD_API int dhdSetComMode(int mode, DHD_ID);
DHD_API int dhdSetComModePriority(int priority, DHD_ID);
DHD_API double dhdGetComFreq(DHD_ID);
DHD_API ulong dhdGetSystemCounter(void);

/* Read. */
DHD_API int dhdGetPosition(double *px, double *py, double *pz, DHD_ID);
DHD_API int dhdGetOrientationRad(double *oa, double *ob, double *og, DHD_ID);
DHD_API int dhdGetOrientationDeg(double *oa, double *ob, double *og, DHD_ID);
DHD_API int dhdGetOrientationFrame(double matrix[3][3], DHD_ID);
DHD_API int dhdGetPositionAndOrientationRad(double *px, double *py, double *pz, double *oa, double *ob, double *og,
                                            DHD_ID);
DHD_API int dhdGetPositionAndOrientationDeg(double *px, double *py, double *pz, double *oa, double *ob, double *og,
                                            DHD_ID);
DHD_API int dhdGetPositionAndOrientationFrame(double *px, double *py, double *pz, double matrix[3][3], DHD_ID);
DHD_API int dhdConfigLinearVelocity(int ms DHD_DEFAULT(DHD_VELOCITY_WINDOW),
                                    int mode DHD_DEFAULT(DHD_VELOCITY_WINDOWING), DHD_ID);
DHD_API int dhdConfigAngularVelocity(int ms DHD_DEFAULT(DHD_VELOCITY_WINDOW),
                                     int mode DHD_DEFAULT(DHD_VELOCITY_WINDOWING), DHD_ID);
DHD_API int dhdConfigGripperVelocity(int ms DHD_DEFAULT(DHD_VELOCITY_WINDOW),
                                     int mode DHD_DEFAULT(DHD_VELOCITY_WINDOWING), DHD_ID);
DHD_API int dhdGetLinearVelocity(double *vx, double *vy, double *vz, DHD_ID);
DHD_API int dhdGetAngularVelocityRad(double *wx, double *wy, double *wz, DHD_ID);
DHD_API int dhdGetAngularVelocityDeg(double *wx, double *wy, double *wz, DHD_ID);
DHD_API int dhdGetButton(int index, DHD_ID);
DHD_API uint dhdGetButtonMask(DHD_ID);
DHD_API int dhdEmulateButton(uchar on, DHD_ID);
DHD_API int dhdGetGripperAngleRad(double *a, DHD_ID);
DHD_API int dhdGetGripperAngleDeg(double *a, DHD_ID);
DHD_API int dhdGetGripperGap(double *g, DHD_ID);
DHD_API int dhdGetGripperThumbPos(double *px, double *py, double *pz, DHD_ID);
DHD_API int dhdGetGripperFingerPos(double *px, double *py, double *pz, DHD_ID);
DHD_API int dhdGetGripperLinearVelocity(double *vg, DHD_ID);
DHD_API int dhdGetGripperAngularVelocityRad(double *wg, DHD_ID);
DHD_API int dhdGetGripperAngularVelocityDeg(double *wg, DHD_ID);
DHD_API int dhdGetForce(double *fx, double *fy, double *fz, DHD_ID);
DHD_API int dhdGetForceAndTorque(double *fx, double *fy, double *fz, double *tx, double *ty, double *tz, DHD_ID);
DHD_API int dhdGetForceAndTorqueAndGripperForce(double *fx, double *fy, double *fz, double *tx, double *ty, double *tz,
                                                double *fg, DHD_ID);

/* Command. */
DHD_API int dhdEnableForce(uchar on, DHD_ID);
DHD_API int dhdEnableGripperForce(uchar on, DHD_ID);
DHD_API int dhdSetForce(double fx, double fy, double fz, DHD_ID);
DHD_API int dhdSetTorque(double tx, double ty, double tz, DHD_ID);
DHD_API int dhdSetForceAndTorque(double fx, double fy, double fz, double tx, double ty, double tz, DHD_ID);
DHD_API int dhdSetForceAndGripperForce(double fx, double fy, double fz, double fg, DHD_ID);
DHD_API int dhdSetForceAndTorqueAndGripperForce(double fx, double fy, double fz, double tx, double ty, double tz,
                                                double fg, DHD_ID);
DHD_API int dhdSetMaxForce(double most, DHD_ID);
DHD_API int dhdSetMaxTorque(double most, DHD_ID);
DHD_API int dhdSetMaxGripperForce(double most, DHD_ID);
DHD_API double dhdGetMaxForce(DHD_ID);
DHD_API double dhdGetMaxTorque(DHD_ID);
DHD_API double dhdGetMaxGripperForce(DHD_ID);
DHD_API int dhdSetStandardGravity(double g, DHD_ID);
DHD_API int dhdSetGravityCompensation(int on DHD_DEFAULT(DHD_ON), DHD_ID);
DHD_API int dhdSetEffectorMass(double mass, DHD_ID);
DHD_API int dhdGetEffectorMass(double *mass, DHD_ID);
DHD_API int dhdSetBrakes(int on DHD_DEFAULT(DHD_ON), DHD_ID);
DHD_API int dhdSetVibration(double frequency, double amplitude, int type DHD_DEFAULT(0), DHD_ID);
DHD_API int dhdSetOutput(uint output, DHD_ID);
DHD_API int dhdSetTimeGuard(int us, DHD_ID);
DHD_API int dhdSetVelocityThreshold(uint value, DHD_ID);
DHD_API int dhdGetVelocityThreshold(uint *value, DHD_ID);
DHD_API int dhdSetWatchdog(uchar value, DHD_ID);
DHD_API int dhdGetWatchdog(uchar *value, DHD_ID);
DHD_API int dhdSetDeviceAngleRad(double angle, DHD_ID);
DHD_API int dhdSetDeviceAngleDeg(double angle, DHD_ID);
DHD_API int dhdGetDeviceAngleRad(double *angle, DHD_ID);
DHD_API int dhdGetDeviceAngleDeg(double *angle, DHD_ID);
DHD_API int dhdSetBaseAngleXRad(double angle, DHD_ID);
DHD_API int dhdSetBaseAngleXDeg(double angle, DHD_ID);
DHD_API int dhdGetBaseAngleXRad(double *angle, DHD_ID);
DHD_API int dhdGetBaseAngleXDeg(double *angle, DHD_ID);
DHD_API int dhdSetBaseAngleZRad(double angle, DHD_ID);
DHD_API int dhdSetBaseAngleZDeg(double angle, DHD_ID);
DHD_API int dhdGetBaseAngleZRad(double *angle, DHD_ID);
DHD_API int dhdGetBaseAngleZDeg(double *angle, DHD_ID);

/* Operating system. */
DHD_API bool dhdKbHit(void);
DHD_API char dhdKbGet(void);
DHD_API double dhdGetTime(void);
DHD_API void dhdSleep(double seconds);
DHD_API int dhdStartThread(void *function(void *), void *argument, int priority);

/* Expert: motors, encoders and joints of a parallel arm. */
DHD_API int dhdEnableExpertMode(void);
DHD_API int dhdDisableExpertMode(void);
DHD_API int dhdGetJointAngles(double j[DHD_MAX_DOF], DHD_ID);
DHD_API int dhdPreset(int enc[DHD_MAX_DOF], uchar mask, DHD_ID);
DHD_API int dhdCalibrateWrist(DHD_ID);
DHD_API int dhdUpdateEncoders(DHD_ID);
DHD_API int dhdGetDeltaEncoders(int *enc0, int *enc1, int *enc2, DHD_ID);
DHD_API int dhdGetWristEncoders(int *enc0, int *enc1, int *enc2, DHD_ID);
DHD_API int dhdGetGripperEncoder(int *enc, DHD_ID);
DHD_API int dhdGetEncoder(int index, DHD_ID);
DHD_API int dhdSetMotor(int index, ushort output, DHD_ID);
DHD_API int dhdSetDeltaMotor(ushort mot0, ushort mot1, ushort mot2, DHD_ID);
DHD_API int dhdSetWristMotor(ushort mot0, ushort mot1, ushort mot2, DHD_ID);
DHD_API int dhdSetGripperMotor(ushort mot, DHD_ID);
DHD_API int dhdDeltaEncoderToPosition(int enc0, int enc1, int enc2, double *px, double *py, double *pz, DHD_ID);
DHD_API int dhdDeltaPositionToEncoder(double px, double py, double pz, int *enc0, int *enc1, int *enc2, DHD_ID);
DHD_API int dhdDeltaMotorToForce(ushort mot0, ushort mot1, ushort mot2, int enc0, int enc1, int enc2, double *fx,
                                 double *fy, double *fz, DHD_ID);
DHD_API int dhdDeltaForceToMotor(double fx, double fy, double fz, int enc0, int enc1, int enc2, ushort *mot0,
                                 ushort *mot1, ushort *mot2, DHD_ID);
DHD_API int dhdWristEncoderToOrientation(int enc0, int enc1, int enc2, double *oa, double *ob, double *og, DHD_ID);
DHD_API int dhdWristOrientationToEncoder(double oa, double ob, double og, int *enc0, int *enc1, int *enc2, DHD_ID);
DHD_API int dhdWristMotorToTorque(ushort mot0, ushort mot1, ushort mot2, int enc0, int enc1, int enc2, double *tx,
                                  double *ty, double *tz, DHD_ID);
DHD_API int dhdWristTorqueToMotor(double ta, double tb, double tg, int enc0, int enc1, int enc2, ushort *mot0,
                                  ushort *mot1, ushort *mot2, DHD_ID);
DHD_API int dhdGripperEncoderToAngleRad(int enc, double *a, DHD_ID);
DHD_API int dhdGripperEncoderToGap(int enc, double *g, DHD_ID);
DHD_API int dhdGripperAngleRadToEncoder(double a, int *enc, DHD_ID);
DHD_API int dhdGripperGapToEncoder(double g, int *enc, DHD_ID);
DHD_API int dhdGripperMotorToForce(ushort mot, double *f, int e[4], DHD_ID);
DHD_API int dhdGripperForceToMotor(double f, ushort *mot, int e[4], DHD_ID);
DHD_API int dhdSetMot(ushort mot[DHD_MAX_DOF], uchar mask DHD_DEFAULT(0xff), DHD_ID);
DHD_API int dhdPreloadMot(ushort mot[DHD_MAX_DOF], uchar mask DHD_DEFAULT(0xff), DHD_ID);
DHD_API int dhdSetJointTorques(double t[DHD_MAX_DOF], uchar mask DHD_DEFAULT(0xff), DHD_ID);
DHD_API int dhdGetEnc(int enc[DHD_MAX_DOF], uchar mask DHD_DEFAULT(0xff), DHD_ID);
DHD_API int dhdGetEncVelocities(double v[DHD_MAX_DOF], DHD_ID);
DHD_API int dhdGetEncRange(int least[DHD_MAX_DOF], int most[DHD_MAX_DOF], DHD_ID);
DHD_API int dhdSetBrk(uchar mask DHD_DEFAULT(0xff), DHD_ID);
DHD_API int dhdGetDeltaJointAngles(double *j0, double *j1, double *j2, DHD_ID);
DHD_API int dhdGetDeltaJacobian(double jacobian[3][3], DHD_ID);
DHD_API int dhdDeltaJointAnglesToJacobian(double j0, double j1, double j2, double jacobian[3][3], DHD_ID);
DHD_API int dhdDeltaJointTorquesExtrema(double j0, double j1, double j2, double least[3], double most[3], DHD_ID);
DHD_API int dhdDeltaGravityJointTorques(double j0, double j1, double j2, double *q0, double *q1, double *q2, DHD_ID);
DHD_API int dhdSetDeltaJointTorques(double t0, double t1, double t2, DHD_ID);
DHD_API int dhdDeltaEncodersToJointAngles(int enc0, int enc1, int enc2, double *j0, double *j1, double *j2, DHD_ID);
DHD_API int dhdDeltaJointAnglesToEncoders(double j0, double j1, double j2, int *enc0, int *enc1, int *enc2, DHD_ID);
DHD_API int dhdGetWristJointAngles(double *j0, double *j1, double *j2, DHD_ID);
DHD_API int dhdGetWristJacobian(double jacobian[3][3], DHD_ID);
DHD_API int dhdWristJointAnglesToJacobian(double j0, double j1, double j2, double jacobian[3][3], DHD_ID);
DHD_API int dhdWristJointTorquesExtrema(double j0, double j1, double j2, double least[3], double most[3], DHD_ID);
DHD_API int dhdWristGravityJointTorques(double j0, double j1, double j2, double *q0, double *q1, double *q2, DHD_ID);
DHD_API int dhdSetWristJointTorques(double t0, double t1, double t2, DHD_ID);
DHD_API int dhdSetForceAndWristJointTorques(double fx, double fy, double fz, double t0, double t1, double t2, DHD_ID);
DHD_API int dhdSetForceAndWristJointTorquesAndGripperForce(double fx, double fy, double fz, double t0, double t1,
                                                           double t2, double fg, DHD_ID);
DHD_API int dhdWristEncodersToJointAngles(int enc0, int enc1, int enc2, double *j0, double *j1, double *j2, DHD_ID);
DHD_API int dhdWristJointAnglesToEncoders(double j0, double j1, double j2, int *enc0, int *enc1, int *enc2, DHD_ID);
DHD_API int dhdGetJointVelocities(double w[DHD_MAX_DOF], DHD_ID);
DHD_API int dhdGetJointAngleRange(double least[DHD_MAX_DOF], double most[DHD_MAX_DOF], DHD_ID);
DHD_API int dhdJointAnglesToInertiaMatrix(double j[DHD_MAX_DOF], double inertia[6][6], DHD_ID);
DHD_API int dhdJointAnglesToGravityJointTorques(double j[DHD_MAX_DOF], double q[DHD_MAX_DOF],
                                                uchar mask DHD_DEFAULT(0xff), DHD_ID);
DHD_API int dhdControllerSetDevice(int device, DHD_ID);
DHD_API int dhdReadConfigFromFile(char *path, DHD_ID);

#ifdef __cplusplus
}
#endif

#endif
