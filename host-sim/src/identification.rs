//! Methods of identification on simulated arms: a study of the commands of this program, which its report names.

use super::{Failure, bail, unusable};
use foretorque_studies::{Outcome, Progress};
use foretorque_workbench::files::at;
use foretorque_workbench::metrics::root_mean;
use foretorque_workbench::parallel::{cores, in_parallel};
use foretorque_workbench::report::page::{Page, Section};
use foretorque_workbench::snapshot::aligned;
use serde::Serialize;
use std::collections::BTreeMap;
use std::env::current_exe;
use std::path::Path;
use std::process::{Command, Stdio};

/// Logs of an arm, with SEED and LENGTH in seconds: excitation, unseen path, path of a tool.
const LOGS: [&str; 3] = [
    "simulate --robot ur5 --trajectory host-sim/paths/ur5-excitation.json --duration-s LENGTH --seed SEED --out OUT/t.csv.gz",
    "simulate --robot ur5 --trajectory validation --torque-noise 0 --seed SEED --out OUT/v.csv.gz",
    "simulate --robot ur5 --trajectory host-sim/paths/ur5.toml --torque-noise 0 --seed SEED --out OUT/tool.csv.gz",
];
/// The fit, with COLUMNS and METHODS.
const FIT: &str = "identify --robot ur5 --log OUT/t.csv.gz --validate OUT/v.csv.gz --validate OUT/tool.csv.gz \
                   --columns COLUMNS --methods METHODS --out OUT/fit";
/// Directory of the paths in [`LOGS`].
const PATHS: &str = "host-sim/paths";
/// Length of the log in the comparison of arms, s.
const LENGTH_S: u32 = 30;
/// Columns and methods of the comparison of arms.
const FITS: [(&str, &str); 2] = [("full", "wls,irls,evidence"), (PLAIN, "wls,bp_residual")];
const PLAIN: &str = "coulomb-viscous";
/// Lengths, s, columns and methods of the comparison of lengths.
const LENGTHS_S: [u32; 3] = [10, 30, 60];
const COLUMNS: [&str; 4] = [
    PLAIN,
    "coulomb-viscous+cogging",
    "coulomb-viscous+stribeck+cogging",
    "full",
];
const METHODS: &str = "wls,consistent,evidence,bp_residual";

/// Errors of the methods on one arm, joints as in `joints_nrmse_moving_ratio` of `identify`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct FitRecord {
    seed: u64,
    length_s: u32,
    columns: String,
    /// Cramér–Rao bound of `wls` on the unseen path.
    cramer_rao_nrmse_moving_ratio: f64,
    /// By method, on the unseen path.
    unseen_nrmse_moving_ratio: BTreeMap<String, f64>,
    /// By method, on the path of a tool.
    tool_nrmse_moving_ratio: BTreeMap<String, f64>,
}

/// `report.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct IdentificationReport {
    version: &'static str,
    fits: Vec<FitRecord>,
}

