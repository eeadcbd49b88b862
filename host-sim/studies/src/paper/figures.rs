//! The figures: the paper's Fig. 3 and Fig. 6, the losses, robustness and efficiency.

use super::JOINTS;
use super::cell::FRICTIONS;
use super::curves::Curves;
use super::summary::Condition;
use foretorque_workbench::excitation::Excitation;
use foretorque_workbench::excitation::page::picture as excitation_picture;
use foretorque_workbench::report::joints::{curve, joint_panels};
use foretorque_workbench::report::plot::{Curve, Ink, Panel, picture};
use std::error::Error;

/// Methods and their colours, in the order of legends and tables.
pub(super) const METHODS: [(&str, Ink); 8] = [
    ("ols", Ink::Joint(7)),
    ("wls", Ink::Joint(0)),
    ("irls", Ink::Joint(2)),
    ("irls_stribeck", Ink::Joint(6)),
    ("consistent", Ink::Joint(5)),
    ("bp_physical", Ink::Joint(1)),
    ("bp_residual", Ink::Joint(3)),
    ("bp_black_box", Ink::Joint(4)),
];

/// Sizes of panels that stand alone, in twos and in threes, pixels.
const WIDE: (u32, u32) = (900, 300);
const HALF: (u32, u32) = (640, 290);
const THIRD: (u32, u32) = (420, 290);

/// Name and picture of every figure.
pub(super) fn pictures(
    excitation: &Excitation,
    curves: &Curves,
    conditions: &[Condition],
) -> Result<Vec<(&'static str, String)>, Box<dyn Error>> {
    let mut out = vec![(
        "fig3-excitation.svg",
        excitation_picture::<JOINTS>(excitation)?,
    )];
    let mut add = |name, title, legend: Legend, panels: Vec<Panel>, columns, size| {
        let drawn = picture(title, &legend, &panels, columns, size)?;
        out.push((name, drawn));
        Ok::<(), Box<dyn Error>>(())
    };
    add(
        "fig6-predicted-torques.svg",
        "Predicted moments for each joint at the validation trajectory (Fig. 6)",
        path_legend(),
        path_panels(curves),
        2,
        HALF,
    )?;
    add(
        "training-loss.svg",
        "Loss (RMSE, eq. 20) while the networks train",
        loss_legend(),
        loss_panels(curves),
        1,
        WIDE,
    )?;
    add(
        "robustness.svg",
        "Torque error on unseen paths over noise, friction and outliers",
        method_legend(),
        robustness_panels(conditions),
        3,
        THIRD,
    )?;
    add(
        "efficiency.svg",
        "Torque error on unseen paths over training rows (1 % noise, Coulomb + viscous)",
        method_legend(),
        efficiency_panel(conditions),
        1,
        WIDE,
    )?;
    Ok(out)
}

/// Colours and what they stand for.
pub(super) type Legend = Vec<(Ink, String)>;

pub(super) fn path_legend() -> Legend {
    vec![
        (Ink::Truth, "true torque".to_owned()),
        (Ink::Before, "BP network, hidden layer 18-32-6".to_owned()),
        (Ink::After, "BP network, physical weights".to_owned()),
    ]
}

pub(super) fn path_panels(curves: &Curves) -> Vec<Panel> {
    joint_panels::<JOINTS>("tau / N·m", |j| {
        let of = |ink, model: usize| {
            curve(ink, &curves.path, move |(t_s, _, torques)| {
                (*t_s, torques[model][j])
            })
        };
        vec![of(Ink::Truth, 0), of(Ink::Before, 2), of(Ink::After, 1)]
    })
}

pub(super) fn loss_legend() -> Legend {
    vec![
        (Ink::Truth, "eq. 21, training 80 %".to_owned()),
        (Ink::Other, "eq. 21, held-out 20 %".to_owned()),
        (Ink::After, "accelerated, training 80 %".to_owned()),
        (Ink::Before, "accelerated, held-out 20 %".to_owned()),
        (
            Ink::Joint(4),
            "hidden layer 18-32-6, training 80 %".to_owned(),
        ),
    ]
}

pub(super) fn loss_panels(curves: &Curves) -> Vec<Panel> {
    let log = |epoch: usize, loss: f64| ((epoch.max(1) as f64).log10(), loss.log10());
    let [plain, fast] = &curves.losses;
    let training = |ink, points: &[(usize, f64, f64)]| curve(ink, points, |p| log(p.0, p.1));
    let held_out = |ink, points: &[(usize, f64, f64)]| curve(ink, points, |p| log(p.0, p.2));
    vec![Panel {
        title: "loss by epoch, no noise".to_owned(),
        x_label: "log10 epoch".to_owned(),
        y_label: "log10 RMSE / RMS torque".to_owned(),
        curves: vec![
            training(Ink::Truth, plain),
            held_out(Ink::Other, plain),
            training(Ink::After, fast),
            held_out(Ink::Before, fast),
            curve(Ink::Joint(4), &curves.black_box, |p| log(p.0, p.1)),
        ],
        from_zero: false,
    }]
}

pub(super) fn method_legend() -> Legend {
    let legend = METHODS.iter().map(|(name, ink)| (*ink, (*name).to_owned()));
    legend.collect()
}

/// A panel for each friction and share of outliers, noise along x.
pub(super) fn robustness_panels(conditions: &[Condition]) -> Vec<Panel> {
    let full = conditions.iter().map(|c| c.rows).max().unwrap_or(0);
    let mut outliers: Vec<f64> = conditions.iter().map(|c| c.outlier_percent).collect();
    outliers.sort_by(f64::total_cmp);
    outliers.dedup();
    let mut panels = Vec::new();
    for outlier_percent in outliers {
        for friction in FRICTIONS {
            let own: Vec<&Condition> = conditions
                .iter()
                .filter(|c| {
                    c.rows == full && c.friction == friction && c.outlier_percent == outlier_percent
                })
                .collect();
            if !own.is_empty() {
                panels.push(Panel {
                    title: format!("{}, {outlier_percent} % outliers", friction.name()),
                    x_label: "noise / % of torque limit".to_owned(),
                    y_label: "log10 NRMSE / %".to_owned(),
                    curves: method_curves(&own, |c| c.noise_percent),
                    from_zero: false,
                });
            }
        }
    }
    panels
}

/// Error over the number of training rows.
pub(super) fn efficiency_panel(conditions: &[Condition]) -> Vec<Panel> {
    let mut own: Vec<&Condition> = conditions
        .iter()
        .filter(|c| {
            c.noise_percent == 1.0
                && c.outlier_percent == 0.0
                && c.friction == super::FrictionKind::CoulombViscous
        })
        .collect();
    own.sort_by_key(|c| c.rows);
    vec![Panel {
        title: "1 % noise, Coulomb + viscous".to_owned(),
        x_label: "log10 training rows (six torques each)".to_owned(),
        y_label: "log10 NRMSE / %".to_owned(),
        curves: method_curves(&own, |c| (c.rows as f64).log10()),
        from_zero: false,
    }]
}

fn method_curves(conditions: &[&Condition], x: impl Fn(&Condition) -> f64) -> Vec<Curve> {
    let points = |name: &str| {
        let errors = conditions.iter().filter_map(|c| {
            let error = c.methods.get(name)?.path_nrmse_ratio;
            // Exact to rounding: below what a plot needs to tell apart.
            Some((x(c), (100.0 * error).max(1e-4).log10()))
        });
        errors.collect()
    };
    let curves = METHODS.iter().map(|(name, ink)| Curve {
        ink: *ink,
        points: points(name),
    });
    curves.collect()
}
