"""Writes the tables of this folder with Pinocchio. See README.md for versions, frames and tolerances.

    python make.py arms     # the ten random arms: arms/*.toml
    python make.py tables   # tables of every arm: *.csv.gz
"""

import gzip
import io
import math
import sys
import tomllib
from pathlib import Path

import numpy as np
import pinocchio as pin

HERE = Path(__file__).resolve().parent
ROBOTS = HERE.parents[2] / "host-sim" / "robots"
SEED = 20250917
UR5_STATES, OTHER_STATES = 2000, 200
RANDOM_ARMS = [(f"random_{n}_{letter}", n) for n in (1, 2, 4, 6, 7) for letter in "ab"]


def rpy_placement(xyz, rpy):
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz, dtype=float))


def inertia_matrix(entries):
    xy, xz, yz = (entries.get(key, 0.0) for key in ("xy", "xz", "yz"))
    xx, yy, zz = entries["xx"], entries["yy"], entries["zz"]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def model_from_toml(path):
    """A description of host-sim as a Pinocchio model whose joint frames are Craig's: joint i turns about its own z."""
    description = tomllib.loads(path.read_text())
    model = pin.Model()
    model.name = description["name"]
    gravity = description.get("gravity_m_s2", [0.0, 0.0, -9.81])
    model.gravity = pin.Motion(np.array(gravity), np.zeros(3))
    parent, link_end = 0, pin.SE3.Identity()
    for joint in description["joints"]:
        if "dh" in joint:
            # Standard DH: Rz(q) Tz(d) belongs to the joint, Tx(a) Rx(alpha) to the far end of its link.
            dh = joint["dh"]
            placement = link_end * pin.SE3(np.eye(3), np.array([0.0, 0.0, dh["d_m"]]))
            link_end = rpy_placement([dh["a_m"], 0.0, 0.0], [dh["alpha_rad"], 0.0, 0.0])
        else:
            placement = link_end * rpy_placement(joint["frame"]["xyz_m"], joint["frame"]["rpy_rad"])
            link_end = pin.SE3.Identity()
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, joint["name"])
        link = joint["link"]
        body = pin.Inertia(link["mass_kg"], np.array(link["com_m"]), inertia_matrix(link["inertia_kg_m2"]))
        model.appendBodyToJoint(parent, body, link_end)
        model.armature[parent - 1] = joint["drive"].get("rotor_inertia_kg_m2", 0.0)
    ranges = [joint["limits"]["position_rad"] for joint in description["joints"]]
    return model, ranges


def model_from_urdf(path):
    model = pin.buildModelFromUrdf(str(path))
    # A continuous joint is (cos q, sin q) to Pinocchio; `configuration` below converts.
    return model, [[-math.pi, math.pi]] * model.nv


def configuration(model, q):
    angles = []
    for joint, angle in zip(list(model.joints)[1:], q):
        angles += [angle] if joint.nq == 1 else [math.cos(angle), math.sin(angle)]
    return np.array(angles)


def states(ranges, count, seed):
    """Random states that f32 holds exactly, so that the board is judged on its arithmetic, not on rounded inputs."""
    random = np.random.default_rng(seed)
    n = len(ranges)
    low, high = np.array(ranges).T
    q = random.uniform(low, high, (count, n))
    qd = random.uniform(-math.pi, math.pi, (count, n))
    qdd = random.uniform(-10.0, 10.0, (count, n))
    return tuple(x.astype(np.float32).astype(np.float64) for x in (q, qd, qdd))


def regressor_is_comparable(model):
    """The regressor is expressed in joint frames: they are ours only where the joint axis is z."""
    return all(joint.shortname().endswith("RZ") for joint in list(model.joints)[1:])


def table(model, ranges, count, seed):
    data = model.createData()
    n = model.nv
    upper = [(i, j) for i in range(n) for j in range(i, n)]
    rows, regressor_rows = [], []
    for q, qd, qdd in zip(*states(ranges, count, seed)):
        at = configuration(model, q)
        tau = pin.rnea(model, data, at, qd, qdd).copy()
        bias = pin.nonLinearEffects(model, data, at, qd).copy()
        gravity = pin.computeGeneralizedGravity(model, data, at).copy()
        mass = np.triu(pin.crba(model, data, at))
        mass = mass + np.triu(mass, 1).T
        # The armature must be in M and in tau alike, whatever a version of Pinocchio does.
        assert np.allclose(mass @ qdd + bias, tau, rtol=0.0, atol=1e-9), "rotor inertia is not in both M and tau"
        rows.append([*q, *qd, *qdd, *tau, *gravity, *(mass[i, j] for i, j in upper)])
        if regressor_is_comparable(model):
            regressor = np.atleast_2d(pin.computeJointTorqueRegressor(model, data, at, qd, qdd))
            inertial = np.concatenate([model.inertias[k].toDynamicParameters() for k in range(1, n + 1)])
            rotor = np.array(model.armature) * qdd
            assert np.allclose(regressor @ inertial + rotor, tau, rtol=0.0, atol=1e-9)
            # Joint j feels links j, j + 1, ...: the other columns are zero and left out.
            regressor_rows.append([regressor[j, c] for j in range(n) for c in range(10 * j, 10 * n)])
    joints = range(1, n + 1)
    header = [f"q{j}_rad" for j in joints] + [f"qd{j}_rad_s" for j in joints] + [f"qdd{j}_rad_s2" for j in joints]
    header += [f"tau{j}_nm" for j in joints] + [f"gravity{j}_nm" for j in joints]
    header += [f"m{i + 1}_{j + 1}_kg_m2" for i, j in upper]
    names = ["m", "mx", "my", "mz", "ixx", "ixy", "iyy", "ixz", "iyz", "izz"]
    regressor_header = [f"y{j}_{names[c % 10]}{c // 10 + 1}" for j in joints for c in range(10 * (j - 1), 10 * n)]
    return (header, rows), (regressor_header, regressor_rows)