/// Runs the study in `directory`, with the arms of `seeds` seeds from the first one; logs are taken away again.
///
/// Errors: no paths below the current directory; a command that fails.
pub(super) fn run(
    directory: &Path,
    (first, seeds): (u64, u64),
    progress: Progress<'_>,
) -> Result<Outcome<IdentificationReport>, Failure> {
    if !Path::new(PATHS).is_dir() {
        bail!("{PATHS} is not here: start in the root of foretorque's sources");
    }
    let arms = (first..first + seeds).map(|seed| (seed, LENGTH_S, FITS.to_vec()));
    let lengths =
        LENGTHS_S.map(|length_s| (first, length_s, COLUMNS.map(|c| (c, METHODS)).to_vec()));
    let jobs: Vec<_> = arms.chain(lengths).collect();
    let mut done = 0;
    let fitted = in_parallel(
        cores(),
        &jobs,
        |(seed, length_s, fits)| {
            let directory = directory.join(format!("seed-{seed}-{length_s}-s-{}", fits.len()));
            std::fs::create_dir_all(&directory).map_err(|error| at(&directory, error))?;
            let records = fit(&directory, (*seed, *length_s), fits);
            std::fs::remove_dir_all(&directory)?;
            records
        },
        || {
            done += 1;
            progress("arms and lengths", done, jobs.len());
        },
    );
    let fits: Result<Vec<_>, _> = fitted.into_iter().collect();
    let report = IdentificationReport {
        version: env!("CARGO_PKG_VERSION"),
        fits: fits?.concat(),
    };
    let (of_arms, of_lengths) = report.fits.split_at(FITS.len() * seeds as usize);
    let tables = [compare_arms(of_arms), compare_lengths(of_lengths)];
    let heads = [ARMS_HEAD, LENGTHS_HEAD];
    let commands = LOGS
        .iter()
        .chain([&FIT])
        .map(|line| format!("  host-sim {line}\n"));
    let mut text = format!(
        "host-sim experiment identification: simulated UR5s; moving rows, measured torque, % NRMSE.\n\n{}",
        commands.clone().collect::<String>()
    );
    let mut page = Page::new(
        "Methods of identification",
        "Simulated UR5s; moving rows, measured torque, % NRMSE.",
    );
    for ((title, caption, header), rows) in heads.into_iter().zip(tables) {
        text += &format!("\n{title}. {caption}\n{}", aligned(header, rows.clone()));
        page = page.sections([Section::new(title, caption).table(header, rows)]);
    }
    let section = Section::new(
        "Commands",
        "SEED, LENGTH, COLUMNS and METHODS are those of the tables.",
    );
    let section = commands.fold(section, |section, line| section.command(line.trim()));
    page = page.sections([section]);
    Ok(Outcome {
        report,
        page,
        text,
        broken: None,
    })
}

fn fit(
    directory: &Path,
    (seed, length_s): (u64, u32),
    fits: &[(&str, &str)],
) -> Result<Vec<FitRecord>, Failure> {
    for line in LOGS {
        let line = line
            .replace("SEED", &seed.to_string())
            .replace("LENGTH", &length_s.to_string());
        execute(directory, &line)?;
    }
    let records = fits.iter().map(|(columns, methods)| {
        let line = FIT.replace("COLUMNS", columns).replace("METHODS", methods);
        execute(directory, &line)?;
        let path = directory.join("fit/report.json");
        let text = std::fs::read_to_string(&path).map_err(|error| at(&path, error))?;
        let report: serde_json::Value = serde_json::from_str(&text)?;
        let figure = |method: &str, log: &str, key: &str| {
            let figure = report["methods"][method]["validation"][log][key].as_f64();
            figure.ok_or_else(|| unusable(format!("{}: no {key} of {method}", path.display())))
        };
        let errors = |log: &str| -> Result<BTreeMap<_, _>, Failure> {
            let methods = methods.split(',');
            let error = |method: &str| figure(method, log, "joints_nrmse_moving_ratio");
            methods
                .map(|method| Ok((method.to_owned(), error(method)?)))
                .collect()
        };
        Ok(FitRecord {
            seed,
            length_s,
            columns: (*columns).to_owned(),
            cramer_rao_nrmse_moving_ratio: figure(
                "wls",
                "v.csv.gz",
                "cramer_rao_nrmse_moving_ratio",
            )?,
            unseen_nrmse_moving_ratio: errors("v.csv.gz")?,
            tool_nrmse_moving_ratio: errors("tool.csv.gz")?,
        })
    });
    records.collect()
}

/// Runs a command of this program with `directory` for OUT.
///
/// Errors: what the command reports.
fn execute(directory: &Path, line: &str) -> Result<(), Failure> {
    let mut command = Command::new(current_exe()?);
    for word in line.split(' ') {
        match word.strip_prefix("OUT/") {
            Some(name) => command.arg(directory.join(name)),
            None => command.arg(word),
        };
    }
    let output = command.stdin(Stdio::null()).output()?;
    let reason = String::from_utf8_lossy(&output.stderr);
    if !output.status.success() {
        bail!("host-sim {line}: {}", reason.trim());
    }
    Ok(())
}

const ARMS_HEAD: (&str, &str, &str) = (
    "Arms",
    "30 s of excitation. Bound (Cramér–Rao of wls), wls, irls and evidence have full columns, the others coulomb-viscous; \
     ratio = bp_residual over plain wls.",
    "seed | bound | wls | irls | evidence | plain wls | bp_residual | ratio | tool path: plain wls | bp_residual | ratio",
);
const LENGTHS_HEAD: (&str, &str, &str) = (
    "Lengths",
    "The first arm by length of the log and columns; unseen path.",
    "length / s | columns | bound | wls | consistent | evidence | bp_residual",
);

