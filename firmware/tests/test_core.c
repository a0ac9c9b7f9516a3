/* The portable core on this computer: shared frames, the guard's every way out, the bus plan against simple chips. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../core/bridge.h"
#include "../core/crc.h"
#include "../core/thermometer.h"

static int failures, checks;

#define CHECK(what) do { checks++; if (!(what)) { failures++; printf("%s:%d: not so: %s\n", __FILE__, __LINE__, #what); } } while (0)

static int unhex(const char *text, uint8_t *out)
{
    int n = 0;
    unsigned value;
    while (sscanf(text + 2 * n, "%2x", &value) == 1)
        out[n++] = (uint8_t)value;
    return n;
}

/* name type sequence payload|- frame, as written by tests/runtime/test_protocol.py's twin in Python */
static void test_vectors(const char *path)
{
    FILE *file = fopen(path, "r");
    char row[512], name[64], payload_text[200], frame_text[200];
    unsigned type, sequence;
    int rows = 0;

    CHECK(file != 0);
    while (file && fgets(row, sizeof row, file)) {
        uint8_t payload[64], wanted[64], made[FRAME_MAX];
        struct frame_parser parser;
        enum frame_event event = FRAME_NOTHING;

        if (row[0] == '#' || sscanf(row, "%63s %x %x %199s %199s", name, &type, &sequence, payload_text, frame_text) != 5)
            continue;
        const int n = payload_text[0] == '-' ? 0 : unhex(payload_text, payload);
        const int m = unhex(frame_text, wanted);
        CHECK(frame_write(made, (uint8_t)type, (uint8_t)sequence, payload, (uint8_t)n) == m);
        CHECK(memcmp(made, wanted, (size_t)m) == 0);
        frame_reset(&parser);
        for (int i = 0; i < m; i++)
            event = frame_byte(&parser, wanted[i]);
        CHECK(event == FRAME_COMPLETE);
        CHECK(parser.frame.type == type && parser.frame.sequence == sequence && parser.frame.length == n);
        CHECK(memcmp(parser.frame.payload, payload, (size_t)n) == 0);
        for (int bit = 16; bit < 8 * m; bit++) { /* every single flipped bit behind the sync is noticed */
            frame_reset(&parser);
            wanted[bit / 8] ^= (uint8_t)(1 << bit % 8);
            for (int i = 0; i < m; i++)
                CHECK(frame_byte(&parser, wanted[i]) != FRAME_COMPLETE);
            wanted[bit / 8] ^= (uint8_t)(1 << bit % 8);
        }
        rows++;
    }
    CHECK(rows >= 8);
    if (file)
        fclose(file);
}

static void test_checks(void)
{
    uint16_t crc = CRC16_START;
    const uint8_t scratchpad[9] = {0x50, 0x05, 0x4B, 0x46, 0x7F, 0xFF, 0x0C, 0x10, 0x1C};
    uint8_t sum = 0;

    for (const char *c = "123456789"; *c; c++)
        crc = crc16(crc, (uint8_t)*c);
    CHECK(crc == 0x29B1);
    for (int i = 0; i < 9; i++)
        sum = crc8(sum, scratchpad[i]);
    CHECK(sum == 0);
}

static const int16_t some[CHANNELS] = {100, -200, 300};

static void engaged(struct guard *guard)
{
    guard_boot(guard, REASON_POWER_ON);
    CHECK(guard_engage(guard, ENGAGE_KEY, 4095, 20000) == ACCEPTED);
    guard_set(guard, 1, some);
    CHECK(guard_live(guard) && guard->duties[1] == -200);
}

static void tripped(const struct guard *guard, uint8_t reason)
{
    CHECK(guard->state == STATE_TRIPPED && guard->reason == reason);
}

