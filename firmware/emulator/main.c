/* The emulator: emulator FIRMWARE.elf --mcu atmega328p --link /tmp/omni [--physics SOCKET] [--lockstep] [--pace 0..1] [--free]
 *
 * Commands come on standard input, one a line; what it has to say begins with @ (the library talks too).
 *   status            one line of counters and state
 *   mark              the time from which the next @off is also measured
 *   reset | brownout  pull the reset pin; sag the supply
 *   hang              the main loop stops permanently: only interrupts and the watchdog are left
 *   pull | plug       close the pty, as if the cable were pulled; bring it back
 *   noise 0|1         the line carries random bytes instead of the host's
 *   absent CHIP | present CHIP      pca9685 ina219-x ina219-y ina219-z max11616 ds18b20-x -y -z
 *   forget            power-cycle the chips without resetting the processor
 *   stuck | free      somebody holds SDA low; lets go
 *   button 0|1        stop button pressed or not
 *   resistance I R    coil I gets R ohm: a short
 *   heat I T          thermometer I at T degC (only without --physics)
 *   pace P            firmware time from here on runs at P of ours, 0 < P <= 1
 *   skip S            the next S seconds of firmware time pass as fast as this computer can
 *   quit
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <getopt.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include <avr_eeprom.h>
#include <avr_extint.h>
#include <avr_ioport.h>
#include <sim_elf.h>
#include <sim_io.h>

#include "emulator.h"

#define STEP 100e-6 /* of the physics, and of the pace */
#define MCUSR 0x54
#define EECR 0x3F
#define EEAR 0x41
#define EEPE 0x02
#define EEMPE 0x04
#define EEPROM_US 3400
#define AT_MOST_BEHIND 1e-3 /* [s] that may be caught up with */

static const struct board {
    const char *mcu;
    uint8_t rx, udre, twi;
    uint16_t oe_ddr, oe_port;
    int oe_bit;
    char stop_port;
    int stop_bit;
    char onewire_ports[CHANNELS];
    int onewire_bits[CHANNELS];
    uint16_t axis_ddr, axis_port;
    int axis_shift;
} boards[] = {
    {"atmega328p", 18, 19, 24, 0x2A, 0x2B, 4, 'D', 2, {'D', 'D', 'D'}, {5, 6, 7}, 0x24, 0x25, 0},
    {"atmega2560", 25, 26, 39, 0x33, 0x34, 5, 'E', 4, {'E', 'H', 'H'}, {3, 3, 4}, 0x101, 0x102, 5},
};

static avr_t *avr;
static const struct board *board;
static const char *link_path = "/tmp/haptorb-omni";
static bool on, quit;
static double pace = 1; /* below 1: firmware time runs slower than ours, for computers that are busy */
static double epoch;    /* our time at which firmware time was zero, had it always run at this pace */
static double skip;     /* firmware time until which it runs as fast as it can */
static double mark = -1;
static uint8_t reset_flags = 0x01; /* power-on */
static int resets, torn; /* the latter: bytes of the EEPROM */

static uint16_t hung_code;
static uint32_t hung_at;
static bool hung;

static double now(void)
{
    return (double)avr->cycle / CLOCK_HZ;
}

static double wall(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void quiet(avr_t *a, const int level, const char *format, va_list ap)
{
    if (level <= LOG_ERROR)
        vfprintf(stderr, format, ap);
}

static void button(bool pressed)
{
    avr_ioport_external_t external = {.name = board->stop_port, .mask = 1 << board->stop_bit,
                                      .value = pressed ? 1 << board->stop_bit : 0};
    avr_ioctl(avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(board->stop_port), &external);
    avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(board->stop_port), board->stop_bit), pressed);
}

static bool pressed;

