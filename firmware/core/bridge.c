#include "bridge.h"

static uint8_t *put16(uint8_t *out, uint16_t value)
{
    out[0] = (uint8_t)value;
    out[1] = (uint8_t)(value >> 8);
    return out + 2;
}

static uint16_t get16(const uint8_t *in)
{
    return (uint16_t)((uint16_t)in[1] << 8 | in[0]);
}

void bridge_boot(struct bridge *bridge, uint8_t board, uint8_t reset_cause)
{
    guard_boot(&bridge->guard, reset_cause);
    plan_start(&bridge->plan);
    frame_reset(&bridge->parser);
    bridge->frame_age = 0;
    bridge->board = board;
    bridge->reset_cause = reset_cause;
    bridge->stop_button = true; /* pressed until it is known not to be */
    for (uint8_t i = 0; i < THERMOMETERS; i++) {
        bridge->plan.readings.temperature[i] = NO_TEMPERATURE;
        bridge->temperature_age[i] = 0xFFFF;
    }
}

void bridge_millisecond(struct bridge *bridge, bool stop_button)
{
    guard_millisecond(&bridge->guard);
    plan_millisecond(&bridge->plan);
    bridge->stop_button = stop_button;
    for (uint8_t i = 0; i < THERMOMETERS; i++)
        if (bridge->temperature_age[i] < 0xFFFF)
            bridge->temperature_age[i]++;
    if (stop_button)
        guard_trip(&bridge->guard, REASON_STOP_BUTTON);
    if (bridge->parser.place == 0)
        bridge->frame_age = 0;
    else if (++bridge->frame_age > FRAME_MS) {
        frame_reset(&bridge->parser); /* the rest of it never came */
        bridge->frame_age = 0;
    }
}

void bridge_temperature(struct bridge *bridge, uint8_t line, int16_t sixteenths)
{
    bridge->plan.readings.temperature[line] = sixteenths;
    bridge->temperature_age[line] = 0;
    bridge->plan.missing &= (uint16_t)~MISSING_THERMOMETER(line);
    guard_temperature(&bridge->guard, sixteenths);
}

void bridge_thermometer_missing(struct bridge *bridge, uint8_t line)
{
    bridge->plan.readings.temperature[line] = NO_TEMPERATURE;
    bridge->plan.missing |= (uint16_t)MISSING_THERMOMETER(line);
}

static uint8_t identity(struct bridge *bridge, uint8_t *out)
{
    uint8_t *p = out;

    *p++ = PROTOCOL_VERSION;
    *p++ = FIRMWARE_MAJOR;
    *p++ = FIRMWARE_MINOR;
    *p++ = bridge->board;
    *p++ = CHANNELS;
    *p++ = HALL_SENSORS;
    *p++ = HALL_AXES;
    *p++ = THERMOMETERS;
    *p++ = bridge->reset_cause;
    for (uint8_t i = 0; i < 8; i++)
        *p++ = (uint8_t) "haptorb"[i]; /* with its final zero */
    for (uint8_t i = 0; i < CALIBRATION_ID; i++)
        *p++ = bridge->calibration.id[i];
    return (uint8_t)(p - out);
}

static uint8_t limits(const struct bridge *bridge, uint8_t *out)
{
    uint8_t *p = out;

    p = put16(p, HARD_DUTY);
    p = put16(p, HARD_CURRENT_MA);
    p = put16(p, bridge->guard.duty_limit);
    p = put16(p, bridge->guard.current_limit);
    p = put16(p, SILENCE_MS);
    p = put16(p, SUSTAINED_DECIAMPERE * 100);
    p = put16(p, HEAT_LIMIT_A2S);
    p = put16(p, HOT_SIXTEENTHS);
    p = put16(p, DUTY_FULL);
    p = put16(p, 1000); /* microampere per unit of a current reading */
    return (uint8_t)(p - out);
}

static uint8_t state(const struct bridge *bridge, uint8_t refusal, uint8_t *out)
{
    out[0] = bridge->guard.state;
    out[1] = bridge->guard.reason;
    put16(out + 2, bridge->plan.missing);
    out[4] = refusal;
    return 5;
}

static uint16_t microseconds(uint16_t units)
{
    return units > 0xFFFF / CLOCK_MICROSECONDS ? 0xFFFF : units * CLOCK_MICROSECONDS;
}

