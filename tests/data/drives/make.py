"""Writes the tables of this folder with the makers' and users' own clients. See README.md for versions and columns.

    pip install moteus==1.1.1 python-can==4.6.1 cantools==45.1.0 canopen==2.4.1 robstride==0.1.0 numpy tqdm
    pip install --no-deps damiao-motor==1.0.6 robstride-dynamics==0.0.1 pycybergear==1.0.0 odrive-can==2.1.0
    python make.py
"""

import struct
import types
import zlib
from importlib import metadata
from pathlib import Path

import can
import cantools
import moteus
import moteus.protocol
import robstride.client
from canopen.objectdictionary import ODVariable, datatypes
from damiao_motor.core.motor import DaMiaoMotor
from robstride_dynamics.bus import Motor, RobstrideBus

HERE = Path(__file__).resolve().parent
ROWS, KEPT = 200_000, 200
ID, HOST = 3, 0x13
MASK = (1 << 64) - 1


def splitmix(state):
    while True:
        state = (state + 0x9E3779B97F4A7C15) & MASK
        z = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
        yield z ^ (z >> 31)


def f32(value):
    return struct.unpack("<f", struct.pack("<f", value))[0]


def commands(scales):
    """Position, velocity, torque, kp and kd up to 1.2 times their scales, as f32."""
    numbers = splitmix(1)
    for _ in range(ROWS):
        shares = [(next(numbers) >> 40) / 2**24 for _ in range(5)]
        signed = [f32((2.4 * share - 1.2) * scale) for share, scale in zip(shares, scales)]
        yield signed[:3] + [f32(1.2 * share * scale) for share, scale in zip(shares[3:], scales[3:])]


class Bus(can.BusABC):
    """A bus that keeps the last message."""

    def __init__(self):
        self.sent = None

    def send(self, message, timeout=None):
        self.sent = message

    def shutdown(self):
        pass

    def __del__(self):
        pass


RobstrideBus.__del__ = lambda self: None


def damiao():
    motor = DaMiaoMotor(motor_id=ID, feedback_id=HOST, bus=Bus(), motor_type="4310")

    def command(p, v, t, kp, kd):
        return ID, bytes(motor.encode_cmd_msg(p, v, t, kp, kd))

    def reply(data):
        # Status and identifier of this drive, a temperature below 64 °C.
        data = bytes([0x10 | ID]) + data[1:6] + bytes([data[6] & 63, 0])
        state = motor.decode_sensor_feedback(data)
        return HOST, data, [state["pos"], state["vel"], state["torq"]]

    return "damiao", (12.5, 30.0, 10.0, 500.0, 5.0), command, reply, ["damiao-motor"]


def robstride_02():
    bus = RobstrideBus("none", {"joint": Motor(ID, "rs-02")})
    bus.channel_handler = Bus()
    client = robstride.client.Client(Bus(), host_can_id=HOST)

    def command(p, v, t, kp, kd):
        bus.write_operation_frame("joint", p, kp, kd, v, t)
        sent = bus.channel_handler.sent
        return sent.arbitration_id, bytes(sent.data)

    def reply(data):
        arbitration_id = 2 << 24 | 2 << 22 | ID << 8 | HOST
        message = types.SimpleNamespace(arbitration_id=arbitration_id, data=data)
        state = client._parse_feedback_resp(message, ID, 1)
        return arbitration_id, data, [state.angle, state.velocity, state.torque]

    packages = ["robstride-dynamics", "robstride"]
    return "robstride", (12.566370964050293, 44.0, 17.0, 500.0, 5.0), command, reply, packages


def moteus_with(resolution, name):
    positions, query = moteus.PositionResolution(), moteus.QueryResolution()
    for field in ("position", "velocity", "feedforward_torque", "kp_scale", "kd_scale"):
        setattr(positions, field, resolution)
    for field in ("position", "velocity", "torque"):
        setattr(query, field, resolution)
    query.voltage = moteus.IGNORE
    controller = moteus.Controller(
        id=ID, source_can_id=HOST, transport=object(), position_resolution=positions, query_resolution=query
    )

    def command(p, v, t, kp, kd):
        sent = controller.make_position(
            position=p,
            velocity=v,
            feedforward_torque=t,
            kp_scale=kp,
            kd_scale=kd,
            watchdog_timeout=0.0625,
            query=True,
        )
        # The transports pad to the next length of CAN-FD.
        data = bytes(sent.data)
        length = next(size for size in (8, 12, 16, 20, 24, 32, 48, 64) if size >= len(data))
        return 0x8000 | HOST << 8 | ID, data + b"\x50" * (length - len(data))

    def reply(data):
        values = struct.pack("<3h", *struct.unpack("<3h", data[:6]))
        data = bytes([0x21, 0, 10, 0x27, 1]) + values + bytes([0x22, 0x0E, 40, 0, 0x50])
        found = moteus.protocol.parse_reply(data)
        registers = [moteus.Register.POSITION, moteus.Register.VELOCITY, moteus.Register.TORQUE]
        return ID << 8 | HOST, data, [found[register] for register in registers]

    scales = (3.0, 10.0, 20.0, 0.8, 0.8)
    return f"moteus_{name}", scales, command, reply if name == "int16" else None, ["moteus"]


