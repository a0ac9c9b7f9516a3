/* The DS18B20s, one per data line: all are told to convert, and 750 ms later each is read.
 *
 * The board plays one 1-wire slot per millisecond, so a 12-bit reading of all three takes about 1.1 s.
 */
#ifndef HAPTORB_THERMOMETER_H
#define HAPTORB_THERMOMETER_H

#include "config.h"

enum slot { SLOT_NONE, SLOT_RESET, SLOT_WRITE_0, SLOT_WRITE_1, SLOT_READ };

struct thermometers {
    uint8_t line;
    uint8_t bit;        /* within reset (0), command, scratchpad */
    bool reading;       /* false: telling them to convert */
    uint16_t wait;      /* [ms] */
    uint8_t scratchpad[9];
};

enum thermometer_news { THERMOMETER_NOTHING, THERMOMETER_READ, THERMOMETER_MISSING };

void thermometers_start(struct thermometers *t);

/* The slot to play on line t->line in this millisecond. */
enum slot thermometers_next(struct thermometers *t);

/* What came of it: for a reset, whether somebody is there; for a read, the bit. On news, `line` and, if it was
 * read, `sixteenths` tell of which and what. */
enum thermometer_news thermometers_done(struct thermometers *t, bool bit, uint8_t *line, int16_t *sixteenths);

#endif