static void test_guard(void)
{
    struct guard g;
    const int16_t wild[CHANNELS] = {32767, -32768, 5};

    guard_boot(&g, REASON_BROWN_OUT);
    CHECK(g.state == STATE_OFF && g.reason == REASON_BROWN_OUT);
    guard_set(&g, 1, some);
    CHECK(g.duties[0] == 0 && !guard_live(&g)); /* nothing before ENGAGE */
    CHECK(guard_engage(&g, 0x1234, 4095, 20000) == REFUSED_KEY);

    engaged(&g);
    for (int i = 0; i < SILENCE_MS - 1; i++)
        guard_tick(&g);
    CHECK(guard_live(&g));
    guard_set(&g, 2, some);
    for (int i = 0; i < SILENCE_MS - 1; i++)
        guard_tick(&g);
    CHECK(guard_live(&g));
    guard_set(&g, 2, some); /* the same again is no sign of life */
    guard_tick(&g);
    tripped(&g, REASON_SILENCE);
    guard_set(&g, 3, some);
    CHECK(g.duties[0] == 0 && !guard_live(&g));
    CHECK(guard_engage(&g, ENGAGE_KEY, 4095, 20000) == REFUSED_TRIPPED); /* OFF first */
    guard_off(&g);
    CHECK(guard_engage(&g, ENGAGE_KEY, 4095, 20000) == ACCEPTED && g.duties[0] == 0);

    engaged(&g);
    guard_set(&g, 9, wild);
    CHECK(g.duties[0] == 4095 && g.duties[1] == -4095 && g.duties[2] == 5);
    guard_off(&g);
    guard_engage(&g, ENGAGE_KEY, 400, 65535); /* a host may ask for less, never for more */
    CHECK(g.current_limit == HARD_CURRENT_MA);
    guard_set(&g, 10, wild);
    CHECK(g.duties[0] == 400 && g.duties[1] == -400);

    engaged(&g);
    guard_current(&g, 2, 20500);
    guard_current(&g, 2, 100); /* one reading may be a disturbance */
    guard_current(&g, 2, -20500);
    CHECK(guard_live(&g));
    guard_current(&g, 2, -32768);
    tripped(&g, REASON_OVER_CURRENT);
    guard_trip(&g, REASON_BUS);
    tripped(&g, REASON_OVER_CURRENT); /* the first reason stays */

    engaged(&g);
    for (int i = 0; i < STORM_ERRORS - 1; i++)
        guard_line_error(&g);
    CHECK(guard_live(&g));
    guard_line_error(&g);
    tripped(&g, REASON_LINE);
    engaged(&g);
    for (int i = 0; i < 1000; i++) { /* an error now and then is forgotten */
        if (i % 20 == 0)
            guard_line_error(&g);
        guard_millisecond(&g);
    }
    CHECK(guard_live(&g));

    engaged(&g);
    guard_temperature(&g, HOT_SIXTEENTHS);
    CHECK(guard_live(&g));
    guard_temperature(&g, HOT_SIXTEENTHS + 1);
    tripped(&g, REASON_HOT);
}

/* Seconds at `ampere` until the store of heat is full. */
static double endurance(int16_t milliampere)
{
    struct guard g;
    long ms = 0;

    engaged(&g);
    guard_current(&g, 1, milliampere);
    while (guard_live(&g) && ms < 400000) {
        guard_millisecond(&g);
        ms++;
    }
    if (ms < 400000)
        tripped(&g, REASON_HEAT);
    return (double)ms / 1000;
}

static void test_heat(void)
{
    CHECK(endurance(5300) >= 400);                      /* sustained */
    CHECK(endurance(10000) > 59 && endurance(10000) < 61); /* half duty for a minute */
    CHECK(endurance(20000) > 11 && endurance(20000) < 12); /* full power: the host derates at 5 s */
}

/* Chips that remember what was written to them, just enough to play the bus. */
static uint8_t pca[256];
static uint16_t ina_config[CHANNELS], ina_pointer[CHANNELS];
static int16_t shunt[CHANNELS];
static uint16_t absent;
static uint8_t adc_config;

static int chip_index(uint8_t address)
{
    return address == 0x60 ? 0 : address == 0x41 ? 1 : address == 0x44 ? 2 : address == 0x45 ? 3 : address == 0x35 ? 4 : -1;
}

