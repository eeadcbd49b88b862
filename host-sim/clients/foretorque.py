"""Client of a foretorque board in one file, and an example loop: read drives, sample, torque, drives, log.

    python3 foretorque.py PORT [--seconds 5] [--period-s 0.001] [--log log.csv]

Standard library and a POSIX system; the messages are those of docs/protocol.md. Put your drives in the place of
SimulatedDrives. The torque of a board adds to the position loop of the drives, which must hold the arm alone.
"""

import argparse
import binascii
import csv
import math
import os
import select
import signal
import struct
import sys
import termios
import time
import tty

VERSION = 4
ARMED, RAMP_DOWN = 1, 2  # safety states in which torque flows
UNKNOWN = -128  # temperature of a motor without a sensor
SILENCE_S = 0.05  # silence of the board that ends the torque, as that of the host does on the board (docs/safety.md)
REPLY_S = 0.01  # wait for one torque, after which the next sample follows: a board holds its torque that long
LEFT_OUT = 0.05  # share of the time that late periods may leave out


class Refused(Exception):
    """The board answered with Nack."""


def stuffed(data):
    """COBS: the data without zeros, and a zero as the end."""
    out = bytearray()
    for block in data.split(b"\0"):
        while len(block) >= 254:
            out += b"\xff" + block[:254]
            block = block[254:]
        out += bytes([len(block) + 1]) + block
    return bytes(out + b"\0")


def unstuffed(frame):
    out, place = bytearray(), 0
    while place < len(frame):
        code = frame[place]
        out += frame[place + 1 : place + code]
        place += code
        if code < 255 and place < len(frame):
            out.append(0)
    return bytes(out)


def scaled(values, size, bits):
    """Integers of `size` bytes in units of 2^-bits, saturated; NaN is the most negative one."""
    most = (1 << (8 * size - 1)) - 1
    codes = (
        -most - 1 if math.isnan(x) else math.floor(max(-most, min(most, x * (1 << bits))) + 0.5)
        for x in values
    )
    return b"".join(code.to_bytes(size, "little", signed=True) for code in codes)


