use super::parameters::{JointNetwork, NETWORK_BOUND, network_inputs};
use crate::limits::cut;
use crate::network::StepParameters;
use nalgebra::SVector;

/// Rows of a joint on which a challenger is judged: 9 s at 167 rows a second.
const TRIAL_ROWS: u32 = 1500;
/// A challenger has to leave less than this part of the mean square residual of the network in force.
const PROMOTION_RATIO: f32 = 0.98;
/// Significance of a promotion, squared.
const SIGNIFICANCE: f32 = 9.0;
/// Residuals count up to this many standard deviations.
const CLIP: f32 = 6.0;

/// How the networks are trained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrainerConfig {
    /// Step of the output layer, as a fraction of the step that would cancel the error of a row; 0 trains nothing.
    pub rate: f32,
    /// Step of the hidden layer, over that of the output layer; 0 leaves it as it is.
    pub hidden: f32,
    /// Errors beyond this many standard deviations of the measurement act as if they had this many.
    pub clip_sigmas: f32,
}

/// What one row says to the network of its joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NetworkRow {
    /// Speed of the joint, rad/s.
    pub qd: f32,
    /// What the linear parameters leave of the torque, in units of the torque limit.
    pub residual: f32,
    /// Standard deviation of the measurement, in units of the torque limit.
    pub sigma: f32,
}

/// How a trial of a network ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum NetworkVerdict {
    /// The challenger takes the place of the network in force. Its mean square residual over that of the other.
    Promoted(f32),
    /// The network in force makes the torque worse than none. Its mean square residual over that without.
    Silenced(f32),
}

/// Sums over one trial.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sums {
    rows: u32,
    active: f32,
    challenger: f32,
    silent: f32,
    /// Σ (active² − challenger²)², Σ (active² − silent²)².
    scatter: f32,
    silent_scatter: f32,
}

impl Sums {
    const NONE: Self = Self {
        rows: 0,
        active: 0.0,
        challenger: 0.0,
        silent: 0.0,
        scatter: 0.0,
        silent_scatter: 0.0,
    };
}

/// Trains the networks of the joints on what the linear parameters leave, out of sight of the torque.
///
/// The trainee learns from every row. A copy of it, the challenger, is held as it is and judged against the network in
/// force on rows that came after it was made: none of them has fitted it. Only a challenger that wins is believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NetworkTrainer<const N: usize> {
    trainee: [JointNetwork; N],
    challenger: [JointNetwork; N],
    sums: [Sums; N],
}

impl<const N: usize> NetworkTrainer<N> {
    /// Starts from `networks`.
    pub(super) const fn new(networks: &[JointNetwork; N]) -> Self {
        Self {
            trainee: *networks,
            challenger: *networks,
            sums: [Sums::NONE; N],
        }
    }

