/* The two check sums on the wires: CRC-16/CCITT-FALSE for frames, CRC-8/MAXIM for the thermometers. */
#ifndef HAPTORB_CRC_H
#define HAPTORB_CRC_H

#include <stdint.h>

#define CRC16_START 0xFFFF

/* Polynomial 0x1021, most significant bit first, start 0xFFFF, no final xor; "123456789" gives 0x29B1. */
uint16_t crc16(uint16_t crc, uint8_t byte);

/* Polynomial 0x31 reflected, start 0, as the 1-wire scratchpad carries it. */
uint8_t crc8(uint8_t crc, uint8_t byte);

#endif
