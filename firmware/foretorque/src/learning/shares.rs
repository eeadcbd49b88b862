//! Shares of loaded set and estimate in the torque of each joint.

use super::parameters::LinearParameters;
use crate::dynamics::FRICTION_COLUMNS;

/// Part of the way from the loaded set to the learnt one that the torque takes, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearntShare<const N: usize> {
    /// Torque of each joint.
    pub joint: [f32; N],
    /// Rigid body of a single set for all joints.
    pub common: f32,
}

impl<const N: usize> LearntShare<N> {
    /// Loaded set alone.
    pub const NONE: Self = Self {
        joint: [0.0; N],
        common: 0.0,
    };
    /// Learnt set alone.
    pub const FULL: Self = Self {
        joint: [1.0; N],
        common: 1.0,
    };

    /// Single set between `loaded` and `learnt`; each of both at its share, bit for bit.
    ///
    /// The rigid body has the common share. Rigid body and friction make up for errors of each other, so the friction of a joint
    /// goes at least as far: at a smaller share of its own, the torque may be worse than that of either set.
    pub(crate) fn single_set<const P: usize>(
        &self,
        loaded: &LinearParameters<N, P>,
        learnt: &LinearParameters<N, P>,
    ) -> LinearParameters<N, P> {
        let mut set = *learnt;
        blend(&loaded.rigid, &mut set.rigid, self.common);
        let shares = self.joint.map(|own| match own > self.common {
            true => own,
            false => self.common,
        });
        blend_friction(&loaded.friction, &mut set.friction, &shares);
        set
    }

    /// Friction in the torque of each joint, between `loaded` and `learnt`.
    pub(super) fn friction<const P: usize>(
        &self,
        loaded: &LinearParameters<N, P>,
        learnt: &LinearParameters<N, P>,
    ) -> [[f32; FRICTION_COLUMNS]; N] {
        let mut friction = learnt.friction;
        blend_friction(&loaded.friction, &mut friction, &self.joint);
        friction
    }
}

/// Friction at the share of each joint of the way from `from` to the present one.
fn blend_friction<const N: usize>(
    from: &[[f32; FRICTION_COLUMNS]; N],
    friction: &mut [[f32; FRICTION_COLUMNS]; N],
    shares: &[f32; N],
) {
    for ((from, friction), share) in from.iter().zip(friction).zip(shares) {
        blend(from, friction, *share);
    }
}

/// Values at `share` of the way from `from` to the present ones.
#[inline(never)]
pub(super) fn blend(from: &[f32], values: &mut [f32], share: f32) {
    if share != 1.0 {
        for (value, from) in values.iter_mut().zip(from) {
            *value = from + share * (*value - from);
        }
    }
}

/// Standard deviations below which a share is 0.
const SIGNIFICANCE: f32 = 2.0;
/// Residual of both sets, standard deviations, beyond which a row counts less: an outlier fits neither.
const CLIP: f32 = 6.0;
/// Largest growth of a range by one row, rad/s or of the torque limit: one encoder error is no motion.
const RANGE_STEP: f32 = 0.02;
/// Torques are reversed from minus this correlation with those of the loaded set on: a set that has next to none of the torque
/// correlates with it by chance.
const REVERSED: f32 = 0.1;

#[derive(Clone, Copy, Debug, PartialEq)]
struct JointEvidence {
    /// Σ d r
    cross: f32,
    /// Σ d²
    power: f32,
    /// Rows in the sums, as far as the memory reaches.
    rows: f32,
    /// Part of these that the next row takes off.
    fading: f32,
    /// Range of the velocity, negative and positive, rad/s.
    velocity: [f32; 2],
    /// Range of the torque of the loaded set.
    load: [f32; 2],
}

impl JointEvidence {
    const NONE: Self = Self {
        cross: 0.0,
        power: 0.0,
        rows: 0.0,
        fading: 0.0,
        velocity: [0.0; 2],
        load: [0.0; 2],
    };
}

/// Widens a range to `value`, by a step at most; its old size over the new one on that side.
#[inline(never)]
fn widen([negative, positive]: &mut [f32; 2], value: f32) -> f32 {
    let widest = if value < 0.0 { negative } else { positive };
    let (known, size) = (*widest, value.abs());
    if size <= known {
        return 1.0;
    }
    let most = known + RANGE_STEP;
    *widest = if size < most { size } else { most };
    known / *widest
}

