"""Bags as they come back from sea: without metadata, cut off, of both storages."""

import binascii
import re
import shutil

import numpy as np
import pytest
from bags import image_message, write_bag
from hypothesis import given, settings
from hypothesis import strategies as st
from needs import rosbags

from uuv_optical_array.forward.array import ArraySettings
from uuv_optical_array.recording.bag import BagWriter, opened
from uuv_optical_array.recording.images import read_recording

pytestmark = rosbags
IMAGES, SIDE = 30, 300  # 180 kB each: six to a chunk
ARRAY = ArraySettings("planar", SIDE)
IMAGES_OF_ALL = {"/array/image": "sensor_msgs/msg/Image"}


def image(i):
    return np.full((SIDE, SIDE), i)


@pytest.fixture(scope="module")
def sent():
    return [image_message(10**9 + i * 10**8, image(i)) for i in range(IMAGES)]


@pytest.fixture(scope="module")
def whole(sent, tmp_path_factory):
    """The bytes of an MCAP file of several chunks, and where each image ends in it."""
    folder = write_bag(tmp_path_factory.mktemp("whole") / "drive", sent, "MCAP")
    data = (folder / "drive.mcap").read_bytes()
    ends = [data.index(message) + len(message) for _, message in sent]
    return data, ends


def read(path):
    found = read_recording(path, ARRAY, poses_needed=False)
    return found.images[:, 0, 0].astype(int).tolist(), dict(found.refused)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_a_folder_without_metadata_is_read_by_its_files(sent, tmp_path, storage):
    """Of two splits, as a recorder that is killed leaves them."""
    first = write_bag(tmp_path / "first", sent[:20], storage)
    second = write_bag(tmp_path / "second", sent[20:], storage, times=range(21, 31))
    for file in second.iterdir():
        file.rename(first / file.name)
    (first / "metadata.yaml").unlink()
    assert read(first) == (list(range(IMAGES)), {})


@settings(max_examples=10)
@given(st.data())
def test_of_a_file_that_is_cut_off_all_that_is_whole_is_read(whole, tmp_path_factory, data):
    content, ends = whole
    cut = data.draw(st.integers(ends[0], ends[-1] + 2000) | st.sampled_from(ends))
    folder = tmp_path_factory.mktemp("cut")
    (folder / "drive.mcap").write_bytes(content[:cut])
    expected = sum(end <= cut for end in ends)
    lost = {"the end of drive.mcap, which is cut off or damaged": 1}
    assert read(folder) == (list(range(expected)), lost)
    assert read(folder / "drive.mcap") == (list(range(expected)), lost)


@pytest.mark.parametrize("packed", [False, True])
def test_a_file_that_is_cut_off_is_read_in_the_order_of_its_times(tmp_path, packed):
    """A recorder writes messages nearly in that order, of one topic after those of another.

    The metadata beside the file are of more than there is.
    """
    rng = np.random.default_rng(3)
    times = (np.arange(200) * 10**8 + rng.integers(0, 9 * 10**8, 200)).tolist()
    sent = [image_message(time + 1, np.full((100, 100), i)) for i, time in enumerate(times)]
    bag = write_bag(tmp_path / "drive", sent, "MCAP", packed=packed, times=times)
    file = bag / "drive.mcap"
    file.write_bytes(file.read_bytes()[:-9])
    with opened(bag) as held:
        found = [(time, message.data[0]) for time, _, message in held.messages(IMAGES_OF_ALL)]
        assert dict(held.lost) == {"the end of drive.mcap, which is cut off or damaged": 1}
    assert found == sorted((time, i) for i, time in enumerate(times))


def test_of_packed_chunks_the_whole_ones_are_read(tmp_path):
    noise = np.random.default_rng(1)  # which no packing makes small
    sent = [image_message(10**9 + i, noise.integers(0, 65535, (SIDE, SIDE))) for i in range(12)]
    bag = write_bag(tmp_path / "packed", sent, "MCAP", packed=True)
    file = bag / "packed.mcap"
    file.write_bytes(file.read_bytes()[: 180_000 * 11])
    found = read_recording(bag, ARRAY, poses_needed=False)
    assert len(found.images) == 6
    assert np.isnan(found.poses).all()
    assert np.isnan(found.rolls).all()


@pytest.mark.parametrize("length", [0, 4, 8, 60, 5000])
@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_a_file_without_a_whole_message_is_refused_in_a_line(sent, tmp_path, storage, length):
    bag = write_bag(tmp_path / "drive", sent[:1], storage)
    (file,) = bag.glob("drive.*")
    file.write_bytes(file.read_bytes()[:length])
    with pytest.raises(ValueError, match=r"drive") as told:
        read(file)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("share", [0.3, 0.95])
def test_a_database_that_is_cut_off_is_refused_with_the_cure(tmp_path, share):
    sent = [image_message(10**9 + i, np.full((5, 5), i)) for i in range(1000)]
    bag = write_bag(tmp_path / "drive", sent)
    file = bag / "drive.db3"
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    for path in (bag, file):
        cure = f"sqlite3 {file} .recover | sqlite3 NEW.db3"
        with pytest.raises(ValueError, match=re.escape(cure)):
            read(path)


