#include "crc.h"

/* All eight shifts of the polynomial folded together, in bytes, because an AVR shifts 16 bits one by one: about
 * 25 cycles a byte, where the bit loop takes 100 and would fall behind a line that brings a byte every 160 cycles. */
uint16_t crc16(uint16_t crc, uint8_t byte)
{
    uint8_t x = (uint8_t)(crc >> 8) ^ byte;
    x ^= x >> 4;
    const uint8_t high = (uint8_t)crc ^ (uint8_t)(x << 4) ^ (x >> 3);
    const uint8_t low = (uint8_t)(x << 5) ^ x;
    return (uint16_t)((uint16_t)high << 8 | low);
}

uint8_t crc8(uint8_t crc, uint8_t byte)
{
    crc ^= byte;
    for (uint8_t i = 0; i < 8; i++)
        crc = (crc & 1) ? (uint8_t)((crc >> 1) ^ 0x8C) : (uint8_t)(crc >> 1);
    return crc;
}
