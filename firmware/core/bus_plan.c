#include "bus_plan.h"

/* PCA9685 */
#define MODE1_SLEEP_AI 0x30
#define MODE1_AI 0x20
#define REG_MODE1 0x00
#define REG_MODE2 0x01
#define REG_LED0_OFF_L 0x08
#define REG_ALL_LED 0xFA
#define REG_PRE_SCALE 0xFE
#define MODE2_TOTEM_POLE 0x04 /* outputs change at STOP, all together; low while OE is high */
#define PRE_SCALE_1526_HZ 3   /* the fastest carrier */
#define FULL 0x10             /* in ON_H: always on; in OFF_H: always off */

/* INA219: +-320 mV, 12 bit (532 us), shunt only, continuous. The shunt register is read, not the current
 * register: 10 uV over 0.01 ohm is 1 mA already, and it stays true if the chip forgets its calibration. */
#define INA_CONFIG_H 0x19
#define INA_CONFIG_L 0x9D
#define REG_SHUNT 0x01

/* MAX11616: reference VDD, conversions clocked by SCL (no clock stretching), unipolar, keep configuration */
#define HALL_SETUP 0x8A
#define HALL_SCAN_0_TO_4 0x09  /* scan up from AIN0 to AIN4, single-ended */
#define HALL_SCAN_6_TO_9 0x53  /* scan up from AIN6 to AIN9, single-ended */

#define SETUP_STEPS 9
#define SETUP_DONE 0xFF
#define RETRY_MS 100
#define CHECK_ROUNDS 32
#define FAILS_MAX 3
#define HALL_PATIENCE (2 * HALL_GROUPS) /* answers */

enum job { JOB_SETUP, JOB_DUTIES, JOB_CURRENT, JOB_HALL, JOB_CHECK_PWM, JOB_CHECK_CURRENT };

/* chips in the order of the bits of `missing` */
enum chip { CHIP_PWM = 0, CHIP_CURRENT = 1, CHIP_HALL = 4 };

static uint8_t address_of(uint8_t chip)
{
    switch (chip) {
    case CHIP_PWM: return PCA9685_ADDRESS;
    case CHIP_CURRENT + 0: return INA219_ADDRESS_X;
    case CHIP_CURRENT + 1: return INA219_ADDRESS_Y;
    case CHIP_CURRENT + 2: return INA219_ADDRESS_Z;
    default: return HALL_ADC_ADDRESS;
    }
}

void plan_start(struct bus_plan *plan)
{
    plan->setup = 0;
    plan->asking = false;
    plan->step = 0;
    plan->check = 0;
    plan->check_wait = 0;
    plan->repoint = 0;
    plan->pause = 2;
    plan->missing = 0x00FF; /* nobody has answered yet */
    plan->signs = 0;
    plan->rewrite = true;
    plan->quiet = false;
    plan->scanning = false;
    for (uint8_t i = 0; i < 5; i++)
        plan->fails[i] = 0;
    for (uint8_t i = 0; i < CHANNELS; i++) {
        plan->written[i] = 0;
        plan->readings.current[i] = plan->readings.told[i] = 0;
    }
    for (uint8_t axis = 0; axis < HALL_AXES; axis++)
        for (uint8_t i = 0; i < HALL_SENSORS; i++)
            plan->readings.hall[axis][i] = 0xFFFF;
    for (uint8_t group = 0; group < HALL_GROUPS; group++)
        plan->readings.hall_time[group] = plan->readings.hall_waited[group] = 0;
    plan->readings.hall_untold = 0;
    plan->readings.hall_group = HALL_GROUPS - 1;
    plan->readings.thermometer = 0;
    plan->readings.rounds = 0;
    plan->readings.current_time = 0;
}

void plan_millisecond(struct bus_plan *plan)
{
    if (plan->pause > 0)
        plan->pause--;
}

bool plan_ready(const struct bus_plan *plan)
{
    return plan->setup == SETUP_DONE && (plan->missing & MISSING_NEEDED) == 0 && plan->quiet;
}

static void put(struct transfer *transfer, uint8_t byte)
{
    transfer->write[transfer->write_length++] = byte;
}

