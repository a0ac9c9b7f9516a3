/* The file that a running servo and the libraries share: three pages, one writer each, 8-byte words throughout.
 *
 * Page 0, facts: written once by the server before `magic`. Page 1, states: by the server after every tick, into one of
 * four slots in turn, so that a reader never waits for a writer. Both are mapped without write permission here. Page 2,
 * command: by the one process that holds `claim`, under a sequence number that is odd while it writes.
 *
 * Lengths in m, forces in N, torques in N·m, angles in rad, times in ns of CLOCK_MONOTONIC. Vectors are in the frame of
 * Force Dimension's interface: x towards the user, y to the right, z up, origin in the middle of the workspace.
 * `src/haptorb/serve/native.py` has the same table; a test compares them. */
#ifndef HAPTORB_LAYOUT_H
#define HAPTORB_LAYOUT_H

#include <stdint.h>

#define LAYOUT_MAGIC 0x6c6e62726f747061LL /* "aptorbnl" */
#define LAYOUT_VERSION 2
#define LAYOUT_PAGE 4096
#define LAYOUT_SIZE (3 * LAYOUT_PAGE)
#define JOINTS_MAX 8

/* Bits of facts.capabilities. */
#define HAS_BASE 1        /* a force of three components */
#define HAS_WRIST 2       /* measures an orientation */
#define HAS_ACTIVE_WRIST 4
#define HAS_GRIPPER 8
#define HAS_ACTIVE_GRIPPER 16
#define IS_LEFT_HANDED 32
#define IS_SIMULATED 64

struct facts {
    int64_t magic;
    int64_t version;
    int64_t size;
    int64_t owner;        /* user id */
    int64_t server;       /* process id */
    int64_t server_start; /* its start, clock ticks since boot */
    int64_t type;         /* device type number of Force Dimension's interface */
    int64_t capabilities;
    int64_t serial;
    double rate;              /* of the servo [Hz] */
    double workspace[6];      /* box of the poses: least x y z, greatest x y z */
    double force_max;         /* peak */
    double force_continuous;
    double stiffness_max;     /* that a program can render stably [N/m] */
    double mass;              /* that the hand feels [kg]; 0: unknown */
    double torque_max;
    double grip_force_max;
    double grip_angle_max;
    double grip_length;       /* from the gripper's axis to thumb and finger; gap = 2 length sin(angle / 2) */
    char name[64];
    char maker[32];
    char version_text[32];
};

enum phase { PHASE_STARTING = 0, PHASE_RUNNING = 1, PHASE_ENDED = 2 };

struct state {
    int64_t tick;
    int64_t stamp;    /* when the tick of this state began */
    int64_t valid;    /* the pose is valid */
    int64_t guard;    /* 0 off, 1 ramping, 2 running, 3 derated, 4 tripped */
    int64_t trip;     /* code of the last trip */
    int64_t buttons;
    int64_t joints;   /* how many joint angles the device has */
    double warmth;    /* winding temperature between ambient, 0, and the derating temperature, 1 */
    double position[3];
    double rotation[9]; /* row by row */
    double velocity[3];
    double angular_velocity[3];
    double force[3];    /* on the hand, as rendered */
    double torque[3];
    double grip_angle;
    double grip_velocity; /* [rad/s] */
    double grip_force;    /* of each of thumb and finger, positive to open */
    double joint_angles[JOINTS_MAX];
    char trip_text[160];
};

#define SLOTS 4
#define SLOT_SIZE 960

struct states {
    int64_t count; /* states written so far; state n is in slot n % SLOTS, the next slot may be half written */
    int64_t phase;
    char reserved[LAYOUT_PAGE - SLOTS * SLOT_SIZE - 16];
    struct {
        struct state state;
        char rest[SLOT_SIZE - sizeof(struct state)];
    } slots[SLOTS];
};

struct command {
    int64_t claim;    /* who commands: process id, library and start, see link.c; 0: nobody */
    int64_t sequence;
    int64_t owner;    /* the claim under which this command was written */
    int64_t stamp;    /* when it was written */
    int64_t enabled;  /* 0: the program has switched its forces off */
    double force[3];
    double torque[3];
    double grip_force;
    char program[64];
    int64_t opened; /* when a program opened the device first; 0: none has */
};

#endif
