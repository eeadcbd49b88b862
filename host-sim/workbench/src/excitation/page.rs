//! The excitation as a page: the paper's Fig. 3, and the certificate.

use super::Excitation;
use super::certificate::Certificate;
use crate::dynamics::{Motion, PerJoint};
use crate::report::page::{Legend, Page, Section};
use crate::report::plot::{self, Curve, Panel, PlotColor};

type Pick = fn(&Motion) -> &PerJoint<f64>;

/// Positions, velocities and accelerations of all joints over one period: the paper's Fig. 3.
pub fn panels(excitation: &Excitation) -> [Panel; 3] {
    const POINTS: u32 = 1000;
    let times = (0..=POINTS).map(|k| excitation.period_s * f64::from(k) / f64::from(POINTS));
    let points: Vec<(f64, Motion)> = times.map(|t_s| (t_s, excitation.motion(t_s))).collect();
    let rows: [(&str, &str, Pick); 3] = [
        ("position", "q / rad", |state| &state.q),
        ("velocity", "qd / rad/s", |state| &state.qd),
        ("acceleration", "qdd / rad/s²", |state| &state.qdd),
    ];
    rows.map(|(title, y_label, pick)| {
        let curve = |j| {
            let color = PlotColor::Joint(j as u8);
            Curve::new(color, &points, |(t_s, state)| (*t_s, pick(state)[j]))
        };
        Panel::new(
            title,
            "t / s",
            y_label,
            (0..excitation.joints.len()).map(curve).collect(),
        )
    })
}

/// Colours and names of so many joints.
pub fn legend(joints: usize) -> Legend {
    (0..joints)
        .map(|j| (PlotColor::Joint(j as u8), format!("joint {}", j + 1)))
        .collect()
}

/// The paper's Fig. 3 as an SVG file.
///
/// Errors: those of the plot library.
pub fn picture(excitation: &Excitation) -> std::io::Result<String> {
    let title = format!(
        "Fourier series excitation trajectories, {} (Fig. 3)",
        excitation.robot
    );
    let (panels, legend) = (panels(excitation), legend(excitation.joints.len()));
    plot::picture(&title, &legend, &panels, 1, (900, 260))
}

/// The page: figure, certificate, coefficients.
pub fn page(excitation: &Excitation) -> Page {
    let lead = format!(
        "Robot {}, period {} s, {} harmonics, seed {}.",
        excitation.robot, excitation.period_s, excitation.order, excitation.seed
    );
    let motion = Section::new(
        "Motion",
        "One period (the paper's Fig. 3): every joint moves at its own mix of five harmonics, at rest at both ends.",
    )
    .legend(legend(excitation.joints.len()))
    .plots(panels(excitation), 1);
    let page = Page::new("Excitation trajectory", lead).sections([motion]);
    match &excitation.certificate {
        Some(certificate) => certified(page, certificate),
        None => page,
    }
}

fn certified(page: Page, certificate: &Certificate) -> Page {
    let limits = certificate.limits.iter().map(|check| {
        [
            format!("{}, {} / {}", check.limit, check.of, check.unit),
            format!("{:.4}", check.worst),
            format!("{:.4}", check.allowed),
            format!("{:.4}", check.margin),
        ]
    });
    let caption = format!(
        "{} points of one period; between them: {}. Condition numbers: {}, {} columns. Predicted error: {}.",
        certificate.points,
        certificate.between_points,
        certificate.condition_number_note,
        certificate.condition_number_columns,
        certificate.predicted_nrmse_note
    );
    page.card(
        format!("{:.3} %", certificate.predicted_nrmse_percent),
        "predicted torque error on task motion (1 % noise, 10 s)",
    )
    .card(
        format!("{:.1}", certificate.condition_number_dh),
        format!("condition number, {}", certificate.condition_number_frames),
    )
    .card(
        format!("{:.1}", certificate.condition_number_board),
        "condition number, the board's link frames",
    )
    .card(
        if certificate.holds {
            "all kept"
        } else {
            "missed"
        },
        "limits, between the points included",
    )
    .sections([
        Section::new("Certificate", caption).table("limit | worst | allowed | margin", limits)
    ])
}