class Board:
    """A board on a serial port. The constructor greets it, which disarms it."""

    def __init__(self, port, timeout_s=2.0):
        self.port = os.open(port, os.O_RDWR | os.O_NOCTTY)
        try:
            tty.setraw(self.port)
            settings = termios.tcgetattr(self.port)
            lines = termios.CLOCAL | termios.CREAD  # three wires, one stop bit
            settings[2] = (settings[2] | lines) & ~(termios.CRTSCTS | termios.CSTOPB)
            settings[4] = settings[5] = termios.B2000000
            termios.tcsetattr(self.port, termios.TCSANOW, settings)
        except termios.error as error:
            raise OSError(f"{port} is not a serial port: {error.args[-1]}") from error
        self.timeout_s, self.waiting, self.sequence, self.period = timeout_s, b"", 0, 0
        self.armed, self.answered, self.lost = False, 0.0, 0  # time of the last answer; samples without one
        self.telemetry = []  # (tick, fields, bytes) that came unasked
        os.write(self.port, b"\0")
        hello = self._ask(b"\x00", 0)
        self.arm_hash, length = struct.unpack_from("<IB", hello)
        self.arm_name = hello[5 : 5 + length].decode()
        self.joints = hello[5 + length]
        place = 7 + length
        place += 8 + hello[place]  # version, capabilities, counter
        self.configuration = hello[place : place + 8]
        self.safety = (0, 0)

    def _frame(self, deadline):
        """Sequence number, tag and content of the next sound frame."""
        late = False
        while True:
            frame, end, rest = self.waiting.partition(b"\0")
            if end:
                self.waiting = rest
                body = unstuffed(frame)
                sound = len(body) > 7 and binascii.crc32(body[:-4]) == int.from_bytes(body[-4:], "little")
                if sound and body[0] == VERSION:
                    return int.from_bytes(body[1:3], "little"), body[3], body[4:-4]
                if sound:
                    raise RuntimeError(f"the board speaks protocol version {body[0]}, this client {VERSION}")
                continue
            left = deadline - time.monotonic()
            if late or not select.select([self.port], [], [], max(0.0, left))[0]:
                silence = f"has been silent for {1e3 * SILENCE_S:.0f} ms" if self.armed else "does not answer"
                raise TimeoutError(f"the board {silence}")
            late = left <= 0  # what has come by the deadline counts, however late this program looks
            received = os.read(self.port, 4096)
            if not received:
                raise OSError("the port is gone")
            self.waiting += received

    def silent(self):
        """Whether no answer has come for so long that the torque must end."""
        return time.monotonic() - self.answered >= SILENCE_S

    def _ask(self, message, answer, wait_s=SILENCE_S):
        """Content of the answer, which must have the tag `answer`. `wait_s` bounds the wait while torque may flow."""
        self.sequence = self.sequence % 65535 + 1
        body = struct.pack("<BH", VERSION, self.sequence) + message
        os.write(self.port, stuffed(body + binascii.crc32(body).to_bytes(4, "little")))
        now = time.monotonic()
        deadline = min(now + wait_s, self.answered + SILENCE_S) if self.armed else now + self.timeout_s
        while True:
            sequence, tag, content = self._frame(deadline)
            if tag == 8:
                tick, fields, length = struct.unpack_from("<IHB", content)
                self.telemetry.append((tick, fields, content[-length:]))
            elif sequence == self.sequence and tag == 5:
                raise Refused(f"the board refused: {content.hex()} (docs/protocol.md, Nack reasons)")
            elif sequence == self.sequence and answer == 1 and tag in (2, 11):
                raise RuntimeError("the board answers in full, or plays or holds an excitation: reset it")
            elif sequence == self.sequence and tag == answer:
                self.answered = time.monotonic()
                return content
            elif tag == answer and self.armed:
                deadline = self.answered + SILENCE_S  # late: a slow link needs more than one reply's time

    def sample(self, desired, measured=None):
        """Runs a tick: `desired` is (q, qd, qdd) of the next period, `measured` (q, tau, temperatures of the motors).

        Returns the torques, N·m; None for a reply that is lost while torque may flow and the board is not silent.
        A sample carries the temperature of one joint, °C or None where it is not known.
        """
        measured_q, measured_tau, celsius = measured or ([0.0] * self.joints,) * 2 + ([None] * self.joints,)
        flags = int(measured is not None) | self.period << 3
        motor = celsius[self.period % self.joints]
        known = motor is not None and not math.isnan(motor)
        motor = math.ceil(max(-127, min(motor, 127))) if known else UNKNOWN
        self.period = (self.period + 1) % 32
        q, qd, qdd = desired
        motion = scaled(q, 3, 20) + scaled(qd, 3, 18) + scaled(qdd, 2, 9)
        effort = scaled(measured_q, 3, 20) + scaled(measured_tau, 3, 14)
        wait_s = max(REPLY_S, 1.1e-6 * struct.unpack_from("<I", self.configuration)[0])  # the timer may pace the reply
        try:
            reply = self._ask(struct.pack("<BBb", 1, flags, motor) + motion + effort, 1, wait_s)
        except TimeoutError:
            if not self.armed or self.silent():
                raise
            self.lost += 1
            return None
        self.tick, self.flags, *self.safety = struct.unpack_from("<IHBB", reply)
        return list(struct.unpack_from(f"<{self.joints}f", reply, 8))

    def configure(self, period_s):
        """Sets the period of the samples, and short replies, where they differ. Only while disarmed and with learning off."""
        period = struct.pack("<I", round(1e6 * period_s))
        wanted = period + self.configuration[4:5] + b"\0" + self.configuration[6:]
        if wanted != self.configuration:
            self._ask(b"\x03" + wanted, 4)
            self.configuration = wanted

    def arm(self, desired, measured):
        """Shows the board where the arm stands, and lets torque through."""
        for _ in range(20):
            self.sample(desired, measured)
        self.armed = True
        self._ask(b"\x0a", 4)

    def disarm(self, hold, drives):
        """Lets the torque go to zero while the drives hold the position `hold`.

        They get every torque on the way, then zero; where the board is silent, zero at once.
        """
        rest, done = [0.0] * self.joints, self.silent()
        try:
            if done:
                drives.command(hold, rest, rest)
            self._ask(b"\x0b", 4)
            while not done:
                torque = self.sample((hold, rest, rest), drives.read())
                if torque is not None:
                    drives.command(hold, rest, torque)
                    done = self.safety[0] not in (ARMED, RAMP_DOWN)
        finally:
            drives.command(hold, rest, rest)
            self.armed = False

    def learning(self, on):
        self._ask(bytes([4, on]), 4)

    def stream(self, fields, every):
        """Asks for telemetry of every `every`-th tick; it collects in `telemetry`."""
        self._ask(struct.pack("<BHH", 17, fields, every), 4)


class SimulatedDrives:
    """Drives that follow at once. Yours send q, qd and the torque to the bus; they read q, torque and temperature from it."""

    def __init__(self, q):
        self.q, self.tau, self.celsius = list(q), [0.0] * len(q), [25.0] * len(q)

    def read(self):
        return self.q, self.tau, self.celsius

    def command(self, q, qd, torque):
        self.q, self.tau = list(q), list(torque)


