"""Bags: what is written is read back by turtleact, by rosbags and by mcap's own reader."""

import errno
import functools
import io
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Literal

import hypothesis.strategies as st
import pytest
from hypothesis import given
from mcap.writer import CompressionType
from mcap.writer import Writer as WriterOfMcap
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from turtleact.interfaces import encode, get_message
from turtleact.interfaces.standard import Time
from turtleact.recording import Bag, BagError, read
from turtleact.recording.bag_writer import BagWriter, Split
from turtleact.recording.metadata import BagInfo
from turtleact.recording.storage import Range
from turtleact.transports.base import QoS

from .bags import (
    POSE,
    START,
    STEP,
    by_mcap,
    by_rosbags,
    fill,
    message,
    of_unfinished,
    opened,
    write_bag,
)

POINT_STAMPED = get_message("geometry_msgs/msg/PointStamped")


def stamps(path, wanted=None):
    return [each.stamp for each in Bag(path).messages(wanted or Range())]


def info_of(path) -> BagInfo:
    return Bag(path).info


# --- round trips ---------------------------------------------------------------------------------


async def test_every_message_comes_back(tmp_path):
    path = write_bag(tmp_path / "run", 9)
    found = [each async for each in read(path)]
    assert [each.stamp for each in found] == [START + number * STEP for number in range(9)]
    assert [each.data for each in found] == [message(number) for number in range(9)]
    assert found[0].topic == "/fibonacci/_action/feedback"
    assert found[4].value.feedback.sequence == [4]
    assert found[5].value == POSE(x=5.0)
    assert found[5].type_name == "turtlesim/msg/Pose"


@pytest.mark.parametrize("compression", ["none", "zstd_fast", "zstd_small"])
def test_rosbags_and_mcap_read_every_message(tmp_path, compression):
    path = write_bag(tmp_path / "run", 2000, Split(compression=compression))
    expected = [
        ("/turtle1/pose" if number % 2 else "/fibonacci/_action/feedback", START + number * STEP)
        for number in range(2000)
    ]
    theirs = by_rosbags(path)
    assert [each[:2] for each in theirs] == expected
    assert theirs[4][2].feedback.sequence.tolist() == [4]
    assert theirs[5][2].x == 5.0
    raw = by_mcap(path / "run_0.mcap")
    assert [each[:2] for each in raw] == expected
    assert [each[2] for each in raw] == [message(number) for number in range(2000)]


def test_a_single_file_is_a_bag_too(tmp_path):
    path = write_bag(tmp_path / "run.mcap", 5)
    assert path.is_file()
    assert len(by_rosbags(path)) == len(stamps(path)) == 5
    assert info_of(path).distro == "turtleact"


def test_a_bag_is_split_by_size_and_by_duration(tmp_path):
    path = write_bag(tmp_path / "size", 3000, Split(max_size=50_000))
    files = [each.path for each in info_of(path).files]
    assert files == [f"size_{number}.mcap" for number in range(len(files))]
    assert len(files) > 2
    assert len(by_rosbags(path)) == len(stamps(path)) == 3000
    path = write_bag(tmp_path / "time", 25, Split(max_duration=10 * STEP))
    assert [each.count for each in info_of(path).files] == [10, 10, 5]


def test_the_description_is_that_of_the_files(tmp_path):
    path = write_bag(tmp_path / "run", 25, Split(max_duration=10 * STEP))
    described = info_of(path)
    (path / "metadata.yaml").unlink()
    seen = info_of(path)
    assert described == seen
    assert [each.count for each in seen.topics] == [13, 12]
    assert all(each.type_hash.startswith("RIHS01_") for each in seen.topics)


def test_only_what_is_asked_for_is_read(tmp_path):
    path = write_bag(tmp_path / "run", 1000)
    some = Range(START + 100 * STEP, START + 200 * STEP, "/turtle1/pose".__eq__)
    found = stamps(path, some)
    assert found == [START + number * STEP for number in range(101, 200, 2)]
    assert stamps(path, Range(START + 2000 * STEP)) == []


def test_messages_out_of_order_come_out_in_order(tmp_path):
    writer = opened(tmp_path / "run")
    for number in (3, 1, 2, 0):
        writer.write(1, START + number, START + number, message(1))
        writer.flush()
    writer.close({})
    assert stamps(tmp_path / "run") == [START, START + 1, START + 2, START + 3]


def test_an_empty_bag_can_be_read(tmp_path):
    path = write_bag(tmp_path / "run", 0)
    assert stamps(path) == by_rosbags(path) == []
    assert (info_of(path).start, info_of(path).count) == (0, 0)


