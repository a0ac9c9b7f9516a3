#include "onewire.h"

#include <util/atomic.h>
#include <util/delay.h>

#include "pins.h"

static const struct {
    volatile uint8_t *ddr;
    volatile uint8_t *pin;
    uint8_t bit;
} lines[THERMOMETERS] = ONEWIRE_LINES;

static uint8_t pulled; /* calls since a reset pulse began */

static void low(uint8_t line)
{
    /* the registers above 0x5F of the big processor need three instructions: not to be torn by an interrupt */
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) *lines[line].ddr |= (uint8_t)_BV(lines[line].bit);
}

static void release(uint8_t line)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) *lines[line].ddr &= (uint8_t)~_BV(lines[line].bit);
}

static bool level(uint8_t line)
{
    return *lines[line].pin & _BV(lines[line].bit);
}

static bool presence(uint8_t line)
{
    release(line);
    _delay_us(12);
    for (uint8_t i = 0; i < 60; i++) { /* somebody pulls within 60 us, for at least 60 us */
        if (!level(line))
            return true;
        _delay_us(1);
    }
    return false;
}

bool onewire_play(uint8_t line, enum slot slot, bool *bit)
{
    *bit = false;
    switch (slot) {
    case SLOT_RESET:
        if (pulled == 0)
            low(line);
        if (++pulled <= 2) /* the next call may come early if this one came late: two make sure of 480 us */
            return false;
        pulled = 0;
        *bit = presence(line);
        return true;
    case SLOT_WRITE_0:
        low(line);
        _delay_us(62);
        release(line);
        return true;
    case SLOT_WRITE_1:
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
        {
            low(line);
            _delay_us(2);
            release(line);
        }
        return true;
    case SLOT_READ:
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
        {
            low(line);
            _delay_us(1);
            release(line);
            _delay_us(7);
            *bit = level(line);
        }
        return true;
    default:
        return false;
    }
}
