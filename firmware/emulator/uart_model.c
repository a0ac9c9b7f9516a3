/* USART0 with the timing of its registers, two bytes of receive buffer and an overrun flag, its other end on a pty. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <pty.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

#include <sim_cycle_timers.h>
#include <sim_interrupts.h>
#include <sim_io.h>

#include "emulator.h"

enum { UCSRA = 0xC0, UCSRB = 0xC1, UBRRL = 0xC4, UBRRH = 0xC5, UDR = 0xC6 };
enum { RXC = 0x80, TXC = 0x40, UDRE = 0x20, DOR = 0x08, U2X = 0x02 };
enum { RXCIE = 0x80, UDRIE = 0x20, RXEN = 0x10, TXEN = 0x08 };

uint64_t uart_received, uart_sent, uart_overruns, uart_last_byte;

bool uart_noise;

static avr_t *avr;
static avr_int_vector_t *rx_vector, *udre_vector;
static int master = -1, slave = -1;
static char link_path[256];

#define PACKET 62 /* bytes of an FT232's packet to the host, without its two of state */
#define LINE_SIZE 65536
static uint8_t line[LINE_SIZE]; /* bytes from the host that have not crossed the line yet */
static uint32_t line_in, line_out;
static bool line_running;
static uint8_t fifo[3]; /* two buffered and one in the shift register */
static int fifo_count;
static uint8_t shift, holding;
static bool shifting, held;
static uint8_t out[4096];
static int out_count;

static uint32_t byte_cycles(void)
{
    const uint32_t ubrr = avr->data[UBRRL] | (avr->data[UBRRH] & 0x0F) << 8;
    return (avr->data[UCSRA] & U2X ? 8 : 16) * (ubrr + 1) * 10;
}

/* From the first bit of what the host says to the last bit of what it hears: the time the wire and the firmware take,
 * free of this computer's own delays. */
#define TURNS 4096
static float turns[TURNS];
static uint32_t turn_count;
static uint64_t turn_began;

