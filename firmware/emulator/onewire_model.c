/* Three DS18B20, each on its own line, seen and answered edge by edge. */
#include <math.h>
#include <string.h>

#include <avr_ioport.h>
#include <sim_cycle_timers.h>

#include "emulator.h"

#define US(n) ((avr_cycle_count_t)((n) * (CLOCK_HZ / 1e6)))

bool onewire_present[CHANNELS] = {true, true, true};

enum mode { WAIT_RESET, ROM_COMMAND, COMMAND, SEND_SCRATCHPAD, BUSY };

static avr_t *avr;
static struct sensor {
    int index, bit;
    avr_irq_t *pin;
    bool low_by_master, low_by_sensor;
    avr_cycle_count_t fell;
    enum mode mode;
    uint8_t shift;
    int count;
    uint8_t scratchpad[9];
    avr_cycle_count_t converted; /* when the conversion under way ends */
    double sampled;
    bool converting;
} sensors[CHANNELS];

static uint8_t crc8(const uint8_t *bytes, int n)
{
    uint8_t crc = 0;
    for (int i = 0; i < n; i++) {
        crc ^= bytes[i];
        for (int k = 0; k < 8; k++)
            crc = crc & 1 ? (crc >> 1) ^ 0x8C : crc >> 1;
    }
    return crc;
}

static void power_on(struct sensor *s)
{
    static const uint8_t fresh[8] = {0x50, 0x05, 0x4B, 0x46, 0x7F, 0xFF, 0x0C, 0x10}; /* 85 degC */
    memcpy(s->scratchpad, fresh, 8);
    s->scratchpad[8] = crc8(s->scratchpad, 8);
    s->mode = WAIT_RESET;
    s->converting = false;
}

static void drive(struct sensor *s)
{
    avr_raise_irq(s->pin, !(s->low_by_master || s->low_by_sensor));
}

static avr_cycle_count_t let_go(avr_t *a, avr_cycle_count_t when, void *param)
{
    struct sensor *s = param;
    s->low_by_sensor = false;
    drive(s);
    return 0;
}

static avr_cycle_count_t announce(avr_t *a, avr_cycle_count_t when, void *param)
{
    struct sensor *s = param;
    s->low_by_sensor = true;
    drive(s);
    avr_cycle_timer_register(avr, US(120), let_go, s);
    return 0;
}

static void finish_conversion(struct sensor *s)
{
    if (s->converting && avr->cycle >= s->converted) {
        const int16_t raw = (int16_t)floor(s->sampled * 16);
        s->scratchpad[0] = (uint8_t)raw;
        s->scratchpad[1] = (uint8_t)(raw >> 8);
        s->scratchpad[8] = crc8(s->scratchpad, 8);
        s->converting = false;
    }
}

static void command(struct sensor *s, uint8_t byte)
{
    s->count = 0;
    if (s->mode == ROM_COMMAND) {
        s->mode = byte == 0xCC ? COMMAND : WAIT_RESET;
    } else if (byte == 0x44) {
        s->sampled = world.temperature[s->index];
        s->converted = avr->cycle + US(750e3);
        s->converting = true;
        s->mode = BUSY;
    } else if (byte == 0xBE) {
        finish_conversion(s);
        s->mode = SEND_SCRATCHPAD;
    } else {
        s->mode = WAIT_RESET;
    }
}

static void fall(struct sensor *s)
{
    s->fell = avr->cycle;
    if (s->mode == SEND_SCRATCHPAD && s->count < 72) {
        if (!(s->scratchpad[s->count / 8] >> (s->count % 8) & 1)) {
            s->low_by_sensor = true;
            avr_cycle_timer_register(avr, US(30), let_go, s);
        }
        s->count++;
    }
}

static void rise(struct sensor *s)
{
    const avr_cycle_count_t low = avr->cycle - s->fell;

    if (low >= US(480)) {
        s->mode = ROM_COMMAND;
        s->count = 0;
        s->low_by_sensor = false;
        avr_cycle_timer_register(avr, US(30), announce, s);
        return;
    }
    if (s->mode == ROM_COMMAND || s->mode == COMMAND) {
        s->shift = (uint8_t)(s->shift >> 1 | (low < US(15) ? 0x80 : 0)); /* it looks 15 to 60 us after the fall */
        if (++s->count == 8)
            command(s, s->shift);
    }
}

static void direction(struct avr_irq_t *irq, uint32_t value, void *param)
{
    struct sensor *s = param;
    const bool low = value >> s->bit & 1;

    if (low == s->low_by_master)
        return;
    s->low_by_master = low;
    if (onewire_present[s->index]) {
        if (low)
            fall(s);
        else
            rise(s);
    }
    drive(s);
}

void onewire_model_reset(void)
{
    for (int i = 0; i < CHANNELS; i++) {
        sensors[i].low_by_master = sensors[i].low_by_sensor = false;
        if (sensors[i].pin)
            avr_raise_irq(sensors[i].pin, 1);
    }
}

void onewire_model_attach(avr_t *a, const char ports[CHANNELS], const int bits[CHANNELS])
{
    avr = a;
    for (int i = 0; i < CHANNELS; i++) {
        struct sensor *s = &sensors[i];
        s->index = i;
        s->bit = bits[i];
        s->pin = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(ports[i]), bits[i]);
        power_on(s);
        avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(ports[i]), IOPORT_IRQ_DIRECTION_ALL),
                                direction, s);
        avr_raise_irq(s->pin, 1);
    }
}
