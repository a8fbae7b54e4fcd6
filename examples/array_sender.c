/* See array_sender.h. */

#include "array_sender.h"

/* A packet that is being written: COBS on the fly, and the CRC-32 of what went in. */
typedef struct {
    uint8_t *packet;
    size_t code, next; /* where the count of the open group and its next byte go */
    uint32_t crc;
} stream;

static void stuff(stream *out, uint8_t byte)
{
    if (byte) {
        out->packet[out->next++] = byte;
    }
    if (!byte || out->next - out->code == 255) { /* the group ends */
        out->packet[out->code] = (uint8_t)(out->next - out->code);
        out->code = out->next++;
    }
}

/* Write a number, little-endian, and take it into the check. */
static void put(stream *out, uint64_t value, int bytes)
{
    int bit;
    while (bytes-- > 0) {
        uint8_t byte = (uint8_t)(value & 0xFF);
        value >>= 8;
        stuff(out, byte);
        out->crc ^= byte;
        for (bit = 0; bit < 8; bit++) {
            out->crc = (out->crc >> 1) ^ ((out->crc & 1u) ? 0xEDB88320u : 0u);
        }
    }
}

static void clear(uuv_sender *sender)
{
    size_t i;
    for (i = 0; i < UUV_MOST_SIDE * UUV_MOST_SIDE; i++) {
        sender->sums[i] = 0;
    }
    sender->samples = 0;
}

void uuv_begin(uuv_sender *sender, uint8_t side)
{
    clear(sender);
    sender->number = 0;
    sender->side = side < 2 ? 2 : side > UUV_MOST_SIDE ? UUV_MOST_SIDE : side;
}

void uuv_add(uuv_sender *sender, const uint16_t *readings)
{
    size_t i, count = (size_t)sender->side * sender->side;
    if (sender->samples == UUV_MOST_SAMPLES) {
        return;
    }
    for (i = 0; i < count; i++) {
        sender->sums[i] += readings[i];
    }
    sender->samples++;
}

size_t uuv_frame(uuv_sender *sender, uint64_t time_us, uint8_t *packet)
{
    stream out = {packet, 0, 1, 0xFFFFFFFFu};
    size_t i, count = (size_t)sender->side * sender->side;
    uint32_t samples = sender->samples;
    if (!samples) {
        return 0;
    }
    put(&out, 1, 1); /* version */
    put(&out, sender->side, 1);
    put(&out, sender->number++, 4);
    put(&out, time_us, 8);
    for (i = 0; i < count; i++) {
        /* The mean to the nearest count, without an overflow. */
        uint32_t whole = sender->sums[i] / samples, rest = sender->sums[i] % samples;
        put(&out, whole + (rest >= samples - rest), 2);
    }
    put(&out, out.crc ^ 0xFFFFFFFFu, 4);
    stuff(&out, 0); /* ends the last group, and would open another */
    packet[out.code] = 0;
    clear(sender);
    return out.code + 1;
}
