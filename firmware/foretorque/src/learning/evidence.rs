//! Which of two models explains the torques better, on rows that neither has been fitted on.

/// What the rows of the last seconds say for a challenger against a champion, and what they say of a common factor on
/// all torques. Residuals in standard deviations of the measurement; old rows fade with the time constant of
/// [`MEMORY_ROWS`].
///
/// ```text
/// d = champion² − challenger²      t = Σ d / √Σ d²
/// ```
/// The pairs share their noise, so t notices a better model long before the mean squares differ visibly.
///
/// Parameters are shared by joints, so rows of one joint alone prove nothing of the torques of the others: a joint that
/// stood still meanwhile may be far off. What is better has to be so for every joint, or leave its torque as it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Evidence<const N: usize> {
    advantage: f32,
    scatter: f32,
    champion: f32,
    challenger: f32,
    /// Σ y², Σ y m, Σ m² of measured torque y and the champion's m.
    measured: f32,
    cross: f32,
    modelled: f32,
    /// Σ y m with both in units of the joint's torque limit: a joint that is known badly counts by its torque here.
    agreement: f32,
    /// Rows, faded like the sums: what noise alone leaves of a torque in these units.
    weight: f32,
    rows: u32,
    joints: [JointEvidence; N],
}

/// What one joint says.
#[derive(Clone, Copy, Debug, PartialEq)]
struct JointEvidence {
    advantage: f32,
    scatter: f32,
    /// Its rows, faded with those of all.
    weight: f32,
    /// By how much the challenger would change its torque while it stands still at most, in units of the torque limit;
    /// faded too.
    untold: f32,
}

/// Rows after which evidence has faded to 37 %.
const MEMORY_ROWS: f32 = 4096.0;
const FADE: f32 = 1.0 - 1.0 / MEMORY_ROWS;
/// Residuals count up to this many standard deviations: an outlier is not evidence.
const CLIP: f32 = 6.0;
/// A common factor is believed when it leaves less than this of what the champion leaves beyond the noise.
const GAIN_RATIO: f32 = 0.2;
/// Change of the torque of a joint that has not told, in units of the torque limit, that is no matter.
const UNTOLD_CHANGE: f32 = 0.01;
/// The same of a joint that has still not told after [`PATIENT`] times the rows it should have: others know it by hearsay.
const HEARSAY_CHANGE: f32 = 0.001;
const PATIENT: f32 = 12.0;

/// t > s without a root: squares with their signs are compared.
fn exceeds(advantage: f32, scatter: f32, sigmas: f32) -> bool {
    advantage * advantage.abs() > sigmas * sigmas.abs() * scatter
}

impl<const N: usize> Evidence<N> {
    /// No row yet.
    pub(super) const NONE: Self = Self {
        advantage: 0.0,
        scatter: 0.0,
        champion: 0.0,
        challenger: 0.0,
        measured: 0.0,
        cross: 0.0,
        modelled: 0.0,
        agreement: 0.0,
        weight: 0.0,
        rows: 0,
        joints: [JointEvidence {
            advantage: 0.0,
            scatter: 0.0,
            weight: 0.0,
            untold: 0.0,
        }; N],
    };

    /// Takes one row of `joint`: measured torque, what the champion makes of it, what the challenger leaves; in standard
    /// deviations, `sigma` of them in units of the joint's torque limit.
    pub(super) fn note(
        &mut self,
        joint: usize,
        measured: f32,
        champion: f32,
        challenger_residual: f32,
        sigma: f32,
    ) {
        let left = measured - champion;
        let sum = measured * measured + champion * champion + challenger_residual;
        if !sum.is_finite() {
            return;
        }
        let (a, b) = (
            left.clamp(-CLIP, CLIP),
            challenger_residual.clamp(-CLIP, CLIP),
        );
        let (a, b) = (a * a, b * b);
        let d = a - b;
        let fade = |sum: &mut f32, value: f32| *sum = FADE * *sum + value;
        fade(&mut self.advantage, d);
        fade(&mut self.scatter, d * d);
        fade(&mut self.champion, a);
        fade(&mut self.challenger, b);
        fade(&mut self.measured, measured * measured);
        fade(&mut self.cross, measured * champion);
        fade(&mut self.modelled, champion * champion);
        fade(&mut self.agreement, measured * champion * (sigma * sigma));
        fade(&mut self.weight, 1.0);
        for told in &mut self.joints {
            told.advantage *= FADE;
            told.scatter *= FADE;
            told.weight *= FADE;
            told.untold *= FADE;
        }
        if let Some(told) = self.joints.get_mut(joint) {
            told.advantage += d;
            told.scatter += d * d;
            told.weight += 1.0;
        }
        self.rows = self.rows.saturating_add(1);
    }

    /// `joint` stands still and tells nothing; the challenger would change its torque by `change`, in units of its limit.
    pub(super) fn note_still(&mut self, joint: usize, change: f32) {
        if let Some(told) = self.joints.get_mut(joint) {
            // The most of it: a change that swings through zero is one.
            let change = change.abs();
            if change > told.untold {
                told.untold = change;
            }
        }
    }

