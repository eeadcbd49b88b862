//! The tables of Pinocchio (`tests/data/pinocchio/README.md`) against the firmware's f32 code as the emulated processor
//! runs it: the ELF `oracle`, built for the board, all arms in one run.

use acceptance::{Table, each_arm};
use foretorque::arm::Arm;
use std::path::Path;
use std::process::{Command, Stdio};

/// f32 torques of the UR5, N·m: three decimal places below the friction of the joint.
const UR5_TOLERANCE: [f64; 6] = [1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5];

/// f32 torques of any arm, in torque limits of the joint: a quarter of what a 17-bit torque command resolves.
const LIMIT_SHARE: f64 = 1e-6;

/// A row of the regressor sums the same torque from up to 40 products, in torque limits of the joint.
const ROW_LIMIT_SHARE: f64 = 2e-6;

/// Seconds after which the emulator is stopped; it needs about one.
const PATIENCE: &str = "120";

/// States of the arms, in the order of `each_arm`, and the torques after the run.
#[derive(Default)]
struct Batch {
    states: Vec<f32>,
    torques: std::vec::IntoIter<f32>,
    arms: usize,
}

impl Batch {
    fn add<A: Arm<N, P>, const N: usize, const P: usize>(&mut self) {
        let table = Table::pinocchio(A::NAME);
        for row in 0..table.len() {
            self.states.push(self.arms as f32);
            for (name, unit) in [("q", "_rad"), ("qd", "_rad_s"), ("qdd", "_rad_s2")] {
                // The tables hold states that f32 represents exactly.
                let values = table.joints::<N>(row, name, unit);
                self.states.extend(values.map(|value| value as f32));
            }
        }
        self.arms += 1;
    }

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

    /// Largest errors of `rnea` and of the regressor's rows over the table, in torque limits and in N·m.
    fn compare<A: Arm<N, P>, const N: usize, const P: usize>(&mut self) {
        let table = Table::pinocchio(A::NAME);
        let mut worst = [[0.0f64; N]; 2];
        for row in 0..table.len() {
            let expected = table.joints::<N>(row, "tau", "_nm");
            for worst in &mut worst {
                for (worst, expected) in worst.iter_mut().zip(expected) {
                    let tau = self.torques.next().expect("a torque for every state");
                    let error = (f64::from(tau) - expected).abs();
                    // Not a number is the worst of all.
                    if error.is_nan() || error > *worst {
                        *worst = error;
                    }
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
}

fn add<A: Arm<N, P>, const N: usize, const P: usize>(batch: &mut Batch) {
    batch.add::<A, N, P>();
}

fn compare<A: Arm<N, P>, const N: usize, const P: usize>(batch: &mut Batch) {
    batch.compare::<A, N, P>();
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
        .args([PATIENCE, "qemu-system-arm", "-machine", "netduinoplus2"])
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
