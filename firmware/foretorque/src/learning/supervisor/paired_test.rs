//! Paired comparison of two models on rows that neither has been fitted on.

/// Sum of paired differences d and of their squares, `t = Σ d / √Σ d²`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PairedSum {
    pub(crate) sum: f32,
    pub(crate) squares: f32,
}

impl PairedSum {
    /// Sums of zero.
    pub(crate) const ZERO: Self = Self {
        sum: 0.0,
        squares: 0.0,
    };

    /// Multiply both sums by `factor`.
    pub(crate) fn fade(&mut self, factor: f32) {
        self.sum *= factor;
        self.squares *= factor;
    }

    /// Add the difference `d`.
    pub(crate) fn add(&mut self, d: f32) {
        self.sum += d;
        self.squares += d * d;
    }

    /// True if t > `sigmas`.
    pub(crate) fn is_above(&self, sigmas: f32) -> bool {
        self.signed_square() > sigmas * sigmas * self.squares
    }

    /// True if t < −`sigmas`.
    pub(crate) fn is_below(&self, sigmas: f32) -> bool {
        -self.signed_square() > sigmas * sigmas * self.squares
    }

    /// Σ d |Σ d|: comparing squares avoids the root.
    fn signed_square(&self) -> f32 {
        self.sum * self.sum.abs()
    }
}

/// Paired test of a candidate (the estimate) against a reference (the committed set), faded over [`MEMORY_ROWS`].
///
/// ```text
/// d = r_reference² − r_candidate²      t = Σ d / √Σ d²      r: residual, standard deviations of the measurement
/// ```
/// Both residuals share the measurement noise, so t becomes significant long before the mean squares differ visibly.
///
/// Joints share parameters, so rows of one joint are no evidence for the torques of the others. A better candidate must
/// pass on every joint, or leave the torque of the joint as it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PairedTest<const N: usize> {
    advantage: PairedSum,
    /// Sums of squared residuals.
    reference: f32,
    candidate: f32,
    /// Σ y², Σ y m, Σ m² of measured torque y and torque m of the reference, standard deviations.
    measured: f32,
    cross: f32,
    modelled: f32,
    /// Σ y m in units of the joints' torque limits, so that a joint of uncertain model counts by its torque.
    cross_torque: f32,
    /// Faded number of rows: expected noise in the sums of squares.
    weight: f32,
    rows: u32,
    joints: [JointTest; N],
}

/// Paired test of one joint.
#[derive(Clone, Copy, Debug, PartialEq)]
struct JointTest {
    advantage: PairedSum,
    /// Faded number of rows.
    weight: f32,
    /// Largest change of the torque at standstill by the candidate, in units of the torque limit; faded.
    static_change: f32,
}

/// Memory of the test, rows: sums fade to 37 %.
const MEMORY_ROWS: f32 = 4096.0;
const FADE: f32 = 1.0 - 1.0 / MEMORY_ROWS;
/// Bound of a residual, standard deviations, against outliers.
const CLIP: f32 = 6.0;
/// Largest part of the reference's residual squares beyond noise that a common gain may leave.
const GAIN_RATIO: f32 = 0.2;
/// Largest admissible change of the torque of an untested joint, in units of the torque limit.
const UNTESTED_LIMIT: f32 = 0.01;
/// Stricter limit for a joint still untested after [`TIMEOUT_FACTOR`] times the required rows; its change is inferred from
/// other joints.
const UNTESTED_LIMIT_LATE: f32 = 0.001;
const TIMEOUT_FACTOR: f32 = 12.0;

impl<const N: usize> PairedTest<N> {
    /// Test without rows.
    pub(crate) const NONE: Self = Self {
        advantage: PairedSum::ZERO,
        reference: 0.0,
        candidate: 0.0,
        measured: 0.0,
        cross: 0.0,
        modelled: 0.0,
        cross_torque: 0.0,
        weight: 0.0,
        rows: 0,
        joints: [JointTest {
            advantage: PairedSum::ZERO,
            weight: 0.0,
            static_change: 0.0,
        }; N],
    };