def odrive(message_name):
    package = metadata.distribution("odrive-can")
    database = cantools.database.load_file(package.locate_file("odrive_can/dbc/odrive-cansimple-0.6.10.dbc"))
    message = database.get_message_by_name(f"Axis{ID}_{message_name}")
    estimates = database.get_message_by_name(f"Axis{ID}_Get_Encoder_Estimates")
    torques = database.get_message_by_name(f"Axis{ID}_Get_Torques")
    number = ("Set_Input_Pos", "Set_Input_Vel", "Set_Input_Torque").index(message_name)

    def clip(value):
        return min(32.767, max(-32.767, value))

    def command(p, v, t, kp, kd):
        # cantools refuses what a signal cannot carry.
        fields = [
            {"Input_Pos": p, "Vel_FF": clip(v), "Torque_FF": clip(t)},
            {"Input_Vel": v, "Input_Torque_FF": t},
            {"Input_Torque": t},
        ]
        return message.frame_id, message.encode(fields[number], strict=False)

    def reply(data):
        p, v, t = (value / 997.0 for value in struct.unpack("<3h", data[:6]))
        if number == 0:
            data = estimates.encode({"Pos_Estimate": p, "Vel_Estimate": v}, strict=False)
            found = estimates.decode(data)
            return estimates.frame_id, data, [found["Pos_Estimate"], found["Vel_Estimate"], None]
        data = torques.encode({"Torque_Target": p, "Torque_Estimate": t}, strict=False)
        return torques.frame_id, data, [None, None, torques.decode(data)["Torque_Estimate"]]

    name = ("odrive_position", "odrive_velocity", "odrive_torque")[number]
    return name, (50.0, 40.0, 40.0, 1.0, 1.0), command, reply if number < 2 else None, ["cantools", "odrive-can"]


def canopen_position():
    """The variables of python-canopen encode and decode each object; CiA 301 packs them in the order of the mapping."""
    kinds = {"control": datatypes.UNSIGNED16, "position": datatypes.INTEGER32, "torque": datatypes.INTEGER16}

    def variable(name):
        made = ODVariable(name, 0x6040)
        made.data_type = kinds[name]
        return made

    control, position, torque = variable("control"), variable("position"), variable("torque")
    counts, rated = 65536.0, 12.0

    def nearest(value):
        return int(value + 0.5) if value >= 0 else -int(0.5 - value)

    def command(p, v, t, kp, kd):
        target = nearest(p * counts)
        share = max(-32767, min(32767, nearest(t * 1000.0 / rated)))
        data = control.encode_raw(0x0F) + position.encode_raw(target) + torque.encode_raw(share)
        return 0x200 + ID, data

    def reply(data):
        data = control.encode_raw(0x27) + data[2:5] + bytes([data[5] & 127]) + data[6:]
        data = data[:5] + bytes([0]) + data[6:]
        p, t = position.decode_raw(data[2:6]), torque.decode_raw(data[6:8])
        return 0x180 + ID, data, [p / counts, None, t * rated / 1000.0]

    return "cia402_position", (50.0, 40.0, 40.0, 1.0, 1.0), command, reply, ["canopen"]


def table(client):
    name, scales, command, reply, packages = client
    versions = ", ".join(f"{package} {metadata.version(package)}" for package in packages)
    lines, checksum = [], 0
    for row, values in enumerate(commands(scales)):
        arbitration_id, data = command(*values)
        checksum = zlib.crc32(struct.pack("<I", arbitration_id) + data, checksum)
        if row < KEPT:
            lines.append(f"{arbitration_id:x},{data.hex()}")
    lines.insert(0, f"# {versions}; {ROWS} commands of splitmix64(1), CRC-32 {checksum:08x}")
    numbers = splitmix(2)
    for _ in range(KEPT if reply else 0):
        arbitration_id, data, values = reply(struct.pack("<Q", next(numbers)))
        fields = ["" if value is None else repr(float(value)) for value in values]
        lines.append(",".join([f"{arbitration_id:x}", bytes(data).hex(), *fields]))
    (HERE / f"{name}.csv").write_text("\n".join(lines) + "\n")
    print(name, lines[0])


if __name__ == "__main__":
    clients = [damiao(), robstride_02(), canopen_position()]
    clients += [moteus_with(moteus.F32, "f32"), moteus_with(moteus.INT32, "int32"), moteus_with(moteus.INT16, "int16")]
    clients += [odrive(name) for name in ("Set_Input_Pos", "Set_Input_Vel", "Set_Input_Torque")]
    for client in clients:
        table(client)
