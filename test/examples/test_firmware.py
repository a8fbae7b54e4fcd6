"""The firmware in C, compiled for this machine, with converters that are simulated here."""

import binascii
import ctypes
import importlib.util
import itertools
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from uuv_optical_array.forward.link_budget import Instrument

EXAMPLES = Path(__file__).parents[2] / "examples"
spec = importlib.util.spec_from_file_location(
    "serial_array_node", EXAMPLES / "serial_array_node.py"
)
node = importlib.util.module_from_spec(spec)
spec.loader.exec_module(node)

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror", "-O1"]
# The four functions hand over to functions that a test gives.
BOARD = """
#include "array_firmware.h"
void (*begun)(void);
uint64_t (*scanned)(void);
void (*transferred)(uint8_t, const uint8_t *, uint8_t *);
void (*sent)(const uint8_t *, size_t);
void board_begin(void) { begun(); }
uint64_t board_scan(void) { return scanned(); }
void board_transfer(uint8_t converter, const uint8_t *out, uint8_t *in, size_t bytes)
{
    if (bytes == FIRMWARE_FRAME_BYTES) {
        transferred(converter, out, in);
    }
}
void board_send(const uint8_t *packet, size_t bytes) { sent(packet, bytes); }
const int pedestal = FIRMWARE_PEDESTAL, side = FIRMWARE_SIDE;
const double average_s = (double)FIRMWARE_EXPOSURE / FIRMWARE_SCANS_PER_S;
const double rate_hz = (double)FIRMWARE_SCANS_PER_S / FIRMWARE_PERIOD;
"""
# As much of the Arduino core of a Teensy as its file uses, to check that it compiles.
ARDUINO = """
#pragma once
#include <stddef.h>
#include <stdint.h>
enum { LOW, HIGH, INPUT, OUTPUT, FALLING, MSBFIRST, SPI_MODE1 };
void digitalWrite(uint8_t, uint8_t); void digitalWriteFast(uint8_t, uint8_t);
void pinMode(uint8_t, uint8_t); void delay(uint32_t); uint32_t micros(); uint32_t millis();
int digitalPinToInterrupt(uint8_t); void attachInterrupt(int, void (*)(), int);
struct Line {
    void begin(uint32_t); void transmitterEnable(uint8_t); size_t write(const uint8_t *, size_t);
};
extern Line Serial1;
struct SPISettings { SPISettings(uint32_t, uint8_t, uint8_t) {} };
struct Bus {
    void begin(); void beginTransaction(SPISettings); void endTransaction();
    void transfer(const void *, void *, size_t);
};
extern Bus SPI;
"""
WREG, RREG = 0b011, 0b101


class Converter:
    """An ADS131M08 on its SPI, by SBAS950B: the answer comes with the frame after the command."""

    def __init__(self, offsets):
        self.offsets, self.volts = offsets, np.zeros(8)
        self.spoil = self.silent = False
        self.reset()

    def reset(self):
        self.registers = {0x00: 0x2808, 0x01: 0x0500, 0x02: 0x0510, 0x03: 0xFF0E}
        self.answer = 0xFF28

    def codes(self):
        inputs = [
            0.0 if self.registers.get(0x09 + 5 * k, 0) & 3 == 1 else volts
            for k, volts in enumerate(self.volts)
        ]
        codes = np.rint(np.array(inputs) / 1.2 * 2**23) + self.offsets
        return np.clip(codes, -(2**23), 2**23 - 1).astype(int).tolist()

    def exchange(self, out):
        """Return the 30 bytes that answer a frame of 30."""
        if self.silent:
            return bytes(30)
        words = [self.answer << 8, *(code & 0xFFFFFF for code in self.codes())]
        sent = b"".join(word.to_bytes(3, "big") for word in words)
        check = binascii.crc_hqx(sent, 0xFFFF) ^ self.spoil
        command, data = int.from_bytes(out[0:2], "big"), int.from_bytes(out[3:5], "big")
        kind, address = command >> 13, command >> 7 & 0x3F
        self.answer = self.registers[0x01]
        if kind == WREG:
            self.registers[address] = data
            self.answer = 0x4000 | address << 7
            if address == 0x02 and not data & 0x0400:
                self.registers[0x01] &= ~0x0400
        elif kind == RREG:
            self.answer = self.registers[address]
        return sent + check.to_bytes(2, "big") + b"\0"


