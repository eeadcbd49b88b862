use super::arm::{ArmOptions, with_rotors};
use super::boards::on_arm;
use super::bus::{Attended, in_loop, prompt, wired};
use super::disturbances::triple;
use super::terminal::show;
use super::{
    Failure, arguments as of, bail, drive, excite, identify, positive, text_of, unsupported,
    unusable,
};
use clap::{Args, ValueEnum};
use foretorque::arm::Arm;
use foretorque::learning::rated_payload;
use foretorque_link::bank::Parameters;
use foretorque_workbench::bus::sim::{SimulatedNetwork, plant_config};
use foretorque_workbench::bus::{
    BusChoice, BusPlayer, Commissioning, Found, Network, Profile, Step,
};
use foretorque_workbench::dynamics::{Joints, ReferenceModel};
use foretorque_workbench::files::WholeFile;
use foretorque_workbench::plant::{Payload, Plant, PlantConfig};
use foretorque_workbench::report::put_json;
use foretorque_workbench::robot::Robot;
use std::path::PathBuf;

/// Check the profile of an arm on its bus step by step, below a tenth of its torque, then drive and identify it
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Profile of the arm, with the pose in which it rests without torque (see docs/bus.md)
    #[arg(long, value_name = "FILE")]
    profile: PathBuf,
    /// Bus: sim, socketcan:IF, slcan:PORT, fdcanusb:PORT or udp:GROUP; two buses as IF,IF
    #[arg(long)]
    bus: BusChoice,
    /// Do this step only; without it all, up to the first mistake
    #[arg(long, value_enum)]
    step: Option<StepName>,
    /// Mass of the known weight, kg; without it the step `weight` is left out
    #[arg(long, value_parser = positive)]
    weight_kg: Option<f64>,
    /// Centre of mass of the known weight in the frame of the last link, m
    #[arg(long, value_name = "X,Y,Z", value_parser = triple)]
    #[arg(default_value = "0,0,0", allow_hyphen_values = true)]
    weight_com: [f64; 3],
    /// Seed of the simulated arm and of the search for the excitation
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    arm: ArmOptions,
    /// Directory for commission.json and the directories excitation, driven and identified
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum StepName {
    /// Every drive answers, with the scales of its profile
    Find,
    /// Each joint turned by hand: identifier, sign, gear
    Turn,
    /// Pose of rest: zeros
    Zero,
    /// A tenth of the torque: sign and scale
    Torque,
    /// Slow sweeps in the loop: friction
    Friction,
    /// Slow sweeps with a known weight: gain
    Weight,
    /// `excite`: a path that excites every parameter
    Excite,
    /// `drive`: that path, three times
    Drive,
    /// `identify`: parameters from its log
    Identify,
}

/// Periods of the excitation that are driven.
const PERIODS: f64 = 3.0;

impl StepName {
    /// The step on the arm; none where another command does it.
    fn on_arm(self) -> Option<Step> {
        // The steps on the arm come first, in the same order.
        Step::ALL.get(self as usize).copied()
    }
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let profile = Profile::load(&arguments.profile)?;
    if profile.rest_rad.is_empty() {
        bail!(
            "{}: rest_rad is missing: the pose of rest without torque",
            profile.file
        );
    }
    if arguments.step == Some(StepName::Weight) && arguments.weight_kg.is_none() {
        bail!("--step weight needs --weight-kg");
    }
    let robot = &arguments.arm.load(&profile.robot)?;
    let wanted: Vec<StepName> = match arguments.step {
        Some(step) => vec![step],
        None => StepName::value_variants().to_vec(),
    };
    let steps = wanted.iter();
    let on_arm: Vec<_> = steps
        .filter_map(|name| Some((*name, name.on_arm()?)))
        .collect();
    if !on_arm.is_empty() {
        on_arm!(robot, A, N, P => arguments.on::<A, N, P>(&profile, robot, &on_arm))?;
    }
    for name in wanted {
        if name.on_arm().is_none() {
            arguments.other(name, &profile)?;
            show!("{name:?}: passed")?;
        }
    }
    if arguments.step.is_none() {
        let bank = arguments.out.join("identified/parameters.bank");
        show!(
            "next: host-sim drive --profile {} --bus {} --bank {} --trajectory validation --learn --out DIR",
            arguments.profile.display(),
            arguments.bus,
            bank.display()
        )?;
    }
    Ok(())
}