/// Evidence for the shares: sums over rows before they are learnt, faded.
///
/// ```text
/// w_j = clip(v (1 − 4 s²/v²), 0, 1)     v = Σ d r / Σ d²     s² = ρ_j σ_j² / Σ d²     d = estimate − loaded
///                                                                              r = measured − loaded
/// ```
/// * v is the least-squares share, s its standard deviation under noise with the correlation factor ρ. The nonnegative
///   garrote [Breiman 1995] of v: 0 below two standard deviations, and v where there is no doubt. A lower bound v − 2 s
///   would leave a part of every error in the torque: the sums fade, so s does not go to 0
/// * the estimate is that of the older checkpoint: a newer one has learnt the noise that is still in r
/// * rows with a large change weigh most, so a share falls fast where the estimate is wrong
/// * a row counts in proportion to the rows of its joint before it, until the memory is full: an estimate of few rows is another one, and
///   its large errors are no evidence on the present one (polynomial-decay averaging [Shamir and Zhang 2013], η = 1)
/// * the sums of a joint fade as its ranges of velocity and of loaded torque grow, by old over new: what slow motion, one direction
///   or one side of gravity has shown is no evidence on the rest. An error of a drive's gain is an offset on one side, and makes
///   the torque worse on the other
///
/// Torques in units of the torque limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ShareEvidence<const N: usize> {
    joints: [JointEvidence; N],
    /// Σ (1 − c) y m + c (y + m)²/2 over all joints, of measured torque y and torque m of the loaded set: negative only where
    /// their correlation is below −c, and neither is far larger than the other.
    agreement: f32,
}

impl<const N: usize> ShareEvidence<N> {
    pub(super) const NONE: Self = Self {
        joints: [JointEvidence::NONE; N],
        agreement: 0.0,
    };

    /// Add a row of `joint` at the velocity `qd`, rad/s; a row that is not finite is ignored.
    ///
    /// * `measured`, `loaded` torques      * `residual` of the estimate      * `sigma` standard deviation of the measurement
    /// * `memory` of the sums of a joint, rows
    pub(super) fn add_row(
        &mut self,
        joint: usize,
        qd: f32,
        [measured, loaded, residual]: [f32; 3],
        sigma: f32,
        memory: f32,
    ) {
        let Some(own) = self.joints.get_mut(joint) else {
            return;
        };
        let change = measured - loaded - residual;
        let missing = measured - loaded;
        let (most, both) = (CLIP * sigma, missing.abs().min(residual.abs()));
        let weight = if both > most { most / both } else { 1.0 };
        let product = weight * change * missing;
        if !(product + measured * loaded + qd).is_finite() {
            return;
        }
        let growth = widen(&mut own.velocity, qd) * widen(&mut own.load, loaded);
        let part = 1.0 - core::mem::take(&mut own.fading);
        let before = part * own.rows;
        let rows = before + 1.0;
        let kept = part * before / rows * growth;
        own.cross = kept * own.cross + product;
        own.power = kept * own.power + weight * change * change;
        own.rows = rows.min(memory);
        // As long a memory, over the rows of all joints.
        let both = measured + loaded;
        let agrees = (1.0 - REVERSED) * measured * loaded + 0.5 * REVERSED * both * both;
        self.agreement += agrees - self.agreement / (memory * N as f32);
    }

    /// Let the rows of a joint count as `part` of them from its next row on: those to come decide soon. A joint at rest keeps
    /// its share.
    #[inline(never)]
    pub(super) fn fade(&mut self, part: f32) {
        self.joints
            .iter_mut()
            .for_each(|own| own.fading = 1.0 - part);
    }

    /// True if the measured torques oppose those of the loaded set: sensors or drives have the wrong sign.
    pub(super) fn is_reversed(&self) -> bool {
        self.agreement < 0.0
    }

    /// Share of `joint`; 0 while the torques are reversed.
    ///
    /// * `variance` ρ σ² of the measurement
    pub(super) fn share(&self, joint: usize, variance: f32) -> f32 {
        let Some(JointEvidence { cross, power, .. }) = self.joints.get(joint) else {
            return 0.0;
        };
        let share = (cross - SIGNIFICANCE * SIGNIFICANCE * variance * power / cross) / power;
        // A comparison with a not-a-number is false. Both terms change their sign with the cross product.
        match *cross > 0.0 && share > 0.0 && !self.is_reversed() {
            true if share < 1.0 => share,
            true => 1.0,
            false => 0.0,
        }
    }

