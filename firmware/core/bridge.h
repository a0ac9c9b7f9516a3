/* What a frame from the host does, and what it is answered. */
#ifndef HAPTORB_BRIDGE_H
#define HAPTORB_BRIDGE_H

#include "bus_plan.h"
#include "calibration.h"
#include "frame.h"
#include "guard.h"

#define BOARD_ATMEGA328P 1
#define BOARD_ATMEGA2560 2
#define HALL_TOLD 0x80 /* in the number of a Hall group: it has been told before */
#define CLOCK_MICROSECONDS 4 /* one unit of the board's clock */

struct bridge {
    struct guard guard;
    struct bus_plan plan;
    struct frame_parser parser;
    uint8_t frame_age; /* [ms] since the frame in the parser began */
    uint8_t board;
    uint8_t reset_cause;
    bool stop_button;
    uint16_t temperature_age[THERMOMETERS]; /* [ms] since it was read, at most 0xFFFF */
    struct calibration calibration;
    uint8_t answer[FRAME_MAX];
};

void bridge_boot(struct bridge *bridge, uint8_t board, uint8_t reset_cause);

/* One byte from the host; returns the length of bridge->answer, or 0. The answer's check sum is still to be added with
 * frame_seal: all before it can go out first. `now` in board clock units. */
uint8_t bridge_byte(struct bridge *bridge, uint8_t byte, uint16_t now);

/* What a thermometer says; and that one does not answer. */
void bridge_temperature(struct bridge *bridge, uint8_t line, int16_t sixteenths);
void bridge_thermometer_missing(struct bridge *bridge, uint8_t line);

/* Every millisecond, from the main loop. */
void bridge_millisecond(struct bridge *bridge, bool stop_button);

#endif