def test_what_is_written_is_a_bag_even_where_the_run_ends_badly(sent, tmp_path):
    def written():
        with BagWriter(tmp_path / "bag") as bag:
            for i, (topic, data) in enumerate(sent[:3]):
                bag.write(topic, "sensor_msgs/msg/Image", i, data)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        written()
    assert (tmp_path / "bag" / "metadata.yaml").is_file()
    assert read(tmp_path / "bag") == ([0, 1, 2], {})
    with pytest.raises(ValueError, match="it exists"):
        BagWriter(tmp_path / "bag")
    with opened(tmp_path / "bag") as held:
        found = [message.header.stamp.nanosec for *_, message in held.messages(IMAGES_OF_ALL)]
    assert found == [0, 10**8, 2 * 10**8]


@pytest.fixture(scope="module")
def own(sent, tmp_path_factory):
    """A bag of two chunks that this package wrote, and where they are in its file."""
    folder = tmp_path_factory.mktemp("own") / "own"
    with BagWriter(folder) as bag:
        for i, (topic, data) in enumerate(sent[:9]):
            bag.write(topic, "sensor_msgs/msg/Image", i, data)
    content = (folder / "own.mcap").read_bytes()
    first, last = (content.index(data) for _, data in (sent[0], sent[8]))
    return folder, (first - 31, last + len(sent[8][1]))


def test_what_is_written_has_checksums_by_the_specification(own):
    content = (own[0] / "own.mcap").read_bytes()
    place, chunks = 8, 0
    while content[place] != 0x0F:
        kind, length = content[place], int.from_bytes(content[place + 1 : place + 9], "little")
        if kind == 6:  # two times, size, checksum, no compression, size
            body = content[place + 9 : place + 9 + length]
            assert int.from_bytes(body[24:28], "little") == binascii.crc32(body[40:]) != 0
            chunks += 1
        place += 9 + length
    start = int.from_bytes(content[-28:-20], "little")
    assert int.from_bytes(content[-12:-8], "little") == binascii.crc32(content[start:-12])
    assert chunks == 2
    assert read(own[0]) == (list(range(9)), {})


@settings(max_examples=30)
@given(st.data())
def test_of_an_own_bag_that_is_damaged_nothing_false_is_read(own, tmp_path_factory, data):
    folder, (first, last) = own
    damaged = tmp_path_factory.mktemp("damaged") / "own"
    shutil.copytree(folder, damaged)
    file = damaged / data.draw(st.sampled_from(["own.mcap", "own.mcap", "metadata.yaml"]))
    content = bytearray(file.read_bytes())
    place = len(content) - data.draw(st.integers(1, len(content)) | st.integers(1, 2500))
    place = max(place, 0)
    flipped = data.draw(st.integers(0, 8))  # 8: cut off
    if flipped < 8:
        content[place] ^= 1 << flipped
    file.write_bytes(content[: None if flipped < 8 else place])
    told = ""
    try:
        numbers, refused = read(damaged)
    except ValueError as error:
        told = str(error)
    assert "\n" not in told
    if told:
        return
    assert not (flipped < 8 and file.suffix == ".mcap" and first <= place < last)
    assert numbers == list(range(len(numbers)))
    assert len(numbers) == 9 or refused


def test_a_damaged_chunk_of_a_file_that_is_cut_off_is_noticed_too(own, tmp_path):
    folder, (first, _) = own
    content = bytearray((folder / "own.mcap").read_bytes())
    content[first + 1000] ^= 1
    (tmp_path / "cut.mcap").write_bytes(content[:-20])
    with pytest.raises(ValueError, match=r"cut.mcap: a chunk is damaged"):
        read(tmp_path / "cut.mcap")


def test_of_a_damaged_summary_nothing_is_believed(own, tmp_path):
    """Else the messages before the time at which a chunk is said to begin would be missing."""
    folder, _ = own
    content = bytearray((folder / "own.mcap").read_bytes())
    place = int.from_bytes(content[-28:-20], "little")
    while content[place] != 8:  # the index of a chunk, which begins with that time
        place += 9 + int.from_bytes(content[place + 1 : place + 9], "little")
    content[place + 9] ^= 4
    (tmp_path / "own.mcap").write_bytes(content)
    lost = {"the end of own.mcap, which is cut off or damaged": 1}
    assert read(tmp_path / "own.mcap") == (list(range(9)), lost)


def test_a_summary_that_is_said_to_begin_beyond_the_end_is_none(own, tmp_path):
    folder, _ = own
    content = bytearray((folder / "own.mcap").read_bytes())
    content[-28:-20] = b"\xff" * 8
    (tmp_path / "own.mcap").write_bytes(content)
    lost = {"the end of own.mcap, which is cut off or damaged": 1}
    assert read(tmp_path / "own.mcap") == (list(range(9)), lost)
