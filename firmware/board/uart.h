/* The serial line to the host: 1 Mbaud, 8 bits, no parity, both directions buffered by interrupts. */
#ifndef HAPTORB_UART_H
#define HAPTORB_UART_H

#include <stdbool.h>
#include <stdint.h>

void uart_start(void);
bool uart_get(uint8_t *byte);
bool uart_waiting(void);

/* How many bytes uart_put would take; they begin to go out at once. */
uint8_t uart_room(void);
void uart_put(const uint8_t *bytes, uint8_t length);

/* Bytes lost or bent since the last call. */
uint8_t uart_errors(void);

#endif
