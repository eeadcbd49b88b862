//! Six simulated drives on two buses, driven by the loop: tracking, and the end of the torque.

mod scenarios;

use foretorque::arm::ur5::Ur5;
use foretorque::joint::JointMotion;
use foretorque::learning::ParameterSet;
use foretorque_link::bank::Parameters;
use foretorque_link::bus::{BusPhase, BusTick};
use foretorque_link::drives::DriveState;
use foretorque_link::safety::SafetyState;
use foretorque_workbench::bus::sim::{LineFault, SimulatedNetwork, TimedFault, plant_config};
use foretorque_workbench::bus::{BusPlayer, Network, Profile};
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::plant::{Events, Plant, PlantConfig};
use foretorque_workbench::robot::Robot;
use foretorque_workbench::trajectory::Trajectory;
use foretorque_workbench::trajectory::via::ViaPath;
use std::path::Path;

type Player = BusPlayer<Ur5, SimulatedNetwork<6>, 6, 40>;
type Set = ParameterSet<6, 40>;

pub(crate) fn profile(rate_hz: f64) -> Profile {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../profiles/sim-ur5.toml");
    let mut profile = Profile::load(&file).expect("it is a profile");
    profile.rate_hz = rate_hz;
    profile
}

pub(crate) fn path(duration_s: f64) -> Trajectory<6> {
    let robot = Robot::load("ur5").expect("built in");
    Trajectory::Via(ViaPath::random(&robot, 1, duration_s, 2.0))
}

/// Drives around another arm than the described one, at the begin of the path.
pub(crate) fn network(
    profile: &Profile,
    path: &Trajectory<6>,
    plant: PlantConfig,
    events: Events<6>,
) -> SimulatedNetwork<6> {
    let robot = Robot::load("ur5").expect("built in");
    let truth = robot.perturbed(1);
    let plant = Plant::<6>::new(&truth, plant_config(plant), 1).expect("six joints");
    let mut plant = plant.with_events(events);
    plant.place(&path.at(0.0).q);
    let config = profile.config::<Ur5, 6, 40>().expect("it fits the arm");
    let noise = Joints::from_fn(|j, _| if j < 3 { 1.5 } else { 0.28 });
    SimulatedNetwork::new(plant, &config, profile.bus[0], &noise, 1)
}

fn described() -> Set {
    ParameterSet::nominal::<Ur5>(1)
}

/// An arm that waits on its brakes at the begin of the path.
fn player(profile: &Profile, path: &Trajectory<6>, forward: bool) -> Player {
    let network = network(profile, path, PlantConfig::default(), Events::default());
    let config = profile.config::<Ur5, 6, 40>().expect("it fits the arm");
    let mut parameters = Parameters::nominal::<Ur5>();
    if !forward {
        parameters.set.rigid.fill(0.0);
    }
    BusPlayer::new(config, &parameters, network).expect("it fits the arm")
}

fn begin(player: &mut Player, path: &Trajectory<6>) {
    player.arm().expect("it arms");
    player.approach(&path.at(0.0).q).expect("it comes there");
}

/// Plays the path, learning or not; calls `seen` after every tick with the time, s, and the torque.
fn play(
    player: &mut Player,
    (profile, path): (&Profile, &Trajectory<6>),
    learning: bool,
    mut seen: impl FnMut(&Player, f64, &Joints<6>),
) {
    begin(player, path);
    player.controller.set_learning(learning);
    for tick in 0..path.ticks(player.period_s()) {
        let t_s = tick as f64 * player.period_s();
        let motion = motion_f32(&path.at(t_s + profile.lead_s()));
        let result = player.tick(Some(&motion)).expect("the bus is there");
        player.check().expect("no fault");
        seen(player, t_s, &result.torque.total.cast());
    }
}