static uint8_t shown; /* axis that the multiplexers pass on */

static void play(struct transfer *t)
{
    const int chip = chip_index(t->address);

    CHECK(chip >= 0 && t->write_length <= WRITE_MAX && t->read_length <= READ_MAX);
    t->failed = absent >> chip & 1;
    if (t->failed)
        return;
    if (chip == 0) {
        for (int i = 1; i < t->write_length; i++)
            pca[(uint8_t)(t->write[0] + i - 1)] = t->write[i];
        if (t->read_length)
            t->read[0] = pca[t->write[0]];
    } else if (chip < 4) {
        const int c = chip - 1;
        if (t->write_length > 0)
            ina_pointer[c] = t->write[0];
        if (t->write_length == 3)
            ina_config[c] = (uint16_t)(t->write[1] << 8 | t->write[2]);
        const uint16_t value = ina_pointer[c] == 1 ? (uint16_t)shunt[c] : ina_config[c];
        t->read[0] = (uint8_t)(value >> 8);
        t->read[1] = (uint8_t)value;
    } else {
        if (t->write[0] & 0x80)
            return;
        adc_config = t->write[0];
        const int first = adc_config & 0x40 ? 6 : 0;
        for (int i = 0; i < t->read_length / 2; i++) {
            t->read[2 * i] = (uint8_t)(0xF0 | shown); /* as the multiplexers are while it scans */
            t->read[2 * i + 1] = (uint8_t)(first + i);
        }
    }
}

static int run(struct bridge *b, int milliseconds)
{
    int transfers = 0;

    for (int ms = 0; ms < milliseconds; ms++) {
        bridge_millisecond(b, false);
        struct transfer ahead[3];
        for (int k = 0; k < 2; k++) { /* three planned before the first is done, as the board does */
            int planned = 0;
            while (planned < 3 && plan_next(&b->plan, &b->guard, &ahead[planned])) {
                shown = plan_hall_axis(&ahead[planned], shown);
                planned++;
            }
            for (int i = 0; i < planned; i++) {
                play(&ahead[i]);
                plan_done(&b->plan, &b->guard, &ahead[i], 0);
                transfers++;
            }
        }
    }
    return transfers;
}

static int duty_on_chip(int channel)
{
    const uint8_t *pwm = pca + 6 + 4 * channel, *dir = pca + 6 + 4 * (3 + channel);
    if (pwm[3] & 0x10)
        return 0;
    const int size = (pwm[3] & 0x0F) << 8 | pwm[2];
    return dir[1] & 0x10 ? -size : size;
}

static uint8_t say(struct bridge *b, uint8_t type, uint8_t sequence, const void *payload, uint8_t length)
{
    uint8_t bytes[FRAME_MAX];
    const uint8_t n = frame_write(bytes, type, sequence, payload, length);
    uint8_t answered = 0;

    for (uint8_t i = 0; i < n; i++)
        answered = bridge_byte(b, bytes[i], 0);
    if (answered) {
        static struct frame_parser host;
        enum frame_event heard = FRAME_NOTHING;
        frame_seal(b->answer, answered);
        frame_reset(&host);
        for (uint8_t i = 0; i < answered; i++)
            heard = frame_byte(&host, b->answer[i]);
        CHECK(heard == FRAME_COMPLETE && host.frame.sequence == sequence);
    }
    return answered;
}

static const uint8_t engage_all[6] = {0xFE, 0x5A, 0xFF, 0x0F, 0xFF, 0xFF};

static void set(struct bridge *b, uint8_t sequence, int x, int y, int z)
{
    const uint8_t p[6] = {(uint8_t)x, (uint8_t)(x >> 8), (uint8_t)y, (uint8_t)(y >> 8), (uint8_t)z, (uint8_t)(z >> 8)};
    CHECK(say(b, FRAME_SET, sequence, p, 6) == 43);
}

