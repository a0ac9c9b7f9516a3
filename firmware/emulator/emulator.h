/* A microcontroller with everything that is soldered to it, in one process, at the pace of real time.
 *
 * The processor is libsimavr's (GPL-3: this program is therefore a separate test program and no part of the Python
 * package). Its UART and I2C are replaced by models of their own here, because libsimavr's take 11 bits a byte and
 * 1 us a clock whatever the registers say, and the question is what really fits into a millisecond.
 */
#ifndef EMULATOR_H
#define EMULATOR_H

#include <stdbool.h>
#include <stdint.h>

#include <sim_avr.h>

#define CHANNELS 3
#define HALL_SENSORS 9
#define HALL_AXES 3
#define CLOCK_HZ 16000000.0

/* The world outside the chips; physics.c moves it, the chips look at it. */
struct world {
    double duty[CHANNELS];        /* -1..1, mean over a PWM period, 0 while OE is high */
    double current[CHANNELS];     /* [A] */
    double hall[HALL_AXES][HALL_SENSORS]; /* inputs of the multiplexers, 0..1 of the reference */
    double temperature[CHANNELS]; /* coil boundary [degC] */
    double resistance[CHANNELS];  /* [ohm] */
    double inductance;            /* [H] */
    double supply;                /* [V] */
};
extern struct world world;

/* main.c */
int multiplexed_axis(void); /* which of the Hall sensors' axes the multiplexers pass on */

/* chips.c: what hangs on the bus */
struct chip {
    const char *name;
    uint8_t address;
    bool present;
    void (*start)(struct chip *, bool read);
    bool (*write)(struct chip *, uint8_t byte); /* returns the acknowledge */
    uint8_t (*read)(struct chip *);
    void (*stop)(struct chip *);
    int channel;
};
struct chip *chips_find(uint8_t address);
struct chip *chips_named(const char *name);
void chips_power_on(void);
void chips_step(double seconds);                 /* conversions of the current sensors */
double pca9685_duty(int channel, bool oe_low);   /* signed, from PWM and direction outputs */

/* twi_model.c */
void twi_model_attach(avr_t *avr, uint8_t vector);
void twi_model_reset(void);
extern bool twi_stuck;             /* somebody holds the bus low */
extern uint64_t twi_busy_cycles, twi_bytes;

/* uart_model.c */
void uart_model_attach(avr_t *avr, uint8_t rx_vector, uint8_t udre_vector);
void uart_model_reset(void);
bool uart_model_open(const char *link); /* a new pty, and a symbolic link to it */
void uart_model_close(void);            /* as if the cable had been pulled */
void uart_model_poll(void);             /* carries bytes between pty and line */
void uart_model_inject(const uint8_t *bytes, int count);
void uart_model_turns(double *median, double *p99, uint32_t *count); /* [us], since the last call */
extern bool uart_noise;                 /* the line carries random bytes */
extern uint64_t uart_received, uart_sent, uart_overruns, uart_last_byte; /* the last: cycle */

/* onewire_model.c */
void onewire_model_attach(avr_t *avr, const char ports[CHANNELS], const int bits[CHANNELS]);
void onewire_model_reset(void);
extern bool onewire_present[CHANNELS];

/* physics.c */
bool physics_connect(const char *socket_path, bool lockstep);
void physics_step(double t, double seconds);
extern uint64_t physics_late;

#endif
