//! The counts of a run as text.

use super::Campaign;
use foretorque_workbench::snapshot::aligned;

/// Headings of [`row`].
pub fn header() -> String {
    format!(
        "{:<42} {:<15} {:>9} {:>9} {:>7} {:>5} {:>9} {:>6}",
        "fault", "board", "injected", "torques", "wrong", "lost", "recovered", "unseen"
    )
}

/// The counts of one campaign.
pub fn row(campaign: &Campaign) -> String {
    format!(
        "{:<42} {:<15} {:>9} {:>9} {:>7} {:>5} {:>9} {:>6}",
        campaign.name,
        campaign.board,
        campaign.injected,
        campaign.torques,
        campaign.wrong_torques,
        campaign.lost_sets,
        campaign.recovered,
        campaign.unnoticed
    )
}

/// The counts of all campaigns.
pub fn text(seed: u64, campaigns: &[Campaign]) -> String {
    let sum = |count: fn(&Campaign) -> u64| campaigns.iter().map(count).sum::<u64>();
    let rows = campaigns.iter().map(|campaign| {
        [
            campaign.name.clone(),
            campaign.board.clone(),
            campaign.injected.to_string(),
            campaign.torques.to_string(),
            campaign.wrong_torques.to_string(),
            campaign.lost_sets.to_string(),
            campaign.recovered.to_string(),
            campaign.unnoticed.to_string(),
        ]
    });
    let header =
        "fault | board | injected | torques compared | wrong | lost sets | recovered | unseen";
    format!(
        "cargo xtask faults, seed {seed}\n\n\
         {} campaigns, {} faults, {} torques compared: {} wrong, {} sets lost, {} not recovered, {} unseen.\n\n{}",
        campaigns.len(),
        sum(|campaign| campaign.injected),
        sum(|campaign| campaign.torques),
        sum(|campaign| campaign.wrong_torques),
        sum(|campaign| campaign.lost_sets),
        sum(|campaign| campaign.injected - campaign.recovered),
        sum(|campaign| campaign.unnoticed),
        aligned(header, rows)
    )
}
