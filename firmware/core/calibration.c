#include "calibration.h"

#include "crc.h"
#include "guard.h"

#define MARK 0xA5
#define NO_MARK 0x00
#define CONTENT (CALIBRATION_PLACE - 1) /* all but the mark */

enum { STEP_UNMARK = 0, STEP_WRITE = 1, STEP_COMPARE = STEP_WRITE + CONTENT, STEP_MARK, STEP_CONFIRM };

static uint8_t start_of(uint8_t place)
{
    return place ? CALIBRATION_PLACE : 0;
}

/* None of this is in a hurry: small rather than fast. */
#define SMALL __attribute__((noinline, cold))

/* Byte `i` behind the mark of a place with this number and id. */
SMALL static uint8_t content(uint8_t i, uint8_t number, const uint8_t *id)
{
    uint16_t crc = crc16(CRC16_START, number);

    if (i == 0)
        return number;
    if (i <= CALIBRATION_ID)
        return id[i - 1];
    for (uint8_t k = 0; k < CALIBRATION_ID; k++)
        crc = crc16(crc, id[k]);
    return i == CONTENT - 1 ? (uint8_t)(crc >> 8) : (uint8_t)crc;
}

/* Whether the place is marked and whole; then `number` and `id` are what it says. */
SMALL static bool place_read(uint8_t place, const struct eeprom *eeprom, uint8_t *number, uint8_t *id)
{
    const uint8_t start = start_of(place);

    if (eeprom->read(start) != MARK)
        return false;
    *number = eeprom->read((uint8_t)(start + 1));
    for (uint8_t i = 0; i < CALIBRATION_ID; i++)
        id[i] = eeprom->read((uint8_t)(start + 2 + i));
    for (uint8_t i = 1 + CALIBRATION_ID; i < CONTENT; i++)
        if (eeprom->read((uint8_t)(start + 1 + i)) != content(i, *number, id))
            return false;
    return true;
}

SMALL void calibration_load(struct calibration *calibration, const struct eeprom *eeprom)
{
    uint8_t number[2], other[CALIBRATION_ID];
    const bool first = place_read(0, eeprom, &number[0], calibration->id);
    const bool second = place_read(1, eeprom, &number[1], other);

    calibration->state = CALIBRATION_REST;
    calibration->step = 0;
    calibration->place = second && (!first || (int8_t)(number[1] - number[0]) > 0);
    calibration->number = first || second ? number[calibration->place] : 0;
    for (uint8_t i = 0; i < CALIBRATION_ID; i++)
        if (calibration->place)
            calibration->id[i] = other[i];
        else if (!first)
            calibration->id[i] = 0; /* not calibrated */
}

SMALL static bool same(const uint8_t *one, const uint8_t *other)
{
    for (uint8_t i = 0; i < CALIBRATION_ID; i++)
        if (one[i] != other[i])
            return false;
    return true;
}

SMALL uint8_t calibration_wish(struct calibration *calibration, const uint8_t *id)
{
    if (calibration->state == CALIBRATION_WRITING)
        return REFUSED_WRITING;
    if (calibration->state == CALIBRATION_FAILED) {
        calibration->state = CALIBRATION_REST;
        if (same(id, calibration->wanted))
            return REFUSED_EEPROM;
    }
    if (same(id, calibration->id))
        return ACCEPTED;
    for (uint8_t i = 0; i < CALIBRATION_ID; i++)
        calibration->wanted[i] = id[i];
    calibration->step = STEP_UNMARK;
    calibration->state = CALIBRATION_WRITING;
    return REFUSED_WRITING;
}

SMALL void calibration_step(struct calibration *calibration, const struct eeprom *eeprom)
{
    const uint8_t start = start_of(!calibration->place), number = (uint8_t)(calibration->number + 1);

    if (calibration->state != CALIBRATION_WRITING)
        return;
    const uint8_t step = calibration->step++;
    if (step == STEP_UNMARK) {
        eeprom->write(start, NO_MARK); /* from here on it is no place, whatever is in it */
    } else if (step < STEP_COMPARE) {
        eeprom->write((uint8_t)(start + step), content((uint8_t)(step - STEP_WRITE), number, calibration->wanted));
    } else if (step == STEP_COMPARE) {
        for (uint8_t i = 0; i < CONTENT; i++)
            if (eeprom->read((uint8_t)(start + 1 + i)) != content(i, number, calibration->wanted))
                calibration->state = CALIBRATION_FAILED;
    } else if (step == STEP_MARK) {
        eeprom->write(start, MARK);
    } else if (eeprom->read(start) != MARK) {
        calibration->state = CALIBRATION_FAILED;
    } else {
        calibration->place = !calibration->place;
        calibration->number = number;
        for (uint8_t i = 0; i < CALIBRATION_ID; i++)
            calibration->id[i] = calibration->wanted[i];
        calibration->state = CALIBRATION_REST;
    }
}