def write_csv_gz(path, header, rows, format_number):
    text = io.StringIO()
    text.write(",".join(header) + "\n")
    for row in rows:
        text.write(",".join(format_number(float(value)) for value in row) + "\n")
    with path.open("wb") as raw, gzip.GzipFile(filename="", fileobj=raw, mode="wb", compresslevel=9, mtime=0) as packed:
        packed.write(text.getvalue().encode())


def exact(value):
    return repr(value).removesuffix(".0")


def eleven_decimals(value):
    text = f"{value:.11f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def write_tables():
    arms = [("ur5", ROBOTS / "ur5.toml"), ("panda", ROBOTS / "panda.urdf"), ("oblique", HERE / "arms" / "oblique.urdf")]
    arms += [(name, HERE / "arms" / f"{name}.toml") for name, _ in RANDOM_ARMS]
    for index, (name, path) in enumerate(arms):
        model, ranges = model_from_toml(path) if path.suffix == ".toml" else model_from_urdf(path)
        count = UR5_STATES if name == "ur5" else OTHER_STATES
        (header, rows), (regressor_header, regressor_rows) = table(model, ranges, count, [SEED, index])
        write_csv_gz(HERE / f"{name}.csv.gz", header, rows, exact)
        if regressor_rows:
            write_csv_gz(HERE / f"{name}_regressor.csv.gz", regressor_header, regressor_rows, eleven_decimals)
        print(f"{name}: {model.nv} joints, {len(rows)} states", file=sys.stderr)


def random_link(random, reach):
    """A box of random size and density somewhere along the link, turned at random: a body by construction."""
    size = random.uniform(0.04, 0.12, 3)
    size[random.integers(3)] += 0.5 * reach
    mass = round(random.uniform(1000.0, 2500.0) * float(np.prod(size)), 4)
    turn = pin.rpy.rpyToMatrix(*random.uniform(-math.pi, math.pi, 3))
    moments = mass / 12.0 * np.array([size[1] ** 2 + size[2] ** 2, size[0] ** 2 + size[2] ** 2, size[0] ** 2 + size[1] ** 2])
    inertia = turn @ np.diag(moments) @ turn.T
    return mass, random.uniform(-0.5 * reach, 0.5 * reach, 3), inertia


def vector(values):
    return "[" + ", ".join(f"{value:.6f}" for value in values) + "]"


def joint_text(random, index, torque):
    reach = 0.4 if index < 3 else 0.2
    mass, com, i = random_link(random, reach)
    entries = {"xx": i[0, 0], "yy": i[1, 1], "zz": i[2, 2], "xy": i[0, 1], "xz": i[0, 2], "yz": i[1, 2]}
    tensor = ", ".join(f"{key} = {value:.8f}" for key, value in entries.items())
    xyz, rpy = random.uniform(-reach, reach, 3), random.uniform(-math.pi, math.pi, 3)
    rotor = random.uniform(0.1, 1.0)
    return f"""
[[joints]]
name = "joint_{index + 1}"
frame = {{ xyz_m = {vector(xyz)}, rpy_rad = {vector(rpy)} }}
link = {{ mass_kg = {mass}, com_m = {vector(com)}, inertia_kg_m2 = {{ {tensor} }} }}
drive = {{ rotor_inertia_kg_m2 = {rotor:.4f}, encoder_bits = 17 }}
friction = {{ viscous_nm_s_rad = 1.0, coulomb_nm = 1.0 }}
limits = {{ position_rad = [-3.14, 3.14], velocity_rad_s = 3.15, acceleration_rad_s2 = 10.0, torque_nm = {torque}.0 }}
"""


def write_arms():
    for index, (name, n) in enumerate(RANDOM_ARMS):
        path = HERE / "arms" / f"{name}.toml"
        torques = [1] * n
        # The limit of a joint is the torque that motions of the table's size ask of it, rounded up to a whole N m. The
        # body of the arm comes from the same random stream both times.
        for _ in range(2):
            random = np.random.default_rng([SEED, 1000 + index])
            head = f"# Random arm {index + 1} of {len(RANDOM_ARMS)}, written by make.py: general twists and offsets, boxes for links.\n"
            head += f'\nname = "{name}"\n'
            path.write_text(head + "".join(joint_text(random, j, torques[j]) for j in range(n)))
            model, ranges = model_from_toml(path)
            data = model.createData()
            motions = zip(*states(ranges, 1000, [SEED, 2000 + index]))
            torques = np.max([np.abs(pin.rnea(model, data, *motion)) for motion in motions], axis=0)
            torques = [math.ceil(torque) for torque in torques]


if __name__ == "__main__":
    jobs = {"arms": write_arms, "tables": write_tables}
    if sys.argv[1:2] == [] or sys.argv[1] not in jobs:
        sys.exit(__doc__)
    jobs[sys.argv[1]]()