static void fresh(struct bridge *b)
{
    memset(pca, 0xEE, sizeof pca);
    memset(ina_config, 0, sizeof ina_config);
    memset(shunt, 0, sizeof shunt);
    absent = 0;
    bridge_boot(b, BOARD_ATMEGA328P, REASON_POWER_ON);
    CHECK(!plan_ready(&b->plan));
    say(b, FRAME_ENGAGE, 1, engage_all, 6);
    CHECK(b->answer[9] == REFUSED_STOP_BUTTON && !guard_live(&b->guard));
    run(b, 30);
    CHECK(plan_ready(&b->plan) && (b->plan.missing & 0x1F) == 0);
    for (uint8_t i = 0; i < THERMOMETERS; i++)
        bridge_temperature(b, i, 25 * 16);
    CHECK(duty_on_chip(0) == 0 && duty_on_chip(1) == 0 && duty_on_chip(2) == 0);
    CHECK(pca[0xFE] == 3 && ina_config[2] == 0x199D);
}

/* The newest group is told, but every one now and then, whatever the pace of the host; without news the last again. */
static void test_hall_groups(void)
{
    static struct bridge b;
    bool news;
    uint8_t expected, codes = 0;

    fresh(&b);
    expected = b.plan.readings.hall_group;
    for (int i = 0; i < HALL_GROUPS; i++) { /* the newest, then what was left over from before */
        CHECK(say(&b, FRAME_READ, (uint8_t)i, 0, 0) == 43);
        CHECK(b.answer[5 + 16] == expected);
        expected = (uint8_t)((expected + 1) % HALL_GROUPS);
        codes |= (uint8_t)(1 << (b.answer[5 + 18] & 0x0F));
    }
    CHECK(codes == (1 << HALL_AXES) - 1);
    say(&b, FRAME_READ, 99, 0, 0);
    CHECK(b.answer[5 + 16] == (b.plan.readings.hall_group | HALL_TOLD));
    for (int rounds = 1; rounds < 9; rounds++) { /* hosts of many paces: nobody is left out */
        uint8_t seen = 0;
        for (int i = 0; i < 100; i++) {
            run(&b, rounds);
            const uint8_t group = plan_hall_told(&b.plan, &news);
            CHECK(news && group < HALL_GROUPS);
            seen |= (uint8_t)(1 << group);
        }
        CHECK(seen == (1 << HALL_GROUPS) - 1);
    }
    const uint8_t lost = b.plan.readings.hall_group;
    absent = 1 << 4;
    run(&b, 2);
    CHECK(b.plan.readings.hall_group != lost || b.plan.missing & MISSING_HALL); /* a scan that fails moves on */
}

static void test_bus(void)
{
    static struct bridge b;

    fresh(&b);
    for (int axis = 0; axis < HALL_AXES; axis++) {
        const uint16_t *hall = b.plan.readings.hall[axis];
        CHECK(hall[0] == (axis << 8 | 0) && hall[4] == (axis << 8 | 4));
        CHECK(hall[5] == (axis << 8 | 6) && hall[8] == (axis << 8 | 9));
    }
    set(&b, 2, 100, 100, 100);
    run(&b, 3);
    CHECK(duty_on_chip(0) == 0); /* not engaged: nothing */
    say(&b, FRAME_ENGAGE, 3, engage_all, 6);
    CHECK(b.answer[9] == ACCEPTED && guard_live(&b.guard));
    for (int k = 0; k < 2000; k++) { /* all signs and sizes, through several checks of the chips */
        const int x = (k * 37) % 8191 - 4095, y = k % 2 ? 4095 : -4095, z = k % 3 ? 0 : -k;
        set(&b, (uint8_t)k, x, y, z);
        shunt[0] = (int16_t)x;
        run(&b, 2);
        CHECK(duty_on_chip(0) == x && duty_on_chip(1) == y && duty_on_chip(2) == (z ? z : 0));
        CHECK(b.plan.readings.current[0] == x);
    }
    CHECK(guard_live(&b.guard));
    absent = 1 << 2; /* a current sensor falls off */
    set(&b, 1, 500, 500, 500);
    run(&b, 6);
    CHECK(b.guard.state == STATE_TRIPPED && b.guard.reason == REASON_CHIP);
    CHECK(b.plan.missing & MISSING_CURRENT(1));
    CHECK(duty_on_chip(0) == 0);
    say(&b, FRAME_OFF, 9, 0, 0);
    say(&b, FRAME_ENGAGE, 10, engage_all, 6);
    CHECK(b.answer[9] == REFUSED_CHIP && (b.answer[7] & 0x1F) == 0x04);
    absent = 0; /* and comes back */
    run(&b, 400);
    CHECK(plan_ready(&b.plan));

    fresh(&b);
    say(&b, FRAME_ENGAGE, 3, engage_all, 6);
    for (int k = 0; k < 200 && guard_live(&b.guard); k++) {
        set(&b, (uint8_t)k, 100, 100, 100);
        run(&b, 2);
        if (k == 20)
            ina_config[1] = 0x399F; /* it has lost its supply for a moment */
    }
    CHECK(b.guard.reason == REASON_CHIP);

    fresh(&b);
    absent = 1 << 4; /* Hall sensors are not needed for safety */
    run(&b, 20);
    CHECK(b.plan.missing & MISSING_HALL);
    CHECK(plan_ready(&b.plan));
}

