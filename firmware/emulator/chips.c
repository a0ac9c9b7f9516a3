/* The chips on the bus, register by register: PCA9685, three INA219, MAX11616. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "emulator.h"

struct world world;

/* ---- PCA9685: 16 channels of 12-bit PWM ---- */

static uint8_t pca[256];     /* registers as written */
static uint8_t pca_out[256]; /* outputs as they are: the chip changes them at STOP */
static uint8_t pca_pointer;
static bool pca_pointed;

static void pca_power_on(void)
{
    memset(pca, 0, sizeof pca);
    pca[0x00] = 0x11; /* asleep, all-call */
    pca[0x01] = 0x04;
    pca[0xFE] = 0x1E;
    for (int i = 0; i < 16; i++)
        pca[0x06 + 4 * i + 3] = 0x10;
    memcpy(pca_out, pca, sizeof pca);
}

static void pca_start(struct chip *chip, bool read)
{
    if (!read)
        pca_pointed = false;
}

static void pca_advance(void)
{
    if (pca[0x00] & 0x20)
        pca_pointer = pca_pointer == 0x45 ? 0x00 : pca_pointer + 1;
}

static bool pca_write(struct chip *chip, uint8_t byte)
{
    if (!pca_pointed) {
        pca_pointer = byte;
        pca_pointed = true;
        return true;
    }
    if (pca_pointer == 0xFE) {
        if (pca[0x00] & 0x10) /* only while it sleeps */
            pca[0xFE] = byte < 3 ? 3 : byte;
    } else if (pca_pointer >= 0xFA && pca_pointer <= 0xFD) {
        for (int i = 0; i < 16; i++)
            pca[0x06 + 4 * i + (pca_pointer - 0xFA)] = byte;
    } else if (pca_pointer <= 0x45) {
        pca[pca_pointer] = pca_pointer == 0x00 ? byte & 0x7F : byte;
    }
    /* beyond the LED registers the pointer moves on to the all-LED block */
    if (pca_pointer >= 0xFA && pca_pointer < 0xFD)
        pca_pointer++;
    else
        pca_advance();
    return true;
}

static uint8_t pca_read(struct chip *chip)
{
    const uint8_t byte = pca_pointer >= 0xFA && pca_pointer <= 0xFD ? 0 : pca[pca_pointer];
    pca_advance();
    return byte;
}

static void pca_stop(struct chip *chip)
{
    memcpy(pca_out, pca, sizeof pca);
}

static double pca_level(int output)
{
    const uint8_t *r = pca_out + 0x06 + 4 * output;
    const int on = (r[1] & 0x0F) << 8 | r[0], off = (r[3] & 0x0F) << 8 | r[2];

    if (pca_out[0x00] & 0x10 || r[3] & 0x10) /* asleep, or always off: that wins over always on */
        return 0;
    if (r[1] & 0x10)
        return 1;
    return ((off - on) & 0x0FFF) / 4096.0;
}

double pca9685_duty(int channel, bool oe_low)
{
    if (!oe_low || !chips_named("pca9685")->present)
        return 0;
    return pca_level(3 + channel) > 0.5 ? -pca_level(channel) : pca_level(channel);
}

/* ---- INA219: shunt voltage of one coil ---- */

static struct ina {
    uint16_t registers[6];
    uint8_t pointer;
    int place;
    uint8_t high;
    double sum, elapsed;
} inas[CHANNELS];

static const double SHUNT = 0.01;

static void ina_power_on(struct ina *ina)
{
    memset(ina, 0, sizeof *ina);
    ina->registers[0] = 0x399F;
}

static double ina_conversion(const struct ina *ina)
{
    static const double by_bits[4] = {84e-6, 148e-6, 276e-6, 532e-6};
    const int adc = (ina->registers[0] >> 3) & 0x0F;
    return adc & 8 ? 532e-6 * (1 << (adc & 7)) : by_bits[adc & 3];
}

static void ina_convert(struct ina *ina, double current)
{
    static const double range[4] = {0.04, 0.08, 0.16, 0.32};
    const double limit = range[(ina->registers[0] >> 11) & 3];
    double v = current * SHUNT;

    v = v > limit ? limit : v < -limit ? -limit : v;
    const int16_t raw = (int16_t)lround(v / 10e-6);
    ina->registers[1] = (uint16_t)raw;
    ina->registers[2] = (uint16_t)((int)(world.supply / 0.004) << 3) | 2;
    ina->registers[4] = (uint16_t)(int16_t)((int32_t)raw * (int16_t)ina->registers[5] / 4096);
    ina->registers[3] = (uint16_t)((abs((int16_t)ina->registers[4]) * (ina->registers[2] >> 3)) / 5000);
}

