/* What devices and scheduler of HD have in common. */
#ifndef HAPTORB_HD_INTERNAL_H
#define HAPTORB_HD_INTERNAL_H

#include "../include/HD/hd.h"
#include "../link/link.h"

#define EXPORT __attribute__((visibility("default")))

/* Put an error onto the stack. */
void hd_push(HDerror error, int internal, HHD device);

/* A frame that this thread has begun and a callback left open ends, and commands nothing. */
void hd_abandon_frames(void);

double hd_rate(void);               /* of the scheduler [Hz] */
double hd_instantaneous_rate(void); /* of its last two ticks [Hz]; 0: it does not run */

#endif
