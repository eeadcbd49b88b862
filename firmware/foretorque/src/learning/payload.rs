use super::quality::PayloadEstimate;
use super::small_filter::SmallFilter;
use crate::arm::{Arm, LINK_PARAMETERS};
use crate::dynamics::BaseParameters;
use crate::math::sqrt;

/// Numbers of a payload that are estimated: m, m·x, m·y, m·z, Ixx, Iyy, Izz in the frame of the last link, the first of
/// the standard parameters of eq. 14.
pub(super) const PAYLOAD_PARAMETERS: usize = 7;

/// A rigid body in the hand: standard parameters about the origin of the last link's frame.
pub(super) type Payload = [f32; PAYLOAD_PARAMETERS];

/// Prior standard deviations of a payload of up to `mass`, kg: its centre of mass within 0.15 m of the last link's
/// origin, its radius of gyration about that within 0.15 m too.
pub(super) const fn payload_sigma(mass: f32) -> Payload {
    let (first, second) = (0.15 * mass, 0.0225 * mass);
    [mass, first, first, first, second, second, second]
}

/// The base parameter and the weight of each number of a payload, from the arm's base map: a body at the last link
/// changes the base parameters linearly.
fn terms<A: Arm<N, P>, const N: usize, const P: usize>() -> impl Iterator<Item = (usize, usize, f32)>
{
    A::BASE_MAP.iter().filter_map(|term| {
        let number = term.standard.checked_sub(LINK_PARAMETERS * (N - 1))?;
        (number < PAYLOAD_PARAMETERS).then_some((term.base, number, term.weight))
    })
}

/// What `payload` adds to the base parameters.
#[inline(never)]
pub(super) fn payload_base<A: Arm<N, P>, const N: usize, const P: usize>(
    payload: &Payload,
) -> BaseParameters<P> {
    let mut beta = BaseParameters::<P>::zeros();
    for (base, number, weight) in terms::<A, N, P>() {
        if let (Some(beta), Some(value)) = (beta.get_mut(base), payload.get(number)) {
            *beta += weight * value;
        }
    }
    beta
}

/// Torque for each unit of each number of a payload, from the regressor row `rigid` of a joint.
#[inline(never)]
pub(super) fn payload_row<A: Arm<N, P>, const N: usize, const P: usize>(
    rigid: &[f32; P],
) -> Payload {
    let mut row = [0.0; PAYLOAD_PARAMETERS];
    for (base, number, weight) in terms::<A, N, P>() {
        if let (Some(row), Some(value)) = (row.get_mut(number), rigid.get(base)) {
            *row += weight * value;
        }
    }
    row
}

/// Weighs a payload: a small filter on what the arm's own model leaves of the torques.
///
/// The estimate of the arm itself is not touched, so that a payload put down is undone exactly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PayloadFilter {
    filter: SmallFilter<PAYLOAD_PARAMETERS>,
    sigma: Payload,
}

impl PayloadFilter {
    /// As uncertain as `sigma`, around `payload`.
    pub(super) const fn new(payload: &Payload, sigma: &Payload) -> Self {
        let mut theta = *payload;
        let mut k = 0;
        while k < PAYLOAD_PARAMETERS {
            theta[k] /= sigma[k];
            k += 1;
        }
        Self {
            filter: SmallFilter::new(theta),
            sigma: *sigma,
        }
    }

    /// What the estimate leaves of the torque `tau` whose row is `row`, N·m.
    pub(super) fn residual(&self, row: &Payload, tau: f32) -> f32 {
        self.filter.residual(&self.scaled(row), tau)
    }

    /// Takes in the torque `tau`, N·m, of standard deviation `sigma`.
    pub(super) fn update(&mut self, row: &Payload, tau: f32, sigma: f32) {
        let inverse = 1.0 / sigma;
        let phi = self.scaled(row).map(|x| x * inverse);
        self.filter.update(&phi, tau * inverse, 1.0);
    }

    /// The estimate.
    pub(super) fn payload(&self) -> Payload {
        let mut payload = self.filter.theta;
        for (value, sigma) in payload.iter_mut().zip(&self.sigma) {
            *value *= sigma;
        }
        payload
    }

