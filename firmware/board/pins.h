/* Which pin is what, on an Arduino Uno (ATmega328P) and an Arduino Mega (ATmega2560); the numbers printed on both
 * boards are the same, so one wiring table serves both.
 *
 *   D2  stop button, closed contact to ground; open (pressed, or a broken wire) stops
 *   D4  OE of the PCA9685, low lets current flow; a 10 k pull-up holds it high while the processor is in reset
 *   D5, D6, D7  1-wire lines of the three thermometers, each with its own 4.7 k pull-up
 *   D8, D9      which axis the Hall sensors' multiplexers show: 0, 1, 2 for x, y, z
 *   D13 lamp: lit while engaged
 *   SDA, SCL    the bus
 */
#ifndef HAPTORB_PINS_H
#define HAPTORB_PINS_H

#include <avr/io.h>

#include "../core/bridge.h"

#if defined(__AVR_ATmega328P__)

#define BOARD BOARD_ATMEGA328P
#define STOP_PIN PIND
#define STOP_PORT PORTD
#define STOP_BIT 2
#define OE_DDR DDRD
#define OE_PORT PORTD
#define OE_BIT 4
#define LAMP_DDR DDRB
#define LAMP_PORT PORTB
#define LAMP_BIT 5
#define AXIS_DDR DDRB
#define AXIS_PORT PORTB
#define AXIS_SHIFT 0
#define BUS_DDR DDRC
#define BUS_PIN PINC
#define BUS_PORT PORTC
#define SDA_BIT 4
#define SCL_BIT 5
#define ONEWIRE_LINES {{&DDRD, &PIND, 5}, {&DDRD, &PIND, 6}, {&DDRD, &PIND, 7}}
#define UART_RX_vect USART_RX_vect
#define UART_UDRE_vect USART_UDRE_vect

#elif defined(__AVR_ATmega2560__)

#define BOARD BOARD_ATMEGA2560
#define STOP_PIN PINE
#define STOP_PORT PORTE
#define STOP_BIT 4
#define OE_DDR DDRG
#define OE_PORT PORTG
#define OE_BIT 5
#define LAMP_DDR DDRB
#define LAMP_PORT PORTB
#define LAMP_BIT 7
#define AXIS_DDR DDRH
#define AXIS_PORT PORTH
#define AXIS_SHIFT 5
#define BUS_DDR DDRD
#define BUS_PIN PIND
#define BUS_PORT PORTD
#define SDA_BIT 1
#define SCL_BIT 0
#define ONEWIRE_LINES {{&DDRE, &PINE, 3}, {&DDRH, &PINH, 3}, {&DDRH, &PINH, 4}}
#define UART_RX_vect USART0_RX_vect
#define UART_UDRE_vect USART0_UDRE_vect

#else
#error "this board has no pin table: add one"
#endif

#endif