    /// Takes one row of `joint`.
    ///
    /// * `active` the network in force, replaced where the verdict says so
    ///
    /// Cost: the network of the joint forwards three times and backwards once.
    #[inline(never)]
    pub(super) fn train(
        &mut self,
        config: &TrainerConfig,
        joint: usize,
        row: &NetworkRow,
        active: &mut JointNetwork,
    ) -> Option<NetworkVerdict> {
        let NetworkRow {
            qd,
            residual,
            sigma,
        } = *row;
        let trainee = self.trainee.get_mut(joint)?;
        let challenger = self.challenger.get_mut(joint)?;
        let sums = self.sums.get_mut(joint)?;
        let x = network_inputs(qd);
        let inverse = 1.0 / sigma;
        let square = |said: f32| {
            let z = cut((residual - said) * inverse, CLIP).0;
            z * z
        };
        let said = |network: &JointNetwork| cut(network.forward(&x)[0], NETWORK_BOUND).0;
        let silent = square(0.0);
        let (active_left, challenger_left) = (square(said(active)), square(said(challenger)));
        if !(residual + active_left + challenger_left + silent).is_finite() {
            return None;
        }
        let advantage = active_left - challenger_left;
        let harm = active_left - silent;
        sums.rows += 1;
        sums.active += active_left;
        sums.challenger += challenger_left;
        sums.silent += silent;
        sums.scatter += advantage * advantage;
        sums.silent_scatter += harm * harm;
        let step = StepParameters {
            learning_rate: config.rate,
            error_clip: config.clip_sigmas * sigma,
        };
        trainee.update_layers(&x, &SVector::from([residual]), &step, config.hidden);
        if sums.rows < TRIAL_ROWS {
            return None;
        }
        let done = core::mem::replace(sums, Sums::NONE);
        let proven = |gain: f32, scatter: f32| gain > 0.0 && gain * gain > SIGNIFICANCE * scatter;
        let verdict = if done.challenger < PROMOTION_RATIO * done.active
            && done.challenger < PROMOTION_RATIO * done.silent
            && proven(done.active - done.challenger, done.scatter)
        {
            *active = *challenger;
            Some(NetworkVerdict::Promoted(done.challenger / done.active))
        } else if proven(done.active - done.silent, done.silent_scatter) {
            *active = active.silenced();
            Some(NetworkVerdict::Silenced(done.active / done.silent))
        } else {
            None
        };
        *challenger = *trainee;
        verdict
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: TrainerConfig = TrainerConfig {
        rate: 1e-3,
        hidden: 0.1,
        clip_sigmas: 3.0,
    };

    fn silent() -> [JointNetwork; 1] {
        [JointNetwork::silent(4)]
    }

    /// Speeds that visit ±2 rad/s evenly in a mixed order, a friction the linear columns do not know, and noise.
    fn row(k: u32, height: f32) -> NetworkRow {
        let qd = 4.0 * (f64::from(k) * 0.618_033_988_75).fract() as f32 - 2.0;
        let word = k.wrapping_mul(0x9E37_79B9) ^ (k << 7);
        let noise = 0.017 * (word.wrapping_mul(0x85EB_CA6B) as i32) as f32 / i32::MAX as f32;
        NetworkRow {
            qd,
            residual: height * crate::math::tanh(qd * 5.0) + noise,
            sigma: 0.01,
        }
    }

    #[test]
    fn a_network_that_explains_unseen_rows_is_believed_and_nothing_is_before_its_trial_ends() {
        let [mut active] = silent();
        let mut trainer = NetworkTrainer::new(&[active]);
        let mut believed = None;
        for k in 0..20_000 {
            let verdict = trainer.train(&CONFIG, 0, &row(k, 0.02), &mut active);
            if let Some(NetworkVerdict::Promoted(ratio)) = verdict {
                assert!(ratio < PROMOTION_RATIO);
                believed = believed.or(Some(k));
            }
            assert_eq!(active == silent()[0], believed.is_none(), "row {k}");
        }
        // The first trial judges what nobody has trained.
        assert!(
            believed.is_some_and(|k| k >= 2 * TRIAL_ROWS - 1),
            "{believed:?}"
        );
    }

    #[test]
    fn where_the_linear_parameters_explain_everything_no_network_is_believed() {
        let [mut active] = silent();
        let mut trainer = NetworkTrainer::new(&[active]);
        for k in 0..60_000 {
            assert_eq!(trainer.train(&CONFIG, 0, &row(k, 0.0), &mut active), None);
        }
        assert_eq!(active, silent()[0]);
    }

    #[test]
    fn a_network_that_harms_is_silenced_within_one_trial() {
        let [mut active] = silent();
        active.output_bias[0] = 0.02;
        let mut trainer = NetworkTrainer::new(&silent());
        for k in 0..TRIAL_ROWS {
            trainer.train(&CONFIG, 0, &row(k, 0.0), &mut active);
        }
        let [[left]] = active.forward(&network_inputs(1.0)).data.0;
        assert!(left.abs() < 1e-3, "{left}");
    }

    #[test]
    fn what_is_not_finite_teaches_nothing() {
        let [mut active] = silent();
        let mut trainer = NetworkTrainer::new(&[active]);
        trainer.train(&CONFIG, 0, &row(1, 0.02), &mut active);
        let before = trainer;
        for bad in [f32::NAN, f32::INFINITY] {
            let broken = NetworkRow {
                residual: bad,
                ..row(2, 0.0)
            };
            trainer.train(&CONFIG, 0, &broken, &mut active);
            assert_eq!(trainer, before);
        }
    }
}
