/* Force Dimension's programming interface DRD: position control of the device, beside DHD. See dhdc.h. */
#ifndef DRDC_H
#define DRDC_H

#include "dhdc.h"

#ifdef __cplusplus
extern "C" {
#endif

#define DRD_DELTA_IDX 0
#define DRD_WRIST_IDX 3
#define DRD_GRIP_IDX 6

DHD_API int drdOpen(void);
DHD_API int drdOpenID(char ID);
DHD_API int drdSetDevice(char ID);
DHD_API int drdGetDeviceID(void);
DHD_API int drdClose(DHD_ID);

DHD_API bool drdIsSupported(DHD_ID);
DHD_API bool drdIsRunning(DHD_ID);
DHD_API bool drdIsMoving(DHD_ID);
DHD_API bool drdIsFiltering(DHD_ID);
DHD_API bool drdIsInitialized(DHD_ID);
DHD_API int drdAutoInit(DHD_ID);
DHD_API int drdCheckInit(DHD_ID);
DHD_API int drdPrecisionInit(DHD_ID);
DHD_API double drdGetTime(void);
DHD_API void drdSleep(double seconds);
DHD_API void drdWaitForTick(DHD_ID);
DHD_API double drdGetCtrlFreq(DHD_ID);

DHD_API int drdGetPositionAndOrientation(double *px, double *py, double *pz, double *oa, double *ob, double *og,
                                         double *pg, double matrix[3][3], DHD_ID);
DHD_API int drdGetVelocity(double *vx, double *vy, double *vz, double *wx, double *wy, double *wz, double *vg, DHD_ID);
DHD_API int drdSetForceAndTorqueAndGripperForce(double fx, double fy, double fz, double tx, double ty, double tz,
                                                double fg, DHD_ID);
DHD_API int drdSetForceAndWristJointTorquesAndGripperForce(double fx, double fy, double fz, double t0, double t1,
                                                           double t2, double fg, DHD_ID);

DHD_API int drdStart(DHD_ID);
DHD_API int drdStop(bool keep_forces DHD_DEFAULT(false), DHD_ID);
DHD_API int drdRegulatePos(bool on, DHD_ID);
DHD_API int drdRegulateRot(bool on, DHD_ID);
DHD_API int drdRegulateGrip(bool on, DHD_ID);
DHD_API int drdEnableFilter(bool on, DHD_ID);
DHD_API int drdHold(DHD_ID);
DHD_API int drdLock(uchar mask, bool initialize, DHD_ID);

DHD_API int drdMoveToPos(double px, double py, double pz, bool block DHD_DEFAULT(true), DHD_ID);
DHD_API int drdMoveToRot(double oa, double ob, double og, bool block DHD_DEFAULT(true), DHD_ID);
DHD_API int drdMoveToGrip(double pg, bool block DHD_DEFAULT(true), DHD_ID);
DHD_API int drdMoveTo(double p[DHD_MAX_DOF], bool block DHD_DEFAULT(true), DHD_ID);
DHD_API int drdMoveToEnc(int enc0, int enc1, int enc2, bool block DHD_DEFAULT(true), DHD_ID);
DHD_API int drdMoveToAllEnc(int enc[DHD_MAX_DOF], bool block DHD_DEFAULT(true), DHD_ID);
DHD_API int drdTrackPos(double px, double py, double pz, DHD_ID);
DHD_API int drdTrackRot(double oa, double ob, double og, DHD_ID);
DHD_API int drdTrackGrip(double pg, DHD_ID);
DHD_API int drdTrack(double p[DHD_MAX_DOF], DHD_ID);
DHD_API int drdTrackEnc(int enc0, int enc1, int enc2, DHD_ID);
DHD_API int drdTrackAllEnc(int enc[DHD_MAX_DOF], DHD_ID);

DHD_API int drdGetPriorities(int *priority, int *control_priority, DHD_ID);
DHD_API int drdSetPriorities(int priority, int control_priority, DHD_ID);
DHD_API int drdSetEncPGain(double gain, DHD_ID);
DHD_API double drdGetEncPGain(DHD_ID);
DHD_API int drdSetEncIGain(double gain, DHD_ID);
DHD_API double drdGetEncIGain(DHD_ID);
DHD_API int drdSetEncDGain(double gain, DHD_ID);
DHD_API double drdGetEncDGain(DHD_ID);
DHD_API int drdSetMotRatioMax(double share, DHD_ID);
DHD_API double drdGetMotRatioMax(DHD_ID);
DHD_API int drdSetEncMoveParam(double velocity, double acceleration, double jerk, DHD_ID);
DHD_API int drdSetEncTrackParam(double velocity, double acceleration, double jerk, DHD_ID);
DHD_API int drdSetPosMoveParam(double velocity, double acceleration, double jerk, DHD_ID);
DHD_API int drdSetPosTrackParam(double velocity, double acceleration, double jerk, DHD_ID);
DHD_API int drdSetRotMoveParam(double velocity, double acceleration, double jerk, DHD_ID);
DHD_API int drdSetRotTrackParam(double velocity, double acceleration, double jerk, DHD_ID);
DHD_API int drdSetGripMoveParam(double velocity, double acceleration, double jerk, DHD_ID);
DHD_API int drdSetGripTrackParam(double velocity, double acceleration, double jerk, DHD_ID);
DHD_API int drdGetEncMoveParam(double *velocity, double *acceleration, double *jerk, DHD_ID);
DHD_API int drdGetEncTrackParam(double *velocity, double *acceleration, double *jerk, DHD_ID);
DHD_API int drdGetPosMoveParam(double *velocity, double *acceleration, double *jerk, DHD_ID);
DHD_API int drdGetPosTrackParam(double *velocity, double *acceleration, double *jerk, DHD_ID);
DHD_API int drdGetRotMoveParam(double *velocity, double *acceleration, double *jerk, DHD_ID);
DHD_API int drdGetRotTrackParam(double *velocity, double *acceleration, double *jerk, DHD_ID);
DHD_API int drdGetGripMoveParam(double *velocity, double *acceleration, double *jerk, DHD_ID);
DHD_API int drdGetGripTrackParam(double *velocity, double *acceleration, double *jerk, DHD_ID);

#ifdef __cplusplus
}
#endif

#endif