# --- bags of others ------------------------------------------------------------------------------

OFFER = Qos(
    QosHistory.KEEP_LAST,
    3,
    QosReliability.BEST_EFFORT,
    QosDurability.TRANSIENT_LOCAL,
    QosTime(1, 5),
    QosTime(9223372036, 854775807),
    QosLiveliness.AUTOMATIC,
    QosTime(9223372036, 854775807),
    False,
)


def write_by_rosbags(path: Path, plugin: StoragePlugin, version: Literal[8, 9]) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(path, version=version, storage_plugin=plugin) as writer:
        one = writer.add_connection(
            "/at",
            "geometry_msgs/msg/PointStamped",
            typestore=store,
            offered_qos_profiles=[OFFER],
        )
        for number in range(5):
            value = POINT_STAMPED()
            value.header.stamp = Time(sec=number)
            value.point.x = number / 2
            writer.write(one, START + number, encode(value))


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("version", [8, 9])
async def test_bags_of_rosbags_are_read(tmp_path, plugin, version):
    path = tmp_path / "theirs"
    write_by_rosbags(path, plugin, version)
    found = [each async for each in read(path)]
    assert [each.value.point.x for each in found] == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert type(found[0].value) is POINT_STAMPED
    [topic] = info_of(path).topics
    assert (topic.name, topic.count) == ("/at", 5)
    assert topic.offers[0].qos == QoS(
        depth=3, durability="transient_local", reliability="best_effort"
    )
    assert topic.offers[0].times.deadline == 1_000_000_005
    assert topic.offers[0].times.lifespan is None
    (path / "metadata.yaml").unlink()
    assert info_of(path).count == 5
    assert info_of(path).storage == plugin.name.lower()


def test_an_old_sqlite_file_has_no_definitions(tmp_path):
    path = tmp_path / "old.db3"
    database = sqlite3.connect(path)
    database.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT,"
        " serialization_format TEXT);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,"
        " data BLOB); INSERT INTO topics VALUES(1, '/pose', 'turtlesim/msg/Pose', 'cdr');"
    )
    database.execute("INSERT INTO messages VALUES(1, 1, ?, ?)", (START, encode(POSE(x=2.0))))
    database.commit()
    database.close()
    bag = Bag(path)
    [raw] = bag.messages(Range())
    assert (raw.channel.schema.name, raw.data) == ("turtlesim/msg/Pose", encode(POSE(x=2.0)))


def test_a_compressed_bag_is_refused_with_a_way_out(tmp_path):
    path = write_bag(tmp_path / "run")
    described = path / "metadata.yaml"
    text = described.read_text().replace("compression_mode: ''", "compression_mode: FILE")
    described.write_text(text)
    with pytest.raises(BagError, match="its files are compressed: 'ros2 bag convert' can write"):
        Bag(path)


# --- what is broken ------------------------------------------------------------------------------


def test_a_killed_recorder_leaves_all_that_was_flushed(tmp_path):
    path = tmp_path / "run"
    program = (
        "import os, signal, sys; from pathlib import Path;"
        "from tests.recording.bags import fill, opened;"
        "writer = opened(Path(sys.argv[1])); fill(writer, 100); writer.flush();"
        "fill(writer, 50, 100); os.kill(os.getpid(), signal.SIGKILL)"
    )
    root = Path(__file__).parents[2]
    ended = subprocess.run([sys.executable, "-c", program, str(path)], cwd=root, check=False)
    assert ended.returncode == -9
    assert stamps(path) == [START + number * STEP for number in range(100)]
    info = info_of(path)
    assert (info.is_closed, info.distro) == (False, "turtleact")
    assert (info.count, [each.count for each in info.topics]) == (100, [50, 50])


def test_a_file_is_read_up_to_where_it_is_cut_off(tmp_path):
    whole = tmp_path / "whole.mcap"
    writer = opened(whole)
    for first in range(0, 100, 10):
        fill(writer, 10, first)
        writer.flush()
    writer.close({})
    content = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    counts = set()
    for length in range(16, len(content), 97):
        cut.write_bytes(content[:length])
        info = info_of(cut)
        assert not info.is_closed
        found = stamps(cut)
        assert found == [START + number * STEP for number in range(len(found))]
        assert len(found) == info.count
        counts.add(len(found))
    assert counts == set(range(0, 101, 10))