/// RMS tracking error, mrad, over the end of a path that is learnt for `learn_s`; then the arm is parked.
fn tracking_mrad(profile: &Profile, forward: bool, learn_s: f64) -> f64 {
    const JUDGED_S: f64 = 6.0;
    let path = path(learn_s + JUDGED_S);
    let mut player = player(profile, &path, forward);
    let (mut sum, mut count) = (0.0, 0);
    play(&mut player, (profile, &path), forward, |player, t_s, _| {
        if t_s > learn_s {
            let error = player.network.plant.q() - path.at(t_s).q;
            sum += error.norm_squared() / 6.0;
            count += 1;
        }
    });
    let counters = (0..6).map(|joint| player.controller.drives().counters(joint).lost as usize);
    let (lost, replies) = (counters.sum::<usize>(), 6 * path.ticks(player.period_s()));
    assert!(1000 * lost < replies, "{lost} of {replies} replies lost");
    let reason = player.park().expect("the bus is there");
    assert!(player.network.all_off(), "{reason}");
    (sum / f64::from(count)).sqrt() * 1e3
}

/// The tracking error, mrad, is so many times smaller with the feed-forward than without it.
pub(crate) fn tracks_better(name: &str, times: f64, tracking: impl Fn(bool) -> f64) {
    let (alone, with) = (tracking(false), tracking(true));
    let ratio = alone / with;
    let line = format!("{name}: {alone:.3} mrad alone, {with:.3} mrad with, ratio {ratio:.2}");
    println!("{line}");
    assert!(alone > times * with, "{line}");
}

#[test]
fn feed_forward_from_the_description_tracks_three_times_better_than_the_drives_alone_after_30_s() {
    for rate_hz in [250.0, 500.0, 1000.0] {
        let tracking = |forward| tracking_mrad(&profile(rate_hz), forward, 30.0);
        tracks_better(&format!("{rate_hz} Hz"), 3.0, tracking);
    }
}

#[test]
fn a_host_that_is_silent_ends_the_torque_and_so_do_the_drives_when_the_loop_hangs() {
    let profile = profile(500.0);
    let path = path(10.0);
    let mut silent = player(&profile, &path, true);
    begin(&mut silent, &path);
    for _ in 0..40 {
        silent.tick(None).expect("the bus is there");
    }
    assert!(silent.check().is_err());
    assert!(silent.network.feed_forward().amax() < 0.2);
    let mut hung = player(&profile, &path, true);
    begin(&mut hung, &path);
    assert!(hung.network.feed_forward().amax() > 1.0);
    for _ in 0..30 {
        hung.network.wait();
    }
    assert!(hung.network.all_off() && hung.network.feed_forward().amax() == 0.0);
    // The loop that comes back finds the drives off and does not arm again by itself.
    let motion: JointMotion<6> = motion_f32(&path.at(0.0));
    for _ in 0..30 {
        hung.tick(Some(&motion)).expect("the bus is there");
    }
    assert!(hung.check().is_err());
    assert!(hung.network.all_off());
}

#[test]
fn arming_that_fails_switches_every_drive_off_again() {
    let profile = profile(500.0);
    let path = path(10.0);
    let mut failed = 0;
    for period in 0..30 {
        for fault in [LineFault::LostCommands(4, 1.0), LineFault::DriveFault(1, 9)] {
            let mut player = player(&profile, &path, true);
            let from_s = f64::from(period) * 2e-3;
            player.network.fault = TimedFault::new(fault, from_s..1e9);
            if player.arm().is_err() {
                // The watchdog of a drive that no command reaches ends its torque.
                let reached = (0..6).filter(|joint| fault != LineFault::LostCommands(*joint, 1.0));
                let mut states = reached.map(|joint| player.network.drives[joint].state);
                let off = states.all(|state| state != DriveState::Enabled);
                assert!(off, "{fault:?} from {from_s} s");
                failed += 1;
            }
        }
    }
    assert!(failed > 10, "{failed}");
}

#[test]
fn a_second_of_periods_is_a_second_of_the_simulated_arm() {
    for rate_hz in [500.0, 540.0, 950.0] {
        let (profile, path) = (profile(rate_hz), path(1.0));
        let mut network = network(&profile, &path, PlantConfig::default(), Events::default());
        for _ in 0..rate_hz as usize {
            network.wait();
        }
        assert!((network.t_s() - 1.0).abs() < 1.1e-4, "{}", network.t_s());
    }
}

