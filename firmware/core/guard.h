/* Whether the coils may have current, and how much: the one place that decides.
 *
 *            ENGAGE (key, limits)                 silence, damaged line, over-current, heat,
 *    OFF ───────────────────────────► ENGAGED ──  missing chip, stuck bus, stop button  ──► TRIPPED
 *     ▲                                  │                                                    │
 *     └────────────── OFF ───────────────┴──────────────────── OFF ───────────────────────────┘
 *
 * After any reset the state is OFF. A trip stays until the host says OFF, and then ENGAGE: both on purpose.
 * guard_tick runs in an interrupt, everything else in the main loop; what they share is one byte wide.
 */
#ifndef HAPTORB_GUARD_H
#define HAPTORB_GUARD_H

#include "config.h"

#define ENGAGE_KEY 0x5AFE

enum guard_state { STATE_OFF = 0, STATE_ENGAGED = 1, STATE_TRIPPED = 2 };

enum guard_reason {
    REASON_NONE = 0,
    REASON_SILENCE = 1,      /* no fresh SET for SILENCE_MS */
    REASON_LINE = 2,         /* storm of damaged frames */
    REASON_OVER_CURRENT = 3,
    REASON_HEAT = 4,         /* I2t of a coil used up */
    REASON_HOT = 5,          /* a thermometer above its limit */
    REASON_CHIP = 6,         /* PWM or current sensor does not answer, or forgot its settings */
    REASON_BUS = 7,          /* I2C held low */
    REASON_STOP_BUTTON = 8,
    REASON_HOST = 9,         /* the host said OFF */
    REASON_POWER_ON = 16,
    REASON_RESET_PIN = 17,
    REASON_BROWN_OUT = 18,
    REASON_WATCHDOG = 19     /* the main loop hung */
};

enum guard_refusal {
    ACCEPTED = 0,
    REFUSED_KEY = 1,
    REFUSED_TRIPPED = 2,     /* say OFF first */
    REFUSED_CHIP = 3,        /* a needed chip is missing */
    REFUSED_STOP_BUTTON = 4,
    REFUSED_ENGAGED = 5,     /* not while coils may have current */
    REFUSED_FRAME = 6,       /* unknown type or wrong length */
    REFUSED_HOT = 7,         /* a thermometer above its limit */
    REFUSED_THERMOMETER = 8, /* one that has said nothing yet, or not for THERMOMETER_STALE_MS */
    REFUSED_WRITING = 9,     /* the EEPROM is being written: ask again */
    REFUSED_EEPROM = 10      /* it did not keep what was written */
};

struct guard {
    volatile uint8_t state;
    volatile uint8_t reason;
    volatile uint8_t silence;     /* [ms] since the last fresh SET */
    uint8_t sequence;             /* of the last SET: a line that repeats itself is not a living host */
    bool fresh;                   /* no SET seen since ENGAGE */
    int16_t duties[CHANNELS];     /* what the coils may have, in 1/DUTY_FULL of the supply */
    uint16_t duty_limit;          /* of this session, never above HARD_DUTY */
    uint16_t current_limit;       /* [mA] of this session, never above HARD_CURRENT_MA */
    uint8_t over[CHANNELS];       /* readings above the limit in a row */
    uint16_t deciampere[CHANNELS];
    uint32_t heat[CHANNELS];      /* [0.01 A2 ms] above the continuous current */
    uint8_t storm;
    uint8_t leak;
    uint8_t line_errors;          /* since boot, wraps */
};

void guard_boot(struct guard *guard, uint8_t reason);

/* Every millisecond, from an interrupt: the one thing that works when everything else hangs. */
void guard_tick(struct guard *guard);

/* Every millisecond, from the main loop: heat, and forgetting of line errors. */
void guard_millisecond(struct guard *guard);

enum guard_refusal guard_engage(struct guard *guard, uint16_t key, uint16_t duty_limit, uint16_t current_limit);
void guard_off(struct guard *guard);
void guard_trip(struct guard *guard, uint8_t reason);

/* Takes duties, clipped to the limit, if engaged; the same sequence twice does not count as life. */
void guard_set(struct guard *guard, uint8_t sequence, const int16_t *duties);

void guard_line_error(struct guard *guard);
void guard_current(struct guard *guard, uint8_t channel, int16_t milliampere);
void guard_temperature(struct guard *guard, int16_t sixteenths);

static inline bool guard_live(const struct guard *guard)
{
    return guard->state == STATE_ENGAGED;
}

#endif