    /// Standard deviation of the mass, kg.
    pub(super) fn mass_sigma(&self) -> f32 {
        sqrt(self.filter.variance(0)) * self.sigma[0]
    }

    fn scaled(&self, row: &Payload) -> Payload {
        let mut phi = *row;
        for (phi, sigma) in phi.iter_mut().zip(&self.sigma) {
            *phi *= sigma;
        }
        phi
    }
}

/// Mass and centre of mass of `payload`.
pub(super) fn describe(payload: &Payload, mass_sigma: f32) -> PayloadEstimate {
    let [mass, x, y, z, ..] = *payload;
    let inverse = if mass > 0.0 { 1.0 / mass } else { 0.0 };
    PayloadEstimate {
        mass,
        com: [x, y, z].map(|first| first * inverse),
        mass_sigma,
    }
}

/// Torque of `payload` for the row `row`, N·m.
pub(super) fn payload_torque(payload: &Payload, row: &Payload) -> f32 {
    let mut tau = 0.0;
    for (value, row) in payload.iter().zip(row) {
        tau += value * row;
    }
    tau
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
    use crate::arm::{LinkInertia, base_parameters};
    use crate::dynamics::{regressor_row, rnea};
    use crate::joint::{JointMotion, JointVector};

    /// 3 kg, 5 cm beyond the flange and aside.
    fn body() -> LinkInertia {
        LinkInertia {
            mass: 3.0,
            com: nalgebra::Vector3::new(0.02, -0.01, 0.13),
            inertia_com: nalgebra::Matrix3::identity() * 0.004,
        }
    }

    fn numbers() -> Payload {
        let standard = body().standard_parameters();
        core::array::from_fn(|k| standard[k])
    }

    fn motion(phase: f32) -> JointMotion<N> {
        JointMotion {
            q: JointVector::from_fn(|j, _| (phase + j as f32).sin()),
            qd: JointVector::from_fn(|j, _| (1.3 * phase + j as f32).cos()),
            qdd: JointVector::from_fn(|j, _| 2.0 * (0.7 * phase + j as f32).sin()),
        }
    }

    #[test]
    fn a_payload_is_a_change_of_the_last_link() {
        let mut links = [LinkInertia::NONE; N];
        links[N - 1] = body();
        let mut whole = base_parameters::<Ur5, N, P>(&links, &[0.0; N]);
        // Products of inertia are not among the numbers of a payload.
        let standard = body().standard_parameters();
        for term in Ur5::BASE_MAP {
            if let 57..60 = term.standard {
                whole[term.base] -= term.weight * standard[term.standard - 50];
            }
        }
        let beta = payload_base::<Ur5, N, P>(&numbers());
        assert!((beta - whole).amax() < 1e-6, "{beta} {whole}");
        for joint in 0..N {
            let motion = motion(joint as f32);
            let tau = rnea::<Ur5, N, P>(&beta, &motion)[joint];
            let row = regressor_row::<Ur5, N, P>(joint, &motion).data.0[0];
            let row = payload_row::<Ur5, N, P>(&row);
            assert!((payload_torque(&numbers(), &row) - tau).abs() < 1e-4);
        }
    }

    #[test]
    fn a_payload_is_weighed_within_a_second_of_motion() {
        let truth = payload_base::<Ur5, N, P>(&numbers());
        let mut filter = PayloadFilter::new(&[0.0; PAYLOAD_PARAMETERS], &payload_sigma(6.0));
        assert!((filter.mass_sigma() - 6.0).abs() < 1e-3);
        for slice in 0..100 {
            let motion = motion(0.01 * slice as f32);
            let tau = rnea::<Ur5, N, P>(&truth, &motion);
            for joint in 0..N {
                let row = regressor_row::<Ur5, N, P>(joint, &motion).data.0[0];
                let row = payload_row::<Ur5, N, P>(&row);
                filter.update(&row, tau[joint], 0.02 * Ur5::LIMITS[joint].torque);
            }
        }
        let found = describe(&filter.payload(), filter.mass_sigma());
        assert!((found.mass - 3.0).abs() < 0.02, "{found:?}");
        assert!((found.com[2] - 0.13).abs() < 0.005, "{found:?}");
        assert!(found.mass_sigma < 0.15, "{found:?}");
    }
}
