"""Writes the tables of this folder: inverse dynamics of the written models by the tools that read them. See README.md.

    python make.py
"""

import gzip
import io
import sys
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces

HERE = Path(__file__).resolve().parent
SEED, STATES = 20261123, 200


def by_mujoco(path, states):
    """Rigid body, armature and damping; contacts, limits and Coulomb friction are constraints of MuJoCo and switched off."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    for q, qd, qdd in zip(*states):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        yield data.qfrc_inverse.copy()


def by_pinocchio(model, states):
    """Rigid body, and rotors where the format has them."""
    data = model.createData()
    for q, qd, qdd in zip(*states):
        yield pin.rnea(model, data, q, qd, qdd).copy()


def by_drake(path, states):
    """Rigid body and reflected rotors."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(path))
    for joint in plant.GetJointIndices():
        joint = plant.get_joint(joint)
        if joint.num_velocities():
            joint.set_default_damping_vector([0.0])
    plant.Finalize()
    context = plant.CreateDefaultContext()
    for q, qd, qdd in zip(*states):
        plant.SetPositions(context, q)
        plant.SetVelocities(context, qd)
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        yield plant.CalcInverseDynamics(context, qdd, forces)


def main():
    for path in sorted(HERE.glob("*.xml")):
        mujoco_model = mujoco.MjModel.from_xml_path(str(path))
        n = mujoco_model.nv
        random = np.random.default_rng([SEED, n])
        low, high = mujoco_model.jnt_range.T
        q = random.uniform(low, high, (STATES, n))
        qd, qdd = random.uniform(-3.0, 3.0, (STATES, n)), random.uniform(-10.0, 10.0, (STATES, n))
        states = (q, qd, qdd)
        columns = {
            "q{}_rad": q,
            "qd{}_rad_s": qd,
            "qdd{}_rad_s2": qdd,
            "mujoco{}_nm": by_mujoco(path, states),
            "pinocchio_mjcf{}_nm": by_pinocchio(pin.buildModelFromMJCF(str(path)), states),
            "pinocchio_urdf{}_nm": by_pinocchio(pin.buildModelFromUrdf(str(path.with_suffix(".urdf"))), states),
            "drake_sdf{}_nm": by_drake(path.with_suffix(".sdf"), states),
        }
        header = [name.format(j + 1) for name in columns for j in range(n)]
        rows = np.hstack([np.array(list(values)) for values in columns.values()])
        text = io.StringIO()
        text.write(",".join(header) + "\n")
        for row in rows:
            text.write(",".join(repr(float(value)) for value in row) + "\n")
        table = path.with_suffix(".csv.gz")
        with table.open("wb") as raw, gzip.GzipFile(filename="", fileobj=raw, mode="wb", compresslevel=9, mtime=0) as packed:
            packed.write(text.getvalue().encode())
        print(f"{path.stem}: {n} joints, {len(rows)} states", file=sys.stderr)


if __name__ == "__main__":
    main()