static void test_frames_in_pieces(void)
{
    static struct bridge b;
    uint8_t bytes[FRAME_MAX];

    fresh(&b);
    const uint8_t n = frame_write(bytes, FRAME_READ, 5, 0, 0);
    for (uint8_t i = 0; i < 4; i++)
        CHECK(bridge_byte(&b, bytes[i], 0) == 0);
    for (int ms = 0; ms <= FRAME_MS + 1; ms++)
        bridge_millisecond(&b, false); /* the rest never comes */
    CHECK(say(&b, FRAME_READ, 6, 0, 0) == 43);
    CHECK(bridge_byte(&b, 0xA5, 0) == 0); /* a stray sync byte before a frame costs nothing */
    CHECK(say(&b, FRAME_READ, 7, 0, 0) == 43);
    CHECK(say(&b, 0x33, 8, 0, 0) == 12 && b.answer[9] == REFUSED_FRAME);
    CHECK(say(&b, FRAME_SET, 9, bytes, 5) == 12 && b.answer[9] == REFUSED_FRAME);
    CHECK(n == 7);
}

static void test_stop_button(void)
{
    static struct bridge b;

    fresh(&b);
    say(&b, FRAME_ENGAGE, 3, engage_all, 6);
    set(&b, 1, 100, 100, 100);
    CHECK(b.answer[9] == 100);
    for (int ms = 0; ms < SILENCE_MS; ms++)
        guard_tick(&b.guard); /* as the interrupt does, which touches no duties */
    say(&b, FRAME_READ, 2, 0, 0);
    CHECK(b.answer[5] == STATE_TRIPPED && b.answer[9] == 0); /* applied: nothing */
    guard_off(&b.guard);
    run(&b, 3);
    say(&b, FRAME_ENGAGE, 3, engage_all, 6);
    CHECK(guard_live(&b.guard));
    bridge_millisecond(&b, true);
    CHECK(b.guard.reason == REASON_STOP_BUTTON && !guard_live(&b.guard));
    say(&b, FRAME_OFF, 4, 0, 0);
    say(&b, FRAME_ENGAGE, 5, engage_all, 6);
    CHECK(b.answer[9] == REFUSED_STOP_BUTTON);
}

static uint8_t engaging(struct bridge *b)
{
    CHECK(say(b, FRAME_ENGAGE, 7, engage_all, 6) == 12);
    return b->answer[9];
}

