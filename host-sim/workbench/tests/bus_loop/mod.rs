//! Six simulated drives on two buses, driven by the loop: tracking, and the end of the torque.

mod campaign;
mod scenarios;

use foretorque::arm::ur5::Ur5;
use foretorque::joint::JointMotion;
use foretorque::learning::ParameterSet;
use foretorque_link::drives::DriveState;
use foretorque_workbench::bus::sim::{LineFault, SimulatedNetwork, TimedFault, plant_config};
use foretorque_workbench::bus::{BusPlayer, Network, Profile};
use foretorque_workbench::closed_loop::motion_f32;
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::plant::{Events, Plant, PlantConfig};
use foretorque_workbench::robot::{Perturbation, Robot};
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
    let truth = robot.perturbed(1, &Perturbation::PLANT);
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
    let mut set = described();
    if !forward {
        set.rigid.fill(0.0);
    }
    BusPlayer::new(config, set, network).expect("it fits the arm")
}

/// Switches the drives on and moves to the begin of the path.
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

#[test]
fn feed_forward_from_the_description_tracks_three_times_better_than_the_drives_alone_after_30_s() {
    for rate_hz in [250.0, 500.0, 1000.0] {
        let profile = profile(rate_hz);
        let alone = tracking_mrad(&profile, false, 30.0);
        let with = tracking_mrad(&profile, true, 30.0);
        println!(
            "{rate_hz} Hz: {alone:.3} mrad alone, {with:.3} mrad with, ratio {:.2}",
            alone / with
        );
        assert!(
            alone > 3.0 * with,
            "{rate_hz} Hz: {alone} mrad alone, {with} mrad with"
        );
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
                let mut states = reached.map(|joint| player.network.drives[joint].state());
                assert!(
                    states.all(|state| state != DriveState::Enabled),
                    "{fault:?} from {from_s} s"
                );
                failed += 1;
            }
        }
    }
    assert!(failed > 10, "{failed}");
}
