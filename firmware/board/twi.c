#include "twi.h"

#include <avr/interrupt.h>
#include <util/atomic.h>
#include <util/delay.h>
#include <util/twi.h>

#include "pins.h"

#define GO (_BV(TWINT) | _BV(TWEN) | _BV(TWIE))

enum slot_state { FREE, READY, RUNNING, DONE };

static struct transfer slots[2];
static volatile uint8_t states[2];
static volatile uint8_t running;
static uint8_t filling, finishing; /* which slot the main loop fills, and looks at, next */
static volatile uint8_t place;

void twi_start(void)
{
    states[0] = states[1] = FREE;
    running = filling = finishing = 0;
    TWSR = 0;
    TWBR = (F_CPU / 400000UL - 16) / 2;
    TWCR = _BV(TWEN);
}

struct transfer *twi_free(void)
{
    return states[filling] == FREE ? &slots[filling] : 0;
}

void twi_go(void)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        if (states[running] == FREE) { /* the bus is idle, and this slot is the one it waits at */
            states[filling] = RUNNING;
            place = 0;
            TWCR = GO | _BV(TWSTA);
        } else {
            states[filling] = READY;
        }
    }
    filling ^= 1;
}

const struct transfer *twi_done(void)
{
    return states[finishing] == DONE ? &slots[finishing] : 0;
}

void twi_taken(void)
{
    states[finishing] = FREE;
    finishing ^= 1;
}

bool twi_busy(void)
{
    return states[0] == RUNNING || states[1] == RUNNING;
}

/* STOP, and in the same breath START of the transfer that waits, if one does. */
static void finish(bool failed)
{
    slots[running].failed = failed;
    states[running] = DONE;
    running ^= 1;
    if (states[running] == READY) {
        states[running] = RUNNING;
        place = 0;
        TWCR = GO | _BV(TWSTO) | _BV(TWSTA);
    } else {
        TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
    }
}

ISR(TWI_vect)
{
    struct transfer *t = &slots[running];

    switch (TW_STATUS) {
    case TW_START:
        TWDR = (uint8_t)(t->address << 1) | (t->write_length == 0);
        TWCR = GO;
        break;
    case TW_REP_START:
        TWDR = (uint8_t)(t->address << 1) | 1;
        TWCR = GO;
        break;
    case TW_MT_SLA_ACK:
    case TW_MT_DATA_ACK:
        if (place < t->write_length) {
            TWDR = t->write[place++];
            TWCR = GO;
        } else if (t->read_length > 0) {
            place = 0;
            TWCR = GO | _BV(TWSTA);
        } else {
            finish(false);
        }
        break;
    case TW_MR_SLA_ACK:
        place = 0;
        TWCR = GO | (t->read_length > 1 ? _BV(TWEA) : 0);
        break;
    case TW_MR_DATA_ACK:
        t->read[place++] = TWDR;
        TWCR = GO | (place + 1 < t->read_length ? _BV(TWEA) : 0);
        break;
    case TW_MR_DATA_NACK:
        t->read[place] = TWDR;
        finish(false);
        break;
    default: /* somebody did not acknowledge, or a disturbance on the bus */
        finish(true);
        break;
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
