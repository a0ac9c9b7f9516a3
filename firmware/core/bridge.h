/* What a frame from the host does, and what it is answered. */
#ifndef HAPTORB_BRIDGE_H
#define HAPTORB_BRIDGE_H

#include "bus_plan.h"
#include "frame.h"
#include "guard.h"

#define BOARD_ATMEGA328P 1
#define BOARD_ATMEGA2560 2
#define CALIBRATION_ID 16
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
    bool store;        /* the board must write `calibration` to its EEPROM */
    uint8_t calibration[CALIBRATION_ID];
    uint8_t answer[FRAME_MAX];
};

void bridge_boot(struct bridge *bridge, uint8_t board, uint8_t reset_cause);

/* One byte from the host; returns the length of bridge->answer, or 0. The answer's check sum is still to be added with
 * frame_seal: all before it can go out first. `now` in board clock units. */
uint8_t bridge_byte(struct bridge *bridge, uint8_t byte, uint16_t now);

/* Every millisecond, from the main loop. */
void bridge_millisecond(struct bridge *bridge, bool stop_button);

#endif
