//! Mass distributions of links: checks, conversions, lumping, seeded perturbation.

use super::{LINK_PARAMETERS, Link, Placement, Robot};
use nalgebra::{Matrix3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

impl Link {
    /// Defect of an inertia tensor (kg·m², about the centre of mass) that no body has; `None` for a possible one.
    ///
    /// The principal moments of a body are positive, and none exceeds the sum of the others.
    pub fn inertia_problem(inertia: &Matrix3<f64>) -> Option<&'static str> {
        let moments = inertia.symmetric_eigenvalues();
        // Rounded data-sheet figures may miss the inequality in their last digit.
        let triangle = 2.0 * moments.max() <= moments.sum() * (1.0 + 1e-6);
        if moments.min() <= 0.0 {
            Some("is not positive definite")
        } else if !triangle {
            Some("breaks the triangle inequality: no body has these principal moments")
        } else {
            None
        }
    }

    /// The link with the nearest inertia that a body has, and the largest change of an entry, kg·m².
    ///
    /// Second moments of mass below a thousandth of the largest become that: the nearest in the Frobenius norm that keeps
    /// a margin.
    pub fn repaired(&self) -> (Self, f64) {
        let mut moments = self.second_moments().symmetric_eigen();
        let least = (1e-3 * moments.eigenvalues.max()).max(1e-9);
        moments
            .eigenvalues
            .apply(|moment| *moment = moment.max(least));
        let moments = moments.recompose();
        let inertia_com = moments.trace() * Matrix3::identity() - moments;
        let change = (inertia_com - self.inertia_com).amax();
        (
            Self {
                inertia_com,
                ..*self
            },
            change,
        )
    }

    /// A rod of `mass`, kg, and 5 cm radius from the origin to `end`, m.
    pub fn rod(mass: f64, end: &Vector3<f64>) -> Self {
        const RADIUS_SQUARED: f64 = 0.0025;
        let along = end * end.transpose() / 12.0 + Matrix3::identity() * (RADIUS_SQUARED / 4.0);
        Self {
            mass,
            com: 0.5 * end,
            inertia_com: mass * (along.trace() * Matrix3::identity() - along),
        }
    }

    /// The link with these standard parameters (eq. 14), the inverse of [`Link::standard_parameters`].
    ///
    /// Assumes: a positive mass.
    pub fn from_standard_parameters(x: &[f64; LINK_PARAMETERS]) -> Self {
        let [mass, mx, my, mz, xx, yy, zz, xy, xz, yz] = *x;
        let com = Vector3::new(mx, my, mz) / mass;
        let about_origin = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let apart = com.dot(&com) * Matrix3::identity() - com * com.transpose();
        Self {
            mass,
            com,
            inertia_com: about_origin - mass * apart,
        }
    }

    /// This link, given in a frame that lies at `frame`, in the parent of that frame.
    pub fn placed(&self, frame: &Placement) -> Self {
        let rot = frame.rot_parent_child;
        Self {
            mass: self.mass,
            com: frame.origin + rot * self.com,
            inertia_com: rot * self.inertia_com * rot.transpose(),
        }
    }

    /// One link for several that move as one body, all in the same frame; `None` when there are none.
    ///
    /// Parallel axes: `I = Σ I_k + m_k (d·d 1 − d dᵀ)`, d from the common centre of mass to that of part k.
    pub fn lumped(parts: &[Self]) -> Option<Self> {
        if let [single] = parts {
            return Some(*single);
        }
        let mass: f64 = parts.iter().map(|part| part.mass).sum();
        let com = parts
            .iter()
            .map(|part| part.com * part.mass)
            .sum::<Vector3<f64>>()
            / mass;
        let about_com = |part: &Self| {
            let d = part.com - com;
            part.inertia_com + part.mass * (d.dot(&d) * Matrix3::identity() - d * d.transpose())
        };
        (!parts.is_empty()).then(|| Self {
            mass,
            com,
            inertia_com: parts.iter().map(about_com).sum(),
        })
    }
}