static uint8_t reading(struct bridge *bridge, uint8_t *out, uint16_t now)
{
    struct readings *r = &bridge->plan.readings;
    const uint16_t age = (uint16_t)(now - r->current_time);
    bool news;
    const uint8_t group = plan_hall_told(&bridge->plan, &news);
    const uint16_t hall_age = (uint16_t)(now - r->hall_time[group]);
    const uint8_t first = group % HALL_BLOCKS == 0 ? 0 : HALL_BLOCK_MAX;
    uint8_t *p = out;

    *p++ = bridge->guard.state;
    *p++ = bridge->guard.reason;
    p = put16(p, bridge->plan.missing);
    for (uint8_t i = 0; i < CHANNELS; i++)
        p = put16(p, guard_live(&bridge->guard) ? (uint16_t)bridge->guard.duties[i] : 0);
    for (uint8_t i = 0; i < CHANNELS; i++)
        p = put16(p, (uint16_t)r->told[i]);
    *p++ = news ? group : group | HALL_TOLD;
    for (uint8_t i = 0; i < HALL_BLOCK_MAX; i++)
        p = put16(p, first + i < HALL_SENSORS ? r->hall[group / HALL_BLOCKS][first + i] : 0xFFFF);
    if (++r->thermometer >= THERMOMETERS)
        r->thermometer = 0;
    *p++ = r->thermometer;
    p = put16(p, (uint16_t)r->temperature[r->thermometer]);
    p = put16(p, microseconds(age));
    p = put16(p, microseconds(hall_age));
    *p++ = bridge->guard.line_errors;
    *p++ = r->rounds;
    return (uint8_t)(p - out);
}

/* Coils whose heat nobody knows get no current: what made them hot may have been before the last restart. */
static uint8_t temperatures(const struct bridge *bridge)
{
    uint8_t found = ACCEPTED;

    for (uint8_t i = 0; i < THERMOMETERS; i++) {
        const int16_t sixteenths = bridge->plan.readings.temperature[i];
        if (sixteenths == NO_TEMPERATURE || bridge->temperature_age[i] > THERMOMETER_STALE_MS)
            found = REFUSED_THERMOMETER;
        else if (sixteenths > HOT_SIXTEENTHS)
            return REFUSED_HOT;
    }
    return found;
}

static uint8_t engage(struct bridge *bridge, const uint8_t *payload)
{
    if (bridge->stop_button)
        return REFUSED_STOP_BUTTON;
    if (!plan_ready(&bridge->plan))
        return REFUSED_CHIP;
    if (bridge->calibration.state == CALIBRATION_WRITING)
        return REFUSED_WRITING;
    const uint8_t refused = temperatures(bridge);
    if (refused != ACCEPTED)
        return refused;
    return guard_engage(&bridge->guard, get16(payload), get16(payload + 2), get16(payload + 4));
}

static uint8_t store(struct bridge *bridge, const uint8_t *payload)
{
    if (guard_live(&bridge->guard))
        return REFUSED_ENGAGED;
    return calibration_wish(&bridge->calibration, payload);
}

static uint8_t answer(struct bridge *bridge, uint16_t now)
{
    const struct frame *frame = &bridge->parser.frame;
    const uint8_t *in = frame->payload;
    uint8_t *out = bridge->answer + FRAME_HEAD;
    uint8_t type = frame->type | FRAME_ANSWER;
    uint8_t length;

    if (frame->type == FRAME_IDENTIFY && frame->length == 0) {
        length = identity(bridge, out);
    } else if (frame->type == FRAME_LIMITS && frame->length == 0) {
        length = limits(bridge, out);
    } else if (frame->type == FRAME_SET && frame->length == 2 * CHANNELS) {
        int16_t duties[CHANNELS];
        for (uint8_t i = 0; i < CHANNELS; i++)
            duties[i] = (int16_t)get16(in + 2 * i);
        guard_set(&bridge->guard, frame->sequence, duties);
        length = reading(bridge, out, now);
    } else if (frame->type == FRAME_READ && frame->length == 0) {
        type = FRAME_READING;
        length = reading(bridge, out, now);
    } else if (frame->type == FRAME_ENGAGE && frame->length == 6) {
        length = state(bridge, engage(bridge, in), out);
    } else if (frame->type == FRAME_OFF && frame->length == 0) {
        guard_off(&bridge->guard);
        type = FRAME_STATE;
        length = state(bridge, ACCEPTED, out);
    } else if (frame->type == FRAME_STORE && frame->length == CALIBRATION_ID) {
        type = FRAME_STATE;
        length = state(bridge, store(bridge, in), out);
    } else {
        type = FRAME_STATE;
        length = state(bridge, REFUSED_FRAME, out);
    }
    return frame_head(bridge->answer, type, frame->sequence, length);
}

uint8_t bridge_byte(struct bridge *bridge, uint8_t byte, uint16_t now)
{
    switch (frame_byte(&bridge->parser, byte)) {
    case FRAME_COMPLETE:
        return answer(bridge, now);
    case FRAME_DAMAGED:
        guard_line_error(&bridge->guard);
        return 0;
    default:
        return 0;
    }
}