static void begin(struct transfer *transfer, uint8_t job, uint8_t channel, uint8_t chip, uint8_t read_length)
{
    transfer->job = job;
    transfer->channel = channel;
    transfer->address = address_of(chip);
    transfer->write_length = 0;
    transfer->read_length = read_length;
    transfer->failed = false;
}

static uint8_t chip_of(const struct transfer *transfer)
{
    for (uint8_t chip = 0; chip < 4; chip++)
        if (transfer->address == address_of(chip))
            return chip;
    return CHIP_HALL;
}

static void setup_step(const struct bus_plan *plan, struct transfer *transfer)
{
    const uint8_t step = plan->setup;

    if (step < 5) {
        begin(transfer, JOB_SETUP, 0, CHIP_PWM, 0);
        switch (step) {
        case 0: put(transfer, REG_MODE1); put(transfer, MODE1_SLEEP_AI); break;
        case 1: put(transfer, REG_PRE_SCALE); put(transfer, PRE_SCALE_1526_HZ); break;
        case 2: put(transfer, REG_MODE2); put(transfer, MODE2_TOTEM_POLE); break;
        case 3: /* every output off, before the oscillator runs */
            put(transfer, REG_ALL_LED);
            put(transfer, 0); put(transfer, 0); put(transfer, 0); put(transfer, FULL);
            break;
        default: put(transfer, REG_MODE1); put(transfer, MODE1_AI); break;
        }
    } else if (step < 8) {
        begin(transfer, JOB_SETUP, step - 5, CHIP_CURRENT + (step - 5), 0);
        put(transfer, 0x00); put(transfer, INA_CONFIG_H); put(transfer, INA_CONFIG_L);
    } else {
        begin(transfer, JOB_SETUP, 0, CHIP_HALL, 0);
        put(transfer, HALL_SETUP);
    }
}

/* ON = 0 always, so the pulse is OFF counts long; zero is the chip's own "always off". */
static void put_pwm(struct transfer *transfer, int16_t duty)
{
    const uint16_t count = duty < 0 ? (uint16_t)-duty : (uint16_t)duty;
    put(transfer, (uint8_t)count);
    put(transfer, count == 0 ? FULL : (uint8_t)(count >> 8));
}

static void put_zero_on(struct transfer *transfer)
{
    put(transfer, 0);
    put(transfer, 0);
}

static bool duties_step(struct bus_plan *plan, const struct guard *guard, struct transfer *transfer)
{
    static const int16_t none[CHANNELS] = {0, 0, 0};
    const int16_t *duties = guard_live(guard) ? guard->duties : none;
    uint8_t signs = plan->signs;
    bool news = plan->rewrite;

    if (plan->missing & MISSING_PWM)
        return false;
    for (uint8_t i = 0; i < CHANNELS; i++) {
        news |= duties[i] != plan->written[i];
        if (duties[i] < 0)
            signs |= (uint8_t)(1 << i);
        else if (duties[i] > 0)
            signs &= (uint8_t)~(1 << i);
    }
    if (!news)
        return false;

    /* From LED0_OFF_L: LED0_ON stays 0 since the set-up and is not worth two bytes a millisecond. */
    begin(transfer, JOB_DUTIES, 0, CHIP_PWM, 0);
    put(transfer, REG_LED0_OFF_L);
    put_pwm(transfer, duties[0]);
    for (uint8_t i = 1; i < CHANNELS; i++) {
        put_zero_on(transfer);
        put_pwm(transfer, duties[i]);
    }
    if (signs != plan->signs || plan->rewrite) {
        /* directions in the same burst: the chip changes all outputs together, at STOP */
        for (uint8_t i = 0; i < CHANNELS; i++) {
            const bool negative = signs & (1 << i);
            put(transfer, 0);
            put(transfer, negative ? FULL : 0);
            put(transfer, 0);
            put(transfer, negative ? 0 : FULL);
        }
    }
    for (uint8_t i = 0; i < CHANNELS; i++)
        plan->written[i] = duties[i];
    plan->signs = signs;
    plan->rewrite = false;
    plan->quiet = false;
    return true;
}