static void on_reset(avr_io_t *io)
{
    twi_model_reset();
    uart_model_reset();
    onewire_model_reset();
    /* No pin interrupts here; the library would look at a low pin, such as the stop button's, in every cycle. */
    for (uint8_t i = 0; i < EXTINT_COUNT; i++)
        if (avr_extint_is_strict_lvl_trig(avr, i) > 0)
            avr_extint_set_strict_lvl_trig(avr, i, 0);
    button(pressed);
    if (hung) {
        memcpy(avr->flash + hung_at, &hung_code, 2);
        hung = false;
        reset_flags = 0x08; /* only the watchdog gets here */
    }
    avr->data[MCUSR] = reset_flags;
    reset_flags = 0x08;
    resets++;
}

static avr_io_t reset_listener = {.kind = "emulator", .reset = on_reset};

static avr_cycle_count_t eeprom_done(avr_t *a, avr_cycle_count_t when, void *param)
{
    avr->data[EECR] &= (uint8_t)~EEPE;
    return 0;
}

/* Called after the library's own, which has the byte written in no time. */
static void eeprom_begun(avr_t *a, avr_io_addr_t addr, uint8_t value, void *param)
{
    if ((value & EEMPE) && (value & EEPE)) {
        avr->data[EECR] |= EEPE;
        avr_cycle_timer_register_usec(avr, EEPROM_US, eeprom_done, 0);
    }
}

/* As if the supply had failed with the reset: the byte that was being written has some of its bits only. */
static void tear_eeprom(void)
{
    const uint16_t at = (uint16_t)(avr->data[EEAR + 1] << 8 | avr->data[EEAR]);
    avr_eeprom_desc_t place = {.ee = 0, .offset = at, .size = 1}; /* asked for its address */

    avr_ioctl(avr, AVR_IOCTL_EEPROM_GET, &place);
    if (!(avr->data[EECR] & EEPE) || !place.ee)
        return;
    *place.ee ^= (uint8_t)(rand() % 255 + 1);
    torn++;
}

static void reset(uint8_t flags)
{
    tear_eeprom();
    reset_flags = flags;
    avr_reset(avr);
}

static bool oe_low(void)
{
    const uint8_t bit = (uint8_t)(1 << board->oe_bit);
    return (avr->data[board->oe_ddr] & bit) && !(avr->data[board->oe_port] & bit); /* else the pull-up holds it */
}

/* Looked at with every byte that the converter gives: the multiplexers have no memory. */
int multiplexed_axis(void)
{
    return (avr->data[board->axis_ddr] & avr->data[board->axis_port]) >> board->axis_shift & 3;
}

static void step(void)
{
    static double last;
    const double t = now();
    bool any = false;

    for (int i = 0; i < CHANNELS; i++) {
        world.duty[i] = pca9685_duty(i, oe_low());
        any |= world.duty[i] != 0;
    }
    physics_step(t, t - last);
    chips_step(t - last);
    last = t;
    if (any && !on)
        printf("@on t=%.6f\n", t);
    if (!any && on) {
        printf("@off t=%.6f since_byte_ms=%.3f since_mark_ms=%.3f\n", t,
               1e3 * (t - (double)uart_last_byte / CLOCK_HZ), mark < 0 ? -1 : 1e3 * (t - mark));
        mark = -1;
    }
    if (any != on)
        fflush(stdout);
    on = any;
}

static void status(double behind)
{
    static uint64_t bus_before;
    static double t_before;
    const double t = now();
    double median, p99;
    uint32_t turns;

    uart_model_turns(&median, &p99, &turns);
    printf("@status t=%.6f on=%d duty=%.6f,%.6f,%.6f current=%.4f,%.4f,%.4f received=%llu sent=%llu overruns=%llu "
           "bus_bytes=%llu bus_load=%.3f resets=%d torn=%d behind_ms=%.2f physics_late=%llu turns=%u turn_us=%.1f turn_p99_us=%.1f\n",
           t, on, world.duty[0], world.duty[1], world.duty[2], world.current[0], world.current[1], world.current[2],
           (unsigned long long)uart_received, (unsigned long long)uart_sent, (unsigned long long)uart_overruns,
           (unsigned long long)twi_bytes, (double)(twi_busy_cycles - bus_before) / CLOCK_HZ / (t - t_before), resets, torn,
           1e3 * behind, (unsigned long long)physics_late, turns, median, p99);
    bus_before = twi_busy_cycles;
    t_before = t;
}

