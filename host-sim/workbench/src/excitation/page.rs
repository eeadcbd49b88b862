//! The excitation as a page: the paper's Fig. 3, and the certificate.

use super::Excitation;
use crate::dynamics::{Joints, State};
use crate::report::page::{Section, Tile, html, table};
use crate::report::plot::{self, Curve, Ink, Panel, grid};
use std::error::Error;

type Pick<const N: usize> = fn(&State<N>) -> &Joints<N>;

/// Positions, velocities and accelerations of all joints over one period.
fn panels<const N: usize>(excitation: &Excitation) -> [Panel; 3] {
    const POINTS: u32 = 1000;
    let points: Vec<(f64, State<N>)> = (0..=POINTS)
        .map(|k| excitation.period_s * f64::from(k) / f64::from(POINTS))
        .map(|t_s| (t_s, excitation.at(t_s)))
        .collect();
    let rows: [(&str, &str, Pick<N>); 3] = [
        ("position", "q / rad", |state| &state.q),
        ("velocity", "qd / rad/s", |state| &state.qd),
        ("acceleration", "qdd / rad/s²", |state| &state.qdd),
    ];
    rows.map(|(title, y_label, pick)| Panel {
        title: title.to_owned(),
        x_label: "t / s".to_owned(),
        y_label: y_label.to_owned(),
        curves: (0..N)
            .map(|j| Curve {
                ink: Ink::Joint(j as u8),
                points: points.iter().map(|(t_s, s)| (*t_s, pick(s)[j])).collect(),
            })
            .collect(),
        from_zero: false,
    })
}

/// Colours and names of the joints.
pub fn legend<const N: usize>() -> Vec<(Ink, String)> {
    (0..N)
        .map(|j| (Ink::Joint(j as u8), format!("joint {}", j + 1)))
        .collect()
}

/// The paper's Fig. 3 as part of a page.
///
/// Errors: what the plot library says.
pub fn figure<const N: usize>(excitation: &Excitation) -> Result<String, Box<dyn Error>> {
    grid(&panels::<N>(excitation), 1, 900, 260)
}

/// The paper's Fig. 3 as an SVG file.
///
/// Errors: what the plot library says.
pub fn picture<const N: usize>(excitation: &Excitation) -> Result<String, Box<dyn Error>> {
    let title = format!(
        "Fourier series excitation trajectories, {} (Fig. 3)",
        excitation.robot
    );
    plot::picture(
        &title,
        &legend::<N>(),
        &panels::<N>(excitation),
        1,
        (900, 260),
    )
}

/// The page: figure, certificate, coefficients.
///
/// Errors: what the plot library says.
pub fn page<const N: usize>(excitation: &Excitation) -> Result<String, Box<dyn Error>> {
    let motion = Section {
        heading: "Motion".to_owned(),
        caption: "One period (the paper's Fig. 3): every joint moves at its own mix of five harmonics, at rest at both ends.".to_owned(),
        legend: legend::<N>(),
        body: figure::<N>(excitation)?,
    };
    let mut sections = vec![motion];
    let mut tiles = Vec::new();
    if let Some(certificate) = &excitation.certificate {
        let tile = |value: String, label: &str| Tile {
            value,
            label: label.to_owned(),
        };
        tiles = vec![
            tile(
                format!("{:.3} %", certificate.predicted_nrmse_percent),
                "predicted torque error on task motion (1 % noise, 10 s)",
            ),
            tile(
                format!("{:.1}", certificate.condition_number_dh),
                "condition number, standard DH link frames",
            ),
            tile(
                format!("{:.1}", certificate.condition_number_board),
                "condition number, the board's link frames",
            ),
            tile(
                if certificate.holds {
                    "all kept"
                } else {
                    "missed"
                }
                .to_owned(),
                "limits, between the points included",
            ),
        ];
        let rows: Vec<Vec<String>> = certificate
            .limits
            .iter()
            .map(|check| {
                vec![
                    format!("{}, {} / {}", check.limit, check.of, check.unit),
                    format!("{:.4}", check.worst),
                    format!("{:.4}", check.allowed),
                    format!("{:.4}", check.margin),
                ]
            })
            .collect();
        sections.push(Section {
            heading: "Certificate".to_owned(),
            caption: format!(
                "{} points of one period; between them: {}. Condition numbers: {}, {} columns. Predicted error: {}.",
                certificate.points,
                certificate.between_points,
                certificate.condition_number_note,
                certificate.condition_number_columns,
                certificate.predicted_nrmse_note
            ),
            legend: Vec::new(),
            body: table(&["limit", "worst", "allowed", "margin"], &rows),
        });
    }
    let lead = format!(
        "Robot {}, period {} s, {} harmonics, seed {}.",
        excitation.robot, excitation.period_s, excitation.order, excitation.seed
    );
    Ok(html("Excitation trajectory", &lead, &tiles, &sections))
}
