"""Of bags that are odd or damaged each message is read, or counted as left out, or all is refused.

Public reports of other readers name most of these kinds.
"""

import shutil
import sqlite3

import numpy as np
import pytest
from bags import TYPES, image_message, odometry_message, write_bag
from needs import rosbags

from uuv_optical_array.forward.array import ArraySettings
from uuv_optical_array.recording.images import read_recording

pytestmark = rosbags
SENT = [image_message(10**9 + i * 10**8, np.full((5, 5), i)) for i in range(12)]
ALL, IMAGE = list(range(len(SENT))), TYPES["image"]
FOREIGN = "proto", "protobuf", b"no definition that a robot knows", "/sonar", "protobuf"


def database(path):
    (file,) = path.glob("*.db3")
    return file


def changed(path, old, new, name="metadata.yaml"):
    """Change words in a file of a bag."""
    text = (path / name).read_text("utf-8")
    assert old in text
    (path / name).write_text(text.replace(old, new), "utf-8")
    return path


def mcap_bag(path, schemas=(), sent=SENT, definition=None, **how):
    """Write an MCAP file by another library, with channels of given schemas beside the images.

    A schema is a name, an encoding, a definition, a topic and the encoding of its messages.
    """
    from mcap.writer import IndexType, Writer

    path.mkdir()
    with (path / "odd.mcap").open("wb") as file:
        if "index_types" in how:
            how["index_types"] = IndexType[how["index_types"]]
        writer = Writer(file, **how)
        writer.start("ros2")
        for kind, encoding, text, topic, packing in schemas:
            schema = writer.register_schema(kind, encoding, text) if kind else 0
            channel = writer.register_channel(topic, packing, schema)
            writer.add_message(channel, 1, b"what is it", 1)
        given = ("ros2msg", definition) if definition else ("", b"")
        channel = writer.register_channel(
            "/array/image", "cdr", writer.register_schema(IMAGE, *given)
        )
        for at, (_, data) in enumerate(sent, start=2):
            writer.add_message(channel, at, data, at)
        writer.finish()
    return path


def read(path, **how):
    """Return the numbers of the images, and what was left out."""
    found = read_recording(path, ArraySettings("planar", 5), poses_needed=False, **how)
    return found.images[:, 0, 0].astype(int).tolist(), dict(found.refused)


def wal_beside(path):
    """A recorder that is killed leaves the newest messages in a file beside the database."""
    file = database(write_bag(path / "whole", SENT[:6]))
    writer = sqlite3.connect(file)
    writer.execute("PRAGMA journal_mode=WAL")
    for _, data in SENT[6:]:
        writer.execute(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (1, 99, ?)", (data,)
        )
    writer.commit()
    shutil.copytree(file.parent, path / "killed")
    writer.close()
    (path / "killed" / "metadata.yaml").unlink()
    return path / "killed"


def journal_beside(path):
    """One that is killed amid a transaction leaves a part of it, and how the pages were before."""
    many = [odometry_message("/other/odometry", i, (0, 0, 0), (0, 0, 0, 1)) for i in range(200)]
    file = database(write_bag(path / "whole", [*SENT, *many]))
    before = file.read_bytes()
    writer = sqlite3.connect(file)
    writer.execute("PRAGMA cache_size=1")
    writer.execute("UPDATE messages SET data = zeroblob(length(data))")
    assert file.read_bytes()[: len(before)] != before
    shutil.copytree(file.parent, path / "killed")
    writer.close()
    assert (path / "killed" / f"{file.name}-journal").stat().st_size > 512
    return path / "killed"


QOS = (
    "- {history: 1, depth: 5, reliability: 1, durability: 2, deadline: {sec: 0, nsec: 0}, lifespan:"
    " {sec: 0, nsec: 0}, liveliness: 1, liveliness_lease_duration: {sec: 0, nsec: 0},"
    " avoid_ros_namespace_conventions: false}"
)


def other_qos(path):
    """In the metadata it is that of the publishers that came later."""
    bag = write_bag(path / "bag", SENT)
    with sqlite3.connect(database(bag)) as file:
        file.execute("UPDATE topics SET offered_qos_profiles = ?", (QOS,))
    return bag


def named(name):
    def made(path):
        bag = write_bag(path / "bag", SENT).rename(path / name)
        database(bag).rename(bag / f"{name}.db3")
        return bag

    return made


def metadata(change):
    def made(path):
        bag = write_bag(path / "bag", SENT, "MCAP")
        text = (bag / "metadata.yaml").read_text("utf-8")
        (bag / "metadata.yaml").write_text(change(text), "utf-8")
        return bag

    return made


def packed_file(storage):
    def made(path):
        import zstandard

        bag = write_bag(path / "bag", SENT, storage)
        (bag / "metadata.yaml").unlink()
        (file,) = bag.iterdir()
        file.with_name(f"{file.name}.zstd").write_bytes(zstandard.compress(file.read_bytes()))
        file.unlink()
        return bag

    return made


def packed_messages(path):
    import zstandard

    return mcap_bag(path / "bag", sent=[(t, zstandard.compress(data)) for t, data in SENT])


def beside(*schemas, **how):
    return lambda path: mcap_bag(path / "bag", schemas, **how)