    /// Share of a single set: the mean of `shares`, weighted by the squares of the changes.
    pub(super) fn common(&self, shares: &[f32; N]) -> f32 {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (own, share) in self.joints.iter().zip(shares) {
            sum += own.power * share;
            weight += own.power;
        }
        let mean = sum / weight;
        // Rounding must not leave the range of the shares.
        if mean > 0.0 { mean.min(1.0) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MEMORY: f32 = 1667.0;
    const SIGMA: f32 = 0.01;
    const NOISE: f32 = 9.0 * SIGMA * SIGMA;
    const QD: f32 = 0.01;

    fn none() -> ShareEvidence<2> {
        ShareEvidence::NONE
    }

    /// Evidence after `rows` rows of joint 0 with the change `change` where `missing` is missing.
    fn after(evidence: &mut ShareEvidence<2>, rows: u32, change: f32, missing: f32) -> f32 {
        for row in 0..rows {
            let noise = SIGMA * 1.4 * (row as f32 * row as f32 * 0.37).sin();
            let wave = (0.05 * row as f32).sin();
            let (loaded, wanted) = (0.3, 0.3 + missing * wave + noise);
            let residual = wanted - loaded - change * wave;
            evidence.add_row(0, QD, [wanted, loaded, residual], SIGMA, MEMORY);
        }
        evidence.share(0, NOISE)
    }

    #[test]
    fn a_right_change_gets_all_and_a_wrong_one_nothing() {
        let mut evidence = ShareEvidence::NONE;
        assert_eq!(evidence.share(0, NOISE), 0.0);
        // 1 − 4 ρ σ² / Σ d² = 0.9996.
        assert!(after(&mut evidence, 4000, 0.1, 0.1) > 0.99);
        // Suddenly wrong by five times as much.
        assert!(after(&mut evidence, 170, -0.5, 0.0) < 0.25);
        assert_eq!(after(&mut none(), 1000, -0.1, 0.1), 0.0);
        assert_eq!(evidence.share(1, NOISE), 0.0);
    }

    #[test]
    fn slow_motion_in_one_direction_on_one_side_of_gravity_is_no_evidence_on_the_rest() {
        // Right for long, then wrong for 170 rows at another velocity, or under another load.
        let share_at = |qd: f32, loaded: f32| {
            let mut evidence = none();
            after(&mut evidence, 4000, 0.1, 0.1);
            for _ in 0..170 {
                evidence.add_row(0, qd, [loaded, loaded, -0.1], SIGMA, MEMORY);
            }
            evidence.share(0, NOISE)
        };
        let [same, faster, back] = [QD, 8.0 * QD, -QD].map(|qd| share_at(qd, 0.3));
        let [light, heavy, other_side] = [0.1, 0.9, -0.3].map(|loaded| share_at(QD, loaded));
        assert_eq!(light, same);
        assert!(heavy < 0.7 && other_side < 0.05, "{heavy} {other_side}");
        let falls = same > 0.75 && faster < 0.4 && back < 0.05;
        assert!(falls, "{same} {faster} {back}");
        // One error of an encoder costs a part of the evidence only.
        let mut evidence = ShareEvidence::<2>::NONE;
        evidence.joints[0].velocity = [0.5; 2];
        evidence.joints[0].load = [0.5; 2];
        after(&mut evidence, 4000, 0.1, 0.1);
        let before = evidence.joints[0].power;
        evidence.add_row(0, 1e6, [0.3, 0.3, 0.0], SIGMA, MEMORY);
        assert!(evidence.joints[0].power > 0.95 * before);
    }

    #[test]
    fn errors_of_an_estimate_of_few_rows_are_soon_no_evidence() {
        let mut evidence = none();
        // Equal memory for all rows leaves 0.8.
        assert_eq!(after(&mut evidence, 200, -0.5, 0.1), 0.0);
        let share = after(&mut evidence, 4000, 0.1, 0.1);
        assert!(share > 0.95, "{share}");
    }

    #[test]
    fn a_change_within_the_noise_gets_little_and_too_large_a_one_its_part() {
        assert!(after(&mut none(), 4000, 0.002, 0.002) < 0.5);
        let share = after(&mut none(), 4000, 0.2, 0.1);
        assert!((share - 0.5).abs() < 0.05, "{share}");
    }

    #[test]
    fn reversed_torques_and_bad_numbers_get_nothing() {
        let mut evidence = ShareEvidence::<2>::NONE;
        evidence.add_row(0, QD, [f32::NAN, 1.0, 1.0], SIGMA, MEMORY);
        evidence.add_row(0, QD, [1.0, f32::INFINITY, 1.0], SIGMA, MEMORY);
        evidence.add_row(0, f32::NAN, [1.0, 1.0, 1.0], SIGMA, MEMORY);
        assert_eq!(evidence, ShareEvidence::NONE);
        (0..2000).for_each(|_| evidence.add_row(0, QD, [-0.5, 0.5, 0.0], SIGMA, MEMORY));
        assert_eq!(evidence.share(0, NOISE), 0.0);
        assert!(evidence.is_reversed());
        // Friction against a set that has next to nothing, whose sign is chance.
        let mut evidence = ShareEvidence::<2>::NONE;
        for row in 0..2000 {
            let across = if row % 2 == 0 { 0.3 } else { -0.3 };
            evidence.add_row(0, QD, [across - 0.01, 1e-3, 0.0], SIGMA, MEMORY);
        }
        assert!(!evidence.is_reversed());
    }

    #[test]
    fn a_blend_at_its_ends_is_the_set_bit_for_bit() {
        let [a, b] = [0.1, 0.7].map(LinearParameters::<2, 3>::filled);
        assert_eq!(LearntShare::FULL.single_set(&a, &b), b);
        assert_eq!(LearntShare::NONE.single_set(&a, &b), a);
        let share = LearntShare {
            joint: [1.0, 0.0],
            common: 0.5,
        };
        let single = share.single_set(&a, &b);
        let halves = single.rigid.iter().chain(&single.friction[1]);
        assert!(halves.copied().all(|value| (value - 0.4).abs() < 1e-6));
        assert_eq!(single.friction[0], b.friction[0]);
        let in_torque = share.friction(&a, &b);
        assert_eq!(in_torque, [b.friction[0], a.friction[1]]);
    }
}