static void presence(const char *name, bool present)
{
    static const char *thermometers[CHANNELS] = {"ds18b20-x", "ds18b20-y", "ds18b20-z"};
    struct chip *chip = chips_named(name);

    if (chip)
        chip->present = present;
    for (int i = 0; i < CHANNELS; i++)
        if (strcmp(name, thermometers[i]) == 0)
            onewire_present[i] = present;
}

static void command(char *line, double behind)
{
    char word[32] = "", argument[32] = "";
    double number = 0;

    if (sscanf(line, "%31s %31s %lf", word, argument, &number) < 1)
        return;
    if (!strcmp(word, "status")) status(behind);
    else if (!strcmp(word, "mark")) mark = now();
    else if (!strcmp(word, "reset")) { mark = now(); reset(0x02); }
    else if (!strcmp(word, "brownout")) { mark = now(); reset(0x04); }
    else if (!strcmp(word, "hang")) {
        const uint16_t here = 0xCFFF; /* rjmp to itself */
        mark = now();
        if (!hung) {
            hung_at = avr->pc;
            memcpy(&hung_code, avr->flash + hung_at, 2);
            memcpy(avr->flash + hung_at, &here, 2);
            hung = true;
        }
    }
    else if (!strcmp(word, "pull")) { mark = now(); uart_model_close(); }
    else if (!strcmp(word, "plug")) { if (!uart_model_open(link_path)) perror("pty"); }
    else if (!strcmp(word, "absent")) { mark = now(); presence(argument, false); }
    else if (!strcmp(word, "present")) presence(argument, true);
    else if (!strcmp(word, "forget")) { mark = now(); chips_power_on(); }
    else if (!strcmp(word, "stuck")) { mark = now(); twi_stuck = true; }
    else if (!strcmp(word, "free")) twi_stuck = false;
    else if (!strcmp(word, "button")) { mark = now(); pressed = argument[0] == '1'; button(pressed); }
    else if (!strcmp(word, "resistance")) { mark = now(); world.resistance[atoi(argument) % CHANNELS] = number; }
    else if (!strcmp(word, "heat")) { mark = now(); world.temperature[atoi(argument) % CHANNELS] = number; }
    else if (!strcmp(word, "noise")) { mark = now(); uart_noise = argument[0] == '1'; }
    else if (!strcmp(word, "pace")) {
        pace = atof(argument) > 0 && atof(argument) < 1 ? atof(argument) : 1;
        epoch = wall() - now() / pace;
    }
    else if (!strcmp(word, "skip")) skip = now() + atof(argument);
    else if (!strcmp(word, "quit")) quit = true;
    else { printf("@error unknown command %s\n", word); fflush(stdout); return; }
    printf("@done %s\n", word);
    fflush(stdout);
}

static void listen_to_commands(double behind)
{
    static char buffer[1024];
    static size_t count;
    struct pollfd in = {.fd = 0, .events = POLLIN};

    if (poll(&in, 1, 0) <= 0)
        return;
    const ssize_t n = read(0, buffer + count, sizeof buffer - 1 - count);
    if (n <= 0) {
        quit = true; /* whoever started this has gone */
        return;
    }
    count += (size_t)n;
    buffer[count] = 0;
    char *line = buffer, *end;
    while ((end = strchr(line, '\n'))) {
        *end = 0;
        command(line, behind);
        line = end + 1;
    }
    count = strlen(line);
    memmove(buffer, line, count);
    if (count == sizeof buffer - 1)
        count = 0;
}

static int usage(const char *why)
{
    fprintf(stderr, "%s\nusage: emulator FIRMWARE.elf --mcu atmega328p|atmega2560 --link PATH "
                    "[--physics SOCKET] [--lockstep] [--pace 0..1] [--free]\n", why);
    return 2;
}

static void no_nap(avr_t *a, avr_cycle_count_t cycles)
{
    /* the pace is kept below, not here */
}

