/* See array_firmware.h. */

#include "array_firmware.h"

#include "array_sender.h"

/* Registers and bits of the ADS131M08, SBAS950B table 8-12. */
#define READ_REGISTER 0xA000u
#define WRITE_REGISTER 0x6000u
#define ID 0x00u
#define MODE 0x02u
#define CHANNEL_CONFIG(channel) (0x09u + 5u * (channel))
#define IS_M08 0x28u            /* high byte of ID */
#define MODE_WITHOUT_RESET 0x0110u /* words of 24 bits, and the note of a reset is cleared */
#define STATUS_RESET 0x0400u
#define SHORTED 1u

#define SETTLE 4 /* scans, after a change of the inputs: the filter takes three */
#define ZEROS 64 /* scans that the offset is the mean of */

static uuv_sender sender;
static uint8_t packet[UUV_PACKET_BYTES];
static int32_t codes[FIRMWARE_CONVERTERS][FIRMWARE_CHANNELS];
static int32_t zeros[FIRMWARE_CONVERTERS][FIRMWARE_CHANNELS];
static uint32_t scans; /* since the last frame began */
static uint64_t first_us, last_us;
static uint8_t again; /* a converter has reset itself */

/* Wait for a scan; 0: the converters have none, as without their clock. */
static int next_scan(void)
{
    const uint64_t before_us = last_us;
    last_us = board_scan();
    return last_us != before_us;
}

/* CRC-16 of polynomial 0x1021 that starts at 0xFFFF, as the converters send it. */
static uint16_t check_of(const uint8_t *bytes, size_t count)
{
    uint32_t crc = 0xFFFFu;
    int bit;
    while (count--) {
        crc ^= (uint32_t)*bytes++ << 8;
        for (bit = 0; bit < 8; bit++) {
            crc = (crc & 0x8000u) ? (crc << 1) ^ 0x1021u : crc << 1;
        }
    }
    return (uint16_t)crc;
}

/* Send a command with one word of data, and take the answer to the command before and the codes;
 * return whether their check is right. */
static int exchange(uint8_t converter, uint16_t command, uint16_t data, uint8_t *in)
{
    uint8_t out[FIRMWARE_FRAME_BYTES] = {0};
    const size_t checked = FIRMWARE_FRAME_BYTES - 3;
    out[0] = (uint8_t)(command >> 8);
    out[1] = (uint8_t)command;
    out[3] = (uint8_t)(data >> 8);
    out[4] = (uint8_t)data;
    board_transfer(converter, out, in, FIRMWARE_FRAME_BYTES);
    return check_of(in, checked) == (uint16_t)(in[checked] << 8 | in[checked + 1]);
}

static void write_register(uint8_t converter, uint16_t address, uint16_t value)
{
    uint8_t in[FIRMWARE_FRAME_BYTES];
    exchange(converter, (uint16_t)(WRITE_REGISTER | address << 7), value, in);
}

static int answers(uint8_t converter)
{
    uint8_t in[FIRMWARE_FRAME_BYTES];
    exchange(converter, READ_REGISTER | ID << 7, 0, in);
    return exchange(converter, 0, 0, in) && in[0] == IS_M08;
}

/* Read all converters; return whether every check is right. The answer to a written register may
 * look like the note of a reset: the first reading after one does not count. */
static int read_codes(void)
{
    uint8_t in[FIRMWARE_FRAME_BYTES], converter, channel;
    int right = 1;
    for (converter = 0; converter < FIRMWARE_CONVERTERS; converter++) {
        if (!exchange(converter, 0, 0, in)) {
            right = 0;
            continue;
        }
        if ((in[0] << 8 | in[1]) & STATUS_RESET) {
            again = 1;
        }
        for (channel = 0; channel < FIRMWARE_CHANNELS; channel++) {
            const uint8_t *word = in + 3 * (channel + 1);
            int32_t code = (int32_t)word[0] << 16 | word[1] << 8 | word[2];
            codes[converter][channel] = code < 0x800000 ? code : code - 0x1000000;
        }
    }
    return right;
}

/* Connect all inputs to their pins, or short them, and let the filters settle. */
static void connect(uint16_t how)
{
    uint8_t converter;
    uint16_t channel;
    for (converter = 0; converter < FIRMWARE_CONVERTERS; converter++) {
        for (channel = 0; channel < FIRMWARE_CHANNELS; channel++) {
            write_register(converter, (uint16_t)CHANNEL_CONFIG(channel), how);
        }
    }
    for (channel = 0; channel < SETTLE; channel++) {
        next_scan();
        read_codes();
    }
    again = 0;
}

int firmware_begin(void)
{
    int64_t sums[FIRMWARE_CONVERTERS][FIRMWARE_CHANNELS] = {{0}};
    uint8_t i, k;
    int taken = 0, tries;
    board_begin();
    next_scan();
    for (i = 0; i < FIRMWARE_CONVERTERS; i++) {
        if (!next_scan() || !answers(i)) {
            return i + 1;
        }
        write_register(i, MODE, MODE_WITHOUT_RESET);
    }
    connect(SHORTED);
    for (tries = 0; taken < ZEROS; tries++) {
        if (tries == 2 * ZEROS) {
            return FIRMWARE_CONVERTERS + 1;
        }
        if (next_scan() && read_codes()) {
            taken++;
            for (i = 0; i < FIRMWARE_CONVERTERS; i++) {
                for (k = 0; k < FIRMWARE_CHANNELS; k++) {
                    sums[i][k] += codes[i][k];
                }
            }
        }
    }
    for (i = 0; i < FIRMWARE_CONVERTERS; i++) {
        for (k = 0; k < FIRMWARE_CHANNELS; k++) {
            zeros[i][k] = (int32_t)(sums[i][k] / ZEROS);
        }
    }
    connect(0);
    uuv_begin(&sender, FIRMWARE_SIDE);
    scans = 0;
    return 0;
}

uint16_t firmware_reading(int32_t code, int32_t zero)
{
    const int32_t count = (int32_t)1 << FIRMWARE_SHIFT;
    /* The pedestal goes on before the shift, so that no negative number is shifted. */
    int32_t raised = code - zero + FIRMWARE_PEDESTAL * count + count / 2;
    if (raised < 0) {
        return 0;
    }
    raised >>= FIRMWARE_SHIFT;
    return (uint16_t)(raised < 0xFFFF ? raised : 0xFFFF);
}

void firmware_step(void)
{
    uint16_t readings[FIRMWARE_SIDE * FIRMWARE_SIDE];
    int right;
    size_t i;
    if (!next_scan()) {
        return;
    }
    right = read_codes();
    if (again) {
        again = firmware_begin() != 0; /* if it fails, the next step tries again */
        return;
    }
    if (scans == 0) {
        first_us = last_us;
    }
    if (right && scans < FIRMWARE_EXPOSURE) {
        for (i = 0; i < FIRMWARE_SIDE * FIRMWARE_SIDE; i++) {
            const size_t converter = i / FIRMWARE_CHANNELS, channel = i % FIRMWARE_CHANNELS;
            readings[i] = firmware_reading(codes[converter][channel], zeros[converter][channel]);
        }
        uuv_add(&sender, readings);
    }
    scans++;
    if (scans == FIRMWARE_EXPOSURE) {
        const uint64_t middle_us = first_us + (last_us - first_us) / 2 - FIRMWARE_DELAY_US;
        board_send(packet, uuv_frame(&sender, middle_us, packet));
    }
    if (scans == FIRMWARE_PERIOD) {
        scans = 0;
    }
}