WHOLE = {
    "wal": wal_beside,
    "journal": journal_beside,
    "other qos": other_qos,
    "hash in the name": named("dive #3"),
    "question mark in the name": named("why?.x"),
    "percent in the name": named("50%20"),
    "no storage identifier": metadata(lambda text: text.replace(" mcap\n", " ''\n")),
    "newer metadata": metadata(lambda text: text.replace("version: 9", "version: 77")),
    "packed mcap without metadata": packed_file("MCAP"),
    "packed database without metadata": packed_file("SQLITE3"),
    "packed messages without metadata": packed_messages,
    "protobuf": beside(FOREIGN),
    "json": beside(("shape", "jsonschema", b"{}", "/shape", "json")),
    "no schema": beside(("", "", b"", "/raw", "bytes")),
    "garbled schema": beside(("a_msgs/msg/B", "ros2msg", b"\xff int= 7 [", "/b", "cdr")),
    "schema without its parts": beside(("a_msgs/msg/B", "ros2msg", b"c_msgs/D d", "/b", "cdr")),
    "service events": beside(
        ("a_msgs/srv/S_Event", "ros2idl", b"module a_msgs {", "/s/_service_event", "cdr")
    ),
    "image without its header": beside(definition=b"std_msgs/Header header\nuint32 height"),
    "no index": beside(use_chunking=False),
    "no summary": beside(use_statistics=False, use_summary_offsets=False),
    "no repeated channels": beside(repeat_channels=False),
    "no message index": beside(index_types="CHUNK"),
}


@pytest.mark.parametrize("make", WHOLE.values(), ids=WHOLE)
def test_what_is_whole_is_read_whole(make, tmp_path):
    assert read(make(tmp_path)) == (ALL, {})


@pytest.mark.parametrize("change", [lambda _: "", lambda text: text[: len(text) // 2]])
def test_metadata_that_cannot_be_read_hide_nothing_and_are_named(change, tmp_path):
    numbers, left_out = read(metadata(change)(tmp_path))
    assert numbers == ALL
    assert [*left_out] == ["the counts of metadata.yaml, which cannot be read"]


def test_of_a_split_that_is_missing_the_messages_are_counted(tmp_path):
    bag = write_bag(tmp_path / "bag", SENT[:7])
    changed(bag, "message_count: 7", "message_count: 12")
    assert read(bag) == (ALL[:7], {"/array/image: counted in metadata.yaml, but in no file": 5})


def test_a_file_of_another_bag_is_not_mixed_in_and_is_named(tmp_path):
    bag, other = write_bag(tmp_path / "bag", SENT), write_bag(tmp_path / "other", SENT[:3])
    database(other).rename(bag / "other.db3")
    assert read(bag) == (ALL, {"other.db3, which metadata.yaml does not name": 1})


def test_images_of_another_type_on_the_same_topic_are_counted(tmp_path):
    packed = "sensor_msgs/msg/CompressedImage", "ros2msg", b"", "/array/image", "cdr"
    as_json = IMAGE, "jsonschema", b"{}", "/array/image", "json"
    bag = mcap_bag(tmp_path / "bag", [packed, as_json])
    assert read(bag) == (
        ALL,
        {
            "/array/image: sensor_msgs/msg/CompressedImage in cdr, not sensor_msgs/msg/Image": 1,
            "/array/image: sensor_msgs/msg/Image in json, not sensor_msgs/msg/Image": 1,
        },
    )


def test_commands_and_states_of_another_type_are_counted(tmp_path):
    bare = "geometry_msgs/msg/Twist", "ros2msg", b"", "/cmd_vel", "cdr"
    text = "std_msgs/msg/String", "ros2msg", b"", "/follow_state", "cdr"
    _, left_out = read(mcap_bag(tmp_path / "bag", [bare, text]))
    assert sorted(left_out.values()) == [1, 1]
    assert {key.partition(":")[0] for key in left_out} == {"/cmd_vel", "/follow_state"}


def test_a_message_that_is_garbled_is_left_out_and_counted(tmp_path):
    sent = [*SENT]
    sent[3], sent[5] = ("/array/image", sent[3][1][:20]), ("/array/image", b"")
    numbers, left_out = read(write_bag(tmp_path / "bag", sent))
    assert numbers == [i for i in ALL if i not in (3, 5)]
    assert left_out == {"/array/image: not a message of its type": 2}


def test_two_messages_of_one_stamp_are_one_and_the_other_is_counted(tmp_path):
    place, level = (1, 2, 3), (0, 0, 0, 1)
    poses = [odometry_message("/leader/odometry", 10**9, place, level)] * 3
    bag = write_bag(tmp_path / "bag", [SENT[0], SENT[0], *poses, *SENT[1:]])
    expected = {"/array/image: duplicate stamp": 1, "/leader/odometry: duplicate stamp": 2}
    assert read(bag) == (ALL, expected)


def test_a_database_whose_index_lacks_rows_does_not_hide_them(tmp_path):
    bag = write_bag(tmp_path / "bag", SENT)
    with sqlite3.connect(database(bag)) as file:
        file.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (77, 1, x'00')")
    assert read(bag) == (ALL, {"messages of no topic": 1})