    /// No joint speaks against the challenger: each has told it on `rows` rows and does not find it worse by more than
    /// `sigmas` standard deviations, or its torque is left as it is.
    pub(super) fn no_joint_objects(&self, rows: f32, sigmas: f32) -> bool {
        let most = if self.rows as f32 > PATIENT * rows {
            HEARSAY_CHANGE
        } else {
            UNTOLD_CHANGE
        };
        self.joints.iter().all(|told| {
            if told.weight >= rows {
                !exceeds(-told.advantage, told.scatter, sigmas)
            } else {
                told.untold <= most
            }
        })
    }

    /// Rows taken.
    pub(super) fn rows(&self) -> u32 {
        self.rows
    }

    /// The challenger is better by `sigmas` standard deviations (worse, if `sigmas` is negative).
    pub(super) fn favours(&self, sigmas: f32) -> bool {
        if sigmas < 0.0 {
            exceeds(-self.advantage, self.scatter, -sigmas)
        } else {
            exceeds(self.advantage, self.scatter, sigmas)
        }
    }

    /// Mean square residual of the challenger over that of the champion.
    pub(super) fn ratio(&self) -> f32 {
        if self.champion > 0.0 {
            self.challenger / self.champion
        } else {
            1.0
        }
    }

    /// The measured torques oppose those of the champion: sensors or drives have the wrong sign.
    pub(super) fn opposes(&self) -> bool {
        self.agreement < 0.0
    }

    /// The factor on all torques that explains what the champion leaves, if one does: sensors or drives are off, not the
    /// arm. `error` is how far from 1 it has to be.
    pub(super) fn common_gain(&self, error: f32) -> Option<f32> {
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

    /// Noise of about one standard deviation, torques of thirty.
    fn rows(count: u32) -> impl Iterator<Item = (f32, f32)> {
        (0..count).map(|k| {
            let t = k as f32;
            let noise = 1.4 * (t * 2.399).sin();
            (30.0 * (t * 0.013).sin() + 8.0, noise)
        })
    }

    #[test]
    fn a_model_that_is_a_tenth_of_the_noise_better_is_noticed_and_an_equal_one_is_not() {
        let (mut better, mut equal) = (Evidence::<2>::NONE, Evidence::<2>::NONE);
        for (torque, noise) in rows(20_000) {
            let champion = torque + 0.2 * (torque * 0.7).sin();
            better.note(0, torque + noise, champion, noise, 0.01);
            equal.note(0, torque + noise, torque, noise, 0.01);
        }
        assert!(better.favours(3.0) && !better.favours(-3.0));
        assert!(!equal.favours(3.0) && !equal.favours(-3.0));
        assert!(better.ratio() < 1.0);
    }

    #[test]
    fn a_common_factor_is_told_from_a_wrong_model() {
        for gain in [-1.0, 0.8, 1.2] {
            let (mut scaled, mut offset) = (Evidence::<2>::NONE, Evidence::<2>::NONE);
            for (torque, noise) in rows(5000) {
                scaled.note(0, gain * torque + noise, torque, noise, 0.01);
                offset.note(0, torque + 5.0 + noise, torque, noise, 0.01);
            }
            let found = scaled.common_gain(0.08).unwrap_or(0.0);
            assert!((found - gain).abs() < 0.02, "{found} for {gain}");
            assert_eq!(offset.common_gain(0.08), None);
        }
        assert_eq!(Evidence::<1>::NONE.common_gain(0.08), None);
    }

    #[test]
    fn what_is_not_finite_is_no_evidence() {
        let mut evidence = Evidence::<1>::NONE;
        evidence.note(0, f32::NAN, 1.0, 1.0, 0.01);
        evidence.note(0, 1.0, f32::INFINITY, 1.0, 0.01);
        evidence.note(0, 1.0, 1.0, f32::NAN, 0.01);
        assert_eq!(evidence, Evidence::NONE);
    }

    #[test]
    fn a_joint_that_stood_still_or_finds_it_worse_speaks_against_what_the_others_find_better() {
        let mut evidence = Evidence::<2>::NONE;
        for (torque, noise) in rows(2000) {
            evidence.note(0, torque + noise, torque + 2.0, noise, 0.01);
            evidence.note_still(1, 0.05);
        }
        assert!(evidence.favours(3.0) && !evidence.no_joint_objects(100.0, 0.0));
        // Only once what it would have been is long ago.
        evidence.note_still(1, 0.001);
        assert!(!evidence.no_joint_objects(100.0, 0.0));
        for (torque, noise) in rows(8000) {
            evidence.note(0, torque + noise, torque + 2.0, noise, 0.01);
        }
        assert!(evidence.no_joint_objects(1000.0, 0.0));
        // And not by hearsay for good: twelve times the rows that were wanted have gone by.
        assert!(!evidence.no_joint_objects(100.0, 0.0));
        for (torque, noise) in rows(400) {
            evidence.note(1, torque + noise, torque, noise + 2.0, 0.01);
        }
        assert!(evidence.favours(3.0) && !evidence.no_joint_objects(100.0, 0.0));
        assert!(!evidence.no_joint_objects(100.0, 3.0));
        for (torque, noise) in rows(800) {
            evidence.note(1, torque + noise, torque + 2.0, noise, 0.01);
        }
        assert!(evidence.no_joint_objects(100.0, 0.0));
    }
}
