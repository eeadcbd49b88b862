//! The page of an identification.

use super::record::Report;
use crate::report::page::{Section, Tile, html, table};
use crate::report::plot::{Curve, Ink, Panel, grid};
use std::error::Error;

/// `report.html`.
///
/// * `trace` time, measured and predicted torque on the first validation log, N·m
///
/// Errors: what the plot library says.
pub fn page<const N: usize>(
    report: &Report,
    trace: &[(f64, [f64; N], [f64; N])],
) -> Result<String, Box<dyn Error>> {
    let percent = |ratio: Option<f64>| {
        ratio.map_or("–".to_owned(), |ratio| format!("{:.2} %", 100.0 * ratio))
    };
    let best = report.methods.get(&report.recommended);
    let first = best.and_then(|method| method.validation.iter().next());
    let mut tiles = vec![
        Tile {
            value: report.recommended.clone(),
            label: "method in the bank".to_owned(),
        },
        Tile {
            value: format!("{} of {}", report.rank, report.rank),
            label: "parameters seen".to_owned(),
        },
        Tile {
            value: format!("{:.0}", report.condition_number),
            label: "condition number (raw SI, Craig frames)".to_owned(),
        },
    ];
    if let Some((file, record)) = first {
        tiles.insert(
            0,
            Tile {
                value: percent(Some(record.joints_nrmse_moving_ratio)),
                label: format!("torque error on {file}, moving rows"),
            },
        );
    }
    let mut sections = vec![methods_section(report)];
    for file in best
        .map(|method| method.validation.keys().cloned().collect::<Vec<_>>())
        .unwrap_or_default()
    {
        sections.push(file_section::<N>(report, &file));
    }
    if !trace.is_empty() {
        sections.push(trace_section(report, trace)?);
    }
    sections.extend(loss_section(report)?);
    sections.extend(needs_section(report));
    sections.push(parameters_section(report));
    let notes: Vec<Vec<String>> = report.notes.iter().map(|note| vec![note.clone()]).collect();
    sections.push(Section {
        heading: "What the logs needed".to_owned(),
        caption: format!(
            "{} rows read, {} used; motion filtered at {} Hz, torque and regressor {}.",
            report.rows_read,
            report.rows_used,
            report.motion_cutoff_hz,
            report
                .torque_cutoff_hz
                .map_or("not filtered".to_owned(), |hz| format!("at {hz} Hz"))
        ),
        legend: Vec::new(),
        body: table(&["note"], &notes),
    });
    Ok(html(
        &format!("Identification of {}", report.robot),
        &format!(
            "Logs: {}. Friction columns: {}.",
            report.logs.join(", "),
            report.columns
        ),
        &tiles,
        &sections,
    ))
}

fn methods_section(report: &Report) -> Section {
    let mean = |values: &[Option<f64>]| {
        let known: Vec<f64> = values.iter().flatten().copied().collect();
        let squares: f64 = known.iter().map(|value| value * value).sum();
        (squares / known.len().max(1) as f64).sqrt()
    };
    let rows = report.methods.iter().map(|(name, method)| {
        let mut row = vec![
            name.clone(),
            format!(
                "{:.2} %",
                100.0 * mean(&method.split_80_20.nrmse_moving_ratio)
            ),
        ];
        let worst = method
            .validation
            .values()
            .map(|record| record.joints_nrmse_moving_ratio);
        let worst = worst.fold(f64::NAN, f64::max);
        row.push(if worst.is_nan() {
            "–".to_owned()
        } else {
            format!("{:.2} %", 100.0 * worst)
        });
        row.push(method.rows.to_string());
        row.push(method.epochs.to_string());
        row.push(format!("{:.3}", method.seconds));
        row
    });
    Section {
        heading: "Methods".to_owned(),
        caption: "Torque error over RMS torque, moving rows. The split holds out rows of the same paths and flatters; \
                  unseen files do not."
            .to_owned(),
        legend: Vec::new(),
        body: table(
            &["method", "80/20 split", "worst unseen file", "rows", "epochs", "seconds"],
            &rows.collect::<Vec<_>>(),
        ),
    }
}

fn file_section<const N: usize>(report: &Report, file: &str) -> Section {
    let mut header = vec![
        "method".to_owned(),
        "all joints".to_owned(),
        "95 %".to_owned(),
    ];
    header.extend((1..=N).map(|joint| format!("J{joint} / N·m")));
    header.extend(["bound".to_owned()]);
    let rows = report.methods.iter().filter_map(|(name, method)| {
        let record = method.validation.get(file)?;
        let mut row = vec![
            name.clone(),
            format!("{:.2} %", 100.0 * record.joints_nrmse_moving_ratio),
            record
                .joints_nrmse_moving_ratio_ci95
                .map_or("–".to_owned(), |[low, high]| {
                    format!("{:.2} … {:.2} %", 100.0 * low, 100.0 * high)
                }),
        ];
        row.extend(
            record
                .rmse_moving_nm
                .iter()
                .map(|rmse| rmse.map_or("–".to_owned(), |rmse| format!("{rmse:.3}"))),
        );
        let bound = record.cramer_rao_nrmse_moving_ratio.unwrap_or(f64::NAN);
        row.push(format!("{:.3} %", 100.0 * bound));
        Some(row)
    });
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    Section {
        heading: format!("Unseen: {file}"),
        caption: "RMS error of each joint while it moves, the interval by bootstrap over seconds of this log, and the Cramér–Rao bound of the part that training noise causes."
            .to_owned(),
        legend: Vec::new(),
        body: table(&header, &rows.collect::<Vec<_>>()),
    }
}

