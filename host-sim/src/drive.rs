use super::arm::{ArmOptions, with_rotors};
use super::boards::on_arm;
use super::bus::{Attended, in_loop, wired};
use super::disturbances::DisturbanceArguments;
use super::motion_log::MotionLog;
use super::terminal::{Bar, show};
use super::{Failure, bail, bank, duration, not_foreign, not_over, unsupported, unusable, within};
use clap::Args;
use foretorque::arm::Arm;
use foretorque::joint::JointVector;
use foretorque::limits::Flags;
use foretorque_link::bank::{ParameterBank, Parameters};
use foretorque_link::bus::{BusConfig, BusFault, FaultCause};
use foretorque_workbench::bus::sim::{SimulatedNetwork, plant_config};
use foretorque_workbench::bus::{BusChoice, BusError, BusPlayer, Network, Profile};
use foretorque_workbench::closed_loop::{TickRecord, motion_f32};
use foretorque_workbench::dynamics::{Joints, State};
use foretorque_workbench::files::{remove_stale, write_whole};
use foretorque_workbench::plant::{Measurement, Plant};
use foretorque_workbench::report::page::or_dash;
use foretorque_workbench::report::write_json;
use foretorque_workbench::robot::Robot;
use foretorque_workbench::trajectory::Trajectory;
use serde::Serialize;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};
use std::sync::mpsc;

/// Standard deviation of the torque that a simulated drive reports, as a share of the joint's limit.
const REPORT_NOISE: f64 = 0.01;

/// Drive an arm whose joints are drives on a CAN bus, with learnt torque feed-forward in every command
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Profile of the arm: its drives, buses, gains and rate (see docs/bus.md)
    #[arg(long, value_name = "FILE")]
    profile: PathBuf,
    /// Bus: sim, socketcan:IF, slcan:PORT, fdcanusb:PORT or udp:GROUP; two buses as IF,IF
    #[arg(long)]
    bus: BusChoice,
    /// A table with t_s, q, qd, qdd; an excitation (.json); a path of the tool (.toml); or `validation`, a seeded path
    #[arg(long, value_name = "FILE|validation")]
    trajectory: String,
    /// Seed of validation path, simulated arm and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Play this long, s; an excitation repeats, a validation path is made as long, everything else ends by itself
    #[arg(long, value_parser = duration)]
    duration_s: Option<f64>,
    /// Parameter bank to start from; without it the description's rigid body
    #[arg(long, value_name = "FILE")]
    bank: Option<PathBuf>,
    /// Learn while it runs
    #[arg(long)]
    learn: bool,
    /// Clear faults that the drives report before they are switched on, as after their watchdog has tripped
    #[arg(long)]
    clear_faults: bool,
    /// Send no torque: the drives' own PD alone, for comparison
    #[arg(long, conflicts_with_all = ["learn", "bank"])]
    alone: bool,
    /// The simulated arm is the description itself, not a variation of it by up to 20 %
    #[arg(long)]
    exact: bool,
    #[command(flatten)]
    pub(super) arm: ArmOptions,
    #[command(flatten)]
    disturbances: DisturbanceArguments,
    /// Directory for log.csv, log.mcap, drive.json and bank.bin, the parameters in force at the end (none with --alone)
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

#[derive(Debug, Serialize)]
struct Summary {
    robot: String,
    bus: String,
    seed: u64,
    rate_hz: f64,
    ticks: usize,
    learning: bool,
    /// Over the second half of the run.
    tracking_rms_mrad: Option<f64>,
    /// With the drives' own PD alone; simulated buses only, and only where it plays the whole path.
    alone_tracking_rms_mrad: Option<f64>,
    tracking_ratio: Option<f64>,
    jitter_median_us: f32,
    jitter_999_us: f32,
    jitter_largest_us: f32,
    periods_without_reply: Vec<u32>,
    foreign_frames: u32,
    ended: Option<String>,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let profile = Profile::load(&arguments.profile)?;
    let robot = &arguments.arm.load(&profile.robot)?;
    let options = [&arguments.bank, &arguments.disturbances.effects];
    let mut read = Robot::files(Path::new(&profile.robot));
    read.extend([arguments.profile.clone(), (&arguments.trajectory).into()]);
    read.extend(options.into_iter().flatten().cloned());
    let results = ["log.csv", "log.mcap", "bank.bin", "drive.json"];
    not_over(read, within(&arguments.out, &results))?;
    not_foreign(&arguments.out, &results)?;
    on_arm!(robot, A, N, P => arguments.on::<A, N, P>(&profile, robot))
}

