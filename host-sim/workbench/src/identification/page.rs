//! The page of an identification.

use super::record::Report;
use crate::dynamics::PerJoint;
use crate::metrics::root_mean_square;
use crate::report::page::{Page, Section, figure, or_dash};
use crate::report::plot::{Curve, Panel, PlotColor};

fn percent(ratio: f64) -> String {
    format!("{:.2} %", 100.0 * ratio)
}

/// The page of `report`.
///
/// * `trace` time, measured and predicted torque on the first validation log, N·m
pub fn page(report: &Report, trace: &[(f64, PerJoint<f64>, PerJoint<f64>)]) -> Page {
    let best = report.methods.get(&report.recommended);
    let files: Vec<&String> = best.map_or(Vec::new(), |method| {
        method.validation.keys().chain(method.test.keys()).collect()
    });
    let mut page = Page::new(
        format!("Identification of {}", report.robot),
        format!(
            "Logs: {}. Friction columns: {}.",
            report.logs.join(", "),
            report.columns
        ),
    );
    let newton_metres = |errors: &[Option<f64>]| {
        let two_digits = |error: &Option<f64>| or_dash(*error, |error| figure(error, 2));
        let errors: Vec<String> = errors.iter().map(two_digits).collect();
        errors.join(" · ") + " N·m"
    };
    if !report.headline_rmse_nm.is_empty() {
        page = page
            .card(
                newton_metres(&report.headline_rmse_nm),
                format!(
                    "RMS torque error joint by joint, {}",
                    report.headline_rows()
                ),
            )
            .card(
                newton_metres(&report.headline_description_rmse_nm),
                "the same of the description's own parameters",
            );
    }
    let refused = report.findings.iter().any(|finding| finding.refuses);
    let verdict = if refused {
        "method; no bank without --force, see the findings"
    } else {
        "recommended method"
    };
    page.card(&report.recommended, verdict)
        .card(format!("{0} of {0}", report.rank), "parameters seen")
        .card(
            format!("{:.0}", report.condition_number),
            "condition number (raw SI, Craig frames)",
        )
        .sections(findings_section(report))
        .sections([methods_section(report)])
        .sections(files.iter().map(|file| file_section(report, file)))
        .sections((!trace.is_empty()).then(|| trace_section(report, trace)))
        .sections(loss_section(report))
        .sections(needs_section(report))
        .sections([parameters_section(report), notes_section(report)])
}

fn findings_section(report: &Report) -> Option<Section> {
    let rows = report.findings.iter().map(|finding| {
        let kind = if finding.refuses { "wrong" } else { "warning" };
        [kind.to_owned(), finding.text.clone()]
    });
    let section = Section::new(
        "Findings",
        "Of the comparison of logs and parameters with the description, its limits, and zero torque.",
    );
    (!report.findings.is_empty()).then(|| section.table("finding | ", rows))
}

fn methods_section(report: &Report) -> Section {
    let rows = report.methods.iter().map(|(name, method)| {
        let unseen = method.validation.values();
        let worst = unseen
            .filter_map(|record| record.joints_nrmse_moving_ratio)
            .reduce(f64::max);
        [
            name.clone(),
            percent(root_mean_square(&method.split_80_20.nrmse_moving_ratio)),
            or_dash(worst, percent),
            method.rows.to_string(),
            method.epochs.to_string(),
            format!("{:.3}", method.seconds),
        ]
    });
    Section::new(
        "Methods",
        "Torque error over RMS torque, moving rows. The split holds out rows of the same paths and flatters; unseen files do \
         not.",
    )
    .table(
        "method | 80/20 split | worst validation file | rows | epochs | seconds",
        rows,
    )
}

fn file_section(report: &Report, file: &str) -> Section {
    let joints: String = (1..=report.still_share_ratio.len())
        .map(|joint| format!(" | J{joint} / N·m"))
        .collect();
    let rows = report.methods.iter().filter_map(|(name, method)| {
        let validated = method.validation.get(file);
        let record = validated.or_else(|| method.test.get(file))?;
        let interval = record.joints_nrmse_moving_ratio_ci95;
        let mut row = vec![
            name.clone(),
            or_dash(record.joints_nrmse_moving_ratio, percent),
            or_dash(interval, |[low, high]| {
                format!("{:.2} … {:.2} %", 100.0 * low, 100.0 * high)
            }),
        ];
        let rmse = record.rmse_moving_nm.iter();
        row.extend(rmse.map(|rmse| or_dash(*rmse, |rmse| figure(rmse, 3))));
        row.push(or_dash(record.cramer_rao_nrmse_moving_ratio, |bound| {
            format!("{:.3} %", 100.0 * bound)
        }));
        Some(row)
    });
    let floor = report.data_check.iter().map(|check| {
        let name = ["scatter from row to row, training logs", "", ""].map(str::to_owned);
        let floors = check.joints.iter().map(|joint| joint.noise_floor_nm);
        let floors = floors.map(|floor| figure(floor, 3));
        let cells = name.into_iter().chain(floors);
        cells.chain([String::new()]).collect()
    });
    let rows = rows.chain(floor);
    Section::new(
        format!("Unseen: {file}"),
        "RMS error of each joint while it moves, the interval by bootstrap over seconds of this log, and the Cramér–Rao bound of \
         the part that training noise causes.",
    )
    .table(format!("method | all joints | 95 %{joints} | bound"), rows)
}

