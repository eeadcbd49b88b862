use super::conditioning::Conditioned;
use super::config::LearnerConfig;
use super::parameters::ParameterSet;
use crate::arm::Arm;
use crate::dynamics::{friction_row, regressor_row};
use crate::limits::cut;

/// One step of normalised least mean squares on the torque row of `joint`, in units of prior standard deviations.
///
/// ```text
/// e    = (tau − φᵀθ) / limit          what the linear model leaves unexplained
/// φ'_i = φ_i σ_i / limit              θ'_i = θ_i / σ_i
/// θ'   ← θ' + rate · φ' clip(e) / (noise² + |φ'|²),     each θ'_i kept within ±box of the prior's
/// ```
/// [Haykin 2014, ch. 6 (normalised LMS)]. `noise` is where the gain of a Kalman filter that starts from the prior has it.
///
/// * returns e, in units of the torque limit; `None`, and nothing changed, if a number was not finite
///
/// Cost: one regressor row, `6 P` multiply-adds.
pub(super) fn correct<A: Arm<N, P>, const N: usize, const P: usize>(
    config: &LearnerConfig<N, P>,
    prior: &ParameterSet<N, P>,
    candidate: &mut ParameterSet<N, P>,
    joint: usize,
    seen: &Conditioned<N>,
) -> Option<f32> {
    let friction = candidate.friction.get_mut(joint)?;
    let friction_prior = prior.friction.get(joint)?;
    let friction_sigma = config.friction_sigma.get(joint)?;
    let scale = 1.0 / A::LIMITS.get(joint)?.torque;

    let row = regressor_row::<A, N, P>(joint, &seen.motion);
    let [viscous, coulomb] = friction_row(*seen.motion.qd.get(joint)?);

    let mut explained = viscous * friction.viscous + coulomb * friction.coulomb;
    let mut power =
        square(viscous * friction_sigma.viscous) + square(coulomb * friction_sigma.coulomb);
    let columns = row.as_slice().iter().zip(&config.rigid_sigma);
    for ((&phi, &sigma), &theta) in columns.zip(candidate.rigid.as_slice()) {
        explained += phi * theta;
        power += square(phi * sigma);
    }
    let residual = (seen.tau.get(joint)? - explained) * scale;
    let power = power * scale * scale + config.noise * config.noise;
    // Whatever was infinite or not a number above ends up in one of these two.
    if !(residual.is_finite() && power.is_finite()) {
        return None;
    }

    let (clipped, _) = cut(residual, config.residual_clip);
    let gain = config.rate * clipped * scale / power;
    let corrected = |theta: f32, prior: f32, sigma: f32, phi: f32| {
        let moved = theta + gain * sigma * sigma * phi;
        let (bounded, outside) = cut(moved - prior, config.box_sigmas * sigma);
        if outside { prior + bounded } else { moved }
    };
    let columns = row
        .as_slice()
        .iter()
        .zip(&config.rigid_sigma)
        .zip(prior.rigid.as_slice());
    for (theta, ((&phi, &sigma), &prior)) in candidate.rigid.as_mut_slice().iter_mut().zip(columns)
    {
        *theta = corrected(*theta, prior, sigma, phi);
    }
    let sigma = friction_sigma.viscous;
    friction.viscous = positive(corrected(
        friction.viscous,
        friction_prior.viscous,
        sigma,
        viscous,
    ));
    let sigma = friction_sigma.coulomb;
    friction.coulomb = positive(corrected(
        friction.coulomb,
        friction_prior.coulomb,
        sigma,
        coulomb,
    ));
    Some(residual)
}

fn square(x: f32) -> f32 {
    x * x
}

/// Friction never pushes.
fn positive(coefficient: f32) -> f32 {
    if coefficient > 0.0 { coefficient } else { 0.0 }
}
