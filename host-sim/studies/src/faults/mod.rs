//! The fault campaign: everything that can be broken is broken, and what the board makes of it is counted.
//!
//! A torque is *wrong* when it differs in one bit from that of a reference board that was fed only with the frames that the
//! board under test accepted. A set is *lost* when, after the fault, neither the newest set that was stored nor the one under
//! way can be loaded.

mod damage;
mod link;
pub mod machine;
mod rig;
pub mod store;
mod timed;
mod uploads;

use crate::StudyError;
use damage::{DAMAGES, Damage};
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque_link::store::slots;
use foretorque_link::wire::Pacing;
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use foretorque_workbench::board::{Native, Transport};
use foretorque_workbench::report::page::or_dash;
use foretorque_workbench::snapshot::aligned;
use link::{damaged_line, foreign_frames, strange_numbers};
use machine::{Crash, crashes, restart_by_watchdog};
use rig::Round;
use serde::Serialize;
use std::path::Path;
use store::{SECTOR, SMALL_SECTOR};
use timed::{timed, timed_faults};
use uploads::{BAD_UPLOADS, bad_uploads};

/// Counts of one kind of fault.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Campaign {
    /// Name of the broken part.
    pub name: String,
    /// Where: `native`, `qemu (bulk)`, `qemu (joint)`, `simulated flash`.
    pub board: String,
    /// Faults.
    pub injected: u64,
    /// Torques that were not those of the reference.
    pub wrong_torques: u64,
    /// Faults after which the last good set could not be loaded, or was not the one in force.
    pub lost_sets: u64,
    /// Faults after which the board gave a right torque for a fresh sample again.
    pub recovered: u64,
    /// Torques or enables without an `Arm` that the board had acknowledged.
    pub without_permission: u64,
    /// Returns to torque for which the host had not asked.
    pub rearmed: u64,
    /// Time-outs of the samples, and those of them that came more than a period too early or too late.
    pub timeouts: u64,
    /// See [`timeouts`](Self::timeouts).
    pub mistimed: u64,
    /// Torques that were compared with the reference, bit by bit.
    pub torques: u64,
    /// Answers with torque enabled whose promises were checked: limits, permission, times.
    pub promised: u64,
    /// Faults that no counter of the board shows; `None` where they need not show.
    pub unnoticed: Option<u64>,
    /// Intact frames, at most, until one was received again.
    pub frames_to_resynchronise: u32,
    /// Faults since the last right torque.
    #[serde(skip)]
    pending: u64,
}

impl Campaign {
    /// Nothing broken yet.
    pub fn new(name: &str, board: &str) -> Self {
        Self {
            name: name.into(),
            board: board.into(),
            ..Self::default()
        }
    }

    /// Something was broken, all of it was noticed, no wrong torque left the board, no set was lost, and the board came back
    /// every time, on a line within two frames.
    pub fn is_survived(&self) -> bool {
        let clean =
            self.wrong_torques == 0 && self.lost_sets == 0 && self.unnoticed.unwrap_or(0) == 0;
        let back = self.recovered == self.injected && self.frames_to_resynchronise <= 2;
        let kept = self.without_permission + self.rearmed + self.mistimed == 0;
        self.injected > 0 && clean && back && kept
    }

    /// Counts a fault after which a set was kept or not, and the board came back or not.
    fn case(&mut self, kept: bool, back: bool) {
        self.injected += 1;
        self.lost_sets += u64::from(!kept);
        self.recovered += u64::from(back);
    }

    /// Counts a round: right torques in it are the recovery from the faults of earlier rounds.
    fn count(&mut self, round: &Round, injected: u64) {
        if round.right_torques > 0 {
            self.recover();
        }
        self.inject(injected);
        self.frames_to_resynchronise = self.frames_to_resynchronise.max(round.resynchronised);
    }

    /// Counts faults that wait for a right torque.
    fn inject(&mut self, faults: u64) {
        self.injected += faults;
        self.pending += faults;
    }

    /// Counts a right torque: the board is back from all faults before it.
    fn recover(&mut self) {
        self.recovered += std::mem::take(&mut self.pending);
    }

    /// The counts of a board that is `back` in the end, or not: then it has not come back from the last fault.
    fn ended(mut self, back: bool) -> Self {
        self.recovered -= u64::from(!back && self.recovered > 0);
        self
    }
}

