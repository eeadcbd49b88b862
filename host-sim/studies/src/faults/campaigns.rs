//! Every kind of fault on every board that can have it.

use super::machine::{Crash, crashes};
use super::store::{self, SECTOR, SMALL_SECTOR};
use super::{BadUpload, Campaign, Damage, TimedFault, timed};
use super::{bad_uploads, damaged_line, foreign_frames, strange_numbers, watchdog_bites};
use foretorque::arm::ur5::{JOINTS, PARAMETERS, Ur5};
use foretorque_link::store::{StoreError, slots};
use foretorque_link::wire::Pacing;
use foretorque_workbench::board::qemu::{Emulator, Image, QemuOptions};
use foretorque_workbench::board::{BoardError, Native, Transport};
use std::error::Error;
use std::path::Path;

/// Ticks of a second of arm time.
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
    /// Six seconds of each kind, and what the store needs to fill and erase both sectors again and again.
    pub const SHORT: Self = Self {
        native_s: 6,
        bulk_s: 6,
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
    fn connect(self) -> Result<Box<dyn Transport>, Failure> {
        Ok(match self {
            Self::Native => Box::new(Native::<Ur5, JOINTS, PARAMETERS>::new()?),
            Self::Bulk => Box::new(Emulator::start(&QemuOptions::new(Image::Bulk))?),
            Self::Usart => Box::new(Emulator::start(&QemuOptions::new(Image::Joint))?),
        })
    }
}

type Failure = Box<dyn Error + Send + Sync>;
type Work = Box<dyn Fn() -> Result<Campaign, Failure> + Send + Sync>;

/// One campaign to be run, on whatever thread.
pub struct Scenario {
    /// Name of the broken part, for a progress bar.
    pub name: &'static str,
    work: Work,
}

impl Scenario {
    fn new<E: Into<Failure>>(
        name: &'static str,
        work: impl Fn() -> Result<Campaign, E> + Send + Sync + 'static,
    ) -> Self {
        Self {
            name,
            work: Box::new(move || work().map_err(Into::into)),
        }
    }

    /// Work on a board that is started for it.
    fn on(
        board: Board,
        name: &'static str,
        work: impl Fn(Box<dyn Transport>) -> Result<Campaign, BoardError> + Send + Sync + 'static,
    ) -> Self {
        Self::new(name, move || -> Result<_, Failure> {
            Ok(work(board.connect()?)?)
        })
    }

    /// Breaks things.
    ///
    /// Errors: a board that cannot be started, or one that is gone for good: that one has not survived.
    pub fn run(&self) -> Result<Campaign, Failure> {
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
        for fault in TimedFault::all() {
            all.push(Scenario::new(fault.name(), move || {
                timed(pacing, fault, lengths.native_s * TICKS_PER_S, seed)
            }));
        }
    }
    flash(&mut all, lengths, seed);
    all.push(Scenario::new("watchdog", move || {
        watchdog_bites(lengths.times, seed)
    }));
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
    for damage in Damage::all() {
        let ticks = ticks(damage);
        all.push(Scenario::on(board, damage.name(), move |link| {
            damaged_line(link, damage, ticks, seed)
        }));
    }
    let few = ticks(Damage::Flips);
    all.push(Scenario::on(board, "strange numbers", move |link| {
        strange_numbers(link, few, seed)
    }));
    all.push(Scenario::on(board, "foreign frames", move |link| {
        foreign_frames(link, few, seed)
    }));
    let times = match board {
        Board::Usart => lengths.times.div_ceil(20),
        _ => lengths.times,
    };
    for bad in BadUpload::all() {
        all.push(Scenario::on(board, bad.name(), move |link| {
            bad_uploads(link, bad, times, seed)
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
        Ok::<_, StoreError>(campaign)
    }));
    all.push(Scenario::new("life of power cuts", move || {
        Ok::<_, StoreError>(store::power_cut_life::<SMALL_SECTOR>(lengths.saves, seed))
    }));
    all.push(Scenario::new("worn flash", move || {
        Ok::<_, StoreError>(store::worn::<SMALL_SECTOR>(lengths.saves / 10, 4, seed))
    }));
    all.push(Scenario::new("protected flash", move || {
        store::protected::<SMALL_SECTOR>(0..=6, seed)
    }));
    all.push(Scenario::new("bit rot", move || {
        store::bit_rot::<SMALL_SECTOR>(2, seed)
    }));
    all.push(Scenario::new("foreign sets", move || {
        store::foreign_sets::<SMALL_SECTOR>(seed)
    }));
}