/* Nobody is engaged while a coil is too warm, or while nobody knows how warm it is. */
static void test_temperatures(void)
{
    static struct bridge b;

    for (uint8_t line = 0; line < THERMOMETERS; line++) {
        fresh(&b);
        bridge_temperature(&b, line, HOT_SIXTEENTHS + 1);
        CHECK(engaging(&b) == REFUSED_HOT && b.guard.state == STATE_OFF);
        bridge_temperature(&b, line, 1502); /* 93.9 degC */
        CHECK(engaging(&b) == REFUSED_HOT && b.guard.state == STATE_OFF);
        bridge_temperature(&b, line, HOT_SIXTEENTHS);
        CHECK(engaging(&b) == ACCEPTED && guard_live(&b.guard));

        fresh(&b);
        bridge_thermometer_missing(&b, line);
        CHECK(engaging(&b) == REFUSED_THERMOMETER && b.guard.state == STATE_OFF);
        bridge_temperature(&b, (uint8_t)((line + 1) % THERMOMETERS), HOT_SIXTEENTHS + 1);
        CHECK(engaging(&b) == REFUSED_HOT); /* the worse of both */

        fresh(&b);
        for (int ms = 0; ms < THERMOMETER_STALE_MS; ms++)
            bridge_millisecond(&b, false);
        for (uint8_t other = 0; other < THERMOMETERS; other++)
            if (other != line)
                bridge_temperature(&b, other, 400);
        CHECK(b.temperature_age[line] == THERMOMETER_STALE_MS && engaging(&b) == ACCEPTED);
        guard_off(&b.guard);
        run(&b, 3);
        bridge_millisecond(&b, false);
        CHECK(engaging(&b) == REFUSED_THERMOMETER);
        for (uint32_t ms = 0; ms < 70000; ms++)
            bridge_millisecond(&b, false);
        CHECK(b.temperature_age[line] == 0xFFFF && engaging(&b) == REFUSED_THERMOMETER); /* never young again */
        for (uint8_t other = 0; other < THERMOMETERS; other++)
            bridge_temperature(&b, other, 400);
        CHECK(engaging(&b) == ACCEPTED);
    }
}

static uint8_t cells[CALIBRATION_BYTES];
static int writes_left; /* then the supply fails, in the middle of a byte */
static bool worn;

static uint8_t cell_read(uint8_t at)
{
    CHECK(at < CALIBRATION_BYTES);
    return cells[at];
}

static void cell_write(uint8_t at, uint8_t byte)
{
    CHECK(at < CALIBRATION_BYTES);
    if (writes_left > 0)
        cells[at] = worn && at == 5 ? 0xFF : byte;
    else if (writes_left == 0)
        cells[at] = (uint8_t)rand(); /* torn: nobody knows */
    writes_left--;
}

static const struct eeprom chip = {cell_read, cell_write};

static void name(uint8_t *id, int number)
{
    for (int i = 0; i < CALIBRATION_ID; i++)
        id[i] = (uint8_t)(number * 31 + i * 7 + 1);
}

/* Whatever moment the supply fails at: the id is the old one or the new one, and the new one once it was called kept. */
static void test_calibration(void)
{
    static const uint8_t none[CALIBRATION_ID];
    uint8_t id[CALIBRATION_ID], before[CALIBRATION_ID];
    struct calibration c;
    int kept = 0, lost = 0, refused = 0;

    memset(cells, 0xFF, sizeof cells); /* as the chip comes */
    worn = false;
    calibration_load(&c, &chip);
    CHECK(memcmp(c.id, none, sizeof none) == 0);
    CHECK(calibration_wish(&c, none) == ACCEPTED);
    srand(7);
    for (int number = 0; number < 30000; number++) {
        bool called_kept = false;
        memcpy(before, c.id, sizeof before);
        name(id, number);
        writes_left = rand() % 30; /* of 21 */
        for (int step = 0; writes_left >= 0 && !called_kept && step < 60; step++) {
            const uint8_t said = calibration_wish(&c, id);
            CHECK(said == ACCEPTED || said == REFUSED_WRITING);
            called_kept = said == ACCEPTED;
            CHECK(!called_kept || memcmp(c.id, id, sizeof id) == 0);
            calibration_step(&c, &chip);
        }
        calibration_load(&c, &chip); /* the supply is back */
        const bool new = memcmp(c.id, id, sizeof id) == 0, old = memcmp(c.id, before, sizeof before) == 0;
        CHECK(new || old);
        CHECK(!called_kept || new);
        kept += called_kept;
        lost += !new;
    }
    CHECK(kept > 1000 && lost > 1000);
    writes_left = 1000000;
    worn = true; /* both places, one after the other */
    for (int number = 0; number < 4; number++) {
        uint8_t said = REFUSED_WRITING;
        name(id, 40000 + number);
        memcpy(before, c.id, sizeof before);
        for (int step = 0; said == REFUSED_WRITING && step < 60; step++) {
            said = calibration_wish(&c, id);
            calibration_step(&c, &chip);
        }
        refused += said == REFUSED_EEPROM;
        CHECK(said == ACCEPTED || (said == REFUSED_EEPROM && memcmp(c.id, before, sizeof before) == 0));
        calibration_load(&c, &chip);
        CHECK(memcmp(c.id, said == ACCEPTED ? id : before, sizeof id) == 0);
    }
    CHECK(refused >= 2);
}

