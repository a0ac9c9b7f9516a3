/* What the DHD and DRD functions have in common: the device behind an ID, and the last error of a thread. */
#ifndef HAPTORB_DEVICE_H
#define HAPTORB_DEVICE_H

#include "../include/drdc.h"
#include "../link/link.h"

#define ALONE_NS 50000000 /* a force lasts as long without its torque being commanded, and the other way round */

struct regulation;

struct device {
    struct link *link; /* NULL: never opened */
    pthread_mutex_t mutex;
    struct state last;       /* as read last, under the time guard */
    int64_t read_at;         /* 0: never */
    int64_t guard_ns;        /* 0: off */
    int64_t commanded_at;
    double command_period;   /* [s], smoothed */
    double force_limit, torque_limit, grip_limit; /* of the program itself; infinite: none */
    double mass;             /* of the end effector, as the program says */
    bool gravity, emulated_button, grip_off;
    double force[3], torque[3]; /* of the last dhdSetForce and dhdSetTorque alone */
    int64_t force_at, torque_at; /* when; 0: a function that commands both came later */
    struct regulation *regulation; /* DRD's; NULL: never started */
};

/* Set the last error of this thread; returns -1. `why` may be NULL. */
int dhd_fail(int error, const char *why);
int dhd_fail_link(enum link_result result);
void dhd_succeed(void);

/* The open device behind `ID`; NULL, and the error, if it is not open. */
struct device *dhd_device(char ID);
int dhd_number(char ID);

/* The newest state; 0, 1 if the time guard gave the last one again, or -1. */
int dhd_read(char ID, struct state *state);

/* As the interface returns it: 0, 2 if less is rendered, or -1. */
int dhd_command(struct device *device, const double force[3], const double torque[3], double grip);

int dhd_open_number(int number);
void dhd_angles(const double rotation[9], double angles[3]);

/* DRD's share in closing a device. */
void drd_end(struct device *device);
/* The controller's own force is added to that of the program; whether it runs. */
bool drd_runs(const struct device *device);

#endif
