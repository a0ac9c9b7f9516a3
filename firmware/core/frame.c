#include "frame.h"

#include "crc.h"

void frame_reset(struct frame_parser *parser)
{
    parser->place = 0;
}

enum frame_event frame_byte(struct frame_parser *parser, uint8_t byte)
{
    struct frame *frame = &parser->frame;
    uint8_t place = parser->place;

    if (place == 0) {
        parser->place = (byte == SYNC_1);
        return FRAME_NOTHING;
    }
    if (place == 1) {
        /* A5 A5 5A is a frame after a stray A5 */
        parser->place = (byte == SYNC_2) ? 2 : (byte == SYNC_1);
        parser->crc = CRC16_START;
        return FRAME_NOTHING;
    }
    parser->place = place + 1;
    if (place == 2) {
        if (byte > PAYLOAD_MAX) { /* nothing so long exists: do not wait for it */
            parser->place = 0;
            return FRAME_DAMAGED;
        }
        frame->length = byte;
    } else if (place == 3) {
        frame->type = byte;
    } else if (place == 4) {
        frame->sequence = byte;
    } else if (place < 5 + frame->length) {
        frame->payload[place - 5] = byte;
    } else if (place == 5 + frame->length) {
        parser->crc ^= byte; /* low byte of the CRC: zero is left if it was right */
        return FRAME_NOTHING;
    } else {
        parser->place = 0;
        return parser->crc == (uint16_t)((uint16_t)byte << 8) ? FRAME_COMPLETE : FRAME_DAMAGED;
    }
    parser->crc = crc16(parser->crc, byte);
    return FRAME_NOTHING;
}

uint8_t frame_write(uint8_t *out, uint8_t type, uint8_t sequence, const uint8_t *payload, uint8_t length)
{
    if (length > PAYLOAD_MAX)
        return 0;
    const uint8_t n = frame_head(out, type, sequence, length);
    for (uint8_t i = 0; i < length; i++)
        out[FRAME_HEAD + i] = payload[i];
    frame_seal(out, n);
    return n;
}

uint8_t frame_head(uint8_t *out, uint8_t type, uint8_t sequence, uint8_t length)
{
    out[0] = SYNC_1;
    out[1] = SYNC_2;
    out[2] = length;
    out[3] = type;
    out[4] = sequence;
    return FRAME_HEAD + length + FRAME_TAIL;
}

void frame_seal(uint8_t *out, uint8_t n)
{
    uint16_t crc = CRC16_START;

    for (uint8_t i = 2; i < n - FRAME_TAIL; i++)
        crc = crc16(crc, out[i]);
    out[n - 2] = (uint8_t)crc;
    out[n - 1] = (uint8_t)(crc >> 8);
}