static void current_step(struct bus_plan *plan, struct transfer *transfer, uint8_t channel)
{
    begin(transfer, JOB_CURRENT, channel, CHIP_CURRENT + channel, 2);
    if (plan->repoint & (1 << channel)) { /* the pointer stays where it was put: normally nothing need be written */
        put(transfer, REG_SHUNT);
        plan->repoint &= (uint8_t)~(1 << channel);
    }
}

static void check_step(struct bus_plan *plan, struct transfer *transfer)
{
    const uint8_t chip = plan->check;

    plan->check = (chip + 1) & 3;
    begin(transfer, chip == CHIP_PWM ? JOB_CHECK_PWM : JOB_CHECK_CURRENT, chip - 1, chip, chip == CHIP_PWM ? 1 : 2);
    put(transfer, 0x00);
    if (chip != CHIP_PWM)
        plan->repoint |= (uint8_t)(1 << (chip - 1));
}

static uint8_t after(uint8_t group)
{
    return group == HALL_GROUPS - 1 ? 0 : group + 1;
}

uint8_t plan_hall_axis(const struct transfer *transfer, uint8_t before)
{
    return transfer->job == JOB_HALL ? transfer->channel / HALL_BLOCKS : before;
}

uint8_t plan_hall_told(struct bus_plan *plan, bool *news)
{
    struct readings *r = &plan->readings;
    uint8_t told = r->hall_group, bit_told = (uint8_t)(1 << told);
    uint8_t group = told, bit = bit_told;

    /* The newest; or one that has waited long, as a host of an unlucky pace would else hear some groups never; or, where
     * the newest is known already, what was left over. */
    for (uint8_t tries = 0; tries < HALL_GROUPS; tries++) {
        group = after(group);
        bit = group == 0 ? 1 : (uint8_t)(bit << 1); /* shifts by a variable are loops on an AVR */
        if (r->hall_waited[group] < 0xFF)
            r->hall_waited[group]++;
        if ((r->hall_untold & bit) && (r->hall_waited[group] > HALL_PATIENCE || !(r->hall_untold & bit_told))) {
            told = group;
            bit_told = bit;
        }
    }
    *news = r->hall_untold & bit_told;
    r->hall_untold &= (uint8_t)~bit_told;
    r->hall_waited[told] = 0;
    return told;
}

bool plan_next(struct bus_plan *plan, const struct guard *guard, struct transfer *transfer)
{
    if (plan->setup != SETUP_DONE) {
        if (plan->pause > 0 || plan->asking)
            return false;
        plan->asking = true; /* each step waits for the answer to the one before */
        setup_step(plan, transfer);
        return true;
    }
    if ((plan->missing & (MISSING_NEEDED | MISSING_HALL)) && !guard_live(guard) && plan->pause == 0) {
        plan->setup = 0; /* somebody is missing: ask all of them again */
        plan->asking = true;
        setup_step(plan, transfer);
        return true;
    }
    if (duties_step(plan, guard, transfer))
        return true;
    for (uint8_t tries = 0; tries < 6; tries++) {
        const uint8_t step = plan->step;
        plan->step = step == 4 ? 0 : step + 1;
        if (step < CHANNELS) {
            if (!(plan->missing & MISSING_CURRENT(step))) {
                current_step(plan, transfer, step);
                return true;
            }
        } else if (step == 3) {
            if (!(plan->missing & MISSING_HALL) && !plan->scanning) {
                const uint8_t group = after(plan->readings.hall_group);
                const uint8_t block = group % HALL_BLOCKS;
                begin(transfer, JOB_HALL, group, CHIP_HALL, block == 0 ? 10 : 8);
                plan->scanning = true;
                put(transfer, block == 0 ? HALL_SCAN_0_TO_4 : HALL_SCAN_6_TO_9);
                return true;
            }
        } else {
            plan->readings.rounds++;
            if (++plan->check_wait >= CHECK_ROUNDS && (plan->missing & MISSING_NEEDED) == 0) {
                plan->check_wait = 0;
                check_step(plan, transfer);
                return true;
            }
        }
    }
    return false;
}

