"""Bags of the rosbag2 test suite: every well-formed one is read, every wrong one refused in one line."""

from pathlib import Path

import pytest

from twin_node.bag import BagError, open_log
from twin_node.messages import MessageError

BAGS = Path(__file__).resolve().parents[3] / "shared" / "data" / "rosbag2_bags"
pytestmark = pytest.mark.skipif(not BAGS.is_dir(), reason=f"no rosbag2 bags at {BAGS}")

COUNTS = {
    "mcap/bag_with_topics_and_service_events": 10,
    "mcap/bags/only_services.mcap": 12,
    "mcap/bags/only_topics.mcap": 7,
    "mcap/bags/topics_and_services.mcap": 13,
    "mcap/cdr_test": 7,
    "mcap/convert_a": 150,
    "mcap/convert_b": 75,
    "mcap/multiple_files/multiple_files_0.mcap": 1324,
    "mcap/multiple_files/multiple_files_1.mcap": 1324,
    "mcap/multiple_files/multiple_files_2.mcap": 529,
    "mcap/talker": 20,
    "mcap/wbag": 6074,
    "sqlite3/bag_with_topics_and_service_events": 10,
    "sqlite3/bags/topics_and_services.db3": 13,
    "sqlite3/cdr_test": 7,
    "sqlite3/convert_a": 150,
    "sqlite3/convert_b": 75,
    "sqlite3/multiple_files/multiple_files_0.db3": 1324,
    "sqlite3/multiple_files/multiple_files_1.db3": 1324,
    "sqlite3/multiple_files/multiple_files_2.db3": 529,
    "sqlite3/talker": 20,
    "sqlite3/wbag": 6074,
}
"""Messages of every well-formed bag, as its metadata or its statistics tell."""

WRONG = {
    "mcap/bags": r"no metadata\.yaml",
    "mcap/multiple_files": r"no metadata\.yaml",
    "mcap/wrong_rmw_test": "expected messages in cdr, found wrong_format",
    "mcap/wrong_rmw_test/wrong_rmw_test_0.mcap": "expected messages in cdr, found wrong_format",
    "sqlite3/bags": r"no metadata\.yaml",
    "sqlite3/empty_bag": "holds no messages",
    "sqlite3/empty_bag/empty_bag_0.db3": "holds no messages",
    "sqlite3/multiple_files": r"no metadata\.yaml",
    "sqlite3/wrong_rmw_test": "expected messages in cdr, found wrong_format",
}

UNDEFINED = ("test_msgs/", "example_interfaces/srv/")
"""Packages of types whose definitions some of the bags do not carry."""


def test_every_bag_of_the_suite_is_covered() -> None:
    folders = {str(path.relative_to(BAGS)) for path in BAGS.glob("*/*")}
    named = {"/".join(name.split("/")[:2]) for name in (*COUNTS, *WRONG)}
    assert folders == named


@pytest.mark.parametrize("name", COUNTS)
def test_well_formed_bags_are_read_whole_and_in_order(name: str) -> None:
    with open_log(BAGS / name) as log:
        messages = list(log.messages())
        assert len(messages) == COUNTS[name] == sum(topic.count for topic in log.topics)
        stamps = [message.stamp for message in messages]
        assert stamps == sorted(stamps)
        assert (log.start_ns, log.end_ns) == (stamps[0], stamps[-1])
        assert log.damage is None
        for message in messages:
            if message.msgtype in message.types:
                assert message.message.__msgtype__ == message.msgtype
            else:
                assert message.msgtype.startswith(UNDEFINED)
                with pytest.raises(MessageError, match=message.msgtype):
                    _ = message.message


@pytest.mark.parametrize("name", WRONG)
def test_wrong_bags_are_refused_in_one_line(name: str) -> None:
    with pytest.raises(BagError, match=WRONG[name]) as caught:
        open_log(BAGS / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_both_storages_hold_the_same_messages() -> None:
    def content(storage: str) -> list[tuple[str, int, bytes]]:
        with open_log(BAGS / storage / "wbag") as log:
            return sorted((message.topic, message.stamp, bytes(message.data)) for message in log.messages())

    assert content("mcap") == content("sqlite3")


def test_types_of_the_log_itself_are_used() -> None:
    with open_log(BAGS / "mcap" / "cdr_test") as log:
        message = next(log.messages(["/test_topic"])).message
        assert isinstance(message.float64_value, float)