    /// Add a row of `joint`, in standard deviations of the measurement; a row that is not finite is ignored.
    ///
    /// * `measured` torque      * `reference` torque of the reference      * `candidate_residual` residual of the candidate
    /// * `sigma` standard deviation, in units of the joint's torque limit
    pub(crate) fn add_row(
        &mut self,
        joint: usize,
        measured: f32,
        reference: f32,
        candidate_residual: f32,
        sigma: f32,
    ) {
        let sum = measured * measured + reference * reference + candidate_residual;
        if !sum.is_finite() {
            return;
        }
        let square = |residual: f32| {
            let clipped = residual.clamp(-CLIP, CLIP);
            clipped * clipped
        };
        let (a, b) = (square(measured - reference), square(candidate_residual));
        let d = a - b;
        let fade = |sum: &mut f32, value: f32| *sum = FADE * *sum + value;
        self.advantage.fade(FADE);
        self.advantage.add(d);
        fade(&mut self.reference, a);
        fade(&mut self.candidate, b);
        fade(&mut self.measured, measured * measured);
        fade(&mut self.cross, measured * reference);
        fade(&mut self.modelled, reference * reference);
        fade(
            &mut self.cross_torque,
            measured * reference * (sigma * sigma),
        );
        fade(&mut self.weight, 1.0);
        for test in &mut self.joints {
            test.advantage.fade(FADE);
            test.weight *= FADE;
            test.static_change *= FADE;
        }
        if let Some(test) = self.joints.get_mut(joint) {
            test.advantage.add(d);
            test.weight += 1.0;
        }
        self.rows = self.rows.saturating_add(1);
    }

    /// Record the torque `change` by the candidate on `joint` at standstill, in units of its torque limit.
    pub(crate) fn add_standstill(&mut self, joint: usize, change: f32) {
        if let Some(test) = self.joints.get_mut(joint) {
            // The largest one: a change that swings through zero counts.
            let change = change.abs();
            if change > test.static_change {
                test.static_change = change;
            }
        }
    }

    /// True if every joint passes: with at least `rows` rows it is not worse by `sigmas` standard deviations, with fewer
    /// its torque at standstill hardly changes.
    pub(crate) fn joints_pass(&self, rows: f32, sigmas: f32) -> bool {
        let most = if self.rows as f32 > TIMEOUT_FACTOR * rows {
            UNTESTED_LIMIT_LATE
        } else {
            UNTESTED_LIMIT
        };
        self.joints.iter().all(|test| {
            if test.weight >= rows {
                !test.advantage.is_below(sigmas)
            } else {
                test.static_change <= most
            }
        })
    }

    /// Number of rows.
    pub(crate) fn rows(&self) -> u32 {
        self.rows
    }

    /// True if the candidate is better by `sigmas` standard deviations.
    pub(crate) fn is_better(&self, sigmas: f32) -> bool {
        self.advantage.is_above(sigmas)
    }

    /// True if the candidate is worse by `sigmas` standard deviations.
    pub(crate) fn is_worse(&self, sigmas: f32) -> bool {
        self.advantage.is_below(sigmas)
    }

    /// Ratio of mean square residuals, candidate to reference; 1 without rows.
    pub(crate) fn ratio(&self) -> f32 {
        if self.reference > 0.0 {
            self.candidate / self.reference
        } else {
            1.0
        }
    }

    /// True if the measured torques are opposed to those of the reference: sensors or drives have the wrong sign.
    pub(crate) fn is_reversed(&self) -> bool {
        self.cross_torque < 0.0
    }

