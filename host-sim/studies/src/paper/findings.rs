//! The figures as sentences; a conclusion is drawn from them alone.

use super::cell::FrictionKind;
use super::steps::{Steps, Trained};
use super::{Condition, Times, by_rows, on_all_rows};
use crate::real_ur5::geometric_mean;
use std::collections::BTreeMap;

/// A method that is this near to another, on the geometric mean, does as well.
const EQUAL: f64 = 0.02;

/// Findings of steps and conditions, whether or not they favour the BP network.
pub(super) fn findings(steps: &Steps, conditions: &[Condition]) -> Vec<String> {
    let mut out = Vec::new();
    let [exact, plain, physical, black_box] = &steps.trained;
    let error = |trained: &Trained| percent(trained.base_parameter_error_ratio.unwrap_or(0.0));
    out.push(format!(
        "Without noise the BP network with physical weights finds the {} base parameters to {} of their norm after {} accelerated \
         epochs ({} after {} epochs of eq. 21 as it stands) and predicts the arbitrary path to {} NRMSE; least squares solves the \
         same equations at once, to {} and {}.",
        steps.base_parameters,
        error(physical),
        physical.epochs,
        error(plain),
        plain.epochs,
        percent(physical.path_nrmse_ratio),
        error(exact),
        percent(exact.path_nrmse_ratio),
    ));
    out.push(format!(
        "A BP network with a hidden layer on q, qd, qdd (18-32-6) shows {} on the held-out 20 % and {} on the arbitrary path.",
        percent(black_box.validation_loss_ratio),
        percent(black_box.path_nrmse_ratio),
    ));
    let grid = on_all_rows(conditions);
    let of = |friction: Option<FrictionKind>, outliers: Option<bool>| -> Vec<&Condition> {
        let fits = |c: &&Condition| {
            friction.is_none_or(|f| c.friction == f)
                && outliers.is_none_or(|o| (c.outlier_percent > 0.0) == o)
                // Without noise some methods are exact, with outliers too: no ratio means anything there.
                && c.noise_percent > 0.0
        };
        grid.iter().copied().filter(fits).collect()
    };
    let noisy = of(None, None);
    if let Some((mean, least, most)) = ratios(&noisy, "bp_physical") {
        out.push(format!(
            "Robustness to noise: over {} noisy conditions the error of bp_physical is {mean:.3} times that of weighted least squares \
             (geometric mean, {least:.3} to {most:.3}): {}.",
            noisy.len(),
            verdict(mean)
        ));
    }
    let hit = of(None, Some(true));
    let mean = |conditions: &[&Condition], of: &str| Some(ratios(conditions, of)?.0);
    if let (Some(physical), Some(robust)) = (mean(&hit, "bp_physical"), mean(&hit, "irls")) {
        out.push(format!(
            "Outliers: with 1 % of them bp_physical has {physical:.3} times the error of weighted least squares, robust least squares \
             (irls) {robust:.3} times."
        ));
    }
    let peaked = of(Some(FrictionKind::Stribeck), None);
    let methods = ["bp_physical", "bp_residual", "irls_stribeck"];
    if let [Some(physical), Some(residual), Some(columns)] = methods.map(|of| mean(&peaked, of)) {
        out.push(format!(
            "Friction the model does not know (Stribeck): bp_physical {physical:.3} times weighted least squares, small BP networks on \
             what least squares leaves (bp_residual) {residual:.3} times, two more columns in robust least squares {columns:.3} times."
        ));
    }
    let best = |friction: FrictionKind| {
        let conditions = of(Some(friction), None);
        let names = grid.first().map(|c| c.methods.keys().cloned());
        let names = names.into_iter().flatten();
        let scored = names.filter_map(|name| Some((mean(&conditions, &name)?, name)));
        scored.min_by(|a, b| a.0.total_cmp(&b.0))
    };
    for friction in super::FRICTIONS {
        if let Some((mean, name)) = best(friction) {
            out.push(format!(
                "Lowest error with {}: {name}, {mean:.3} times weighted least squares.",
                friction.name()
            ));
        }
    }
    if let Some((mean, least, most)) = ratios(&noisy, "bp_black_box") {
        out.push(format!(
            "The black-box network has {mean:.0} times the error of weighted least squares on unseen paths ({least:.0} to {most:.0})."
        ));
    }
    out.extend(samples(conditions));
    out.extend(failures(conditions));
    out
}

/// Which methods found no model now and then.
fn failures(conditions: &[Condition]) -> Option<String> {
    let mut failed: BTreeMap<&str, usize> = BTreeMap::new();
    for (name, count) in conditions.iter().flat_map(|c| &c.failed) {
        *failed.entry(name).or_default() += count;
    }
    let draws: usize = conditions.iter().map(|c| c.draws).sum();
    let failed = failed.iter();
    let reported = failed.map(|(name, count)| format!("{name} in {count} of {draws} draws"));
    let reported: Vec<String> = reported.collect();
    (!reported.is_empty()).then(|| format!("Found no model: {}.", reported.join(", ")))
}

