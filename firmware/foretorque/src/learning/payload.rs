use super::dense_ud::DenseUdFilter;
use super::prior_covariance::{self, GRAVITY};
use super::quality::PayloadEstimate;
use crate::arm::{Arm, ArmModel, LINK_PARAMETERS, table};
use crate::dynamics::BaseParameters;
use crate::math::sqrt;

/// Number of estimated payload parameters: m, m·x, m·y, m·z, Ixx, Iyy, Izz, the first standard parameters of eq. 14.
pub(super) const PAYLOAD_PARAMETERS: usize = 7;

/// Payload: standard parameters of a rigid body about the origin of the last link's frame, expressed in that frame.
pub(super) type Payload = [f32; PAYLOAD_PARAMETERS];

pub(super) const NO_PAYLOAD: Payload = [0.0; PAYLOAD_PARAMETERS];

/// Largest distance of a payload's centre of mass from the origin of the last link, share of the stretched arm.
const COM_PART: f32 = 0.4;
/// Least value of that distance, m. The flange of an arm that reaches 1 m is up to 0.1 m from that origin, and a gripper with its
/// body reaches 0.25 m further.
const LEAST_COM_DISTANCE: f32 = 0.5;
/// Distance of the rated payload's centre of mass from that origin, m.
pub const RATED_COM_DISTANCE: f32 = 0.25;
/// Weight of the rated payload at full stretch, in units of the torque limit.
///
/// Descriptions do not contain the rated payload. A third gives 5.0 kg for the UR5 (data sheet: 5 kg) and 3.3 kg for the
/// Panda (3 kg).
const RATED_TORQUE: f32 = 1.0 / 3.0;

/// Largest part of a torque limit for a payload.
pub const PAYLOAD_PART: f32 = 0.85;

/// Distance from joint `joint` to the origin of the last link with all links between in one line, m.
const fn stretch<const N: usize, const P: usize>(arm: &ArmModel<N, P>, joint: usize) -> f32 {
    let mut length = 0.0;
    let mut later = joint + 1;
    while later < N {
        let [x, y, z] = arm.placements[later].origin;
        length += prior_covariance::sqrt(x * x + y * y + z * z);
        later += 1;
    }
    length
}

/// Largest distance of a payload's centre of mass from the origin of the last link, m.
pub(super) fn max_com_distance<A: Arm<N, P>, const N: usize, const P: usize>() -> f32 {
    table!(A, com_distance)
}

const fn com_distance<const N: usize, const P: usize>(arm: &ArmModel<N, P>) -> f32 {
    let part = COM_PART * stretch(arm, 0);
    if part > LEAST_COM_DISTANCE {
        part
    } else {
        LEAST_COM_DISTANCE
    }
}

/// Rated payload of an arm, kg: the mass whose weight at full stretch takes a third of the torque limit of the weakest
/// joint. The first joint has a lever of 0.25 m at least, also as the only one.
pub fn rated_payload<A: Arm<N, P>, const N: usize, const P: usize>() -> f32 {
    table!(A, rated_mass)
}

const fn rated_mass<const N: usize, const P: usize>(arm: &ArmModel<N, P>) -> f32 {
    let mut least = RATED_TORQUE * arm.limits[0].torque / (GRAVITY * RATED_COM_DISTANCE);
    let mut joint = 0;
    while joint + 1 < N {
        let lever = stretch(arm, joint);
        let mass = RATED_TORQUE * arm.limits[joint].torque / (GRAVITY * lever);
        if mass < least {
            least = mass;
        }
        joint += 1;
    }
    least
}

/// Bound of the payload torque of each joint, N·m: twice the weight of the rated payload at full stretch, for weight and
/// acceleration, and at most 85 % of the limit.
pub fn payload_bound<A: Arm<N, P>, const N: usize, const P: usize>() -> [f32; N] {
    table!(A, torque_bound)
}

