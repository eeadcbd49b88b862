//! One panel for each joint.

use super::plot::{Curve, Ink, Panel};

/// Width and height of a panel where three stand in a row, CSS pixels.
pub const THIRD: (u32, u32) = (370, 250);

/// A panel over time for each of `N` joints.
pub fn joint_panels<const N: usize>(
    y_label: &str,
    mut curves: impl FnMut(usize) -> Vec<Curve>,
) -> Vec<Panel> {
    (0..N)
        .map(|j| Panel {
            title: format!("joint {}", j + 1),
            x_label: "t / s".to_owned(),
            y_label: y_label.to_owned(),
            curves: curves(j),
            from_zero: false,
        })
        .collect()
}

/// A curve through what `pick` takes of every point.
pub fn curve<T>(ink: Ink, points: &[T], pick: impl Fn(&T) -> (f64, f64)) -> Curve {
    Curve {
        ink,
        points: points.iter().map(pick).collect(),
    }
}

/// A ratio in percent, one decimal.
pub fn percent(ratio: f64) -> String {
    format!("{:.1} %", 100.0 * ratio)
}