    /// Common gain of all torques that explains the residual of the reference; `None` if none does.
    ///
    /// A common gain is an error of sensors or drives, not of the arm.
    ///
    /// * `error` least deviation of the gain from 1
    pub(crate) fn common_gain(&self, error: f32) -> Option<f32> {
        if self.modelled.partial_cmp(&0.0) != Some(core::cmp::Ordering::Greater) {
            return None;
        }
        let gain = self.cross / self.modelled;
        let left = self.measured - gain * self.cross - self.weight;
        let before = self.measured - 2.0 * self.cross + self.modelled - self.weight;
        ((gain - 1.0).abs() > error && left < GAIN_RATIO * before).then_some(gain)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Torques of thirty standard deviations, and noise of about one.
    fn rows(count: u32) -> impl Iterator<Item = (f32, f32)> {
        (0..count).map(|k| {
            let t = k as f32;
            let noise = 1.4 * (t * 2.399).sin();
            (30.0 * (t * 0.013).sin() + 8.0, noise)
        })
    }

    #[test]
    fn a_small_advantage_is_significant_and_none_is_not() {
        let (mut better, mut equal) = (PairedTest::<2>::NONE, PairedTest::<2>::NONE);
        for (torque, noise) in rows(20_000) {
            let reference = torque + 0.2 * (torque * 0.7).sin();
            better.add_row(0, torque + noise, reference, noise, 0.01);
            equal.add_row(0, torque + noise, torque, noise, 0.01);
        }
        assert!(better.is_better(3.0) && !better.is_worse(3.0));
        assert!(!equal.is_better(3.0) && !equal.is_worse(3.0));
        assert!(better.ratio() < 1.0);
    }

    #[test]
    fn a_common_gain_is_distinguished_from_an_offset() {
        for gain in [-1.0, 0.8, 1.2] {
            let (mut scaled, mut offset) = (PairedTest::<2>::NONE, PairedTest::<2>::NONE);
            for (torque, noise) in rows(5000) {
                scaled.add_row(0, gain * torque + noise, torque, noise, 0.01);
                offset.add_row(0, torque + 5.0 + noise, torque, noise, 0.01);
            }
            let found = scaled.common_gain(0.08).unwrap_or(0.0);
            assert!((found - gain).abs() < 0.02, "{found} for {gain}");
            assert_eq!(offset.common_gain(0.08), None);
        }
        assert_eq!(PairedTest::<1>::NONE.common_gain(0.08), None);
    }

    #[test]
    fn a_row_that_is_not_finite_is_ignored() {
        let mut test = PairedTest::<1>::NONE;
        test.add_row(0, f32::NAN, 1.0, 1.0, 0.01);
        test.add_row(0, 1.0, f32::INFINITY, 1.0, 0.01);
        test.add_row(0, 1.0, 1.0, f32::NAN, 0.01);
        assert_eq!(test, PairedTest::NONE);
    }

    #[test]
    fn an_untested_or_worse_joint_fails_a_better_candidate() {
        let mut test = PairedTest::<2>::NONE;
        for (torque, noise) in rows(2000) {
            test.add_row(0, torque + noise, torque + 2.0, noise, 0.01);
            test.add_standstill(1, 0.05);
        }
        assert!(test.is_better(3.0) && !test.joints_pass(100.0, 0.0));
        // A smaller change does not replace the larger one before it has faded.
        test.add_standstill(1, 0.001);
        assert!(!test.joints_pass(100.0, 0.0));
        for (torque, noise) in rows(8000) {
            test.add_row(0, torque + noise, torque + 2.0, noise, 0.01);
        }
        assert!(test.joints_pass(1000.0, 0.0));
        // More than twelve times the required rows without a row of the joint: the stricter limit.
        assert!(!test.joints_pass(100.0, 0.0));
        for (torque, noise) in rows(400) {
            test.add_row(1, torque + noise, torque, noise + 2.0, 0.01);
        }
        assert!(test.is_better(3.0) && !test.joints_pass(100.0, 0.0));
        assert!(!test.joints_pass(100.0, 3.0));
        for (torque, noise) in rows(800) {
            test.add_row(1, torque + noise, torque + 2.0, noise, 0.01);
        }
        assert!(test.joints_pass(100.0, 0.0));
    }
}