class Board:
    """Four converters that share a reset and scan each 250 us, and the packets that were sent."""

    def __init__(self, library):
        rng = np.random.default_rng(1)
        self.converters = [Converter(rng.integers(-3000, 3000, 8)) for _ in range(4)]
        self.time_us, self.resets, self.packets, self.scan_us = 5_000_000, 0, [], 250
        self.library, self.spoilt = library, set()
        kinds = {
            "begun": ctypes.CFUNCTYPE(None),
            "scanned": ctypes.CFUNCTYPE(ctypes.c_uint64),
            "transferred": ctypes.CFUNCTYPE(
                None, ctypes.c_uint8, ctypes.POINTER(ctypes.c_uint8), ctypes.POINTER(ctypes.c_uint8)
            ),
            "sent": ctypes.CFUNCTYPE(None, ctypes.POINTER(ctypes.c_uint8), ctypes.c_size_t),
        }
        self.kept = {name: kind(getattr(self, name)) for name, kind in kinds.items()}
        for name, function in self.kept.items():
            ctypes.c_void_p.in_dll(library, name).value = ctypes.cast(
                function, ctypes.c_void_p
            ).value

    def begun(self):
        self.resets += 1
        for converter in self.converters:
            converter.reset()

    def scanned(self):
        self.time_us += self.scan_us
        return self.time_us

    def transferred(self, converter, out, into):
        answer = self.converters[converter].exchange(bytes(out[:30]))
        ctypes.memmove(into, answer, 30)

    def sent(self, packet, count):
        self.packets.append(bytes(packet[:count]))

    def light(self, volts):
        """Give the amplifiers of 25 detectors their voltages above the reference."""
        for i, each in enumerate(volts):
            self.converters[i // 8].volts[i % 8] = each

    def steps(self, count):
        for _ in range(count):
            self.library.firmware_step()


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    if shutil.which("gcc") is None:
        pytest.skip("the firmware in C needs a compiler, gcc")
    folder = tmp_path_factory.mktemp("firmware")
    (folder / "board.c").write_text(BOARD)
    sources = [EXAMPLES / "array_firmware.c", EXAMPLES / "array_sender.c", folder / "board.c"]
    words = ["gcc", *STRICT, f"-I{EXAMPLES}", "-shared", "-fPIC", "-o", folder / "firmware.so"]
    subprocess.run([*words, *sources], check=True)
    return ctypes.CDLL(str(folder / "firmware.so"))


@pytest.fixture
def board(library):
    board = Board(library)
    assert library.firmware_begin() == 0
    return board


def readings_of(packet):
    assert packet.endswith(b"\0")
    return node.frame_from(packet[:-1])


def test_a_frame_has_the_voltages_in_counts_above_the_pedestal(board):
    """Whatever the converters' offsets; 1.2 V are 65536 counts of 16 bits, 18.3 uV each."""
    volts = np.linspace(0.0, 1.15, 25)
    board.light(volts)
    board.steps(400)
    (packet,) = board.packets
    number, time_us, readings = readings_of(packet)
    assert number == 0
    # The middle of 80 scans, less the delay of the filter.
    assert time_us == board.time_us - 400 * 250 + 250 + 79 * 250 // 2 - 375
    expected = 100 + volts / 1.2 * 65536
    np.testing.assert_allclose(readings.ravel(), expected, atol=0.51)
    board.steps(800)
    assert [readings_of(each)[0] for each in board.packets] == [0, 1, 2]
    assert readings_of(board.packets[1])[1] - time_us == 100_000


def test_darkness_reads_the_pedestal_and_its_noise_is_not_clipped(board):
    rng = np.random.default_rng(2)
    for _ in range(8):
        board.light(rng.normal(0, 20e-6, 25))  # more than a count
        board.steps(400)
    dark = np.array([readings_of(packet)[2].ravel() for packet in board.packets])
    assert dark.mean() == pytest.approx(100, abs=5 * 20 / 18.3 / np.sqrt(dark.size))
    assert dark.min() < 98


@pytest.mark.parametrize(
    ("code", "reading"),
    [
        (0, 100), (63, 100), (64, 101), (-64, 100), (-65, 99), (128 * 1000, 1100),
        (-128 * 100, 0), (-(2**23), 0), (2**23 - 1, 65535), (128 * 65435, 65535),
    ],
)  # fmt: skip
def test_a_code_becomes_a_count_by_a_shift_of_7(library, code, reading):
    library.firmware_reading.restype = ctypes.c_uint16
    assert library.firmware_reading(ctypes.c_int32(code), 0) == reading
    assert library.firmware_reading(ctypes.c_int32(code + 1000), 1000) == reading


def test_the_firmware_has_the_figures_of_the_budget(library):
    it = Instrument()

    def figure(name, kind):
        return kind.in_dll(library, name).value

    assert figure("pedestal", ctypes.c_int) == it.pedestal_counts
    assert figure("average_s", ctypes.c_double) == pytest.approx(it.average_s)
    assert figure("rate_hz", ctypes.c_double) == 10
    assert figure("side", ctypes.c_int) == 5


@pytest.mark.parametrize("silent", [0, 1, 2, 3])
def test_a_converter_that_does_not_answer_is_named(library, silent):
    board = Board(library)
    board.converters[silent].silent = True
    assert library.firmware_begin() == silent + 1
    board.converters[silent].silent = False
    assert library.firmware_begin() == 0


def test_wrong_checks_and_a_missing_clock_are_told_at_the_start(library):
    board = Board(library)
    board.scan_us = 0
    assert library.firmware_begin() == 1
    board = Board(library)
    one, count = board.converters[2], itertools.count()

    def spoilt(out):
        one.spoil = next(count) > 10  # right while it is asked for its name
        return Converter.exchange(one, out)

    one.exchange = spoilt
    assert library.firmware_begin() == 5


def test_scans_with_a_wrong_check_are_left_out(board):
    board.light(np.full(25, 0.6))
    board.steps(20)
    board.light(np.full(25, 0.0))  # what spoilt scans would add
    board.converters[1].spoil = True
    board.steps(30)
    board.converters[1].spoil = False
    board.light(np.full(25, 0.6))
    board.steps(350)
    (packet,) = board.packets
    np.testing.assert_array_equal(readings_of(packet)[2], 100 + 32768)


def test_a_converter_that_has_reset_itself_starts_all_anew(board):
    resets, volts = board.resets, np.linspace(0.1, 1.0, 25)
    board.light(volts)
    board.steps(100)
    board.converters[3].reset()
    board.steps(402)
    assert board.resets == resets + 1
    number, _, readings = readings_of(board.packets[-1])
    assert number == 0
    np.testing.assert_allclose(readings.ravel(), 100 + volts / 1.2 * 65536, atol=0.51)


def test_the_file_of_the_teensy_compiles(tmp_path):
    if shutil.which("g++") is None:
        pytest.skip("the board's file in C++ needs a compiler, g++")
    for name in ("Arduino.h", "SPI.h"):
        (tmp_path / name).write_text(ARDUINO)
    words = ["g++", "-std=gnu++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
    source = EXAMPLES / "teensy41_board.cpp"
    subprocess.run([*words, f"-I{tmp_path}", f"-I{EXAMPLES}", source], check=True)