static void lost(struct bus_plan *plan, struct guard *guard, uint8_t chip)
{
    plan->missing |= (uint16_t)(1 << chip);
    plan->pause = RETRY_MS;
    plan->rewrite = true;
    if (chip != CHIP_HALL)
        guard_trip(guard, REASON_CHIP);
}

static void setup_done(struct bus_plan *plan, const struct transfer *transfer, uint8_t chip)
{
    static const uint8_t next_chip[SETUP_STEPS] = {5, 5, 5, 5, 5, 6, 7, 8, 9};
    const uint16_t bit = (uint16_t)(1 << chip);

    plan->asking = false;
    if (transfer->failed) {
        plan->missing |= bit;
        plan->setup = next_chip[plan->setup];
    } else {
        if (plan->setup >= 4) /* the last word to this chip was heard */
            plan->missing &= (uint16_t)~bit;
        plan->setup++;
    }
    if (plan->setup >= SETUP_STEPS) {
        plan->setup = SETUP_DONE;
        plan->rewrite = true;
        plan->repoint = 0x07;
        plan->pause = RETRY_MS;
        for (uint8_t i = 0; i < 5; i++)
            plan->fails[i] = 0;
    }
}

/* Currents are told with the field that was read next: the coils' own part of it is subtracted by them. */
static void settle(struct bus_plan *plan)
{
    for (uint8_t i = 0; i < CHANNELS; i++)
        plan->readings.told[i] = plan->readings.current[i];
    plan->readings.current_time = plan->round_time;
}

void plan_done(struct bus_plan *plan, struct guard *guard, const struct transfer *transfer, uint16_t now)
{
    const uint8_t chip = chip_of(transfer);
    struct readings *readings = &plan->readings;

    if (transfer->job == JOB_SETUP) {
        setup_done(plan, transfer, chip);
        return;
    }
    if (transfer->job == JOB_HALL)
        plan->scanning = false;
    if (transfer->failed) {
        if (transfer->job == JOB_DUTIES)
            plan->rewrite = true;
        if (transfer->job == JOB_CURRENT)
            plan->repoint |= (uint8_t)(1 << transfer->channel);
        if (transfer->job == JOB_HALL)
            readings->hall_group = transfer->channel; /* the other group next time: one dead wire hides no sensor */
        if (++plan->fails[chip] >= FAILS_MAX)
            lost(plan, guard, chip);
        return;
    }
    plan->fails[chip] = 0;
    switch (transfer->job) {
    case JOB_DUTIES:
        plan->quiet = plan->written[0] == 0 && plan->written[1] == 0 && plan->written[2] == 0;
        break;
    case JOB_CURRENT: {
        const int16_t raw = (int16_t)((uint16_t)transfer->read[0] << 8 | transfer->read[1]);
        readings->current[transfer->channel] = raw; /* 10 uV over 0.01 ohm: 1 mA */
        if (transfer->channel == 0)
            plan->round_time = now;
        if (transfer->channel == CHANNELS - 1 && plan->missing & MISSING_HALL)
            settle(plan);
        guard_current(guard, transfer->channel, raw);
        break;
    }
    case JOB_HALL: {
        const uint8_t group = transfer->channel;
        const uint8_t first = group % HALL_BLOCKS == 0 ? 0 : HALL_BLOCK_MAX;
        const uint8_t count = group % HALL_BLOCKS == 0 ? HALL_BLOCK_MAX : HALL_SENSORS - HALL_BLOCK_MAX;
        for (uint8_t i = 0; i < count; i++)
            readings->hall[group / HALL_BLOCKS][first + i] =
                (uint16_t)((uint16_t)(transfer->read[2 * i] & 0x0F) << 8 | transfer->read[2 * i + 1]);
        readings->hall_time[group] = now;
        readings->hall_untold |= (uint8_t)(1 << group);
        readings->hall_group = group;
        settle(plan);
        break;
    }
    case JOB_CHECK_PWM:
        if (transfer->read[0] != MODE1_AI)
            lost(plan, guard, CHIP_PWM);
        break;
    case JOB_CHECK_CURRENT:
        if (transfer->read[0] != INA_CONFIG_H || transfer->read[1] != INA_CONFIG_L)
            lost(plan, guard, chip);
        break;
    default:
        break;
    }
}
