//! The counts of a run, as they are kept in the documentation.

use super::Campaign;

/// A row for each campaign, and the sums.
pub fn text(campaigns: &[Campaign]) -> String {
    let sum = |count: fn(&Campaign) -> u64| campaigns.iter().map(count).sum::<u64>();
    let mut out = format!(
        "{} campaigns, {} faults, {} torques compared: {} wrong, {} sets lost, {} not recovered, {} unseen.\n\n\
         | fault | board | injected | torques compared | wrong | lost sets | recovered | unseen |\n\
         |---|---|---:|---:|---:|---:|---:|---:|\n",
        campaigns.len(),
        sum(|campaign| campaign.injected),
        sum(|campaign| campaign.torques),
        sum(|campaign| campaign.wrong_torques),
        sum(|campaign| campaign.lost_sets),
        sum(|campaign| campaign.injected - campaign.recovered),
        sum(|campaign| campaign.unnoticed),
    );
    for campaign in campaigns {
        out += &format!(
            "| {} | {} | {} | {} | {} | {} | {} | {} |\n",
            campaign.name,
            campaign.board,
            campaign.injected,
            campaign.torques,
            campaign.wrong_torques,
            campaign.lost_sets,
            campaign.recovered,
            campaign.unnoticed
        );
    }
    out
}