impl Arguments {
    fn on<A: Arm<N, P> + Send, const N: usize, const P: usize>(
        &self,
        profile: &Profile,
        robot: &Robot,
    ) -> Result<(), Failure> {
        let robot = &with_rotors(robot)?;
        let simulated = self.bus.is_simulated();
        if !simulated && (self.exact || self.disturbances.any()?) {
            bail!("the arm on this bus is real: leave out --exact and the disturbances");
        }
        let drive = Drive::<A, N, P>::new(self, profile, robot)?;
        if !simulated {
            return drive.play(Box::new(wired(&self.bus, profile)?), None);
        }
        let mut alone = None;
        if !self.alone {
            let played = drive.logged(Box::new(drive.simulated()?), true, None)?;
            alone = played.rms_mrad().filter(|_| played.ended.is_none());
            if let Some(reason) = played.ended {
                show!("PD of the drives alone: {reason}")?;
            }
        }
        drive.play(Box::new(drive.simulated()?), alone)
    }
}

/// Parts of a run that do not depend on the bus.
struct Drive<'a, A: Arm<N, P>, const N: usize, const P: usize> {
    arguments: &'a Arguments,
    profile: &'a Profile,
    robot: &'a Robot,
    config: BusConfig<N>,
    bank: ParameterBank,
    parameters: Parameters<N, P>,
    path: Trajectory<N>,
    /// End of the path, and time in which it slows down to it where it does not end at rest, s.
    end_s: f64,
    stop_s: f64,
    ticks: usize,
    arm: PhantomData<fn() -> A>,
}

/// Speed at the begin of a path that a drive from rest takes, rad/s.
const MOVES_RAD_S: f64 = 0.02;
/// Shortest time in which a path that does not end at rest slows down, s.
const STOP_S: f64 = 0.3;
/// Time before the end of a path at which its last motion is taken, s.
const LAST_S: f64 = 1e-6;
/// Share of the ticks with a cut torque, and of the time that late ticks leave out, that is no trouble.
const TOLERATED: f64 = 0.05;

/// Place on a path at `t_s`, s, its rate, and the rate's change, 1/s, where the path slows down to its end at `end_s`, s, in
/// `stop_s`, s.
///
/// From half of that before the end on, with s from 0 to 1: `rate = 1 − 3 s² + 2 s³`, whose integral is a half.
fn slowed(t_s: f64, end_s: f64, stop_s: f64) -> (f64, f64, f64) {
    let begin_s = end_s - 0.5 * stop_s;
    if stop_s == 0.0 || t_s <= begin_s {
        return (t_s, 1.0, 0.0);
    }
    let s = ((t_s - begin_s) / stop_s).min(1.0);
    let place = begin_s + stop_s * (s - s.powi(3) + 0.5 * s.powi(4));
    (
        place,
        1.0 - s * s * (3.0 - 2.0 * s),
        6.0 * s * (s - 1.0) / stop_s,
    )
}

struct Played<A: Arm<N, P>, const N: usize, const P: usize> {
    player: BusPlayer<A, Attended, N, P>,
    ticks: usize,
    squares: f64,
    counted: usize,
    /// Ticks in which a torque was cut to its limit, and in which what was learnt was.
    cut: [usize; 2],
    /// Time of the periods that were left out on the path, s.
    left_out_s: f64,
    ended: Option<String>,
}

impl<A: Arm<N, P>, const N: usize, const P: usize> Played<A, N, P> {
    /// Tracking error, mrad; `None` without a measurement in the second half.
    fn rms_mrad(&self) -> Option<f64> {
        (self.counted > 0).then(|| (self.squares / (N * self.counted) as f64).sqrt() * 1e3)
    }
}

