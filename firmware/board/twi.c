#include "twi.h"

#include <avr/interrupt.h>
#include <util/atomic.h>
#include <util/delay.h>
#include <util/twi.h>

#include "pins.h"

#define GO (_BV(TWINT) | _BV(TWEN) | _BV(TWIE))

enum slot_state { FREE, READY, RUNNING, DONE };

#define SLOTS 3

static struct transfer slots[SLOTS];
static volatile uint8_t states[SLOTS];
static volatile uint8_t running;
static uint8_t filling, finishing; /* which slot the main loop fills, and looks at, next */

static uint8_t after(uint8_t slot)
{
    return slot == SLOTS - 1 ? 0 : slot + 1;
}

void twi_start(void)
{
    for (uint8_t i = 0; i < SLOTS; i++)
        states[i] = FREE;
    running = filling = finishing = 0;
    TWSR = 0;
    TWBR = (F_CPU / 400000UL - 16) / 2;
    TWCR = _BV(TWEN);
}

static void begin(void);

struct transfer *twi_free(void)
{
    return states[filling] == FREE ? &slots[filling] : 0;
}

void twi_go(void)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        if (states[running] == FREE) { /* the bus is idle, and this slot is the one it waits at */
            begin();
            TWCR = GO | _BV(TWSTA);
        } else {
            states[filling] = READY;
        }
    }
    filling = after(filling);
}

const struct transfer *twi_done(void)
{
    return states[finishing] == DONE ? &slots[finishing] : 0;
}

void twi_taken(void)
{
    states[finishing] = FREE;
    finishing = after(finishing);
}

bool twi_busy(void)
{
    return states[running] == RUNNING;
}

/* What the interrupt needs of the running transfer, so that a byte costs it as little as possible: the clock line is
 * held low until it has answered. */
static struct transfer *current;
static uint8_t *byte;
static uint8_t left;

static void begin(void)
{
    current = &slots[running];
    byte = current->write;
    left = current->write_length;
    states[running] = RUNNING;
}

/* STOP, and in the same breath START of the transfer that waits, if one does. Inline, as a call would have the interrupt
 * save every register at every byte, and the bus wait for that. */
static inline __attribute__((always_inline)) void finish(bool failed)
{
    current->failed = failed;
    states[running] = DONE;
    running = after(running);
    if (states[running] == READY) {
        TWCR = GO | _BV(TWSTO) | _BV(TWSTA);
        begin();
    } else {
        TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
    }
}

ISR(TWI_vect)
{
    const uint8_t status = TW_STATUS;

    if (status == TW_MT_DATA_ACK || status == TW_MT_SLA_ACK) {
        if (left > 0) {
            TWDR = *byte++;
            TWCR = GO;
            left--;
        } else if (current->read_length > 0) {
            TWCR = GO | _BV(TWSTA);
        } else {
            finish(false);
        }
    } else if (status == TW_MR_DATA_ACK) {
        *byte++ = TWDR;
        left--;
        TWCR = left > 1 ? GO | _BV(TWEA) : GO; /* the last byte is not acknowledged */
    } else if (status == TW_MR_DATA_NACK) {
        *byte = TWDR;
        finish(false);
    } else if (status == TW_MR_SLA_ACK) {
        left = current->read_length;
        TWCR = left > 1 ? GO | _BV(TWEA) : GO;
        byte = current->read;
    } else if (status == TW_START || status == TW_REP_START) {
        TWDR = (uint8_t)(current->address << 1) | (status == TW_REP_START || left == 0);
        TWCR = GO;
    } else { /* somebody did not acknowledge, or a disturbance on the bus */
        finish(true);
    }
}

void twi_recover(void)
{
    TWCR = 0;
    BUS_PORT &= (uint8_t)~(_BV(SDA_BIT) | _BV(SCL_BIT)); /* open drain: low by DDR, high by the pull-ups */
    BUS_DDR &= (uint8_t)~_BV(SDA_BIT);
    for (uint8_t i = 0; i < 9; i++) { /* a chip that lost count lets go of SDA after at most nine clocks */
        BUS_DDR |= _BV(SCL_BIT);
        _delay_us(3);
        BUS_DDR &= (uint8_t)~_BV(SCL_BIT);
        _delay_us(3);
    }
    BUS_DDR |= _BV(SDA_BIT); /* STOP: SDA rises while SCL is high */
    _delay_us(3);
    BUS_DDR &= (uint8_t)~_BV(SDA_BIT);
    _delay_us(3);
    twi_start();
}
