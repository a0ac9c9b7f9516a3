/* The I2C bus at 400 kHz: up to two transfers wait behind the running one, so that the bus never waits for
 * the main loop. */
#ifndef HAPTORB_TWI_H
#define HAPTORB_TWI_H

#include "../core/bus_plan.h"

void twi_start(void);

/* A slot to fill with the next transfer, or NULL if both are taken; twi_go when it is filled. */
struct transfer *twi_free(void);
void twi_go(void);

/* The oldest finished transfer, or NULL; twi_taken when it has been looked at. */
const struct transfer *twi_done(void);
void twi_taken(void);

bool twi_busy(void);

/* Gives up on what is running, clocks a stuck chip free, and starts again with empty hands. */
void twi_recover(void);

#endif