/// A line for each arm, then the RMS over them.
fn compare_arms(fits: &[FitRecord]) -> Vec<Vec<String>> {
    let figures = |[full, plain]: &[FitRecord; FITS.len()]| {
        let (unseen, tool) = (
            &plain.unseen_nrmse_moving_ratio,
            &plain.tool_nrmse_moving_ratio,
        );
        let full_columns = &full.unseen_nrmse_moving_ratio;
        let over = |errors: &BTreeMap<String, f64>| errors["bp_residual"] / errors["wls"];
        [
            100.0 * full.cramer_rao_nrmse_moving_ratio,
            100.0 * full_columns["wls"],
            100.0 * full_columns["irls"],
            100.0 * full_columns["evidence"],
            100.0 * unseen["wls"],
            100.0 * unseen["bp_residual"],
            over(unseen),
            100.0 * tool["wls"],
            100.0 * tool["bp_residual"],
            over(tool),
        ]
    };
    let (pairs, _) = fits.as_chunks();
    let arms: Vec<[f64; 10]> = pairs.iter().map(figures).collect();
    let rms = std::array::from_fn(|k| root_mean(arms.iter().map(|arm| arm[k] * arm[k])));
    let names = pairs.iter().map(|[full, _]| full.seed.to_string());
    let names = names.chain(["RMS".to_owned()]);
    let line = |(name, figures): (String, &[f64; 10])| {
        let figures = figures.iter().map(|figure| format!("{figure:.2}"));
        [name].into_iter().chain(figures).collect()
    };
    names.zip(arms.iter().chain([&rms])).map(line).collect()
}

fn compare_lengths(fits: &[FitRecord]) -> Vec<Vec<String>> {
    let line = |fit: &FitRecord| {
        let errors = METHODS
            .split(',')
            .map(|method| fit.unseen_nrmse_moving_ratio[method]);
        let figures = [fit.cramer_rao_nrmse_moving_ratio]
            .into_iter()
            .chain(errors);
        let figures = figures.map(|ratio| format!("{:.2}", 100.0 * ratio));
        [fit.length_s.to_string(), fit.columns.clone()]
            .into_iter()
            .chain(figures)
            .collect()
    };
    fits.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CommandLine;
    use clap::Parser as _;

    #[test]
    fn every_command_of_the_study_is_one_of_this_program() {
        for line in LOGS.iter().chain([&FIT]) {
            let line = line.replace("SEED", "1").replace("LENGTH", "10");
            for (columns, methods) in FITS.into_iter().chain(COLUMNS.map(|c| (c, METHODS))) {
                let line = line.replace("COLUMNS", columns).replace("METHODS", methods);
                CommandLine::try_parse_from(["host-sim"].into_iter().chain(line.split(' ')))
                    .unwrap_or_else(|error| panic!("{line}: {error}"));
            }
        }
    }

    #[test]
    fn tables_have_the_errors_of_each_fit_in_percent() {
        let fit = |columns: &str, methods: &str, error: f64| {
            let errors = (1u8..).zip(methods.split(','));
            let errors = errors.map(|(k, method)| (method.to_owned(), error * f64::from(k)));
            let errors: BTreeMap<String, f64> = errors.collect();
            FitRecord {
                seed: 4,
                length_s: LENGTH_S,
                columns: columns.to_owned(),
                cramer_rao_nrmse_moving_ratio: error / 2.0,
                unseen_nrmse_moving_ratio: errors.clone(),
                tool_nrmse_moving_ratio: errors,
            }
        };
        let [full, plain] = FITS;
        let arms = compare_arms(&[fit(full.0, full.1, 0.01), fit(plain.0, plain.1, 0.1)]);
        let figures = "0.50 1.00 2.00 3.00 10.00 20.00 2.00 10.00 20.00 2.00";
        let arms: Vec<String> = arms.iter().map(|row| row.join(" ")).collect();
        assert_eq!(arms, [format!("4 {figures}"), format!("RMS {figures}")]);
        let lengths = compare_lengths(&[fit(PLAIN, METHODS, 0.01)]);
        assert_eq!(
            lengths[0].join(" "),
            "30 coulomb-viscous 0.50 1.00 2.00 3.00 4.00"
        );
    }
}