impl<'a, A: Arm<N, P> + Send, const N: usize, const P: usize> Drive<'a, A, N, P> {
    fn new(
        arguments: &'a Arguments,
        profile: &'a Profile,
        robot: &'a Robot,
    ) -> Result<Self, Failure> {
        let config = profile.config::<A, N, P>()?;
        let period_s = 1.0 / profile.rate_hz;
        let bank = match &arguments.bank {
            Some(file) => bank::read_for(file, robot)?,
            None => ParameterBank::nominal::<A, N, P>(),
        };
        let parameters = bank.parameters::<A, N, P>()?;
        let (name, length_s) = (&arguments.trajectory, arguments.duration_s);
        let path = Trajectory::load(name, robot, arguments.seed, length_s, period_s)?;
        path.check(robot, period_s)?;
        if let Trajectory::Excitation { series, .. } = &path {
            let checked = series.check_torque_and_clearance(robot);
            checked.map_err(|problem| unusable(format!("{name}: {problem}")))?;
        }
        let begin: State<N> = path.at(0.0);
        let begin = begin.qd.amax();
        if begin > MOVES_RAD_S {
            bail!(
                "--trajectory {name}: it begins at {begin:.3} rad/s: the arm starts at rest, so the path must"
            );
        }
        let end_s = arguments.duration_s.unwrap_or(f64::INFINITY);
        let end_s = end_s.min(path.duration_s());
        let end: State<N> = path.at(end_s - LAST_S);
        let stop_s = match end.qd.amax() < MOVES_RAD_S {
            true => 0.0,
            false => {
                let joints = end.qd.iter().zip(&robot.joints);
                let slow = joints.map(|(qd, joint)| 1.5 * qd.abs() / joint.limits.acceleration);
                slow.fold(STOP_S, f64::max).min(2.0 * end_s)
            }
        };
        Ok(Self {
            arguments,
            profile,
            robot,
            config,
            bank,
            parameters,
            path,
            end_s,
            stop_s,
            ticks: ((end_s + 0.5 * stop_s) / period_s).round() as usize,
            arm: PhantomData,
        })
    }

    /// Desired motion at `t_s`, s.
    fn motion(&self, t_s: f64) -> State<N> {
        let (place_s, rate, change) = slowed(t_s, self.end_s, self.stop_s);
        let last_s = if self.stop_s > 0.0 {
            self.end_s - LAST_S
        } else {
            place_s
        };
        let on_path: State<N> = self.path.at(place_s.min(last_s));
        State {
            q: on_path.q,
            qd: on_path.qd * rate,
            qdd: on_path.qdd * (rate * rate) + on_path.qd * change,
        }
    }

    /// The simulated arm at the begin of the path.
    fn simulated(&self) -> Result<SimulatedNetwork<N>, Failure> {
        let arguments = self.arguments;
        let truth = match arguments.exact {
            true => self.robot.clone(),
            false => self.robot.perturbed(arguments.seed),
        };
        let config = plant_config(arguments.disturbances.plant_config()?);
        let plant = Plant::<N>::new(&truth, config, arguments.seed);
        let plant = plant.ok_or_else(|| unsupported(N))?;
        let duration_s = self.ticks as f64 / self.profile.rate_hz;
        let mut plant = plant.with_events(arguments.disturbances.events::<N>(duration_s)?);
        plant.place(&self.path.at(0.0).q);
        let limits = self.robot.joints.iter().map(|joint| joint.limits.torque);
        let noise = Joints::from_iterator(limits.map(|limit| REPORT_NOISE * limit));
        let (rates, seed) = (self.profile.common_rates()?, arguments.seed);
        let config = &self.config;
        Ok(SimulatedNetwork::new(plant, config, rates, &noise, seed))
    }