def motion(t_s, start):
    """Desired position, velocity, acceleration: a slow swing of every joint that begins at rest."""
    size, omega = 0.1, 2.0
    swing = size * (1.0 - math.cos(omega * t_s))
    return (
        [q + swing for q in start],
        [size * omega * math.sin(omega * t_s)] * len(start),
        [size * omega**2 * math.cos(omega * t_s)] * len(start),
    )


def positive(text):
    value = float(text)
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


def angles(text):
    values = [float(angle) for angle in text.split(",")]
    if not all(map(math.isfinite, values)):
        raise argparse.ArgumentTypeError(f"{text} has an angle that is not finite")
    return values


def drive(board, drives, start, chosen, file):
    """The example loop: arms, moves for the ticks chosen, and disarms whatever happens."""
    joints, hold = board.joints, start
    names = [("q", "rad"), ("qd", "rad_s"), ("qdd", "rad_s2"), ("tau", "nm"), ("feed_forward", "nm")]
    desired = (start, [0.0] * joints, [0.0] * joints)
    try:
        board.arm(desired, drives.read())
        if os.path.isfile(chosen.log):
            file.truncate(0)  # a log from before stays where the board refuses
        log = csv.writer(file)
        log.writerow(["t_s"] + [f"{name}{j}_{unit}" for name, unit in names for j in range(1, joints + 1)] + ["flags"])
        begin, left_out_s = time.monotonic(), 0.0
        for tick in range(chosen.ticks):
            path_s = tick * chosen.period_s
            t_s = path_s + left_out_s
            late_s = time.monotonic() - begin - t_s
            if late_s < chosen.period_s:
                time.sleep(max(0.0, -late_s))
            else:
                # Missed periods are left out: the motion goes on from where it is, and samples never come in a burst.
                t_s, left_out_s = t_s + late_s, left_out_s + late_s
                board.period = (board.period + int(late_s / chosen.period_s)) % 32
                if left_out_s > LEFT_OUT * chosen.seconds:
                    raise RuntimeError(f"link or program are too slow: {left_out_s:.3f} of {t_s:.3f} s were left out")
            measured = drives.read()
            desired = motion(path_s, start)
            torque = board.sample(desired, measured)
            if torque is None:
                continue  # the drives go on with their last command
            if board.safety[0] != ARMED:
                raise RuntimeError(
                    f"the board ended the torque: state {board.safety[0]}, reason {board.safety[1]} (docs/safety.md)"
                )
            drives.command(desired[0], desired[1], torque)
            hold = desired[0]
            # The torque acts in the next period, the measurement is from before it.
            log.writerow([t_s, *measured[0], *desired[1], *desired[2], *measured[1], *torque, board.flags])
    finally:
        board.disarm(hold, drives)


def main():
    arguments = argparse.ArgumentParser(description="Drive simulated drives with the torque of a board.")
    arguments.add_argument("port")
    arguments.add_argument("--seconds", type=positive, default=5.0)
    arguments.add_argument("--period-s", type=positive, default=1e-3)
    arguments.add_argument("--start", type=angles, help="pose, rad,...")
    arguments.add_argument("--log", default="log.csv")
    chosen = arguments.parse_args()
    for ending in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(ending, signal.default_int_handler)
    signal.signal(signal.SIGTSTP, signal.SIG_IGN)  # a program that stands still would leave the torque at the drives
    if not 1e-4 <= chosen.period_s <= 0.02:
        arguments.error(f"argument --period-s: {chosen.period_s} is not between 0.0001 and 0.02")
    chosen.ticks = round(chosen.seconds / chosen.period_s)
    if chosen.ticks == 0:
        arguments.error(f"argument --seconds: {chosen.seconds} is less than a period")
    board = Board(chosen.port)
    print(f"{board.arm_name}, {board.joints} joints")
    start = chosen.start or [0.0] * board.joints
    if len(start) != board.joints:
        arguments.error(f"argument --start: {len(start)} angles for {board.joints} joints")
    board.configure(chosen.period_s)
    with open(chosen.log, "a", newline="") as file:
        drive(board, SimulatedDrives(start), start, chosen, file)
    print(f"{chosen.ticks} ticks, {board.lost} without a reply, {chosen.log}")


if __name__ == "__main__":
    try:
        main()
    except (OSError, RuntimeError, TimeoutError, Refused) as failure:
        sys.exit(f"error: {failure}")
    except KeyboardInterrupt:
        sys.exit("error: interrupted")
