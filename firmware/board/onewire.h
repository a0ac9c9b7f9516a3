/* One slot on one of the thermometers' lines. Interrupts stay on except for the 13 us in which timing counts:
 * the serial line brings a byte every 10 us and can hold two. */
#ifndef HAPTORB_ONEWIRE_H
#define HAPTORB_ONEWIRE_H

#include "../core/thermometer.h"

/* Plays `slot`; a reset takes three calls, a millisecond apart. Returns false while it is not over.
 * *bit: what was read, or for a reset whether somebody answered. */
bool onewire_play(uint8_t line, enum slot slot, bool *bit);

#endif