def test_what_is_missing_from_a_file_that_is_cut_off_is_logged_once(tmp_path, caplog):
    path = write_bag(tmp_path / "run", 100)
    assert len(stamps(path)) == 100
    assert not caplog.records
    file = path / "run_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    bag = Bag(path)
    for _ in range(2):
        assert not list(bag.messages(Range()))
    [said] = caplog.messages
    assert said == f"bag '{file}': it was not closed, so messages may be missing at its end"


def test_messages_behind_a_damaged_record_are_left_out(tmp_path, caplog):
    whole, path = tmp_path / "whole.mcap", tmp_path / "run.mcap"
    writer = opened(whole)
    fill(writer, 10)
    assert writer.waiting == 10
    writer.flush()
    assert writer.waiting == 0
    good = whole.stat().st_size
    fill(writer, 10, 10)
    writer.flush()
    content = bytearray(whole.read_bytes())
    writer.close({})
    content[good + 100] ^= 0xFF
    path.write_bytes(content)
    assert len(stamps(path)) == 10
    [said] = caplog.messages
    assert said.startswith(f"bag '{path}': a record is damaged (crc")


def test_a_damaged_chunk_is_named(tmp_path):
    path = write_bag(tmp_path / "run.mcap", 100)
    content = bytearray(path.read_bytes())
    place = content.index(message(50))
    content[place + 6] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(BagError, match=r"a chunk is damaged \(crc") as raised:
        stamps(path)
    assert str(raised.value).endswith(
        "use 'turtleact bag convert' with --playback-duration or --start-offset"
    )


@pytest.mark.parametrize("content", [b"", b"MCAP", b"\x89MCAP0\r\n", os.urandom(4000)])
def test_what_is_no_mcap_file_is_refused_or_empty(tmp_path, content):
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    if content.startswith(b"\x89MCAP0\r\n"):
        assert stamps(path) == []
    else:
        with pytest.raises(BagError, match="it is not an MCAP file"):
            Bag(path)


@pytest.mark.parametrize("content", [b"", b"not a database" * 100])
def test_what_is_no_sqlite_file_is_refused(tmp_path, content):
    path = tmp_path / "x.db3"
    path.write_bytes(content)
    with pytest.raises(BagError, match="it is not an SQLite file of rosbag2"):
        Bag(path)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "it has no 'rosbag2_bagfile_information' with the description of a bag"),
        ("a: 1", "it has no 'rosbag2_bagfile_information' with the description of a bag"),
        ("rosbag2_bagfile_information: 3", "it has no 'rosbag2_bagfile_information'"),
        ("[", r"it is not YAML: line \d, column \d: "),
        ("a: \0", "it is not YAML: "),
        (
            "rosbag2_bagfile_information: {}",
            "it does not describe a bag: 'relative_file_paths' is missing",
        ),
    ],
)
def test_a_description_that_cannot_be_read_is_named(tmp_path, text, problem):
    path = write_bag(tmp_path / "run")
    (path / "metadata.yaml").write_text(text)
    hint = "delete or rename this file to read the bag without it$"
    with pytest.raises(BagError, match=f"metadata.yaml': {problem}.*; {hint}"):
        Bag(path)


def test_what_is_not_there_is_named(tmp_path):
    with pytest.raises(BagError, match="it does not exist"):
        Bag(tmp_path / "none")
    with pytest.raises(BagError, match=r"it has neither metadata\.yaml nor files of a bag"):
        Bag(tmp_path)
    path = write_bag(tmp_path / "run")
    (path / "run_0.mcap").unlink()
    with pytest.raises(BagError, match=r"run_0\.mcap is missing; metadata\.yaml names it"):
        Bag(path)


def test_a_bag_is_never_overwritten(tmp_path):
    path = write_bag(tmp_path / "run")
    with pytest.raises(BagError, match="it exists already"):
        BagWriter(path, Split())
    with pytest.raises(BagError, match="a single file cannot be split"):
        BagWriter(tmp_path / "run.mcap", Split(max_size=1))
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match="it cannot be created"):
        BagWriter(tmp_path / "file" / "run", Split())


class Disk(io.FileIO):
    """A file on a disk with so much room for all files of a folder."""

    room = 0

    def write(self, data):
        own = Path(self.name)
        others = sum(each.stat().st_size for each in own.parent.iterdir() if each != own)
        # Bytes that the file has can be replaced.
        left = max(self.room - others, own.stat().st_size) - self.tell()
        if left <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(data[:left])


