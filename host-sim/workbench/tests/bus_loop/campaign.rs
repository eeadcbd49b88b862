//! Faults of bus and drives: no torque that was not released reaches a drive.

use super::{Player, begin, path, player, profile};
use foretorque_link::bus::{BusPhase, BusTick};
use foretorque_link::safety::SafetyState;
use foretorque_workbench::bus::sim::{LineFault, TimedFault};
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::dynamics::Joints;

/// Watches every torque that reaches a drive.
struct Witness {
    /// Torques that the loop has released, newest last.
    released: Vec<Joints<6>>,
    /// Steps of the torque in the frames, N·m.
    step: Joints<6>,
    wrong: Vec<String>,
}

impl Witness {
    /// Every torque in force is one that was released for that joint within the watchdog's time, or zero.
    fn watch(&mut self, player: &Player, tick: &BusTick<6>) {
        let t_s = player.network.t_s();
        let seen = player.network.feed_forward();
        for j in 0..6 {
            // Carried rounding adds up to a step to the half of one.
            let near = |torque: f64| (torque - seen[j]).abs() <= 1.01 * self.step[j];
            let known = self
                .released
                .iter()
                .rev()
                .take(60)
                .any(|released| near(released[j]));
            if !(known || near(0.0)) {
                self.wrong
                    .push(format!("{t_s:.3} s: joint {} has {} N·m", j + 1, seen[j]));
            }
        }
        self.released.push(tick.torque.total.cast());
    }
}

/// Plays 1 s, then 1.5 s in which `fault` is in force for `for_s`: the end, every torque, the arm.
///
/// * `right` torques that are released without the fault; empty where they are not known yet
fn campaign(
    fault: Option<(LineFault, f64)>,
    right: &[Joints<6>],
) -> (Result<(), String>, Witness, Player) {
    const AT_S: f64 = 1.0;
    let (profile, path) = (profile(500.0), path(10.0));
    let mut player = player(&profile, &path, true);
    begin(&mut player, &path);
    if let Some((fault, for_s)) = fault {
        let at_s = player.network.t_s() + AT_S;
        player.network.fault = TimedFault::new(fault, at_s..at_s + for_s);
    }
    let joints = player.controller.config().joints;
    let steps = joints.map(|joint| f64::from(joint.drive.torque_resolution()));
    let mut witness = Witness {
        released: vec![player.network.feed_forward()],
        step: Joints::from(steps),
        wrong: Vec::new(),
    };
    let (mut end, mut ended_s) = (Ok(()), None);
    for tick in 0..1250 {
        let t_s = f64::from(tick) * 2e-3;
        let motion = motion_f32(&path.at(t_s + profile.lead_s()));
        let result = player.tick(Some(&motion)).expect("the bus is there");
        witness.watch(&player, &result);
        let mut wrong = |what| witness.wrong.push(format!("{t_s:.3} s: {what}"));
        if result.status.state == SafetyState::Armed {
            let torque: Joints<6> = result.torque.total.cast();
            if right
                .get(tick as usize)
                .is_some_and(|right| *right != torque)
            {
                wrong(format!("released {torque}"));
            }
            if ended_s.is_some() {
                wrong("armed again".to_owned());
            }
        } else if ended_s.is_none() {
            ended_s = Some(t_s);
            end = player.check().map_err(|error| error.to_string());
        }
        let acting = player.network.feed_forward();
        let over = ended_s.is_some_and(|ended_s| t_s > ended_s + 0.08);
        if over && acting.amax() > witness.step.amax() {
            wrong(format!("{acting} after the end"));
        }
    }
    (end, witness, player)
}

/// Fault of a joint or of its bus.
type FaultOf = fn(usize, usize) -> LineFault;

#[test]
fn no_fault_of_bus_or_drives_makes_a_wrong_torque() {
    use LineFault as F;
    let (end, undisturbed, _) = campaign(None, &[]);
    assert_eq!((end, undisturbed.wrong), (Ok(()), Vec::new()));
    let right = &undisturbed.released[1..];
    // A fault of a joint from 0 to 2 or of its bus, the joint, and the message of its end. Each is tried on both buses, whose
    // joints are 1 to 3 and 4 to 6.
    const SILENT: &str = "joint J: the drive does not answer";
    let cases: [(FaultOf, usize, &str); 19] = [
        (|j, _| F::LostReplies(j, 0.1), 2, ""),
        (|j, _| F::LostReplies(j, 1.0), 2, SILENT),
        (|j, _| F::LostReplies(j, 0.5), 1, "the bus loses"),
        (|j, _| F::LostCommands(j, 0.1), 1, ""),
        (|j, _| F::LostCommands(j, 1.0), 1, SILENT),
        (|j, _| F::LateReplies(j, 1), 0, ""),
        (|j, _| F::LateReplies(j, 6), 0, ""),
        (|j, _| F::DoubledCommands(j), 2, ""),
        (|j, _| F::DoubledReplies(j), 0, ""),
        (
            |j, _| F::StuckReply(j),
            1,
            "joint J: the reply of the drive repeats itself",
        ),
        (|j, _| F::WrongIdentifier(j, j as u8 + 2), 0, "joint "),
        (|j, _| F::WrongIdentifier(j, 9), 0, SILENT),
        (|j, _| F::FlippedBits(j, 0.02), 1, ""),
        (|j, _| F::Dead(j), 1, SILENT),
        (
            |j, _| F::Reset(j),
            2,
            "joint J: the drive has switched itself off",
        ),
        (
            |j, _| F::DriveFault(j, 0xa),
            2,
            "joint J: the drive reports fault 0xa",
        ),
        (|_, bus| F::BusOff(bus), 0, "the bus is off"),
        (|_, bus| F::Babble(bus, 0), 0, "joint "),
        (|_, bus| F::Overload(bus, 0.3), 0, " "),
    ];
    let lasting = cases.into_iter().map(|case| (case, 1.5));
    let short: (FaultOf, usize, &str) = (|_, bus| F::BusOff(bus), 0, "the bus is off");
    for ((fault, joint, message), for_s) in lasting.chain([(short, 0.01)]) {
        for bus in 0..2 {
            let joint = joint + 3 * bus;
            let fault = fault(joint, bus);
            let (end, witness, player) = campaign(Some((fault, for_s)), right);
            let wrong = witness.wrong;
            let count = wrong.len();
            assert!(
                wrong.is_empty(),
                "{fault:?}: {count} wrong torques, {}",
                wrong[0]
            );
            println!("{fault:?} for {for_s} s: {end:?}");
            if message.is_empty() {
                assert_eq!(end, Ok(()), "{fault:?}");
                continue;
            }
            let number = (joint + 1).to_string();
            let expected = format!("torque off: {}", message.trim().replace('J', &number));
            let error = end.expect_err("an end");
            assert!(
                error.starts_with(&expected),
                "{fault:?}: {error}, expected {expected}"
            );
            assert!(
                !matches!(player.controller.drives().phase(), BusPhase::Running(_)),
                "{fault:?}"
            );
        }
    }
}
