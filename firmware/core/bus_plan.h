/* Which I2C transfer comes next, and what the answer means.
 *
 * Set-up of every chip first; then in a loop: new duties if there are any, the three currents, one group of Hall
 * readings: one axis of the sensors of one block. The clock of the bus sets the pace: at 400 kHz a round takes 0.9 ms.
 *
 * Wiring (docs/reference/hardware.md): PCA9685 outputs 0-2 are the drivers' PWM inputs, 3-5 their direction inputs.
 */
#ifndef HAPTORB_BUS_PLAN_H
#define HAPTORB_BUS_PLAN_H

#include "guard.h"

#define PCA9685_ADDRESS 0x60
#define INA219_ADDRESS_X 0x41
#define INA219_ADDRESS_Y 0x44
#define INA219_ADDRESS_Z 0x45
#define HALL_ADC_ADDRESS 0x35

#define NO_TEMPERATURE 0x7FFF

#define WRITE_MAX 24
#define READ_MAX 10

/* bits of `missing` */
#define MISSING_PWM 0x0001
#define MISSING_CURRENT(channel) (0x0002 << (channel))
#define MISSING_HALL 0x0010
#define MISSING_THERMOMETER(i) (0x0020 << (i))
#define MISSING_NEEDED 0x000F /* without these no current may flow */

struct transfer {
    uint8_t address;
    uint8_t write_length;
    uint8_t read_length;
    uint8_t job;
    uint8_t channel;
    bool failed; /* set by the board: somebody did not acknowledge */
    uint8_t write[WRITE_MAX];
    uint8_t read[READ_MAX];
};

struct readings {
    int16_t current[CHANNELS];     /* [mA] */
    int16_t told[CHANNELS];        /* the three that were read just before the Hall group that was read last [mA] */
    uint16_t current_time;         /* when the first of these was read, in board clock units */
    uint16_t hall[HALL_AXES][HALL_SENSORS]; /* ADC codes, 0xFFFF before the first reading */
    uint16_t hall_time[HALL_GROUPS]; /* when each was read, in board clock units */
    uint8_t hall_untold;           /* bit per group: read since it was told to the host last */
    uint8_t hall_group;            /* read last */
    uint8_t hall_waited[HALL_GROUPS]; /* answers since each was told */
    int16_t temperature[THERMOMETERS]; /* [1/16 degC], NO_TEMPERATURE before the first reading */
    uint8_t thermometer;           /* told last */
    uint8_t rounds;                /* of the bus, wraps */
};

struct bus_plan {
    uint8_t setup;                 /* next step of the set-up, SETUP_DONE after it */
    bool asking;                   /* a step of the set-up is under way */
    uint8_t step;                  /* within a round */
    uint8_t check;                 /* chip whose settings are compared next */
    uint8_t check_wait;
    uint8_t repoint;               /* bit per current sensor whose register pointer was moved by a check */
    uint8_t fails[5];              /* in a row, per chip */
    uint16_t pause;                /* [ms] before the set-up is tried (again) */
    uint16_t missing;
    int16_t written[CHANNELS];     /* duties that the PWM chip has */
    uint8_t signs;                 /* direction outputs as the chip has them, bit set for negative */
    bool rewrite;                  /* everything must be written, whatever is believed to be there */
    bool quiet;                    /* the PWM chip has acknowledged zero duties */
    bool scanning;                 /* a Hall scan is on its way: the multiplexers must not move */
    uint16_t round_time;
    struct readings readings;
};

void plan_start(struct bus_plan *plan);
void plan_millisecond(struct bus_plan *plan);

/* The next transfer, or false if there is none now. */
bool plan_next(struct bus_plan *plan, const struct guard *guard, struct transfer *transfer);

/* What came of it; a few transfers may be planned ahead of their answers. `now` in board clock units. */
void plan_done(struct bus_plan *plan, struct guard *guard, const struct transfer *transfer, uint16_t now);

/* The axis that the multiplexers must show from now on; the transfer that is planned next may need it. */
uint8_t plan_hall_axis(const struct transfer *transfer, uint8_t before);

/* The group to tell the host now, counted as told from here on; without news it has been told before. */
uint8_t plan_hall_told(struct bus_plan *plan, bool *news);

/* The PWM chip and the current sensors have all answered, and all duties on the chip are zero. */
bool plan_ready(const struct bus_plan *plan);

#endif