/* STORE is accepted once it is kept; no current flows meanwhile. */
static void test_store(void)
{
    static struct bridge b;
    uint8_t id[CALIBRATION_ID];

    fresh(&b);
    memset(cells, 0xFF, sizeof cells);
    worn = false;
    writes_left = 1000000;
    calibration_load(&b.calibration, &chip);
    name(id, 3);
    CHECK(say(&b, FRAME_STORE, 1, id, CALIBRATION_ID) == 12 && b.answer[9] == REFUSED_WRITING);
    CHECK(engaging(&b) == REFUSED_WRITING && !guard_live(&b.guard));
    say(&b, FRAME_IDENTIFY, 2, 0, 0);
    CHECK(b.answer[5 + 17] == 0); /* not before it is kept */
    for (int step = 0; step < 30; step++)
        calibration_step(&b.calibration, &chip);
    CHECK(say(&b, FRAME_STORE, 3, id, CALIBRATION_ID) == 12 && b.answer[9] == ACCEPTED);
    say(&b, FRAME_IDENTIFY, 4, 0, 0);
    CHECK(memcmp(b.answer + 5 + 17, id, sizeof id) == 0);
    CHECK(engaging(&b) == ACCEPTED);
    name(id, 4);
    CHECK(say(&b, FRAME_STORE, 5, id, CALIBRATION_ID) == 12 && b.answer[9] == REFUSED_ENGAGED);
}

static void test_thermometers(void)
{
    struct thermometers t;
    uint8_t pad[9] = {0x91, 0x01, 0x4B, 0x46, 0x7F, 0xFF, 0x0C, 0x10, 0};
    uint8_t line, sum = 0;
    int16_t value = 0;
    int reads = 0, missing = 0, bits = 0;

    for (int i = 0; i < 8; i++)
        sum = crc8(sum, pad[i]);
    pad[8] = sum;
    thermometers_start(&t);
    for (int ms = 0; ms < 3000; ms++) {
        const enum slot slot = thermometers_next(&t);
        if (slot == SLOT_NONE)
            continue;
        bool bit = slot == SLOT_RESET && t.line != 1; /* the second line is empty */
        if (slot == SLOT_RESET)
            bits = 0;
        if (slot == SLOT_READ) {
            bit = pad[bits / 8] >> bits % 8 & 1;
            bits++;
        }
        switch (thermometers_done(&t, bit, &line, &value)) {
        case THERMOMETER_READ: reads++; CHECK(line != 1 && value == 0x191); break;
        case THERMOMETER_MISSING: missing++; CHECK(line == 1); break;
        default: break;
        }
    }
    CHECK(reads >= 4 && missing >= 4);
}

int main(int argc, char **argv)
{
    test_checks();
    test_vectors(argc > 1 ? argv[1] : "vectors/frames.txt");
    test_guard();
    test_heat();
    test_bus();
    test_hall_groups();
    test_frames_in_pieces();
    test_stop_button();
    test_thermometers();
    test_temperatures();
    test_calibration();
    test_store();
    printf("%d checks, %d failures\n", checks, failures);
    return failures != 0;
}
