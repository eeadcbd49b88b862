//! Dynamics against tables made by Pinocchio (`tests/data/pinocchio/README.md`).

use crate::arms::oblique::Oblique;
use crate::{Table, description, each_arm};
use foretorque::arm::{Arm, LINK_PARAMETERS};
use foretorque::dynamics::{BaseParameters, regressor_row, rnea};
use foretorque::joint::{JointMotion, JointVector};
use foretorque_workbench::dynamics::{Joints, ReferenceModel, State};
use std::path::Path;
use std::process::{Command, Stdio};

/// f64 against f64 in another formulation: torques of a few hundred N·m carry some 1e-13 N·m of rounding.
const REFERENCE_TOLERANCE: f64 = 1e-10;

/// Regressor entries are tabulated with eleven decimals.
const TABULATED_TOLERANCE: f64 = 1e-10;

/// f32 torques of any arm, in torque limits of the joint: a quarter of what a 17-bit torque command resolves.
pub(crate) const LIMIT_SHARE: f64 = 1e-6;

/// f32 regressor entries, relative to the largest entry of the row: some ten roundings of 6e-8.
const ROW_TOLERANCE: f64 = 2e-6;

/// The worse of two errors; not a number is the worst of all.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || a > b { a } else { b }
}

fn largest<const N: usize>(errors: &Joints<N>) -> f64 {
    let errors = errors.iter();
    errors.fold(0.0, |worst, error| worse(worst, error.abs()))
}

/// Standard parameters as the tables name them, in the order of eq. 14.
const NAMES: [&str; LINK_PARAMETERS] = [
    "m", "mx", "my", "mz", "ixx", "iyy", "izz", "ixy", "ixz", "iyz",
];

fn state<const N: usize>(table: &Table, row: usize) -> State<N> {
    State {
        q: table.joints::<N>(row, "q", "_rad").into(),
        qd: table.joints::<N>(row, "qd", "_rad_s").into(),
        qdd: table.joints::<N>(row, "qdd", "_rad_s2").into(),
    }
}

/// The state as the board gets it; the tables hold states that f32 represents exactly.
fn motion<const N: usize>(table: &Table, row: usize) -> JointMotion<N> {
    let state = state::<N>(table, row);
    let narrow = |x: Joints<N>| JointVector::<N>::from_fn(|joint, _| x[joint] as f32);
    JointMotion {
        q: narrow(state.q),
        qd: narrow(state.qd),
        qdd: narrow(state.qdd),
    }
}

fn regressor_entry(table: &Table, row: usize, joint: usize, standard: usize) -> f64 {
    let (link, parameter) = (standard / LINK_PARAMETERS, standard % LINK_PARAMETERS);
    // Left out of the tables: joint j does not feel the links before it.
    if link < joint {
        return 0.0;
    }
    let name = NAMES[parameter];
    table.value(row, &format!("y{}_{name}{}", joint + 1, link + 1))
}

fn reference_agrees<A: Arm<N, P>, const N: usize, const P: usize>() {
    let name = A::NAME;
    let table = Table::pinocchio(name);
    let states = if name == "ur5" { 2000 } else { 200 };
    assert_eq!(table.len(), states, "{name}");
    let model = ReferenceModel::<N>::new(&description(name)).expect("as many joints as the table");
    let (mut tau, mut gravity, mut mass) = (0.0_f64, 0.0_f64, 0.0_f64);
    for row in 0..table.len() {
        let state = state::<N>(&table, row);
        let expected: Joints<N> = table.joints::<N>(row, "tau", "_nm").into();
        tau = worse(tau, largest(&(model.inverse_dynamics(&state) - expected)));
        let expected: Joints<N> = table.joints::<N>(row, "gravity", "_nm").into();
        let error = model.gravity_torques(&state.q) - expected;
        gravity = worse(gravity, largest(&error));
        let matrix = model.mass_matrix(&state.q);
        for i in 0..N {
            for j in 0..N {
                let (upper, lower) = (i.min(j) + 1, i.max(j) + 1);
                let expected = table.value(row, &format!("m{upper}_{lower}_kg_m2"));
                mass = worse(mass, (matrix[(i, j)] - expected).abs());
            }
        }
    }
    for (error, of) in [(tau, "torque"), (gravity, "gravity"), (mass, "mass matrix")] {
        let told = format!("{name}: {of} of the reference off by {error:.1e}");
        println!("{told}");
        assert!(error <= REFERENCE_TOLERANCE, "{told}");
    }
}

