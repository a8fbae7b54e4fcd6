/* The firmware of the array in docs/how_to/build_instrument.md, in portable C99: reads 25 detectors
 * by four ADS131M08 (Texas Instruments SBAS950B), averages, and sends frames by array_sender.h.
 *
 * The hardware is behind the four functions board_*. teensy41_board.cpp has them for a Teensy 4.1,
 * with setup() and loop(); for another microcontroller write these four, and call
 *
 *     while (firmware_begin()) { }     once
 *     firmware_step();                 for ever: it waits for the converters
 *
 * Detector i, row by row from the top port corner, is channel i % 8 of converter i / 8. Another
 * order does no harm: `uuv_array commission` finds it.
 */
#ifndef UUV_ARRAY_FIRMWARE_H
#define UUV_ARRAY_FIRMWARE_H

#include <stddef.h>
#include <stdint.h>

#define FIRMWARE_SIDE 5       /* detectors in a row */
#define FIRMWARE_CONVERTERS 4 /* which share clock and reset, and so sample in the same instant */
#define FIRMWARE_CHANNELS 8

/* Scans a second, as the converters have after a reset with a clock of 8.192 MHz. */
#define FIRMWARE_SCANS_PER_S 4000u
#define FIRMWARE_EXPOSURE 80u /* scans of a reading: 20 ms, a whole period of lamps at 50 Hz */
#define FIRMWARE_PERIOD 400u  /* scans from one frame to the next: 10 frames a second */
#define FIRMWARE_DELAY_US 375 /* of the converters' filter: one and a half scans */

/* A code has 24 bits with a sign, and light only the positive half: 2^23 codes are 1.2 V, and 2^7
 * codes a count. Darkness reads the pedestal: that of `uuv_array budget` and of the scene. */
#define FIRMWARE_SHIFT 7
#define FIRMWARE_PEDESTAL 100

#define FIRMWARE_FRAME_BYTES (3 * (FIRMWARE_CHANNELS + 2)) /* of a converter, on SPI */

/* Set up pins, serial line and SPI (mode 1, most significant bit first, up to 25 MHz), and hold the
 * common reset of the converters low for a millisecond. */
void board_begin(void);

/* Wait until the converters have new data, and return that time, us, by a clock that never goes
 * back; the time before again where none came for 10 ms. */
uint64_t board_scan(void);

/* Exchange bytes with one converter, whose chip select is low meanwhile. */
void board_transfer(uint8_t converter, const uint8_t *out, uint8_t *in, size_t bytes);

/* Send a packet over the serial line, without waiting for its end. */
void board_send(const uint8_t *packet, size_t bytes);

/* Start the converters and measure their offsets, inputs shorted. Return 0, or which converter, from
 * 1, does not answer: look at its supply, clock, chip select and data line; 5: all answer, but
 * checks are wrong: shorten the lines of SPI, or slow it down. */
int firmware_begin(void);

/* Take one scan, and send a frame when its time has come. Scans with a wrong check are left out; a
 * converter that has reset itself, as after a drop of its supply, starts all of them anew. */
void firmware_step(void);

/* The reading of a code, counts, by the offset of its channel. */
uint16_t firmware_reading(int32_t code, int32_t zero);

#endif
