/* What this firmware serves and the limits it never exceeds, whatever a host asks for.
 *
 * Every number marked (assumed) is not in the paper; docs/reference/hardware.md says why it was chosen.
 */
#ifndef HAPTORB_CONFIG_H
#define HAPTORB_CONFIG_H

#include <stdbool.h>
#include <stdint.h>

#define PROTOCOL_VERSION 3
#define FIRMWARE_MAJOR 1
#define FIRMWARE_MINOR 0

#define CHANNELS 3          /* coils */
#define HALL_SENSORS 9      /* places, on the axes and diagonals of the coils */
#ifndef HALL_AXES
#define HALL_AXES 3         /* of each: x, y, z through multiplexers, or 1: radial, straight to the converter */
#endif
#define HALL_BLOCKS 2       /* sensors read together: 0-4 in block 0, 5-8 in block 1 */
#define HALL_BLOCK_MAX 5
#define HALL_GROUPS (HALL_AXES * HALL_BLOCKS) /* group = 2 * axis + block */
#define THERMOMETERS 3      /* one DS18B20 at each coil's boundary (assumed; the paper shows one coil) */

/* Full scale of a duty: the PCA9685 counts to 4095, and 4096 would need its separate full-on bit. */
#define DUTY_FULL 4095

/* The device may draw 20 A per coil (12 V over 0.6 ohm); one ampere above that something is broken. */
#define HARD_DUTY DUTY_FULL
#define HARD_CURRENT_MA 21000
#define OVER_CURRENT_READINGS 2 /* in a row, so that one disturbed reading does not stop the session */

/* I2t of each coil: 17 W sustained in 0.6 ohm is 5.32 A; half duty (10 A) for 60 s must still pass,
 * so the store is (100 - 28.3) A2 * 60 s = 4302 A2s. The host's thermal model derates long before. */
#define SUSTAINED_DECIAMPERE 53
#define HEAT_LIMIT_A2S 4300UL

#define HOT_SIXTEENTHS (85 * 16) /* boundary temperature that stops everything (assumed: plastic dome softens) */

/* A temperature older than this is none: a reading of all three takes 1.1 s, so three were missed. */
#define THERMOMETER_STALE_MS 4000

/* 15 ms of silence stop the coils; with the PWM's period and the bus they are off within 20 ms. */
#define SILENCE_MS 15

/* So many damaged frames within about a tenth of a second are no accident: the line is not to be trusted. */
#define STORM_ERRORS 8
#define STORM_LEAK_MS 16

/* A frame must be complete this long after it began, or its remains are thrown away. */
#define FRAME_MS 3

#endif