fn trace_section(report: &Report, trace: &[(f64, PerJoint<f64>, PerJoint<f64>)]) -> Section {
    let (truth, after) = (PlotColor::Truth, PlotColor::After);
    let panels = Panel::of_joints(report.still_share_ratio.len(), "torque / N·m", |joint| {
        vec![
            Curve::new(truth, trace, |(t, tau, _)| (*t, tau[joint])),
            Curve::new(after, trace, |(t, _, tau)| (*t, tau[joint])),
        ]
    });
    Section::new(
        "Predicted moments of every joint",
        "On the first validation log (Fig. 6 of the paper).",
    )
    .legend([
        (truth, "measured, filtered"),
        (after, report.recommended.as_str()),
    ])
    .plots(panels, 2)
}

fn loss_section(report: &Report) -> Option<Section> {
    let panels: Vec<Panel> = report
        .methods
        .iter()
        .flat_map(|(name, method)| {
            let base = &method.base_parameter_error_ratio_by_epoch;
            [
                (name.clone(), "log10 of loss", &method.loss_ratio),
                (
                    format!("{name}: base parameters"),
                    "log10 of error ratio",
                    base,
                ),
            ]
        })
        .filter(|(_, _, points)| !points.is_empty())
        .map(|(title, label, points)| {
            let curve = Curve::new(PlotColor::After, points, |(epoch, loss)| {
                (*epoch as f64, loss.max(1e-12).log10())
            });
            Panel::new(title, "epoch", label, vec![curve])
        })
        .collect();
    let section = Section::new("Training", "Loss (RMSE, eq. 20) by epoch, logarithmic.");
    (!panels.is_empty()).then(|| section.plots(panels, 2))
}

/// Error on the first validation log by rows of training.
fn needs_section(report: &Report) -> Option<Section> {
    let curves = report.methods.values().map(|method| &method.learning_curve);
    let longest = curves
        .max_by_key(|curve| curve.len())
        .filter(|curve| !curve.is_empty())?;
    let points = longest.iter();
    let counts: String = points
        .map(|point| format!("{} rows | ", point.rows))
        .collect();
    let rows = report.methods.iter().map(|(name, method)| {
        let curve = &method.learning_curve;
        let mut row = vec![name.clone()];
        row.extend(longest.iter().map(|wanted| {
            let point = curve.iter().find(|point| point.rows == wanted.rows);
            or_dash(point, |point| percent(point.joints_nrmse_moving_ratio))
        }));
        row.push(or_dash(curve.last(), |point| {
            format!("{:.3}", point.seconds)
        }));
        row
    });
    let section = Section::new(
        "Rows and seconds each method needs",
        "Torque error on the first unseen file after training on the first rows of the logs only.",
    );
    Some(section.table(format!("method | {counts}seconds, all rows"), rows))
}

fn parameters_section(report: &Report) -> Section {
    let method = report.methods.get(&report.recommended);
    let parameters = method.into_iter().flat_map(|method| &method.parameters);
    Section::new(
        format!("Parameters: {}", report.recommended),
        "Base set: the first independent columns from left to right, links in Craig frames, about the link origin.",
    )
    .table(
        "parameter | value | deviation | 95 % | description | truth | unit",
        parameters.map(|parameter| {
            [
                parameter.name.clone(),
                figure(parameter.value, 5),
                figure(parameter.std, 5),
                or_dash(parameter.ci95, |interval| {
                    interval.map(|end| figure(end, 5)).join(" … ")
                }),
                or_dash(parameter.description, |value| figure(value, 5)),
                or_dash(parameter.truth, |truth| figure(truth, 5)),
                parameter.unit.clone(),
            ]
        }),
    )
}

fn notes_section(report: &Report) -> Section {
    let cutoff = report.torque_cutoff_hz.map(|hz| format!("at {hz} Hz"));
    let filtered = cutoff.unwrap_or_else(|| "not filtered".to_owned());
    Section::new(
        "Treatment of the logs",
        format!(
            "{} rows read, {} used; motion filtered at {} Hz, torque and regressor {filtered}.",
            report.rows_read, report.rows_used, report.motion_cutoff_hz
        ),
    )
    .table("note", report.notes.iter().map(|note| [note.clone()]))
}