int main(int argc, char **argv)
{
    static const struct option options[] = {{"mcu", 1, 0, 'm'}, {"link", 1, 0, 'l'}, {"physics", 1, 0, 'p'},
                                            {"lockstep", 0, 0, 's'}, {"pace", 1, 0, 'c'}, {"free", 0, 0, 'f'}, {0, 0, 0, 0}};
    const char *mcu = "atmega328p", *physics = 0;
    bool lockstep = false, free_running = false;
    elf_firmware_t firmware;

    for (int c; (c = getopt_long(argc, argv, "", options, 0)) != -1;) {
        if (c == 'm') mcu = optarg;
        else if (c == 'l') link_path = optarg;
        else if (c == 'p') physics = optarg;
        else if (c == 's') lockstep = true;
        else if (c == 'c') pace = atof(optarg);
        else if (c == 'f') free_running = true;
        else return usage("what is that?");
    }
    for (unsigned i = 0; i < sizeof boards / sizeof *boards; i++)
        if (strcmp(boards[i].mcu, mcu) == 0)
            board = &boards[i];
    if (pace <= 0 || pace > 1)
        return usage("the pace is above 0 and at most 1");
    if (!board || optind != argc - 1)
        return usage(board ? "which firmware?" : "which processor?");
    memset(&firmware, 0, sizeof firmware);
    signal(SIGPIPE, SIG_IGN);
    avr_global_logger_set(quiet);
    if (elf_read_firmware(argv[optind], &firmware) != 0)
        return usage("that is no firmware");
    avr = avr_make_mcu_by_name(mcu);
    avr_init(avr);
    firmware.frequency = (uint32_t)CLOCK_HZ;
    avr_load_firmware(avr, &firmware);
    avr->frequency = (uint32_t)CLOCK_HZ;
    avr->sleep = no_nap;

    world.supply = 12;
    world.inductance = 0.4e-3;
    for (int i = 0; i < CHANNELS; i++) {
        world.resistance[i] = 0.6;
        world.temperature[i] = 25;
    }
    for (int axis = 0; axis < HALL_AXES; axis++)
        for (int k = 0; k < HALL_SENSORS; k++)
            world.hall[axis][k] = 0.5;
    chips_power_on();
    uart_model_attach(avr, board->rx, board->udre);
    twi_model_attach(avr, board->twi);
    onewire_model_attach(avr, board->onewire_ports, board->onewire_bits);
    avr_register_io(avr, &reset_listener);
    avr_register_io_write(avr, EECR, eeprom_begun, 0);
    reset(0x01);
    if (!uart_model_open(link_path)) {
        perror("pty");
        return 1;
    }
    if (physics && !physics_connect(physics, lockstep)) {
        perror(physics);
        return 1;
    }
    printf("@ready %s\n", link_path);
    fflush(stdout);

    epoch = wall();
    double behind = 0;
    uint64_t target = avr->cycle, slices = 0;
    while (!quit) {
        target += (uint64_t)(STEP * CLOCK_HZ);
        while (avr->cycle < target) {
            const int state = avr_run(avr);
            if (state == cpu_Crashed || state == cpu_Done) {
                printf("@crashed pc=%x\n", avr->pc);
                return 1;
            }
        }
        step();
        uart_model_poll();
        if (++slices % 20 == 0)
            listen_to_commands(behind);
        if (free_running)
            continue;
        if (now() < skip) {
            epoch = wall() - now() / pace;
            continue;
        }
        behind = (wall() - epoch) * pace - now();
        if (behind > AT_MOST_BEHIND) { /* the computer was busy elsewhere: time that was lost stays lost. To race after it
                                        * would let 15 ms of firmware time pass in less of the host's. */
            epoch += (behind - AT_MOST_BEHIND) / pace;
        } else if (behind < 0) {
            struct timespec nap = {0, (long)(-behind / pace * 1e9)};
            nanosleep(&nap, 0);
        }
    }
    uart_model_close();
    return 0;
}