fn reference_regressor_agrees<A: Arm<N, P>, const N: usize, const P: usize>() {
    let name = A::NAME;
    let table = Table::pinocchio(name);
    let expected = Table::pinocchio(&format!("{name}_regressor"));
    assert_eq!(table.len(), expected.len(), "{name}");
    let model = ReferenceModel::<N>::new(&description(name)).expect("as many joints as the table");
    let mut worst = 0.0_f64;
    for row in 0..table.len() {
        let state = state::<N>(&table, row);
        let regressor = model.regressor(&state);
        for joint in 0..N {
            for standard in 0..LINK_PARAMETERS * N {
                let entry = regressor_entry(&expected, row, joint, standard);
                worst = worse(worst, (regressor[(joint, standard)] - entry).abs());
            }
            // The tables end here: Pinocchio's regressor has no rotor columns. A rotor is felt by its own joint.
            for rotor in 0..N {
                let felt = rotor == joint;
                let entry = if felt { state.qdd[joint] } else { 0.0 };
                let found = regressor[(joint, LINK_PARAMETERS * N + rotor)];
                assert_eq!(found, entry, "{name}");
            }
        }
    }
    println!("{name}: regressor off by {worst:.1e}");
    assert!(worst <= TABULATED_TOLERANCE, "{name}: {worst:e}");
}

fn board_agrees<A: Arm<N, P>, const N: usize, const P: usize>() {
    let name = A::NAME;
    let table = Table::pinocchio(name);
    let beta = BaseParameters::<P>::from_fn(|k, _| A::NOMINAL[k]);
    let mut worst = 0.0_f64;
    for row in 0..table.len() {
        let tau = rnea::<A, N, P>(&beta, &motion(&table, row));
        let expected = table.joints::<N>(row, "tau", "_nm");
        for joint in 0..N {
            let error = (f64::from(tau[joint]) - expected[joint]).abs();
            worst = worse(worst, error / f64::from(A::LIMITS[joint].torque));
        }
    }
    println!("{name}: board off by {worst:.1e} of the torque limits");
    assert!(worst <= LIMIT_SHARE, "{name}: {worst:e}");
}

/// Rows of the board's regressor are the table's columns of the base set.
fn board_rows_agree<A: Arm<N, P>, const N: usize, const P: usize>() {
    let name = A::NAME;
    let table = Table::pinocchio(name);
    let expected = Table::pinocchio(&format!("{name}_regressor"));
    let columns = (0..).zip(A::COLUMNS.iter().flat_map(|columns| columns.inertial));
    let independent = columns.filter_map(|(k, is_base)| is_base.then_some(k));
    let independent: Vec<usize> = independent.collect();
    let mut worst = 0.0_f64;
    for state in 0..table.len() {
        let motion = motion::<N>(&table, state);
        for joint in 0..N {
            let row = regressor_row::<A, N, P>(joint, &motion);
            let entry = |&column: &usize| regressor_entry(&expected, state, joint, column);
            let entries: Vec<f64> = independent.iter().map(entry).collect();
            let scale = entries
                .iter()
                .fold(1.0, |max: f64, entry| max.max(entry.abs()));
            for (value, entry) in row.iter().zip(&entries) {
                worst = worse(worst, (f64::from(*value) - entry).abs() / scale);
            }
            let rotors = (0..N).filter(|&rotor| A::COLUMNS[rotor].rotor);
            for (value, rotor) in row.iter().skip(independent.len()).zip(rotors) {
                let felt = rotor == joint;
                assert_eq!(*value, if felt { motion.qdd[joint] } else { 0.0 }, "{name}");
            }
        }
    }
    println!("{name}: board's regressor off by {worst:.1e} of its largest entry");
    assert!(worst <= ROW_TOLERANCE, "{name}: {worst:e}");
}

#[test]
fn reference_dynamics_agree_with_pinocchio() {
    each_arm!(reference_agrees);
}

#[test]
fn untidy_urdf_is_read_as_pinocchio_reads_it() {
    reference_agrees::<Oblique, 4, 27>();
    board_agrees::<Oblique, 4, 27>();
}

#[test]
fn reference_regressor_agrees_with_pinocchio_column_by_column() {
    each_arm!(reference_regressor_agrees);
}

#[test]
fn board_torques_of_every_arm_agree_with_pinocchio() {
    each_arm!(board_agrees);
}

#[test]
fn board_regressor_rows_are_the_base_columns_of_pinocchio() {
    each_arm!(board_rows_agree);
}

/// f32 torques of the UR5, N·m: three decimal places below the friction of the joint.
pub(crate) const UR5_TOLERANCE: [f64; 6] = [1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5];