impl Arguments {
    /// A step that is a command of its own.
    fn other(&self, name: StepName, profile: &Profile) -> Result<(), Failure> {
        let directory = |name: &str| self.out.join(name).display().to_string();
        let [excited, driven] = ["excitation", "driven"].map(directory);
        let path = format!("{excited}/excitation.json");
        let seed = self.seed.to_string();
        match name {
            StepName::Drive => {
                if !self.bus.is_simulated() {
                    prompt("the arm moves through its excitation next: keep clear")?;
                }
                let text = std::fs::read_to_string(&path).map_err(|error| {
                    unusable(format!("{path}: {error}; the step before writes it"))
                })?;
                let series: serde_json::Value = serde_json::from_str(&text)?;
                let period_s = series["period_s"].as_f64();
                let duration_s = (PERIODS * period_s.unwrap_or_default()).to_string();
                let (file, bus) = (self.profile.display().to_string(), self.bus.to_string());
                let words = [
                    ["--profile", &file],
                    ["--bus", &bus],
                    ["--trajectory", &path],
                    ["--duration-s", &duration_s],
                    ["--seed", &seed],
                    ["--out", &driven],
                ];
                let mut drive: drive::Arguments = of(words.as_flattened())?;
                drive.arm = self.arm.clone();
                drive::run(&drive)
            }
            StepName::Identify => {
                let log = format!("{driven}/log.csv");
                let out = directory("identified");
                let words = ["--robot", &profile.robot, "--log", &log, "--out", &out];
                let mut identify: identify::Arguments = of(&words)?;
                identify.robot.arm = self.arm.clone();
                identify::run(&identify)
            }
            _ => {
                let robot = &profile.robot;
                let words = [["--robot", robot], ["--seed", &seed], ["--out", &excited]];
                let mut excite: excite::Arguments = of(words.as_flattened())?;
                excite.robot.arm = self.arm.clone();
                excite::run(&excite)
            }
        }
    }

    fn on<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
        profile: &Profile,
        robot: &Robot,
        wanted: &[(StepName, Step)],
    ) -> Result<(), Failure> {
        let rated = f64::from(rated_payload::<A, N, P>());
        if let Some(mass) = self.weight_kg.filter(|mass| *mass > rated) {
            bail!("--weight-kg {mass}: more than the {rated:.2} kg that the arm carries");
        }
        let (config, robot) = (profile.config::<A, N, P>()?, &with_rotors(robot)?);
        let rest = Joints::<N>::from_column_slice(&profile.rest_rad);
        let other_size = || unsupported(N);
        let model = ReferenceModel::new(robot).ok_or_else(other_size)?;
        let network: Box<dyn Network> = if self.bus.is_simulated() {
            let truth = robot.perturbed(self.seed);
            let plant = Plant::<N>::new(&truth, plant_config(PlantConfig::default()), self.seed);
            let mut plant = plant.ok_or_else(other_size)?;
            plant.place(&rest);
            let rates = profile.common_rates()?;
            let network = SimulatedNetwork::new(plant, &config, rates, &Joints::zeros(), self.seed);
            Box::new(network)
        } else {
            Box::new(wired(&self.bus, profile)?)
        };
        let friction = robot.each(|joint| joint.friction.coulomb);
        let friction = friction.map(Joints::from).ok_or_else(other_size)?;
        let work = || {
            let network = Attended::new(network, self.bus.is_simulated());
            let parameters = Parameters::nominal::<A>();
            let player = BusPlayer::<A, _, N, P>::new(config, &parameters, network)?;
            let mut arm = Commissioning::new(player, model, rest);
            arm.friction_nm = friction;
            self.steps(arm, wanted)
        };
        in_loop::<A, N, P, _>(&self.bus, work, || Ok(()))
    }

    /// Executes the steps, and writes what was found up to the first mistake. A step alone keeps the findings of the others.
    fn steps<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
        mut arm: Commissioning<A, Attended, N, P>,
        wanted: &[(StepName, Step)],
    ) -> Result<(), Failure> {
        let file = self.out.join("commission.json");
        if self.step.is_some() && file.exists() {
            let refused = |problem: String| unusable(format!("{}: {problem}", file.display()));
            let text = text_of(&file)?;
            let found: Vec<Found> =
                serde_json::from_str(&text).map_err(|error| refused(error.to_string()))?;
            let (count, way) = (found.len(), "choose another --out");
            let other = format!("findings of {count} joints, the arm has {N}: {way}");
            arm.found = found.try_into().map_err(|_| refused(other))?;
        }
        // A place that cannot be written is refused before the arm moves.
        let mut place = WholeFile::create(&file)?;
        let weight = |mass| Payload::cube(mass, self.weight_com, 0.0, 0.0).body;
        arm.weight = self.weight_kg.map(weight);
        let mut outcome = Ok(());
        for (name, step) in wanted {
            if *step == Step::Weight && arm.weight.is_none() {
                show!("Weight: left out, --weight-kg states no weight")?;
                continue;
            }
            outcome = arm.step(*step);
            if outcome.is_err() {
                break;
            }
            let shown = arm.found.iter().any(|found| found.gain.is_some());
            match *step == Step::Weight && !shown {
                true => show!("{name:?}: it shows the gain of no joint, take a heavier one")?,
                false => show!("{name:?}: passed")?,
            }
        }
        put_json(&mut place, arm.found.as_slice())?;
        place.finish()?;
        Ok(outcome?)
    }
}
