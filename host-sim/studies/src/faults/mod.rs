//! The fault campaign: everything that can be broken is broken, and what the board makes of it is counted.
//!
//! A torque is *wrong* when it differs in one bit from that of a reference board that was fed only with the frames that the
//! board under test accepted. A set is *lost* when, after the fault, neither the newest set that was stored nor the one under
//! way can be loaded.

mod campaigns;
mod damage;
mod link;
pub mod machine;
mod rig;
pub mod store;
mod timed;
mod uploads;

pub use campaigns::{Lengths, Scenario, scenarios};
pub use damage::Damage;
pub use link::{damaged_line, foreign_frames, strange_numbers};
pub use machine::watchdog_bites;
pub use timed::{TimedFault, timed};
pub use uploads::{BadUpload, bad_uploads};

use foretorque_workbench::snapshot::aligned;
use rig::Round;
use serde::Serialize;

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
    /// Torques that were compared.
    pub torques: u64,
    /// Faults that no counter of the board shows.
    pub unnoticed: u64,
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
        let clean = self.wrong_torques == 0 && self.lost_sets == 0 && self.unnoticed == 0;
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
            self.recovered += std::mem::take(&mut self.pending);
        }
        self.injected += injected;
        self.pending += injected;
        self.frames_to_resynchronise = self.frames_to_resynchronise.max(round.resynchronised);
    }
}

fn cells(campaign: &Campaign) -> [String; 12] {
    let count = |count: u64| count.to_string();
    [
        campaign.name.clone(),
        campaign.board.clone(),
        count(campaign.injected),
        count(campaign.torques),
        count(campaign.wrong_torques),
        count(campaign.lost_sets),
        count(campaign.recovered),
        count(campaign.unnoticed),
        count(campaign.without_permission),
        count(campaign.rearmed),
        count(campaign.timeouts),
        count(campaign.mistimed),
    ]
}

/// The counts of all campaigns.
pub fn text(seed: u64, campaigns: &[Campaign]) -> String {
    let sum = |count: fn(&Campaign) -> u64| campaigns.iter().map(count).sum::<u64>();
    let header = "fault | board | injected | torques compared | wrong | lost sets | recovered | unseen | without permission | re-armed | time-outs | mistimed";
    format!(
        "cargo xtask faults, seed {seed}\n\n\
         {} campaigns, {} faults, {} torques compared: {} wrong, {} sets lost, {} not recovered, {} unseen, \
         {} torques without permission, {} re-arms unasked, {} of {} time-outs more than a period off.\n\n{}",
        campaigns.len(),
        sum(|campaign| campaign.injected),
        sum(|campaign| campaign.torques),
        sum(|campaign| campaign.wrong_torques),
        sum(|campaign| campaign.lost_sets),
        sum(|campaign| campaign.injected - campaign.recovered),
        sum(|campaign| campaign.unnoticed),
        sum(|campaign| campaign.without_permission),
        sum(|campaign| campaign.rearmed),
        sum(|campaign| campaign.mistimed),
        sum(|campaign| campaign.timeouts),
        aligned(header, campaigns.iter().map(cells))
    )
}