#[test]
fn a_fault_of_before_is_cleared_where_that_is_asked_for() {
    let (profile, path) = (profile(500.0), path(10.0));
    for clears in [false, true] {
        let mut player = player(&profile, &path, true);
        player.clears_faults = clears;
        player.network.drives[2].state = DriveState::Fault(0xd);
        let outcome = player.arm().map_err(|error| error.to_string());
        match outcome {
            Err(error) => assert!(!clears && error.ends_with("reports fault 0xd"), "{error}"),
            Ok(_) => assert!(clears),
        }
    }
}

/// Watches every torque that reaches a drive.
struct Observed {
    /// Torques that the loop has released, newest last.
    released: Vec<Joints<6>>,
    /// Steps of the torque in the frames, N·m.
    step: Joints<6>,
    wrong: Vec<String>,
}

impl Observed {
    /// Every torque in force is one that was released for that joint within the watchdog's time, or zero.
    fn watch(&mut self, player: &Player, tick: &BusTick<6>) {
        let t_s = player.network.t_s();
        let seen = player.network.feed_forward();
        for j in 0..6 {
            // Carried rounding adds up to a step to the half of one.
            let near = |torque: f64| (torque - seen[j]).abs() <= 1.01 * self.step[j];
            let mut recent = self.released.iter().rev().take(60);
            if !(recent.any(|released| near(released[j])) || near(0.0)) {
                let (joint, torque) = (j + 1, seen[j]);
                let wrong = format!("{t_s:.3} s: joint {joint} has {torque} N·m");
                self.wrong.push(wrong);
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
) -> (Result<(), String>, Observed, Player) {
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
    let mut observed = Observed {
        released: vec![player.network.feed_forward()],
        step: Joints::from(steps),
        wrong: Vec::new(),
    };
    let (mut end, mut ended_s) = (Ok(()), None);
    for tick in 0..1250 {
        let t_s = f64::from(tick) * 2e-3;
        let motion = motion_f32(&path.at(t_s + profile.lead_s()));
        let result = player.tick(Some(&motion)).expect("the bus is there");
        observed.watch(&player, &result);
        let mut wrong = |what| observed.wrong.push(format!("{t_s:.3} s: {what}"));
        if result.status.state == SafetyState::Armed {
            let torque: Joints<6> = result.torque.total.cast();
            let right = right.get(tick as usize);
            if right.is_some_and(|right| *right != torque) {
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
        if over && acting.amax() > observed.step.amax() {
            wrong(format!("{acting} after the end"));
        }
    }
    (end, observed, player)
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
    const REPEATS: &str = "joint J: the reply of the drive repeats itself";
    const OFF: &str = "joint J: the drive has switched itself off";
    const REPORTS: &str = "joint J: the drive reports fault 0xa";
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
        (|j, _| F::StuckReply(j), 1, REPEATS),
        (|j, _| F::WrongIdentifier(j, j as u8 + 2), 0, "joint "),
        (|j, _| F::WrongIdentifier(j, 9), 0, SILENT),
        (|j, _| F::FlippedBits(j, 0.02), 1, ""),
        (|j, _| F::Dead(j), 1, SILENT),
        (|j, _| F::Reset(j), 2, OFF),
        (|j, _| F::DriveFault(j, 0xa), 2, REPORTS),
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
            let (end, observed, player) = campaign(Some((fault, for_s)), right);
            let (count, first) = (observed.wrong.len(), observed.wrong.first());
            assert_eq!(first, None, "{fault:?}: {count} wrong torques");
            println!("{fault:?} for {for_s} s: {end:?}");
            if message.is_empty() {
                assert_eq!(end, Ok(()), "{fault:?}");
                continue;
            }
            let number = (joint + 1).to_string();
            let expected = format!("torque off: {}", message.trim().replace('J', &number));
            let error = end.expect_err("an end");
            let named = error.starts_with(&expected);
            assert!(named, "{fault:?}: {error}, expected {expected}");
            let phase = player.controller.drives().phase();
            assert!(!matches!(phase, BusPhase::Running(_)), "{fault:?}");
        }
    }
}
