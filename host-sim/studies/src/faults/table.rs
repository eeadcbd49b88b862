//! The counts of a run as text.

use super::Campaign;
use foretorque_workbench::snapshot::aligned;

/// Headings of [`row`].
pub fn header() -> String {
    format!(
        "{:<42} {:<15} {:>9} {:>9} {:>7} {:>5} {:>9} {:>6} {:>9} {:>8} {:>9} {:>8}",
        "fault",
        "board",
        "injected",
        "torques",
        "wrong",
        "lost",
        "recovered",
        "unseen",
        "unallowed",
        "re-armed",
        "time-outs",
        "mistimed"
    )
}

/// The counts of one campaign.
pub fn row(campaign: &Campaign) -> String {
    format!(
        "{:<42} {:<15} {:>9} {:>9} {:>7} {:>5} {:>9} {:>6} {:>9} {:>8} {:>9} {:>8}",
        campaign.name,
        campaign.board,
        campaign.injected,
        campaign.torques,
        campaign.wrong_torques,
        campaign.lost_sets,
        campaign.recovered,
        campaign.unnoticed,
        campaign.without_permission,
        campaign.rearmed,
        campaign.timeouts,
        campaign.mistimed
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
            campaign.without_permission.to_string(),
            campaign.rearmed.to_string(),
            campaign.timeouts.to_string(),
            campaign.mistimed.to_string(),
        ]
    });
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
        aligned(header, rows)
    )
}
