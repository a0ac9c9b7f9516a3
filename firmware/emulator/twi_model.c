/* The two-wire interface of the ATmega, with the clock that TWBR and the prescaler really give. */
#include <stdio.h>

#include <sim_cycle_timers.h>
#include <sim_interrupts.h>
#include <sim_io.h>

#include "emulator.h"

enum { TWBR = 0xB8, TWSR = 0xB9, TWDR = 0xBB, TWCR = 0xBC };
enum { TWINT = 0x80, TWEA = 0x40, TWSTA = 0x20, TWSTO = 0x10, TWEN = 0x04, TWIE = 0x01 };

bool twi_stuck;
uint64_t twi_busy_cycles, twi_bytes;

static avr_t *avr;
static avr_int_vector_t *vector;
static enum { IDLE, STARTED, TRANSMIT, RECEIVE } phase;
static struct chip *chip;
static uint8_t next_status;

static uint32_t period(void)
{
    static const int scale[4] = {1, 4, 16, 64};
    return 16 + 2 * avr->data[TWBR] * scale[avr->data[TWSR] & 3];
}

static avr_cycle_count_t complete(avr_t *a, avr_cycle_count_t when, void *param)
{
    avr->data[TWSR] = (avr->data[TWSR] & 3) | next_status;
    avr->data[TWCR] |= TWINT;
    avr_raise_interrupt(avr, vector);
    return 0;
}

static void later(uint32_t cycles, uint8_t status)
{
    next_status = status;
    twi_busy_cycles += cycles;
    if (!twi_stuck)
        avr_cycle_timer_register(avr, cycles, complete, 0);
}

static void stop(void)
{
    if (chip && chip->stop)
        chip->stop(chip);
    chip = 0;
    phase = IDLE;
}

static void address_byte(uint8_t byte)
{
    const bool read = byte & 1;

    if (chip && chip->address != byte >> 1 && chip->stop)
        chip->stop(chip);
    chip = chips_find(byte >> 1);
    if (chip && chip->start)
        chip->start(chip, read);
    phase = read ? RECEIVE : TRANSMIT;
    later(9 * period(), read ? (chip ? 0x40 : 0x48) : (chip ? 0x18 : 0x20));
}

static void go(uint8_t control)
{
    if (control & TWSTO) {
        stop();
        avr->data[TWCR] &= ~TWSTO;
        if (control & TWSTA) { /* the bus must be free for a while between STOP and START */
            phase = STARTED;
            later(2 * period(), 0x08);
        }
        return;
    }
    if (control & TWSTA) {
        const bool again = phase != IDLE;
        phase = STARTED;
        later(period(), again ? 0x10 : 0x08);
        return;
    }
    twi_bytes++;
    switch (phase) {
    case STARTED:
        address_byte(avr->data[TWDR]);
        break;
    case TRANSMIT:
        later(9 * period(), chip && chip->write(chip, avr->data[TWDR]) ? 0x28 : 0x30);
        break;
    case RECEIVE:
        avr->data[TWDR] = chip ? chip->read(chip) : 0xFF;
        later(9 * period(), control & TWEA ? 0x50 : 0x58);
        break;
    default:
        break;
    }
}

static void control_write(avr_t *a, avr_io_addr_t addr, uint8_t v, void *param)
{
    const uint8_t flag = avr->data[TWCR] & TWINT;

    if (!(v & TWEN)) {
        avr_cycle_timer_cancel(avr, complete, 0);
        avr->data[TWCR] = v & ~TWINT;
        stop();
        return;
    }
    avr->data[TWCR] = (v & TWINT) ? (v & ~TWINT) : (v | flag);
    if (v & TWINT) {
        avr_clear_interrupt(avr, vector);
        if (v & (TWSTO | TWSTA) || flag)
            go(v);
    }
}

static void data_write(avr_t *a, avr_io_addr_t addr, uint8_t v, void *param)
{
    avr->data[TWDR] = v;
}

void twi_model_reset(void)
{
    phase = IDLE;
    chip = 0;
}

void twi_model_attach(avr_t *a, uint8_t number)
{
    avr = a;
    for (int i = 0; i < avr->interrupts.vector_count; i++)
        if (avr->interrupts.vector[i]->vector == number)
            vector = avr->interrupts.vector[i];
    avr->io[AVR_DATA_TO_IO(TWCR)].w.c = control_write;
    avr->io[AVR_DATA_TO_IO(TWDR)].w.c = data_write;
}