fn trace_section<const N: usize>(
    report: &Report,
    trace: &[(f64, [f64; N], [f64; N])],
) -> Result<Section, Box<dyn Error>> {
    let panels: Vec<Panel> = (0..N)
        .map(|joint| Panel {
            title: format!("Joint {}", joint + 1),
            x_label: "t / s".to_owned(),
            y_label: "torque / N·m".to_owned(),
            curves: vec![
                Curve {
                    ink: Ink::Truth,
                    points: trace.iter().map(|(t, tau, _)| (*t, tau[joint])).collect(),
                },
                Curve {
                    ink: Ink::After,
                    points: trace.iter().map(|(t, _, tau)| (*t, tau[joint])).collect(),
                },
            ],
            from_zero: false,
        })
        .collect();
    Ok(Section {
        heading: "Predicted moments of every joint".to_owned(),
        caption: "On the first validation log (Fig. 6 of the paper).".to_owned(),
        legend: vec![
            (Ink::Truth, "measured, filtered".to_owned()),
            (Ink::After, report.recommended.clone()),
        ],
        body: grid(&panels, 2, 560, 240)?,
    })
}

fn loss_section(report: &Report) -> Result<Option<Section>, Box<dyn Error>> {
    let mut panels: Vec<Panel> = Vec::new();
    let panel = |title: String, y_label: &str, points: Vec<(f64, f64)>| Panel {
        title,
        x_label: "epoch".to_owned(),
        y_label: y_label.to_owned(),
        curves: vec![Curve {
            ink: Ink::After,
            points,
        }],
        from_zero: false,
    };
    let logarithms = |curve: &[(usize, f64)]| -> Vec<(f64, f64)> {
        curve
            .iter()
            .map(|(epoch, loss)| (*epoch as f64, loss.max(1e-12).log10()))
            .collect()
    };
    for (name, method) in &report.methods {
        if !method.loss_ratio.is_empty() {
            panels.push(panel(
                name.clone(),
                "log10 of loss",
                logarithms(&method.loss_ratio),
            ));
        }
        if !method.base_parameter_error_ratio_by_epoch.is_empty() {
            let curve = logarithms(&method.base_parameter_error_ratio_by_epoch);
            panels.push(panel(
                format!("{name}: base parameters"),
                "log10 of error ratio",
                curve,
            ));
        }
    }
    if panels.is_empty() {
        return Ok(None);
    }
    Ok(Some(Section {
        heading: "Training".to_owned(),
        caption: "Loss (RMSE, eq. 20) by epoch, logarithmic.".to_owned(),
        legend: Vec::new(),
        body: grid(&panels, 2, 560, 220)?,
    }))
}

/// Error on the first validation log by rows of training.
fn needs_section(report: &Report) -> Option<Section> {
    let curves = || report.methods.values().map(|method| &method.learning_curve);
    let longest = curves().max_by_key(|curve| curve.len())?;
    if longest.is_empty() {
        return None;
    }
    let mut header = vec!["method".to_owned()];
    header.extend(longest.iter().map(|point| format!("{} rows", point.rows)));
    header.push("seconds, all rows".to_owned());
    let rows = report.methods.iter().map(|(name, method)| {
        let curve = &method.learning_curve;
        let mut row = vec![name.clone()];
        row.extend(longest.iter().map(|wanted| {
            let point = curve.iter().find(|point| point.rows == wanted.rows);
            point.map_or("–".to_owned(), |point| {
                format!("{:.2} %", 100.0 * point.joints_nrmse_moving_ratio)
            })
        }));
        let last = curve.last();
        row.push(last.map_or("–".to_owned(), |point| format!("{:.3}", point.seconds)));
        row
    });
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    Some(Section {
        heading: "Rows and seconds each method needs".to_owned(),
        caption: "Torque error on the first unseen file after training on the first rows of the logs only.".to_owned(),
        legend: Vec::new(),
        body: table(&header, &rows.collect::<Vec<_>>()),
    })
}

fn parameters_section(report: &Report) -> Section {
    let method = report.methods.get("irls").or_else(|| {
        report
            .methods
            .values()
            .find(|method| !method.parameters.is_empty())
    });
    let rows = method.map_or_else(Vec::new, |method| {
        let parameters = method.parameters.iter();
        parameters
            .map(|parameter| {
                vec![
                    parameter.name.clone(),
                    format!("{:.5}", parameter.value),
                    format!("{:.5}", parameter.std),
                    parameter.ci95.map_or("–".to_owned(), |[low, high]| {
                        format!("{low:.5} … {high:.5}")
                    }),
                    parameter
                        .truth
                        .map_or("–".to_owned(), |truth| format!("{truth:.5}")),
                    parameter.unit.clone(),
                ]
            })
            .collect()
    });
    Section {
        heading: "Parameters".to_owned(),
        caption: "Base set: the first independent columns from left to right, links in Craig frames, about the link origin."
            .to_owned(),
        legend: Vec::new(),
        body: table(&["parameter", "value", "deviation", "95 %", "truth", "unit"], &rows),
    }
}
