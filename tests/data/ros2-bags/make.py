"""Tables of the bags by another reader: python3 -m pip install rosbags==0.11.9 mcap==1.6.0; python3 make.py

Writes ur10.csv.gz and panda.csv.gz (joints in the order of the arm), and panda.mcap, the
messages of panda.db3 written by another writer.
"""

import gzip
import sqlite3
from pathlib import Path

from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPE = "sensor_msgs/msg/JointState"
UR10 = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
JOINTS = {
    "ur10": [f"{name}_joint" for name in UR10],
    "panda": [f"fer_joint{k}" for k in range(1, 8)],
}

for name, joints in JOINTS.items():
    bag = sqlite3.connect(f"file:{name}.db3?immutable=1", uri=True)
    rows = bag.execute("SELECT timestamp, data FROM messages ORDER BY timestamp, id").fetchall()
    header = ["t_s"]
    for quantity in ["position", "velocity", "effort"]:
        header += [f"{joint}/{quantity}" for joint in joints]
    lines, start = [",".join(header)], None
    for _, data in rows:
        message = STORE.deserialize_cdr(data, TYPE)
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        start = stamp if start is None else start
        place = [message.name.index(joint) for joint in joints]
        row = [1e-9 * (stamp - start)]
        for values in (message.position, message.velocity, message.effort):
            row += [float(values[k]) for k in place]
        lines.append(",".join(repr(value) for value in row))
    with gzip.GzipFile(f"{name}.csv.gz", "wb", mtime=0) as file:
        file.write(("\n".join(lines) + "\n").encode())
    if name == "panda":
        with Path("panda.mcap").open("wb") as file:
            writer = Writer(file)
            writer.start(profile="ros2")
            schema = writer.register_schema(TYPE, "ros2msg", b"")
            channel = writer.register_channel("/joint_states", "cdr", schema)
            for time, data in rows:
                writer.add_message(channel, time, data, time)
            writer.finish()