type Count = fn(&Campaign) -> Option<u64>;

/// Counts of a campaign by their names in a report; `None` where nothing was counted.
const COUNTS: [(&str, Count); 11] = [
    ("injected", |own| Some(own.injected)),
    ("torques compared", |own| counted(own.torques)),
    ("under promises", |own| counted(own.promised)),
    ("wrong", |own| Some(own.wrong_torques)),
    ("lost sets", |own| Some(own.lost_sets)),
    ("recovered", |own| Some(own.recovered)),
    ("unseen", |own| own.unnoticed),
    ("without permission", |own| Some(own.without_permission)),
    ("re-armed", |own| Some(own.rearmed)),
    ("time-outs", |own| counted(own.timeouts)),
    ("mistimed", |own| {
        counted(own.timeouts).map(|_| own.mistimed)
    }),
];

fn counted(count: u64) -> Option<u64> {
    Some(count).filter(|count| *count > 0)
}

/// The counts of all campaigns.
pub fn text(seed: u64, campaigns: &[Campaign]) -> String {
    let sum = |count: fn(&Campaign) -> u64| campaigns.iter().map(count).sum::<u64>();
    let (number, injected) = (campaigns.len(), sum(|own| own.injected));
    let must_show = campaigns.iter().filter(|own| own.unnoticed.is_some());
    let must_show: u64 = must_show.map(|own| own.injected).sum();
    let not_recovered = injected - sum(|own| own.recovered);
    let header = COUNTS.map(|(name, _)| name).join(" | ");
    let rows = campaigns.iter().map(|own| {
        let counts = COUNTS.map(|(_, count)| or_dash(count(own), |count| count.to_string()));
        [own.name.clone(), own.board.clone()]
            .into_iter()
            .chain(counts)
    });
    format!(
        "cargo xtask faults, seed {seed}\n\n\
         {number} campaigns, {injected} faults, {} torques compared bit by bit and {} under promises: {} wrong, {} sets lost, \
         {not_recovered} not recovered, {} unseen of {must_show} faults that must show, {} torques without permission, {} re-arms \
         unasked, {} of {} time-outs more than a period off.\n\n{}",
        sum(|own| own.torques),
        sum(|own| own.promised),
        sum(|own| own.wrong_torques),
        sum(|own| own.lost_sets),
        sum(|own| own.unnoticed.unwrap_or(0)),
        sum(|own| own.without_permission),
        sum(|own| own.rearmed),
        sum(|own| own.mistimed),
        sum(|own| own.timeouts),
        aligned(&format!("fault | board | {header}"), rows)
    )
}

const TICKS_PER_S: u32 = 1000;

/// How much of everything.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lengths {
    /// Arm time of each kind of damage on the board in this process, s.
    pub native_s: u32,
    /// Arm time of 0.01 % byte errors on the bulk firmware in the emulator, s; of every other kind a tenth.
    pub bulk_s: u32,
    /// Samples of each kind of damage on the flashable firmware over its USART.
    pub usart_ticks: u32,
    /// Uploads of each kind that fail; crashes of each kind are a twentieth.
    pub times: u32,
    /// Saves in a life of power cuts.
    pub saves: u32,
}

impl Lengths {
    /// The whole campaign: ten minutes of arm time with byte errors.
    pub const FULL: Self = Self {
        native_s: 60,
        bulk_s: 600,
        usart_ticks: 1000,
        times: 200,
        saves: 20_000,
    };
    /// Three seconds of each kind, and what the store needs to fill and erase both sectors again and again.
    pub const SHORT: Self = Self {
        native_s: 3,
        bulk_s: 3,
        usart_ticks: 40,
        times: 10,
        saves: 3000,
    };
}

/// Where a campaign takes its board from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Board {
    Native,
    Bulk,
    Usart,
}

impl Board {
    fn connect(self) -> Result<Box<dyn Transport>, StudyError> {
        Ok(match self {
            Self::Native => Box::new(Native::<Ur5, JOINTS, PARAMETERS>::new()?),
            Self::Bulk => Box::new(Emulator::start(&QemuOptions::new(Image::Bulk))?),
            Self::Usart => Box::new(Emulator::start(&QemuOptions::new(Image::Joint))?),
        })
    }
}

