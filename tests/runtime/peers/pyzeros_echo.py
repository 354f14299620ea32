"""Echoes strings and images through pyzeros, whose keys and CDR are its own: `pyzeros_echo.py PORT`."""

import json
import os
import sys
import warnings

import zenoh

warnings.simplefilter("ignore")
from pyzeros.pub import Pub  # noqa: E402 (its imports warn)
from pyzeros.session import Session  # noqa: E402
from pyzeros.sub import RawSub  # noqa: E402
from ros2_pyterfaces.cydr.all_msgs import JointState, String  # noqa: E402

config = zenoh.Config()
config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{sys.argv[1]}"]))
config.insert_json5("listen/endpoints", json.dumps(["tcp/127.0.0.1:0"]))
config.insert_json5("scouting/multicast/enabled", "false")
node = Session("pyzeros_peer", zenoh.open(config))
strings, joints = (
    Pub(String, "/from_peer", session=node, scope=None),
    Pub(JointState, "/joints_back", session=node, scope=None),
)


def echo(sample: zenoh.Sample) -> None:
    text = String.deserialize(bytes(sample.payload)).data
    text = text if isinstance(text, bytes) else text.encode()
    strings.publish(String(data=b"echo " + text))


def echo_joints(sample: zenoh.Sample) -> None:
    joints.publish(JointState.deserialize(bytes(sample.payload)))


listeners = [
    RawSub(String, "/to_peer", echo, session=node, scope=None),
    RawSub(JointState, "/joints", echo_joints, session=node, scope=None),
]
# Its codecs, the attachment's too, are generated and compiled at first use.
assert String.deserialize(String(data=b"x").serialize()).data
JointState.deserialize(JointState().serialize())
strings.publish(String(data=b"compiled"))
print("ready", flush=True)
sys.stdin.read()
os._exit(0)