    /// Arms, approaches the path, plays it and parks.
    fn tracking(
        &self,
        network: Box<dyn Network>,
        alone: bool,
        log: &mut dyn FnMut(TickRecord<N>) -> bool,
    ) -> Result<Played<A, N, P>, Failure> {
        let mut parameters = self.parameters;
        if alone {
            parameters.set = Parameters::nominal::<A>().set;
            parameters.set.rigid.fill(0.0);
        }
        let network = Attended::new(network, self.arguments.bus.is_simulated());
        let mut player = BusPlayer::new(self.config, &parameters, network)?;
        player.clears_faults = self.arguments.clear_faults;
        player.arm().map_err(|error| match error {
            BusError::Fault(BusFault {
                cause: FaultCause::Drive(_),
                ..
            }) if !player.clears_faults => {
                unusable(format!("{error}; where its reason is gone: --clear-faults"))
            }
            error => error.into(),
        })?;
        let mut played = Played {
            player,
            ticks: 0,
            squares: 0.0,
            counted: 0,
            cut: [0; 2],
            left_out_s: 0.0,
            ended: None,
        };
        let followed = self.follow(&mut played, alone, log);
        let parked = played.player.park().map_err(Failure::from);
        let ended = followed.and(parked).err();
        played.ended = ended.map(|failure| failure.to_string());
        Ok(played)
    }

    fn follow(
        &self,
        played: &mut Played<A, N, P>,
        alone: bool,
        log: &mut dyn FnMut(TickRecord<N>) -> bool,
    ) -> Result<(), Failure> {
        let player = &mut played.player;
        player.approach(&self.path.at(0.0).q)?;
        let learns = self.arguments.learn && !alone;
        player.controller.set_learning(learns);
        let period_s = 1.0 / self.profile.rate_hz;
        let lead_s = self.profile.lead_s();
        // A measurement was taken when the command of the period before arrived.
        let age_s = 1.5 * period_s - lead_s;
        let mut feed_forward = JointVector::zeros();
        let left_out_s = player.left_out_s();
        for tick in 0..self.ticks {
            let t_s = tick as f64 * period_s;
            let motion = motion_f32(&self.motion(t_s + lead_s));
            let result = player.tick(Some(&motion))?;
            player.check()?;
            played.ticks += 1;
            played.left_out_s = player.left_out_s() - left_out_s;
            for (count, flag) in
                (played.cut.iter_mut()).zip([Flags::SATURATED, Flags::LEARNED_CLIPPED])
            {
                *count += usize::from(result.torque.flags.contains(flag));
            }
            let desired = self.motion((t_s - age_s).max(0.0));
            if let Some(measured) = result.measured {
                let measured = Measurement {
                    q: measured.q.cast::<f64>(),
                    tau: measured.tau.cast::<f64>(),
                };
                if 2 * tick >= self.ticks {
                    played.squares += (measured.q - desired.q).norm_squared();
                    played.counted += 1;
                }
                let logged = log(TickRecord {
                    t_s: t_s + played.left_out_s,
                    desired,
                    q: measured.q,
                    measured,
                    reported: Some(measured),
                    tau: measured.tau,
                    // The measured torque is that of the command before.
                    feed_forward,
                    shares: None,
                    flags: result.torque.flags.0,
                    stage: None,
                });
                if !logged {
                    bail!("the log cannot be written");
                }
            }
            feed_forward = result.torque.total;
        }
        Ok(())
    }

    /// Plays the path in the thread of the loop, while this one writes the log and shows the progress.
    fn logged(
        &self,
        network: Box<dyn Network>,
        alone: bool,
        mut log: Option<&mut MotionLog<N>>,
    ) -> Result<Played<A, N, P>, Failure> {
        let (sender, records) = mpsc::channel();
        let work = move || {
            let mut send = |record| sender.send(record).is_ok();
            self.tracking(network, alone, &mut send)
        };
        let write = || {
            let bar = Bar::new();
            for (tick, record) in records.into_iter().enumerate() {
                if let Some(log) = &mut log {
                    log.add(&record)?;
                }
                if tick % 256 == 0 {
                    bar.show("drive", tick, self.ticks);
                }
            }
            Ok(())
        };
        in_loop::<A, N, P, _>(&self.arguments.bus, work, write)
    }

