#include "thermometer.h"

#include "crc.h"

#define SKIP_ROM 0xCC /* one sensor per line: no need to know its number */
#define CONVERT 0x44
#define READ_SCRATCHPAD 0xBE
#define CONVERT_MS 760
#define COMMAND_BITS 16
#define SCRATCHPAD_BITS 72
#define POWER_ON_SIXTEENTHS (85 * 16) /* what a sensor says that never converted */

void thermometers_start(struct thermometers *t)
{
    t->line = 0;
    t->bit = 0;
    t->reading = false;
    t->wait = 10;
}

static void next_line(struct thermometers *t)
{
    t->bit = 0;
    if (++t->line < THERMOMETERS)
        return;
    t->line = 0;
    t->reading = !t->reading;
    t->wait = t->reading ? CONVERT_MS : 1;
}

enum slot thermometers_next(struct thermometers *t)
{
    if (t->wait > 0) {
        t->wait--;
        return SLOT_NONE;
    }
    if (t->bit == 0)
        return SLOT_RESET;
    if (t->bit <= COMMAND_BITS) {
        const uint16_t command = (uint16_t)((uint16_t)(t->reading ? READ_SCRATCHPAD : CONVERT) << 8 | SKIP_ROM);
        return (command >> (t->bit - 1)) & 1 ? SLOT_WRITE_1 : SLOT_WRITE_0;
    }
    return SLOT_READ;
}

static enum thermometer_news scratchpad_read(const struct thermometers *t, int16_t *sixteenths)
{
    uint8_t crc = 0;

    for (uint8_t i = 0; i < 9; i++)
        crc = crc8(crc, t->scratchpad[i]);
    /* byte 5 is 0xFF in every real scratchpad: a line stuck low reads as nine zeros, whose CRC is right too */
    if (crc != 0 || t->scratchpad[5] != 0xFF)
        return THERMOMETER_MISSING;
    *sixteenths = (int16_t)((uint16_t)t->scratchpad[1] << 8 | t->scratchpad[0]);
    return *sixteenths == POWER_ON_SIXTEENTHS ? THERMOMETER_NOTHING : THERMOMETER_READ;
}

enum thermometer_news thermometers_done(struct thermometers *t, bool bit, uint8_t *line, int16_t *sixteenths)
{
    *line = t->line;
    if (t->bit == 0) {
        t->bit = 1;
        if (bit)
            return THERMOMETER_NOTHING;
        next_line(t);
        return THERMOMETER_MISSING;
    }
    if (t->bit > COMMAND_BITS) {
        const uint8_t place = t->bit - COMMAND_BITS - 1;
        const uint8_t mask = (uint8_t)(1 << (place & 7));
        if (bit)
            t->scratchpad[place >> 3] |= mask;
        else
            t->scratchpad[place >> 3] &= (uint8_t)~mask;
    }
    t->bit++;
    if (t->bit > COMMAND_BITS && !t->reading) {
        next_line(t);
        return THERMOMETER_NOTHING;
    }
    if (t->bit > COMMAND_BITS + SCRATCHPAD_BITS) {
        const enum thermometer_news news = scratchpad_read(t, sixteenths);
        next_line(t);
        return news;
    }
    return THERMOMETER_NOTHING;
}