/// A row of the regressor sums the same torque from up to 40 products, in torque limits of the joint.
const ROW_LIMIT_SHARE: f64 = 2e-6;

/// Seconds after which the emulator is stopped; it needs about one.
const TIMEOUT: &str = "120";

/// The tables against the firmware as the emulated processor runs it: the ELF `oracle`, built for the board, all arms in one
/// run. States of the arms, in the order of `each_arm`, and the torques after the run.
#[derive(Default)]
struct Batch {
    states: Vec<f32>,
    torques: std::vec::IntoIter<f32>,
    arms: usize,
}

impl Batch {
    /// Computes the torques on the emulated processor.
    fn run(&mut self) {
        let folder = std::env::temp_dir().join(format!("foretorque-oracle-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("the temporary folder can be written");
        let (states, torques) = (folder.join("states"), folder.join("torques"));
        let bytes: Vec<u8> = self.states.iter().flat_map(|x| x.to_le_bytes()).collect();
        std::fs::write(&states, bytes).expect("the temporary folder can be written");
        emulate(&states, &torques);
        let bytes = std::fs::read(&torques).expect("the emulator has written it");
        let (numbers, rest) = bytes.as_chunks::<4>();
        assert!(rest.is_empty());
        let torques: Vec<f32> = numbers.iter().map(|&b| f32::from_le_bytes(b)).collect();
        self.torques = torques.into_iter();
        std::fs::remove_dir_all(&folder).expect("the temporary folder can be removed");
    }
}

fn add<A: Arm<N, P>, const N: usize, const P: usize>(batch: &mut Batch) {
    let table = Table::pinocchio(A::NAME);
    for row in 0..table.len() {
        let motion = motion::<N>(&table, row);
        batch.states.push(batch.arms as f32);
        for values in [motion.q, motion.qd, motion.qdd] {
            batch.states.extend(values.iter());
        }
    }
    batch.arms += 1;
}

/// Largest errors of `rnea` and of the regressor's rows over the table, in torque limits and in N·m.
fn compare<A: Arm<N, P>, const N: usize, const P: usize>(batch: &mut Batch) {
    let table = Table::pinocchio(A::NAME);
    let mut worst = [[0.0f64; N]; 2];
    for row in 0..table.len() {
        let expected = table.joints::<N>(row, "tau", "_nm");
        for worst in &mut worst {
            for (worst, expected) in worst.iter_mut().zip(expected) {
                let tau = batch.torques.next().expect("a torque for every state");
                *worst = worse(*worst, (f64::from(tau) - expected).abs());
            }
        }
    }
    let name = A::NAME;
    let [rnea, rows] = worst;
    let (rnea_um, rows_um) = (rnea.map(|e| 1e6 * e), rows.map(|e| 1e6 * e));
    println!("{name}: rnea off by {rnea_um:.2?} µN·m, rows of the regressor by {rows_um:.2?}");
    for joint in 0..N {
        let limit = f64::from(A::LIMITS[joint].torque);
        let bound = match (name, UR5_TOLERANCE.get(joint)) {
            ("ur5", Some(&tolerance)) => tolerance,
            _ => LIMIT_SHARE * limit,
        };
        assert!(rnea[joint] <= bound, "{name}: joint {}", joint + 1);
        let bound = ROW_LIMIT_SHARE * limit;
        assert!(rows[joint] <= bound, "{name}: row {}", joint + 1);
    }
}

/// Runs the ELF with the two files.
fn emulate(states: &Path, torques: &Path) {
    let target = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target");
    let elf = target.join("thumbv7em-none-eabihf/firmware/oracle");
    let place = elf.display();
    assert!(
        elf.exists(),
        "no firmware at {place}: build it with `cargo firmware`"
    );
    let (states, torques) = (states.display(), torques.display());
    let semihosting = format!("enable=on,target=native,arg=oracle,arg={states},arg={torques}");
    let status = Command::new("timeout")
        .args([TIMEOUT, "qemu-system-arm", "-machine", "netduinoplus2"])
        .args(["-nographic", "-monitor", "none", "-serial", "none"])
        .args(["-semihosting-config", &semihosting, "-kernel"])
        .arg(&elf)
        .stdin(Stdio::null())
        .status()
        .expect("qemu-system-arm is installed: `cargo xtask setup`");
    assert!(status.success(), "the emulated run ended with {status}");
}

#[test]
fn torques_of_every_arm_as_the_emulated_processor_computes_them_agree_with_pinocchio() {
    let mut batch = Batch::default();
    each_arm!(add, &mut batch);
    batch.run();
    each_arm!(compare, &mut batch);
    assert_eq!(batch.torques.next(), None);
}