static int by_size(const void *a, const void *b)
{
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

void uart_model_turns(double *median, double *p99, uint32_t *count)
{
    static float sorted[TURNS];
    const uint32_t n = turn_count < TURNS ? turn_count : TURNS;

    memcpy(sorted, turns, n * sizeof *turns);
    qsort(sorted, n, sizeof *sorted, by_size);
    *median = n ? sorted[n / 2] : 0;
    *p99 = n ? sorted[n * 99 / 100] : 0;
    *count = turn_count;
    turn_count = 0;
}

static avr_cycle_count_t arrive(avr_t *a, avr_cycle_count_t when, void *param)
{
    if (line_in == line_out) { /* the cable was pulled while a byte was on its way */
        line_running = false;
        return 0;
    }
    const uint8_t byte = line[line_out++ % LINE_SIZE];

    uart_received++;
    uart_last_byte = avr->cycle;
    if (avr->data[UCSRB] & RXEN) {
        if (fifo_count == 3) {
            avr->data[UCSRA] |= DOR;
            uart_overruns++;
        } else {
            fifo[fifo_count++] = byte;
            avr->data[UCSRA] |= RXC;
            avr_raise_interrupt(avr, rx_vector);
        }
    }
    line_running = line_in != line_out;
    return line_running ? when + byte_cycles() : 0;
}

static void line_start(void)
{
    if (!line_running && line_in != line_out) {
        line_running = true;
        if (turn_began == 0)
            turn_began = avr->cycle;
        avr_cycle_timer_register(avr, byte_cycles(), arrive, 0);
    }
}

static avr_cycle_count_t departed(avr_t *a, avr_cycle_count_t when, void *param)
{
    uart_sent++;
    if (out_count < (int)sizeof out)
        out[out_count++] = shift;
    if (held) {
        shift = holding;
        held = false;
        avr->data[UCSRA] |= UDRE;
        avr_raise_interrupt(avr, udre_vector);
        return when + byte_cycles();
    }
    shifting = false;
    if (turn_began) {
        turns[turn_count++ % TURNS] = (float)((double)(avr->cycle - turn_began) / CLOCK_HZ * 1e6);
        turn_began = 0;
    }
    avr->data[UCSRA] |= TXC;
    return 0;
}

static uint8_t data_read(avr_t *a, avr_io_addr_t addr, void *param)
{
    uint8_t byte = 0;

    if (fifo_count > 0) {
        byte = fifo[0];
        fifo[0] = fifo[1];
        fifo[1] = fifo[2];
        fifo_count--;
    }
    avr->data[UCSRA] &= ~DOR;
    if (fifo_count > 0) {
        avr_raise_interrupt(avr, rx_vector);
    } else {
        avr->data[UCSRA] &= ~RXC;
        avr_clear_interrupt(avr, rx_vector);
    }
    avr->data[UDR] = byte;
    return byte;
}

static void data_write(avr_t *a, avr_io_addr_t addr, uint8_t v, void *param)
{
    if (!(avr->data[UCSRB] & TXEN))
        return;
    if (!shifting) {
        shifting = true;
        shift = v;
        avr_cycle_timer_register(avr, byte_cycles(), departed, 0);
        avr_raise_interrupt(avr, udre_vector); /* the buffer is free again at once */
    } else if (!held) {
        held = true;
        holding = v;
        avr->data[UCSRA] &= ~UDRE;
        avr_clear_interrupt(avr, udre_vector);
    }
}

static void control_write(avr_t *a, avr_io_addr_t addr, uint8_t v, void *param)
{
    const uint8_t before = avr->data[UCSRB];

    avr->data[UCSRB] = v;
    if ((v & UDRIE) && !(before & UDRIE) && !held)
        avr_raise_interrupt(avr, udre_vector);
    if ((v & RXCIE) && !(before & RXCIE) && fifo_count > 0)
        avr_raise_interrupt(avr, rx_vector);
}

static void status_write(avr_t *a, avr_io_addr_t addr, uint8_t v, void *param)
{
    avr->data[UCSRA] = (avr->data[UCSRA] & ~(U2X | 1)) | (v & (U2X | 1));
    if (v & TXC)
        avr->data[UCSRA] &= ~TXC;
}

static uint8_t status_read(avr_t *a, avr_io_addr_t addr, void *param)
{
    return avr->data[UCSRA];
}

static void plain_write(avr_t *a, avr_io_addr_t addr, uint8_t v, void *param)
{
    avr->data[addr] = v;
}

void uart_model_reset(void)
{
    fifo_count = 0;
    turn_began = 0;
    shifting = held = line_running = false;
    avr->data[UCSRA] = UDRE;
}

static avr_int_vector_t *vector_number(uint8_t number)
{
    for (int i = 0; i < avr->interrupts.vector_count; i++)
        if (avr->interrupts.vector[i]->vector == number)
            return avr->interrupts.vector[i];
    return 0;
}

void uart_model_attach(avr_t *a, uint8_t rx, uint8_t udre)
{
    avr = a;
    rx_vector = vector_number(rx);
    udre_vector = vector_number(udre);
    avr->io[AVR_DATA_TO_IO(UDR)].r.c = data_read;
    avr->io[AVR_DATA_TO_IO(UDR)].w.c = data_write;
    avr->io[AVR_DATA_TO_IO(UCSRA)].r.c = status_read;
    avr->io[AVR_DATA_TO_IO(UCSRA)].w.c = status_write;
    avr->io[AVR_DATA_TO_IO(UCSRB)].w.c = control_write;
    avr->io[AVR_DATA_TO_IO(UBRRL)].w.c = plain_write;
    uart_model_reset();
}

bool uart_model_open(const char *link)
{
    char name[128];
    struct termios raw;

    snprintf(link_path, sizeof link_path, "%s", link);
    if (openpty(&master, &slave, name, 0, 0) != 0)
        return false;
    tcgetattr(slave, &raw);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw); /* the slave stays open here: without it a read fails when the host closes */
    fcntl(master, F_SETFL, O_NONBLOCK);
    fcntl(master, F_SETFD, FD_CLOEXEC);
    fcntl(slave, F_SETFD, FD_CLOEXEC);
    unlink(link_path);
    return symlink(name, link_path) == 0;
}

void uart_model_close(void)
{
    if (master >= 0) {
        unlink(link_path);
        close(slave);
        close(master);
    }
    master = slave = -1;
    line_in = line_out; /* what was on the way is lost with the cable */
}

void uart_model_inject(const uint8_t *bytes, int count)
{
    for (int i = 0; i < count && line_in - line_out < LINE_SIZE; i++)
        line[line_in++ % LINE_SIZE] = bytes[i];
    line_start();
}

void uart_model_poll(void)
{
    uint8_t buffer[512];

    if (master < 0) {
        out_count = 0;
        return;
    }
    const int room = LINE_SIZE - (int)(line_in - line_out);
    if (room > 0) {
        const ssize_t n = read(master, buffer, room < (int)sizeof buffer ? (size_t)room : sizeof buffer);
        if (n > 0 && !uart_noise)
            uart_model_inject(buffer, (int)n);
    }
    if (uart_noise && line_in - line_out < 32) {
        for (int i = 0; i < 32; i++)
            buffer[i] = (uint8_t)(random() >> 8);
        uart_model_inject(buffer, 32);
    }
    line_start();
    /* As USB adapters do: what belongs together is told together, when the line falls quiet or a packet is full. */
    if (out_count > 0 && (!shifting || out_count >= PACKET)) {
        const ssize_t n = write(master, out, (size_t)out_count);
        if (n > 0)
            memmove(out, out + n, (size_t)(out_count -= (int)n));
        else if (out_count == (int)sizeof out)
            out_count = 0; /* nobody reads: an FTDI drops too */
    }
}