const fn torque_bound<const N: usize, const P: usize>(arm: &ArmModel<N, P>) -> [f32; N] {
    let mass = rated_mass(arm);
    let mut bound = [0.0; N];
    let mut joint = 0;
    while joint < N {
        let lever = stretch(arm, joint) + RATED_COM_DISTANCE;
        let torque = 2.0 * GRAVITY * mass * lever;
        let most = PAYLOAD_PART * arm.limits[joint].torque;
        bound[joint] = if torque < most { torque } else { most };
        joint += 1;
    }
    bound
}

/// Prior standard deviations of a payload of up to `mass`, kg: centre of mass and radius of gyration within 0.15 m of the
/// last link's origin.
pub(super) const fn payload_sigma(mass: f32) -> Payload {
    let (first, second) = (0.15 * mass, 0.0225 * mass);
    [mass, first, first, first, second, second, second]
}

/// Entries of the arm's base map for a body at the last link: base parameter, payload parameter, weight.
fn terms<A: Arm<N, P>, const N: usize, const P: usize>() -> impl Iterator<Item = (usize, usize, f32)>
{
    A::base_map().iter().filter_map(|term| {
        let number = term.standard.checked_sub(LINK_PARAMETERS * (N - 1))?;
        (number < PAYLOAD_PARAMETERS).then_some((term.base, number, term.weight))
    })
}

/// Base parameters of `payload`, to be added to those of the arm.
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

/// Torque row of a payload, N·m for each unit of each parameter, from the regressor row `rigid` of a joint.
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

/// Filter of the payload parameters, driven by the residual torques of the arm without payload.
///
/// It is separate from the estimate of the arm, so that removing a payload is exact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PayloadFilter {
    filter: DenseUdFilter<PAYLOAD_PARAMETERS>,
    sigma: Payload,
}

impl PayloadFilter {
    /// Estimate `payload` with standard deviations `sigma`.
    pub(super) const fn new(payload: &Payload, sigma: &Payload) -> Self {
        let mut theta = *payload;
        let mut k = 0;
        while k < PAYLOAD_PARAMETERS {
            theta[k] /= sigma[k];
            k += 1;
        }
        Self {
            filter: DenseUdFilter::new(theta),
            sigma: *sigma,
        }
    }

    /// Residual of the torque `tau` with row `row`, N·m.
    pub(super) fn residual(&self, row: &Payload, tau: f32) -> f32 {
        self.filter.residual(&self.scaled(row), tau)
    }

    /// Update with the torque `tau` of standard deviation `sigma`, N·m.
    ///
    /// * returns the square of the innovation over its expected one
    pub(super) fn update(&mut self, row: &Payload, tau: f32, sigma: f32) -> f32 {
        let inverse = 1.0 / sigma;
        let phi = self.scaled(row).map(|x| x * inverse);
        let innovation = self.filter.residual(&phi, tau * inverse);
        innovation * innovation / self.filter.update(&phi, tau * inverse, 1.0)
    }

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

/// Mass and centre of mass of `payload`, for reports.
pub(super) fn payload_estimate(payload: &Payload, mass_sigma: f32) -> PayloadEstimate {
    let [mass, x, y, z, ..] = *payload;
    let inverse = if mass > 0.0 { 1.0 / mass } else { 0.0 };
    PayloadEstimate {
        mass,
        com: [x, y, z].map(|first| first * inverse),
        mass_sigma,
    }
}

/// Torque of `payload` with the row `row`, N·m.
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
    use crate::arm::panda::{self, Panda};
    use crate::arm::ur5::{JOINTS as N, PARAMETERS as P, Ur5};
    use crate::arm::{BaseIndex, LinkInertia, base_parameters};
    use crate::dynamics::{regressor_row, rnea};
    use crate::joint::JointMotion;
    use crate::sines;

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

    fn motion(t: f64) -> JointMotion<N> {
        sines(t, |j| [1.0, 1.0 + 0.1 * j as f64, j as f64])
    }

