#include "uart.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

#include "pins.h"

#define RX_SIZE 128 /* powers of two, so that indices wrap by a mask */
#define TX_SIZE 128

static uint8_t rx[RX_SIZE], tx[TX_SIZE];
static volatile uint8_t rx_in, rx_out, tx_in, tx_out, errors;

void uart_start(void)
{
    UBRR0 = F_CPU / 16 / 1000000UL - 1; /* exactly 1 Mbaud from 16 MHz */
    UCSR0A = 0;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

ISR(UART_RX_vect)
{
    const uint8_t status = UCSR0A;
    const uint8_t byte = UDR0;
    const uint8_t in = rx_in, next = (in + 1) & (RX_SIZE - 1);

    if (status & (_BV(FE0) | _BV(DOR0)))
        errors++;
    if (next == rx_out) {
        errors++;
        return;
    }
    rx[in] = byte;
    rx_in = next;
}

ISR(UART_UDRE_vect)
{
    const uint8_t out = tx_out, next = (out + 1) & (TX_SIZE - 1);

    UDR0 = tx[out];
    tx_out = next;
    if (next == tx_in)
        UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

bool uart_waiting(void)
{
    return rx_in != rx_out;
}

bool uart_get(uint8_t *byte)
{
    if (rx_in == rx_out)
        return false;
    *byte = rx[rx_out];
    rx_out = (rx_out + 1) & (RX_SIZE - 1);
    return true;
}

uint8_t uart_room(void)
{
    return (uint8_t)(tx_out - tx_in - 1) & (TX_SIZE - 1);
}

void uart_put(const uint8_t *bytes, uint8_t length)
{
    uint8_t in = tx_in;

    for (uint8_t i = 0; i < length; i++) {
        tx[in] = bytes[i];
        in = (in + 1) & (TX_SIZE - 1);
    }
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        tx_in = in;
        UCSR0B |= _BV(UDRIE0);
    }
}

uint8_t uart_errors(void)
{
    uint8_t n;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        n = errors;
        errors = 0;
    }
    return n;
}
