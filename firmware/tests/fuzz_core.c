/* Random bytes into the firmware's parser while coils are live: it must never take a duty that nobody sent.
 *
 *   fuzz_core BYTES [SEED]
 *
 * Every few thousand bytes a true frame is slipped in, so that the parser is not merely asleep, and half of the noise
 * is made of true frames with bits flipped (up to three, or a burst of up to 16 bits: what CRC-16 promises to see).
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../core/bridge.h"

static uint64_t seed = 1;

static uint32_t draw(void)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (uint32_t)(seed >> 16);
}

static struct bridge bridge;
static int16_t sent[CHANNELS];
static uint8_t sequence;
static unsigned long bytes, answers, wrong, taken, engaged_again;

static void check(void)
{
    for (int i = 0; i < CHANNELS; i++) {
        const int16_t duty = bridge.guard.duties[i];
        if (duty != 0 && duty != sent[i]) {
            wrong++;
            printf("after %lu bytes: duty %d on coil %d, last sent %d\n", bytes, duty, i, sent[i]);
        }
    }
}

static void feed(const uint8_t *data, int n)
{
    for (int i = 0; i < n; i++) {
        answers += bridge_byte(&bridge, data[i], (uint16_t)(bytes / 3)) > 0;
        bytes++;
        check();
    }
}

static int set_frame(uint8_t *out, int16_t *duties)
{
    uint8_t payload[2 * CHANNELS];

    for (int i = 0; i < CHANNELS; i++) {
        duties[i] = (int16_t)((int)(draw() % 8191) - 4095);
        payload[2 * i] = (uint8_t)duties[i];
        payload[2 * i + 1] = (uint8_t)((uint16_t)duties[i] >> 8);
    }
    return frame_write(out, FRAME_SET, ++sequence, payload, sizeof payload);
}

static void engage(void)
{
    bridge.plan.setup = 0xFF; /* the chips are well: this is about the line */
    bridge.plan.missing = 0;
    bridge.plan.quiet = true;
    bridge_millisecond(&bridge, false);
    guard_off(&bridge.guard);
    if (guard_engage(&bridge.guard, ENGAGE_KEY, 4095, 21000) == ACCEPTED)
        engaged_again++;
}

int main(int argc, char **argv)
{
    const unsigned long wanted = argc > 1 ? strtoul(argv[1], 0, 10) : 10000000;
    uint8_t buffer[FRAME_MAX];
    int16_t duties[CHANNELS];

    seed = argc > 2 ? strtoull(argv[2], 0, 10) : 20201120;
    bridge_boot(&bridge, BOARD_ATMEGA328P, REASON_POWER_ON);
    while (bytes < wanted) {
        if (!guard_live(&bridge.guard))
            engage();
        const uint32_t kind = draw() % 8;
        if (kind == 0) { /* a true frame, after silence: what the parser holds is thrown away */
            const int n = set_frame(buffer, duties);
            for (int i = 0; i <= FRAME_MS + 1; i++)
                bridge_millisecond(&bridge, false);
            const uint8_t before = bridge.guard.sequence;
            memcpy(sent, duties, sizeof sent);
            memset(bridge.guard.duties, 0, sizeof duties);
            feed(buffer, n);
            taken += bridge.guard.sequence == sequence && before != sequence;
        } else if (kind < 4) { /* a bent frame */
            const int n = set_frame(buffer, duties);
            if (draw() & 1) {
                for (uint32_t flips = 1 + draw() % 3; flips > 0; flips--) {
                    const uint32_t bit = 16 + draw() % (uint32_t)(8 * n - 16);
                    buffer[bit / 8] ^= (uint8_t)(1 << bit % 8);
                }
            } else {
                const uint32_t first = 16 + draw() % (uint32_t)(8 * n - 32), length = 1 + draw() % 16;
                buffer[first / 8] ^= (uint8_t)(1 << first % 8);
                for (uint32_t bit = first + 1; bit < first + length; bit++)
                    if (draw() & 1)
                        buffer[bit / 8] ^= (uint8_t)(1 << bit % 8);
            }
            int16_t meant[CHANNELS];
            memcpy(meant, duties, sizeof meant);
            /* two flips of the same bit undo each other: then the frame is true after all */
            uint8_t again[FRAME_MAX], payload[2 * CHANNELS];
            for (int i = 0; i < CHANNELS; i++) {
                payload[2 * i] = (uint8_t)meant[i];
                payload[2 * i + 1] = (uint8_t)((uint16_t)meant[i] >> 8);
            }
            frame_write(again, FRAME_SET, sequence, payload, sizeof payload);
            if (memcmp(again, buffer, (size_t)n) == 0) {
                memcpy(sent, meant, sizeof sent);
                memset(bridge.guard.duties, 0, sizeof meant);
            }
            feed(buffer, n);
        } else { /* plain noise, rich in sync bytes */
            const int n = 1 + (int)(draw() % sizeof buffer);
            for (int i = 0; i < n; i++) {
                const uint32_t r = draw();
                buffer[i] = r % 16 == 0 ? SYNC_1 : r % 16 == 1 ? SYNC_2 : (uint8_t)(r >> 8);
            }
            feed(buffer, n);
        }
    }
    printf("%lu bytes, %lu answers, %lu true frames taken, %lu times engaged again, %lu wrong duties\n", bytes, answers,
           taken, engaged_again, wrong);
    return wrong != 0 || taken == 0;
}