    #[test]
    fn a_payload_is_a_change_of_the_last_link() {
        let mut links = [LinkInertia::NONE; N];
        links[N - 1] = body();
        let mut whole = base_parameters::<Ur5, N, P>(&links, &[0.0; N]);
        // Products of inertia are no payload parameters.
        let standard = body().standard_parameters();
        for term in Ur5::BASE_MAP {
            if let 57..60 = term.standard {
                whole[term.base] -= term.weight * standard[term.standard - 50];
            }
        }
        let beta = payload_base::<Ur5, N, P>(&numbers());
        assert!((beta - whole).amax() < 1e-6, "{beta} {whole}");
        for joint in 0..N {
            let motion = motion(joint as f64);
            let tau = rnea::<Ur5, N, P>(&beta, &motion)[joint];
            let row = regressor_row::<Ur5, N, P>(joint, &motion).data.0[0];
            let row = payload_row::<Ur5, N, P>(&row);
            assert!((payload_torque(&numbers(), &row) - tau).abs() < 1e-4);
        }
    }

    #[test]
    fn a_payload_is_found_within_a_second_of_motion() {
        let truth = payload_base::<Ur5, N, P>(&numbers());
        let mut filter = PayloadFilter::new(&[0.0; PAYLOAD_PARAMETERS], &payload_sigma(6.0));
        assert!((filter.mass_sigma() - 6.0).abs() < 1e-3);
        for slice in 0..100 {
            let motion = motion(0.01 * f64::from(slice));
            let tau = rnea::<Ur5, N, P>(&truth, &motion);
            for joint in 0..N {
                let row = regressor_row::<Ur5, N, P>(joint, &motion).data.0[0];
                let row = payload_row::<Ur5, N, P>(&row);
                filter.update(&row, tau[joint], 0.02 * Ur5::LIMITS[joint].torque);
            }
        }
        let found = payload_estimate(&filter.payload(), filter.mass_sigma());
        assert!((found.mass - 3.0).abs() < 0.02, "{found:?}");
        assert!((found.com[2] - 0.13).abs() < 0.005, "{found:?}");
        assert!(found.mass_sigma < 0.15, "{found:?}");
    }

    #[test]
    fn the_rated_payload_is_near_that_of_the_data_sheets() {
        let ur5 = rated_payload::<Ur5, N, P>();
        let panda = rated_payload::<Panda, { panda::JOINTS }, { panda::PARAMETERS }>();
        assert!((ur5 - 5.0).abs() < 0.3, "{ur5}");
        assert!((panda - 3.0).abs() < 0.5, "{panda}");
    }

    #[test]
    fn a_long_arm_carries_its_payload_further_from_its_last_link() {
        let short = Ur5::model();
        let mut placements = short.placements;
        placements[2].origin[0] -= 2.0;
        let arm = ArmModel {
            placements,
            ..*short
        };
        let (stretched, longer) = (stretch(short, 0), stretch(&arm, 0));
        assert!(longer > stretched + 1.9, "{longer}");
        assert_eq!(com_distance(&arm), COM_PART * longer);
    }

    #[test]
    fn a_single_joint_carries_its_payload_at_its_largest_distance() {
        let arm = Ur5::model();
        let columns = [arm.columns[5]];
        let single = ArmModel::<1, P> {
            name: "single",
            gravity: arm.gravity,
            placements: [arm.placements[5]],
            columns,
            index: BaseIndex::of(&columns),
            base_map: &[],
            limits: [arm.limits[5]],
            cogging_cycles: [0.0],
            encoder_step: arm.encoder_step,
            nominal: arm.nominal,
            links: [arm.links[5]],
            rotors: [arm.rotors[5]],
        };
        let [limit, weight] = [single.limits[0].torque, 9.81 * rated_mass(&single)];
        assert!((weight * 0.25 - limit / 3.0).abs() < 1e-3, "{weight}");
        assert!(torque_bound(&single)[0] < 0.7 * limit);
        assert_eq!([com_distance(&single), com_distance(arm)], [0.5; 2]);
    }

    #[test]
    fn the_payload_bound_lies_between_weight_and_torque_limit() {
        let bound = payload_bound::<Ur5, N, P>();
        let weight = 5.0 * 9.81 * (1.0 + 0.13);
        assert!(bound[1] > weight, "{bound:?}");
        for (bound, limits) in bound.iter().zip(&Ur5::LIMITS) {
            assert!(*bound <= 0.85 * limits.torque);
        }
    }
}
