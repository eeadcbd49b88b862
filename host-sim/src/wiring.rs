use super::arm::ArmOptions;
use super::boards::on_arm;
use super::terminal::show;
use super::{Failure, not_over, unusable};
use clap::{Args, ValueEnum};
use foretorque::arm::Arm;
use foretorque_link::bus::{Role, Wires, Wiring};
use foretorque_link::drives::Protocol;
use foretorque_workbench::bus::{JointEntry, Profile};
use foretorque_workbench::files::write_whole;
use foretorque_workbench::robot::Robot;
use std::path::{Path, PathBuf};

/// Write the drives of a profile as bytes for the flash of a board on their bus, the firmware `joint-can`
#[derive(Debug, Args)]
pub(super) struct Arguments {
    /// Profile of the arm: its drives, buses and gains (see docs/bus.md)
    #[arg(long, value_name = "FILE")]
    profile: PathBuf,
    /// Place of the board among the drives
    #[arg(long, value_enum)]
    role: RoleName,
    /// The one joint, from 1, whose drive is on this board; without it all
    #[arg(long)]
    joint: Option<usize>,
    #[command(flatten)]
    arm: ArmOptions,
    /// File for the bytes, which belong to address 0x08080000
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Roles and ports.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum RoleName {
    /// The board sends every command on CAN1 and CAN2
    Master,
    /// Commands pass from CAN1 to CAN2, with the torque of the board
    InLine,
    /// Commands pass from USART6 to UART4, in the text form of moteus
    Uart,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let profile = Profile::load(&arguments.profile)?;
    let robot = &arguments.arm.load(&profile.robot)?;
    let read = Robot::files(Path::new(&profile.robot)).into_iter();
    not_over(
        read.chain([arguments.profile.clone()]),
        [arguments.out.clone()],
    )?;
    on_arm!(robot, A, N, P => arguments.write::<A, N, P>(&profile))
}

impl Arguments {
    fn write<A: Arm<N, P>, const N: usize, const P: usize>(
        &self,
        profile: &Profile,
    ) -> Result<(), Failure> {
        let (role, wires) = match self.role {
            RoleName::Master => (Role::Master, Wires::Can),
            RoleName::InLine => (Role::InLine, Wires::Can),
            RoleName::Uart => (Role::InLine, Wires::Uart),
        };
        let fast = |joint: &JointEntry| matches!(joint.drive.protocol, Protocol::Moteus(_));
        let fast = profile.joint.iter().position(fast);
        if let Some(joint) = fast.filter(|_| wires == Wires::Can) {
            let place = format!("{}: joint {}", profile.file, joint + 1);
            let reason = "its drive needs CAN-FD, which this board does not have";
            return Err(unusable(format!("{place}: {reason}")));
        }
        let mut wiring = profile.wiring::<A, N, P>(role, wires)?;
        if let Some(only) = self.joint {
            if !(1..=N).contains(&only) {
                let reason = format!("--joint {only}: the arm has joints 1 to {N}");
                return Err(unusable(reason));
            }
            let joints = (1..).zip(&mut wiring.joints);
            let others = joints.filter(|(joint, _)| *joint != only);
            others.for_each(|(_, slot)| *slot = None);
        }
        let mut buffer = vec![0; Wiring::<N>::BYTES];
        let file = &profile.file;
        let many = format!("{file}: more drives than the flash of a board holds");
        let bytes = wiring.encode(&mut buffer).map_err(|_| unusable(many))?;
        write_whole(&self.out, bytes)?;
        let (count, out) = (bytes.len(), self.out.display());
        show!(
            "{count} bytes; next: probe-rs download --chip STM32F405RGTx --binary-format bin --base-address 0x08080000 {out}"
        )
    }
}