type Work = Box<dyn Fn() -> Result<Campaign, StudyError> + Send + Sync>;

/// One campaign to be run, on whatever thread.
pub struct Scenario {
    /// Name of the broken part, for a progress bar.
    pub name: &'static str,
    work: Work,
}

impl Scenario {
    fn new(
        name: &'static str,
        work: impl Fn() -> Result<Campaign, StudyError> + Send + Sync + 'static,
    ) -> Self {
        let work = Box::new(work);
        Self { name, work }
    }

    /// Breaks things.
    ///
    /// Errors: a board that cannot be started, or one that is gone for good: that one has not survived.
    pub fn run(&self) -> Result<Campaign, StudyError> {
        (self.work)()
    }
}

/// All campaigns; `scratch` is a directory for traces of the emulator.
pub fn scenarios(lengths: Lengths, seed: u64, scratch: &Path) -> Vec<Scenario> {
    let mut all = Vec::new();
    for board in [Board::Native, Board::Bulk, Board::Usart] {
        line(&mut all, board, lengths, seed);
    }
    for pacing in [Pacing::Link, Pacing::SysTick] {
        for fault in timed_faults() {
            let (name, ..) = fault;
            all.push(Scenario::new(name, move || {
                timed(pacing, fault, lengths.native_s * TICKS_PER_S, seed)
            }));
        }
    }
    flash(&mut all, lengths, seed);
    all.push(Scenario::new("watchdog", restart_by_watchdog));
    for crash in Crash::ALL {
        let trace = scratch.join(format!("{}.trace", crash.name.replace(' ', "-")));
        let times = lengths.times.div_ceil(20);
        all.push(Scenario::new(crash.name, move || {
            crashes(crash, times, trace.clone())
        }));
    }
    all
}

fn line(all: &mut Vec<Scenario>, board: Board, lengths: Lengths, seed: u64) {
    let ticks = |damage| match (board, damage) {
        (Board::Native, _) => lengths.native_s * TICKS_PER_S,
        (Board::Bulk, Damage::Noise) => lengths.bulk_s * TICKS_PER_S,
        (Board::Bulk, _) => lengths.bulk_s * TICKS_PER_S / 10,
        (Board::Usart, _) => lengths.usart_ticks,
    };
    for (damage, name) in DAMAGES {
        let ticks = ticks(damage);
        all.push(Scenario::new(name, move || {
            damaged_line(board.connect()?, (damage, name), ticks, seed)
        }));
    }
    let few = ticks(Damage::Flips);
    all.push(Scenario::new("strange numbers", move || {
        strange_numbers(board.connect()?, few, seed)
    }));
    all.push(Scenario::new("foreign frames", move || {
        foreign_frames(board.connect()?, few, seed)
    }));
    let times = match board {
        Board::Usart => lengths.times.div_ceil(20),
        _ => lengths.times,
    };
    for (bad, name) in BAD_UPLOADS {
        all.push(Scenario::new(name, move || {
            bad_uploads(board.connect()?, (bad, name), times, seed)
        }));
    }
}

fn flash(all: &mut Vec<Scenario>, lengths: Lengths, seed: u64) {
    let full = slots(SECTOR as u32);
    // New flash, and both sides of every change of sector.
    let real = match lengths == Lengths::FULL {
        true => [0..=1, full - 1..=full + 1, 2 * full - 1..=2 * full + 1].to_vec(),
        false => vec![full..=full],
    };
    let real = real.into_iter().flatten();
    all.push(Scenario::new("power cuts", move || {
        store::power_cuts::<SECTOR>(real.clone(), seed)
    }));
    all.push(Scenario::new("power cuts, small", move || {
        let mut campaign = store::power_cuts::<SMALL_SECTOR>(0..=6, seed)?;
        campaign.name += ", two slots a sector";
        Ok(campaign)
    }));
    all.push(Scenario::new("life of power cuts", move || {
        Ok(store::power_cut_life(lengths.saves, seed))
    }));
    all.push(Scenario::new("worn flash", move || {
        Ok(store::worn(lengths.saves / 10, seed))
    }));
    all.push(Scenario::new("protected flash", move || {
        store::protected(seed)
    }));
    all.push(Scenario::new("bit rot", move || store::bit_rot(seed)));
    all.push(Scenario::new("foreign sets", move || {
        store::foreign_sets(seed)
    }));
}
