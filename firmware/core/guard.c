#include "guard.h"

#define HEAT_LIMIT (HEAT_LIMIT_A2S * 100UL * 1000UL) /* A2s in units of (0.1 A)2 ms */

static void still(struct guard *guard)
{
    for (uint8_t i = 0; i < CHANNELS; i++)
        guard->duties[i] = 0;
}

void guard_boot(struct guard *guard, uint8_t reason)
{
    guard->state = STATE_OFF;
    guard->reason = reason;
    guard->silence = 0;
    guard->sequence = 0;
    guard->fresh = true;
    guard->duty_limit = 0;
    guard->current_limit = 0;
    guard->storm = 0;
    guard->leak = 0;
    guard->line_errors = 0;
    for (uint8_t i = 0; i < CHANNELS; i++) {
        guard->over[i] = 0;
        guard->deciampere[i] = 0;
        guard->heat[i] = 0;
    }
    still(guard);
}

void guard_tick(struct guard *guard)
{
    if (guard->state != STATE_ENGAGED)
        return;
    if (++guard->silence >= SILENCE_MS) {
        guard->reason = REASON_SILENCE;
        guard->state = STATE_TRIPPED;
    }
}

void guard_millisecond(struct guard *guard)
{
    if (++guard->leak >= STORM_LEAK_MS) {
        guard->leak = 0;
        if (guard->storm > 0)
            guard->storm--;
    }
    for (uint8_t i = 0; i < CHANNELS; i++) {
        const uint32_t square = (uint32_t)guard->deciampere[i] * guard->deciampere[i];
        const uint32_t sustained = (uint32_t)SUSTAINED_DECIAMPERE * SUSTAINED_DECIAMPERE;
        if (square >= sustained)
            guard->heat[i] += square - sustained;
        else if (guard->heat[i] > sustained - square)
            guard->heat[i] -= sustained - square;
        else
            guard->heat[i] = 0;
        if (guard->heat[i] > HEAT_LIMIT) {
            guard->heat[i] = HEAT_LIMIT; /* must not wrap around to cold */
            guard_trip(guard, REASON_HEAT);
        }
    }
}

enum guard_refusal guard_engage(struct guard *guard, uint16_t key, uint16_t duty_limit, uint16_t current_limit)
{
    if (key != ENGAGE_KEY)
        return REFUSED_KEY;
    if (guard->state == STATE_TRIPPED)
        return REFUSED_TRIPPED;
    if (guard->state == STATE_ENGAGED)
        return REFUSED_ENGAGED;
    still(guard);
    guard->duty_limit = duty_limit < HARD_DUTY ? duty_limit : HARD_DUTY;
    guard->current_limit = current_limit < HARD_CURRENT_MA ? current_limit : HARD_CURRENT_MA;
    for (uint8_t i = 0; i < CHANNELS; i++)
        guard->over[i] = 0;
    guard->storm = 0;
    guard->fresh = true;
    guard->reason = REASON_NONE;
    guard->silence = 0;
    guard->state = STATE_ENGAGED; /* last: from here on the interrupt watches */
    return ACCEPTED;
}

void guard_off(struct guard *guard)
{
    if (guard->state != STATE_OFF)
        guard->reason = REASON_HOST;
    guard->state = STATE_OFF;
    still(guard);
}

void guard_trip(struct guard *guard, uint8_t reason)
{
    if (guard->state == STATE_ENGAGED) { /* the first reason is the one worth knowing */
        guard->state = STATE_TRIPPED;
        guard->reason = reason;
    }
    still(guard);
}

void guard_set(struct guard *guard, uint8_t sequence, const int16_t *duties)
{
    const int16_t limit = (int16_t)guard->duty_limit;

    if (guard->state != STATE_ENGAGED) {
        still(guard);
        return;
    }
    if (!guard->fresh && sequence == guard->sequence)
        return;
    guard->fresh = false;
    guard->sequence = sequence;
    for (uint8_t i = 0; i < CHANNELS; i++)
        guard->duties[i] = duties[i] > limit ? limit : duties[i] < -limit ? (int16_t)-limit : duties[i];
    guard->silence = 0;
}

void guard_line_error(struct guard *guard)
{
    guard->line_errors++;
    if (guard->storm < 255)
        guard->storm++;
    if (guard->storm >= STORM_ERRORS)
        guard_trip(guard, REASON_LINE);
}

void guard_current(struct guard *guard, uint8_t channel, int16_t milliampere)
{
    /* −32768 has no positive twin in 16 bits */
    const uint16_t size = milliampere < 0 ? (uint16_t)(-(int32_t)milliampere) : (uint16_t)milliampere;

    guard->deciampere[channel] = size / 100;
    if (guard->state != STATE_ENGAGED || size <= guard->current_limit) {
        guard->over[channel] = 0;
        return;
    }
    if (++guard->over[channel] >= OVER_CURRENT_READINGS)
        guard_trip(guard, REASON_OVER_CURRENT);
}

void guard_temperature(struct guard *guard, int16_t sixteenths)
{
    if (sixteenths > HOT_SIXTEENTHS)
        guard_trip(guard, REASON_HOT);
}