    fn play(&self, network: Box<dyn Network>, alone_mrad: Option<f64>) -> Result<(), Failure> {
        let out = &self.arguments.out;
        let mut log = MotionLog::<N>::create(&out.join("log.csv"), true, None, true)?;
        let played = self.logged(network, self.arguments.alone, Some(&mut log))?;
        log.finish()?;
        let controller = &played.player.controller;
        if self.arguments.alone {
            remove_stale(out, &["bank.bin"])?;
        } else {
            let mut learnt = self.bank.clone();
            learnt.refresh::<A, N, P>(&controller.feed_forward().in_force());
            write_whole(&out.join("bank.bin"), &bank::bytes(&learnt)?)?;
        }
        let [median, high, largest] = played.player.jitter_us();
        let rms = played.rms_mrad();
        let lost = (0..N).map(|j| controller.drives().counters(j).lost);
        let summary = Summary {
            robot: self.robot.name.clone(),
            bus: self.arguments.bus.to_string(),
            seed: self.arguments.seed,
            rate_hz: self.profile.rate_hz,
            ticks: played.ticks,
            learning: self.arguments.learn,
            tracking_rms_mrad: rms,
            alone_tracking_rms_mrad: alone_mrad,
            tracking_ratio: alone_mrad.zip(rms).map(|(alone, rms)| alone / rms),
            jitter_median_us: median,
            jitter_999_us: high,
            jitter_largest_us: largest,
            periods_without_reply: lost.collect(),
            foreign_frames: controller.drives().strays(),
            ended: played.ended.clone(),
        };
        write_json(&out.join("drive.json"), &summary)?;
        if let Some(reason) = played.ended {
            bail!("{reason}");
        }
        let (ticks, rate_hz) = (summary.ticks, summary.rate_hz);
        show!(
            "{ticks} ticks at {rate_hz} Hz, tracking error {} mrad RMS in the second half",
            or_dash(rms, |rms| format!("{rms:.3}"))
        )?;
        if let Some((alone, ratio)) = alone_mrad.zip(summary.tracking_ratio) {
            show!("PD of the drives alone: {alone:.3} mrad, ratio {ratio:.2}")?;
        }
        let lost: u32 = summary.periods_without_reply.iter().sum();
        show!(
            "begin of the ticks: median {median:.0} µs late, 99.9 % {high:.0} µs, largest {largest:.0} µs; \
             {lost} replies lost"
        )?;
        let [cut, clipped] = played.cut.map(|count| count as f64 / ticks.max(1) as f64);
        if clipped > TOLERATED {
            show!(
                "learnt torque was clipped for {:.0} % of the path",
                100.0 * clipped
            )?;
        }
        if cut > TOLERATED {
            bail!(
                "a torque was at its limit for {:.0} % of the path: a slower path, or limits of the profile",
                100.0 * cut
            );
        }
        let late = played.left_out_s * rate_hz / ticks.max(1) as f64;
        if late > TOLERATED {
            bail!(
                "periods were left out for {:.0} % of the path, as their ticks came too late: a lower rate_hz, or a system that gives priority of real time",
                100.0 * late
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_that_is_cut_slows_down_to_its_end() {
        let at = |t_s: f64| slowed(t_s, 5.0, 0.4);
        assert_eq!(at(4.8), (4.8, 1.0, 0.0));
        let (place, rate, change) = at(5.2);
        assert!((place - 5.0).abs() < 1e-12 && rate.abs() < 1e-12 && change.abs() < 1e-12);
        assert_eq!(at(9.0), at(5.2));
        let h = 1e-5;
        for k in 1..100 {
            let t_s = 4.7 + 0.005 * f64::from(k) + 1e-4;
            let (_, rate, change) = at(t_s);
            let [before, after] = [at(t_s - h), at(t_s + h)];
            assert!(((after.0 - before.0) / (2.0 * h) - rate).abs() < 1e-6);
            assert!(((after.1 - before.1) / (2.0 * h) - change).abs() < 1e-3);
        }
        assert_eq!(slowed(6.0, 5.0, 0.0), (6.0, 1.0, 0.0));
    }
}
