/* The sender of a detector array, in portable C99: averages samples and makes the frames that
 * serial_array_node.py reads, whose layout it describes. It allocates nothing, needs no library,
 * and takes 4 bytes a detector and a packet of UUV_PACKET_BYTES.
 *
 *     static uuv_sender sender;
 *     static uint8_t packet[UUV_PACKET_BYTES];
 *
 *     uuv_begin(&sender, 5);                      once, with the detectors in a row
 *     uuv_add(&sender, samples);                  for each scan of all detectors
 *     send(packet, uuv_frame(&sender, middle_us, packet));    at the rate of the images
 *
 * `middle_us` is the middle of the time that was averaged, by a clock of the array that never
 * goes back. Readings are in whatever wiring: `uuv_array commission` finds it.
 */
#ifndef UUV_ARRAY_SENDER_H
#define UUV_ARRAY_SENDER_H

#include <stddef.h>
#include <stdint.h>

#ifndef UUV_MOST_SIDE
#define UUV_MOST_SIDE 7 /* detectors in a row */
#endif
#define UUV_FRAME_BYTES (14 + 2 * UUV_MOST_SIDE * UUV_MOST_SIDE + 4)
#define UUV_PACKET_BYTES (UUV_FRAME_BYTES + UUV_FRAME_BYTES / 254 + 2)
#define UUV_MOST_SAMPLES 65536u /* of one frame, so that no sum overflows; more are left out */

typedef struct {
    uint32_t sums[UUV_MOST_SIDE * UUV_MOST_SIDE];
    uint32_t samples, number;
    uint8_t side;
} uuv_sender;

/* Start anew: the next frame has the number 0. The side is from 2 to UUV_MOST_SIDE. */
void uuv_begin(uuv_sender *sender, uint8_t side);

/* Add one sample of each detector, in counts. */
void uuv_add(uuv_sender *sender, const uint16_t *readings);

/* Write the frame of the mean of all samples since the last one, its closing zero included, and
 * return its bytes; 0, and nothing is written, where there was no sample. */
size_t uuv_frame(uuv_sender *sender, uint64_t time_us, uint8_t *packet);

#endif
