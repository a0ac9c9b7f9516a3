/* Frames on the serial line: A5 5A, length, type, sequence, payload, CRC-16 (low byte first).
 *
 * The CRC covers length, type, sequence and payload. All numbers in payloads are little-endian.
 */
#ifndef HAPTORB_FRAME_H
#define HAPTORB_FRAME_H

#include "config.h"

#define SYNC_1 0xA5
#define SYNC_2 0x5A
#define PAYLOAD_MAX 40
#define FRAME_MAX (PAYLOAD_MAX + 7)

enum frame_type {
    FRAME_IDENTIFY = 0x01,
    FRAME_LIMITS = 0x02,
    FRAME_SET = 0x03,
    FRAME_ENGAGE = 0x04,
    FRAME_OFF = 0x05,
    FRAME_READ = 0x06,
    FRAME_STORE = 0x07,
    FRAME_ANSWER = 0x80, /* added to the type of what is answered; SET and READ are both answered by 0x83 */
    FRAME_READING = 0x83,
    FRAME_STATE = 0x84
};

enum frame_event { FRAME_NOTHING, FRAME_COMPLETE, FRAME_DAMAGED };

struct frame {
    uint8_t length;
    uint8_t type;
    uint8_t sequence;
    uint8_t payload[PAYLOAD_MAX];
};

struct frame_parser {
    struct frame frame;
    uint16_t crc;
    uint8_t place; /* how many bytes of the frame have been seen */
};

void frame_reset(struct frame_parser *parser);

/* One byte from the line. After FRAME_COMPLETE, parser->frame is valid until the next byte. */
enum frame_event frame_byte(struct frame_parser *parser, uint8_t byte);

#define FRAME_HEAD 5 /* bytes before the payload */
#define FRAME_TAIL 2 /* and behind it: the check sum */

/* Bytes of a whole frame into out (FRAME_MAX); returns how many. A payload that is too long gives 0. */
uint8_t frame_write(uint8_t *out, uint8_t type, uint8_t sequence, const uint8_t *payload, uint8_t length);

/* The same in two steps, for a payload that is in its place, out + FRAME_HEAD, already: the head; and the check sum of a
 * frame of n bytes, which takes an AVR so long that the line should be busy meanwhile. */
uint8_t frame_head(uint8_t *out, uint8_t type, uint8_t sequence, uint8_t length);
void frame_seal(uint8_t *out, uint8_t n);

#endif