void chips_step(double seconds)
{
    for (int i = 0; i < CHANNELS; i++) {
        struct ina *ina = &inas[i];
        ina->sum += world.current[i] * seconds;
        ina->elapsed += seconds;
        if ((ina->registers[0] & 5) == 5 && ina->elapsed >= ina_conversion(ina)) { /* continuous, shunt enabled */
            ina_convert(ina, ina->sum / ina->elapsed);
            ina->sum = ina->elapsed = 0;
        }
    }
}

static void ina_start(struct chip *chip, bool read)
{
    inas[chip->channel].place = 0;
}

static bool ina_write(struct chip *chip, uint8_t byte)
{
    struct ina *ina = &inas[chip->channel];

    switch (ina->place++) {
    case 0: ina->pointer = byte; break;
    case 1: ina->high = byte; break;
    case 2:
        if (ina->pointer == 0) {
            if (ina->high & 0x80)
                ina_power_on(ina);
            else
                ina->registers[0] = (uint16_t)(ina->high << 8 | byte);
        } else if (ina->pointer == 5) {
            ina->registers[5] = (uint16_t)(ina->high << 8 | (byte & 0xFE));
        }
        break;
    default: break;
    }
    return true;
}

static uint8_t ina_read(struct chip *chip)
{
    struct ina *ina = &inas[chip->channel];
    const uint16_t value = ina->pointer < 6 ? ina->registers[ina->pointer] : 0;
    return (uint8_t)(ina->place++ & 1 ? value : value >> 8);
}

/* ---- MAX11616: 12 channels of 12 bits ---- */

static uint8_t adc_setup, adc_config;
static int adc_place;

static void adc_power_on(void)
{
    adc_setup = 0x02;
    adc_config = 0x01;
}

static void adc_start(struct chip *chip, bool read)
{
    adc_place = 0;
}

static bool adc_write(struct chip *chip, uint8_t byte)
{
    if (byte & 0x80) {
        adc_setup = byte & 0x7F;
        if (!(byte & 0x02))
            adc_config = 0x01;
    } else {
        adc_config = byte;
    }
    return true;
}

/* Sensors 0-4 are on AIN0-AIN4, 5-8 on AIN6-AIN9: the two blocks that the chip can scan. Before each there is half a
 * 74HC4052: one of the sensor's axes. */
static double adc_input(int ain)
{
    const int sensor = ain <= 4 ? ain : ain >= 6 && ain <= 9 ? ain - 1 : -1;
    const int axis = multiplexed_axis();
    return sensor < 0 || axis >= HALL_AXES ? 0 : world.hall[axis][sensor];
}

static uint8_t adc_read(struct chip *chip)
{
    static uint16_t code;
    const int last = (adc_config >> 1) & 0x0F, scan = (adc_config >> 5) & 3;
    const int first = scan == 0 ? 0 : scan == 2 ? (last < 6 ? last : 6) : last;
    const int count = scan == 1 ? 1 : last - first + 1;

    if (!(adc_place & 1)) {
        const double v = adc_input(first + (adc_place / 2) % count);
        code = (uint16_t)lround((v < 0 ? 0 : v > 1 ? 1 : v) * 4095);
    }
    return adc_place++ & 1 ? (uint8_t)code : (uint8_t)(0xF0 | code >> 8);
}

/* ---- the bus ---- */

static struct chip bus[] = {
    {"pca9685", 0x60, true, pca_start, pca_write, pca_read, pca_stop, 0},
    {"ina219-x", 0x41, true, ina_start, ina_write, ina_read, 0, 0},
    {"ina219-y", 0x44, true, ina_start, ina_write, ina_read, 0, 1},
    {"ina219-z", 0x45, true, ina_start, ina_write, ina_read, 0, 2},
    {"max11616", 0x35, true, adc_start, adc_write, adc_read, 0, 0},
};

struct chip *chips_find(uint8_t address)
{
    for (unsigned i = 0; i < sizeof bus / sizeof *bus; i++)
        if (bus[i].address == address && bus[i].present)
            return &bus[i];
    return 0;
}

struct chip *chips_named(const char *name)
{
    for (unsigned i = 0; i < sizeof bus / sizeof *bus; i++)
        if (strcmp(bus[i].name, name) == 0)
            return &bus[i];
    return 0;
}

void chips_power_on(void)
{
    pca_power_on();
    for (int i = 0; i < CHANNELS; i++)
        ina_power_on(&inas[i]);
    adc_power_on();
}
