/* The device's side of haptorb on an AVR: a serial line, an I2C bus, three thermometers, and a way to switch off.
 *
 * Three guards stand behind one another. The millisecond interrupt switches the coils off when the host is silent,
 * whatever the main loop does. The processor's watchdog resets everything when the main loop hangs for 16 ms. And
 * while the processor is in reset, for whatever reason, a resistor switches the coils off.
 */
#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <util/atomic.h>

#include "../core/bridge.h"
#include "../core/thermometer.h"
#include "onewire.h"
#include "pins.h"
#include "twi.h"
#include "uart.h"

#define BUS_PATIENCE_MS 5

static struct bridge bridge;
static struct thermometers thermometers;
static volatile uint8_t ticks;
static uint8_t mcusr __attribute__((section(".noinit")));

static uint8_t EEMEM stored[CALIBRATION_BYTES];

/* Before anything else: after a watchdog reset the watchdog is still running at its shortest. */
void catch_reset(void) __attribute__((naked, used, section(".init3")));
void catch_reset(void)
{
    mcusr = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

static uint8_t reset_cause(void)
{
    if (mcusr & _BV(WDRF))
        return REASON_WATCHDOG;
    if (mcusr & _BV(BORF))
        return mcusr & _BV(PORF) ? REASON_POWER_ON : REASON_BROWN_OUT; /* power-on crosses the brown-out level too */
    if (mcusr & _BV(EXTRF))
        return REASON_RESET_PIN;
    return REASON_POWER_ON;
}

static void coils_off(void)
{
    OE_PORT |= _BV(OE_BIT);
    LAMP_PORT &= (uint8_t)~_BV(LAMP_BIT);
}

/* The pin follows the guard; asked and answered with interrupts off, so that no trip can fall in between. */
static void follow(void)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        if (guard_live(&bridge.guard)) {
            OE_PORT &= (uint8_t)~_BV(OE_BIT);
            LAMP_PORT |= _BV(LAMP_BIT);
        } else {
            coils_off();
        }
    }
}

ISR(TIMER0_COMPA_vect)
{
    guard_tick(&bridge.guard);
    if (!guard_live(&bridge.guard))
        coils_off();
    ticks++;
}

static uint16_t now(void)
{
    uint16_t t;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) t = TCNT1; /* two bytes through one shared latch */
    return t;
}

static void clocks_start(void)
{
    TCCR0A = _BV(WGM01); /* every 64 * 250 cycles: 1 ms */
    TCCR0B = _BV(CS01) | _BV(CS00);
    OCR0A = 249;
    TIMSK0 = _BV(OCIE0A);
    TCCR1A = 0; /* free running, 4 us */
    TCCR1B = _BV(CS11) | _BV(CS10);
}

static uint8_t stored_read(uint8_t at)
{
    return eeprom_read_byte(&stored[at]);
}

static void stored_write(uint8_t at, uint8_t byte)
{
    eeprom_update_byte(&stored[at], byte); /* only begun: whoever calls next asks whether it is over */
}

static const struct eeprom eeprom = {stored_read, stored_write};

static void host_bytes(void)
{
    uint8_t byte;

    for (uint8_t n = uart_errors(); n > 0; n--)
        guard_line_error(&bridge.guard);
    while (uart_get(&byte)) {
        const uint8_t length = bridge_byte(&bridge, byte, now());
        if (length > 0) {
            follow();
            if (uart_room() >= length) { /* else nobody listens: half a frame is worth nothing */
                uart_put(bridge.answer, length - FRAME_TAIL);
                frame_seal(bridge.answer, length);
                uart_put(bridge.answer + length - FRAME_TAIL, FRAME_TAIL);
            }
            return; /* the bus first, then the next frame */
        }
    }
}

/* The multiplexers' axis for the Hall scan that is about to be queued; the plan lets no two scans be on their way. No
 * interrupt touches the port. */
static void show(const struct transfer *next)
{
    static uint8_t axis;

    axis = plan_hall_axis(next, axis);
    AXIS_PORT = (uint8_t)((AXIS_PORT & ~(3 << AXIS_SHIFT)) | axis << AXIS_SHIFT);
}

static uint8_t bus_quiet; /* [ms] without a finished transfer while one is running */

/* Returns whether it did anything. */
static bool bus(void)
{
    const struct transfer *done = twi_done();

    if (done) {
        plan_done(&bridge.plan, &bridge.guard, done, now());
        twi_taken();
        bus_quiet = 0;
    }
    struct transfer *next = twi_free();
    if (!next || !plan_next(&bridge.plan, &bridge.guard, next))
        return done != 0;
    show(next);
    twi_go();
    return true;
}

/* Until the next interrupt: something is always due within a millisecond. Asked with interrupts off, and they go on
 * again only with the instruction before sleep, so that nothing that comes in between is slept over. */
static void nap(uint8_t seen)
{
    cli();
    if (seen == ticks && !twi_done() && !uart_waiting()) {
        sleep_enable();
        sei();
        sleep_cpu();
        sleep_disable();
    }
    sei();
}

static void thermometer_slot(void)
{
    static uint8_t fails[THERMOMETERS]; /* a disturbed reading now and then is no missing sensor */
    const enum slot slot = thermometers_next(&thermometers);
    uint8_t line;
    int16_t sixteenths;
    bool bit;

    if (slot == SLOT_NONE || !onewire_play(thermometers.line, slot, &bit))
        return;
    switch (thermometers_done(&thermometers, bit, &line, &sixteenths)) {
    case THERMOMETER_READ:
        fails[line] = 0;
        bridge_temperature(&bridge, line, sixteenths);
        break;
    case THERMOMETER_MISSING:
        if (++fails[line] < 3)
            break;
        fails[line] = 3;
        bridge_thermometer_missing(&bridge, line);
        break;
    default:
        break;
    }
}

static void millisecond(void)
{
    bridge_millisecond(&bridge, STOP_PIN & _BV(STOP_BIT));
    if (twi_busy() && ++bus_quiet > BUS_PATIENCE_MS) {
        bus_quiet = 0;
        guard_trip(&bridge.guard, REASON_BUS);
        follow();
        twi_recover();
        plan_start(&bridge.plan);
    }
    if (eeprom_is_ready())
        calibration_step(&bridge.calibration, &eeprom);
}

int main(void)
{
    uint8_t seen = 0;

    coils_off();
    OE_DDR |= _BV(OE_BIT); /* high before it is an output: never low in between */
    LAMP_DDR |= _BV(LAMP_BIT);
    STOP_PORT |= _BV(STOP_BIT);
    AXIS_DDR |= 3 << AXIS_SHIFT;

    bridge_boot(&bridge, BOARD, reset_cause());
    calibration_load(&bridge.calibration, &eeprom);
    thermometers_start(&thermometers);
    clocks_start();
    uart_start();
    twi_start();
    wdt_enable(WDTO_15MS);
    set_sleep_mode(SLEEP_MODE_IDLE);
    sei();

    for (;;) {
        host_bytes();
        const bool moved = bus();
        if (seen != ticks) {
            const uint8_t last = ticks;
            while (seen != last) {
                seen++;
                millisecond();
            }
            thermometer_slot();
            wdt_reset();
        }
        follow();
        if (!moved)
            nap(seen);
    }
}