/// Rows that the methods need: the fewest with which the error is at most twice that with all rows.
fn samples(conditions: &[Condition]) -> Option<String> {
    let (curve, full) = (by_rows(conditions), on_all_rows(conditions).first()?.rows);
    let last = curve.iter().find(|c| c.rows == full)?;
    let needed: Vec<String> = ["wls", "irls", "consistent", "bp_physical", "bp_residual"]
        .iter()
        .filter_map(|name| {
            let error = |c: &Condition| Some(c.methods.get(*name)?.path_nrmse_ratio);
            let goal = 2.0 * error(last)?;
            let reaches = |c: &&&Condition| error(c).is_some_and(|own| own <= goal);
            let first = curve.iter().find(reaches)?;
            let own = error(first)?;
            Some(format!("{name} {} rows ({})", first.rows, percent(own)))
        })
        .collect();
    (curve.len() > 1).then(|| {
        format!(
            "Samples needed for at most twice the error of all {full} rows (1 % noise, Coulomb + viscous): {}.",
            needed.join(", ")
        )
    })
}

pub(super) fn of_times(times: &Times) -> Option<String> {
    let last = |name: &str| times.least_seconds.get(name)?.last().copied();
    let (rows, reference) = last("wls")?;
    let others = [
        "irls",
        "consistent",
        "bp_physical",
        "bp_residual",
        "bp_black_box",
    ];
    let others = others.iter().filter_map(|name| {
        let (_, seconds) = last(name)?;
        let (ms, times) = (1e3 * seconds, seconds / reference);
        Some(format!("{name} {ms:.0} ms ({times:.0}×)"))
    });
    let others: Vec<String> = others.collect();
    Some(format!(
        "Seconds of training on {rows} rows: weighted least squares {:.1} ms; {}.",
        1e3 * reference,
        others.join(", ")
    ))
}

/// Geometric mean, least and most of the error of a method over that of weighted least squares.
fn ratios(conditions: &[&Condition], of: &str) -> Option<(f64, f64, f64)> {
    let ratios = conditions.iter().filter_map(|c| {
        let error = |name: &str| Some(c.methods.get(name)?.path_nrmse_ratio);
        Some(error(of)? / error("wls")?)
    });
    let usable = |ratio: &f64| ratio.is_finite() && *ratio > 0.0;
    let ratios: Vec<f64> = ratios.filter(usable).collect();
    if ratios.is_empty() {
        return None;
    }
    let mean = geometric_mean(&ratios);
    let least = ratios.iter().copied().fold(f64::INFINITY, f64::min);
    Some((mean, least, ratios.iter().copied().fold(0.0, f64::max)))
}

fn verdict(ratio: f64) -> &'static str {
    if ratio < 1.0 - EQUAL {
        "it is the more robust of the two, as the paper claims"
    } else if ratio <= 1.0 + EQUAL {
        "it is neither more nor less robust, and the paper's claim is not confirmed"
    } else {
        "it is the less robust of the two, and the paper's claim is refuted"
    }
}

/// Percent with three digits that mean something.
pub(super) fn percent(ratio: f64) -> String {
    let percent = 100.0 * ratio;
    if percent == 0.0 || percent >= 0.001 {
        let decimals = (2.0 - percent.max(1e-9).log10().floor()).clamp(0.0, 5.0) as usize;
        format!("{percent:.decimals$} %")
    } else {
        format!("{percent:.1e} %")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paper::MethodSummary;

    fn condition(physical: f64) -> Condition {
        let method = |path_nrmse_ratio| MethodSummary {
            path_nrmse_ratio,
            path_nrmse_least_ratio: path_nrmse_ratio,
            path_nrmse_most_ratio: path_nrmse_ratio,
            split_nrmse_ratio: 0.0,
            epochs: 1.0,
        };
        Condition {
            noise_percent: 1.0,
            friction: FrictionKind::None,
            outlier_percent: 0.0,
            rows: 2000,
            draws: 1,
            methods: BTreeMap::from([
                ("wls".to_owned(), method(0.01)),
                ("bp_physical".to_owned(), method(physical)),
            ]),
            failed: BTreeMap::new(),
        }
    }

    #[test]
    fn the_verdict_follows_the_figures_whichever_way_they_go() {
        for (physical, claim) in [
            (0.005, "more robust of the two, as the paper claims"),
            (0.01, "claim is not confirmed"),
            (0.02, "claim is refuted"),
        ] {
            let (mean, ..) = ratios(&[&condition(physical)], "bp_physical").expect("both");
            assert!(verdict(mean).contains(claim), "{physical}");
        }
    }

    #[test]
    fn percents_keep_their_digits() {
        for (ratio, written) in [
            (0.0, "0.00000 %"),
            (1e-7, "1.0e-5 %"),
            (0.00234, "0.234 %"),
            (0.0234, "2.34 %"),
            (2.344, "234 %"),
        ] {
            assert_eq!(percent(ratio), written);
        }
    }
}