/// Distance of a robot from its description.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Perturbation {
    /// Largest relative change of masses, centres of mass and inertias.
    pub inertial: f64,
    /// Factor on every rotor inertia.
    pub rotor: f64,
    /// Factor on viscous and Coulomb friction.
    pub friction: f64,
    /// Keep the Stribeck peak and the cogging torque.
    pub rich_friction: bool,
}

impl Perturbation {
    /// The plant for acceptance: ±20 % on the inertial parameters, everything else as described.
    pub const PLANT: Self = Self {
        inertial: 0.2,
        rotor: 1.0,
        friction: 1.0,
        rich_friction: true,
    };

    /// The wrong prior, relative to the plant: inertial parameters 20 % off, rotor inertia −20 %, viscous and Coulomb
    /// friction −40 %, no Stribeck peak, no cogging.
    pub const WRONG_PRIOR: Self = Self {
        inertial: 0.2,
        rotor: 0.8,
        friction: 0.6,
        rich_friction: false,
    };
}

impl Robot {
    /// This robot with its mass distribution and friction varied; the same seed gives the same robot.
    ///
    /// Every link stays a possible body. The plant for acceptance is `robot.perturbed(seed, &Perturbation::PLANT)`, the
    /// wrong prior is that plant perturbed again by [`Perturbation::WRONG_PRIOR`] with another seed.
    pub fn perturbed(&self, seed: u64, spec: &Perturbation) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut robot = self.clone();
        for joint in &mut robot.joints {
            joint.link = perturbed_link(&joint.link, spec.inertial, &mut random);
            joint.drive.rotor_inertia *= spec.rotor;
            joint.friction.viscous *= spec.friction;
            joint.friction.coulomb *= spec.friction;
            if !spec.rich_friction {
                joint.friction.stribeck_ratio = 0.0;
                joint.friction.cogging = 0.0;
            }
        }
        robot
    }
}

/// Acceleration of an unloaded rotor at the torque limit, rad/s²: geared drives of arms lie between 70 and 300.
const ROTOR_ACCELERATION_RAD_S2: f64 = 200.0;

impl Robot {
    /// This robot with a rotor at every joint, and the joints (from 1) at which the description gives none: there it is the
    /// torque limit over 200 rad/s². A drive without a rotor cannot be controlled at 1 kHz.
    pub fn with_assumed_rotors(&self) -> (Self, Vec<usize>) {
        let (mut robot, mut assumed) = (self.clone(), Vec::new());
        for (j, joint) in robot.joints.iter_mut().enumerate() {
            if joint.drive.rotor_inertia <= 0.0 {
                joint.drive.rotor_inertia = joint.limits.torque / ROTOR_ACCELERATION_RAD_S2;
                assumed.push(j + 1);
            }
        }
        (robot, assumed)
    }
}

/// Mass and centre of mass move by up to `size` of themselves (the centre by up to `size` of its distance, in any
/// direction). The second moments S of the mass become `A S Aᵀ` with `A = 1 + size/2 · noise`: S stays positive
/// semi-definite, so the link stays a body, its moments move by about `size`, and off-diagonal entries appear.
fn perturbed_link(link: &Link, size: f64, random: &mut ChaCha8Rng) -> Link {
    let mass = link.mass * (1.0 + size * symmetric(random));
    let direction = Vector3::from_fn(|_, _| symmetric(random));
    let com = link.com + direction * (size * link.com.norm() / 3.0_f64.sqrt());
    let shape = Matrix3::from_fn(|row, col| {
        f64::from(u8::from(row == col)) + 0.5 * size * symmetric(random)
    });
    let moments = shape * link.second_moments() * shape.transpose();
    Link {
        mass,
        com,
        inertia_com: moments.trace() * Matrix3::identity() - moments,
    }
}

/// Uniform in −1 … 1.
fn symmetric(random: &mut ChaCha8Rng) -> f64 {
    random.random_range(-1.0..=1.0)
}