@pytest.fixture
def disk(monkeypatch):
    """Gives the disk so much room."""
    made = Path.open

    def put(room):
        def open(path, mode="r", **options):
            if mode != "xb":
                return made(path, mode, **options)
            file = Disk(path, mode)
            file.room = room
            return file

        monkeypatch.setattr(Path, "open", open)

    yield put
    monkeypatch.undo()


def fill_up(writer) -> int:
    """Write until the disk is full; return how many messages were given to the bag."""
    given = 0
    with pytest.raises(OSError, match="No space left"):  # noqa: PT012  # until it is full
        for first in range(0, 10_000, 10):
            given += 10
            fill(writer, 10, first)
            writer.flush()
    return given


@pytest.mark.parametrize("room", [20_000, 20_700, 22_400, 23_999])
def test_a_full_disk_loses_only_what_was_written_last(tmp_path, disk, room):
    disk(room)
    path = tmp_path / "run.mcap"
    writer = opened(path)
    given = fill_up(writer)
    writer.close({})
    kept = [START + number * STEP for number in range(given - 10)]
    assert stamps(path) == of_unfinished(path) == kept
    assert (writer.waiting, info_of(path).is_closed) == (10, False)


def test_without_room_for_its_head_no_file_is_left(tmp_path, disk):
    disk(0)
    with pytest.raises(BagError, match="it cannot be created: No space left"):
        BagWriter(tmp_path / "run", Split())
    with pytest.raises(BagError, match="it cannot be created: No space left"):
        BagWriter(tmp_path / "run.mcap", Split())
    assert not list(tmp_path.iterdir())


# --- descriptions --------------------------------------------------------------------------------


def test_a_folder_can_be_moved_and_renamed(tmp_path):
    path = write_bag(tmp_path / "run")
    shutil.move(path, tmp_path / "other")
    assert len(stamps(tmp_path / "other")) == 10


FILES = ("none", "zstd_fast", "lz4")


@functools.cache
def content(compression) -> bytes:
    """A file with ten chunks."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        if compression == "lz4":
            with path.open("wb") as stream:
                theirs = WriterOfMcap(stream, 100, CompressionType.LZ4)
                theirs.start("ros2")
                schema = theirs.register_schema(POSE.type_name, "ros2msg", b"float32 x")
                one = theirs.register_channel("/pose", "cdr", schema)
                for number in range(20):
                    theirs.add_message(one, number, message(1), number)
                theirs.finish()
        else:
            writer = opened(path, Split(compression=compression))
            for first in range(0, 100, 10):
                fill(writer, 10, first)
                writer.flush()
            writer.close({})
        return path.read_bytes()


@given(
    st.sampled_from(FILES),
    st.integers(0, 100_000),
    st.binary(max_size=9),
    st.integers(0, 30),
)
def test_a_damaged_file_gives_messages_or_says_what_is_wrong(file, place, put, cut):
    damaged = bytearray(content(file))
    place %= len(damaged)
    damaged[place : place + cut] = put
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        path.write_bytes(damaged)
        try:
            bag = Bag(path)
        except BagError:
            return
        try:
            assert sum(1 for _ in bag.messages(Range())) <= 120
        except BagError as error:
            said = str(error)
        else:
            said = "is damaged"
    assert "is damaged" in said


@pytest.mark.parametrize("place", [-28, -100])
def test_a_file_with_a_damaged_index_is_looked_through(tmp_path, place):
    path = write_bag(tmp_path / "run.mcap", 20)
    damaged = bytearray(path.read_bytes())
    damaged[place : place + 8] = b"\xff" * 8
    path.write_bytes(damaged)
    assert len(stamps(path)) == info_of(path).count == 20


def test_a_description_that_cannot_be_written_leaves_the_files(tmp_path, monkeypatch):
    def replace(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    writer = opened(tmp_path / "run")
    fill(writer, 10)
    monkeypatch.setattr(Path, "replace", replace)
    with pytest.raises(OSError, match="No space left"):
        writer.close({})
    assert [each.name for each in (tmp_path / "run").iterdir()] == ["run_0.mcap"]
    assert len(stamps(tmp_path / "run")) == 10


def test_a_bag_of_many_files_is_read_in_the_order_of_their_numbers(tmp_path):
    path = write_bag(tmp_path / "run", 24, Split(max_duration=2 * STEP))
    (path / "metadata.yaml").unlink()
    assert [each.path for each in info_of(path).files][9:] == [
        "run_9.mcap",
        "run_10.mcap",
        "run_11.mcap",
    ]
    assert stamps(path) == [START + number * STEP for number in range(24)]
