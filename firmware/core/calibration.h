/* The id of the calibration that belongs to this device, in two places of the EEPROM: one is whole at any time.
 *
 * A new id goes into the place that is not in use, its mark is written last, and all of it is read back before anybody
 * is told that it is kept. A reset or a supply that fails at any moment leaves the old id or the new one, and never the
 * old one after the new one was called kept. One byte is begun at a time and none is waited for: the EEPROM takes
 * 3.4 ms for each.
 */
#ifndef HAPTORB_CALIBRATION_H
#define HAPTORB_CALIBRATION_H

#include <stdbool.h>
#include <stdint.h>

#define CALIBRATION_ID 16
#define CALIBRATION_PLACE (1 + 1 + CALIBRATION_ID + 2) /* mark, number, id, check sum of number and id */
#define CALIBRATION_BYTES (2 * CALIBRATION_PLACE)

enum calibration_state { CALIBRATION_REST, CALIBRATION_WRITING, CALIBRATION_FAILED };

struct calibration {
    uint8_t id[CALIBRATION_ID];     /* kept, as it was read from the EEPROM; zeros: none */
    uint8_t wanted[CALIBRATION_ID]; /* being written */
    uint8_t state;
    uint8_t place;                  /* in use: 0 or 1 */
    uint8_t number;                 /* of the place in use, counts up and wraps */
    uint8_t step;
};

/* What the board gives: one byte of its EEPROM, read or begun to be written. Neither is called while one is busy. */
struct eeprom {
    uint8_t (*read)(uint8_t at);
    void (*write)(uint8_t at, uint8_t byte);
};

void calibration_load(struct calibration *calibration, const struct eeprom *eeprom);

/* Wishes for `id` to be kept; returns a guard_refusal: ACCEPTED only when it is, REFUSED_WRITING until then (ask again),
 * REFUSED_EEPROM once if it could not be read back. */
uint8_t calibration_wish(struct calibration *calibration, const uint8_t *id);

/* The next byte, if any; to be called when the EEPROM is not busy. */
void calibration_step(struct calibration *calibration, const struct eeprom *eeprom);

#endif
