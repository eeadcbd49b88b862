use super::boards::on_arm;
use super::drive::wired;
use super::terminal::{show, write_line};
use super::{Failure, unusable};
use clap::{Args, ValueEnum};
use foretorque::arm::Arm;
use foretorque::learning::ParameterSet;
use foretorque_link::bank::NETWORK_SEED;
use foretorque_link::drives::Frame;
use foretorque_workbench::bus::sim::{SimulatedNetwork, plant_config};
use foretorque_workbench::bus::{
    Ask, BusChoice, BusError, BusPlayer, Commissioning, Network, Operator, Profile, Step,
    WiredNetwork,
};
use foretorque_workbench::dynamics::{Joints, ReferenceModel};
use foretorque_workbench::files::write_whole;
use foretorque_workbench::plant::{Plant, PlantConfig};
use foretorque_workbench::robot::{Perturbation, Robot};
use std::io::{self, BufRead};
use std::path::PathBuf;
use std::time::Duration;

/// Check the profile of an arm on its bus step by step, below a tenth of its torque, before it is driven
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
    /// Seed of the simulated arm
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Directory for commission.json
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Names of the steps.
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
}

impl StepName {
    const ALL: [(Self, Step); 5] = [
        (Self::Find, Step::Find),
        (Self::Turn, Step::Turn),
        (Self::Zero, Step::Zero),
        (Self::Torque, Step::Torque),
        (Self::Friction, Step::Friction),
    ];
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let profile = Profile::load(&arguments.profile)?;
    if profile.rest_rad.is_empty() {
        let file = &profile.file;
        return Err(unusable(format!(
            "{file}: rest_rad is missing: the pose of rest without torque"
        )));
    }
    let robot = &Robot::load(&profile.robot)?;
    on_arm!(robot, A, N, P => arguments.on::<A, N, P>(&profile, robot))
}

impl Arguments {
    fn on<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
        profile: &Profile,
        robot: &Robot,
    ) -> Result<(), Failure> {
        let arguments = self;
        let config = profile.config::<A, N, P>()?;
        let rest = Joints::<N>::from_column_slice(&profile.rest_rad);
        let set = ParameterSet::nominal::<A>(NETWORK_SEED);
        let other_size = || unusable(format!("robot '{}' has not {N} joints", robot.name));
        let model = ReferenceModel::new(robot).ok_or_else(other_size)?;
        let network: Box<dyn Operator> = if arguments.bus == BusChoice::Sim {
            let truth = robot.perturbed(arguments.seed, &Perturbation::PLANT);
            let plant = plant_config(PlantConfig::default());
            let plant = Plant::<N>::new(&truth, plant, arguments.seed);
            let mut plant = plant.ok_or_else(other_size)?;
            plant.place(&rest);
            let rates = profile.bus.first().copied().unwrap_or_default();
            let noise = Joints::zeros();
            let network = SimulatedNetwork::new(plant, &config, rates, &noise, arguments.seed);
            Box::new(network)
        } else {
            Box::new(Attended(wired(&arguments.bus, profile)?))
        };
        let player = BusPlayer::<A, _, N, P>::new(config, set, network)?;
        steps(arguments, Commissioning::new(player, model, rest))
    }
}

/// Executes the steps, and writes what was found up to the first mistake.
fn steps<A: Arm<N, P>, const N: usize, const P: usize>(
    arguments: &Arguments,
    mut arm: Commissioning<A, Box<dyn Operator>, N, P>,
) -> Result<(), Failure> {
    let wanted = |name: &StepName| arguments.step.is_none_or(|only| only == *name);
    let mut outcome = Ok(());
    for (name, step) in StepName::ALL.into_iter().filter(|(name, _)| wanted(name)) {
        outcome = arm.step(step);
        if outcome.is_err() {
            break;
        }
        show!("{name:?}: passed")?;
    }
    let text = serde_json::to_string_pretty(&arm.found.as_slice())? + "\n";
    write_whole(&arguments.out.join("commission.json"), text.as_bytes())?;
    outcome?;
    if arguments.step.is_none() {
        show!(
            "next: host-sim excite, host-sim drive --trajectory excitation.json, host-sim identify"
        )?;
    }
    Ok(())
}

/// A network with somebody at the terminal who moves the arm.
struct Attended(WiredNetwork);

impl Network for Attended {
    fn name(&self) -> String {
        self.0.name()
    }

    fn send(&mut self, bus: u8, frame: &Frame) -> Result<(), BusError> {
        self.0.send(bus, frame)
    }

    fn receive(&mut self) -> Result<Option<(u8, Frame)>, BusError> {
        self.0.receive()
    }

    fn wait(&mut self) -> Duration {
        self.0.wait()
    }

    fn is_off(&self) -> bool {
        self.0.is_off()
    }
}

impl Operator for Attended {
    fn ask(&mut self, ask: &Ask) -> Result<(), BusError> {
        let request = match ask {
            Ask::Pose(pose) => format!("put the arm into the pose {pose:?} rad"),
            Ask::Turn { joint, by_rad } => {
                let degrees = by_rad.to_degrees();
                format!("turn joint {} by {degrees:+.0}° by hand", joint + 1)
            }
        };
        let gone = |error: io::Error| BusError::Gone {
            name: "terminal".to_owned(),
            error,
        };
        write_line(format_args!("{request}, then press Enter")).map_err(gone)?;
        let mut line = String::new();
        match io::stdin().lock().read_line(&mut line).map_err(gone)? {
            0 => Err(gone(io::ErrorKind::UnexpectedEof.into())),
            _ => Ok(()),
        }
    }
}
