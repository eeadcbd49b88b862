//! The counts of a run as text.

use super::Campaign;

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

/// A row for each campaign, and their number.
pub fn text(campaigns: &[Campaign]) -> String {
    let rows: String = campaigns
        .iter()
        .map(|campaign| row(campaign) + "\n")
        .collect();
    let injected: u64 = campaigns.iter().map(|campaign| campaign.injected).sum();
    format!(
        "{}\n{rows}{} campaigns, {injected} faults\n",
        header(),
        campaigns.len()
    )
}
