// The four functions of array_firmware.h for a Teensy 4.1 (PJRC, NXP i.MX RT1062), by its Arduino
// core: copy this file, array_firmware.* and array_sender.* into one sketch, whose .ino file stays
// empty. Pins are those of the table in docs/how_to/build_instrument.md.

#include <Arduino.h>
#include <SPI.h>

extern "C" {
#include "array_firmware.h"
}

static const uint8_t SELECT[FIRMWARE_CONVERTERS] = {10, 9, 8, 7};  // CS of U1 to U4
static const uint8_t READY = 6;   // DRDY of U1
static const uint8_t RESET = 5;   // SYNC/RESET of all
static const uint8_t FAULT = 4;   // an LED with 1 kOhm: it blinks the number of a silent converter
static const uint8_t DRIVE = 2;   // DE of the MAX3485E, whose DI is at pin 1
static const uint32_t SPI_HZ = 15000000, BAUD = 921600;

static volatile bool ready = false;
static volatile uint32_t ready_us = 0;

static void on_ready()
{
    ready_us = micros();
    ready = true;
}

extern "C" void board_begin(void)
{
    for (uint8_t pin : SELECT) {
        digitalWrite(pin, HIGH);
        pinMode(pin, OUTPUT);
    }
    pinMode(READY, INPUT);
    pinMode(RESET, OUTPUT);
    pinMode(FAULT, OUTPUT);
    Serial1.begin(BAUD);
    Serial1.transmitterEnable(DRIVE);
    SPI.begin();
    digitalWrite(RESET, LOW);
    delay(1);
    digitalWrite(RESET, HIGH);
    delay(1);
    attachInterrupt(digitalPinToInterrupt(READY), on_ready, FALLING);
}

extern "C" uint64_t board_scan(void)
{
    // micros() begins anew after 71 minutes; scans are nearer to each other.
    static uint64_t time_us = 0;
    static uint32_t last_us = 0;
    const uint32_t began_ms = millis();
    while (!ready && millis() - began_ms < 10) {  // a converter without clock has no data
    }
    ready = false;
    const uint32_t now_us = ready_us;
    time_us += now_us - last_us;
    last_us = now_us;
    return time_us;
}

extern "C" void board_transfer(uint8_t converter, const uint8_t *out, uint8_t *in, size_t bytes)
{
    SPI.beginTransaction(SPISettings(SPI_HZ, MSBFIRST, SPI_MODE1));
    digitalWriteFast(SELECT[converter], LOW);
    SPI.transfer(out, in, bytes);
    digitalWriteFast(SELECT[converter], HIGH);
    SPI.endTransaction();
}

extern "C" void board_send(const uint8_t *packet, size_t bytes)
{
    Serial1.write(packet, bytes);
}

void setup()
{
    while (int silent = firmware_begin()) {
        for (int i = 0; i < silent; i++) {
            digitalWrite(FAULT, HIGH);
            delay(200);
            digitalWrite(FAULT, LOW);
            delay(200);
        }
        delay(1000);
    }
}

void loop()
{
    firmware_step();
}
