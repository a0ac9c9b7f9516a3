/* A program's end of the shared file: finds devices, reads the state, commands a force. No call waits for the servo. */
#ifndef HAPTORB_LINK_H
#define HAPTORB_LINK_H

#include "layout.h"

#include <pthread.h>
#include <stdbool.h>

#define LINKS_MAX 16
#define LINK_TEXT 256

enum library { LIBRARY_DHD = 1, LIBRARY_HD = 2 };

enum link_result {
    LINK_OK,
    LINK_SATURATED,    /* commanded, but less than was asked */
    LINK_NO_DEVICE,
    LINK_NO_MEMORY,
    LINK_FORKED,       /* opened by the parent of this process */
    LINK_SILENT,       /* the servo has ended, or does not answer */
    LINK_IN_USE,       /* another process commands the device */
    LINK_NOT_ENABLED,
    LINK_NOT_FINITE,
    LINK_CLOSED,
};

struct link {
    bool open;
    bool forked;
    bool disabled; /* the program has switched its forces off itself */
    const struct facts *facts;
    const struct states *states;
    struct command *command;
    uint64_t device, inode; /* of the mapped file */
    int64_t claim;          /* this library's, in this process */
    pthread_mutex_t mutex;  /* of `command` */
    char path[256];
};

/* Devices that can be opened now; `why` (LINK_TEXT) says what was found instead if there is none. */
int link_count(char *why);

/* The link with the number `index`, opened. */
enum link_result link_open(int index, enum library library, struct link **found, char *why);
void link_close(struct link *link);

/* Tell the servo that a program uses the device: a hand that waits for one begins. */
void link_greet(struct link *link);

/* A consistent copy of the newest state. */
enum link_result link_read(struct link *link, struct state *state);

/* Command a force [N], a torque [N·m] and a gripper force [N], from now on for as long as a command lasts. */
enum link_result link_command(struct link *link, const double force[3], const double torque[3], double grip);

/* Whether forces of this program are wanted; without, the device is free for another program. */
enum link_result link_enable(struct link *link, bool on);

/* Whether this process, nobody or another one commands the device; its name and number go into `who` (LINK_TEXT). */
bool link_is_taken(const struct link *link, char *who);

int64_t link_now(void); /* CLOCK_MONOTONIC [ns] */
void link_sleep_until(int64_t time);

/* What a person can do when there is no device: once for each process, on standard error. */
void link_explain_once(const char *library, const char *why);

/* What each result means, for the interfaces' own error texts. */
const char *link_text(enum link_result result);

#endif
