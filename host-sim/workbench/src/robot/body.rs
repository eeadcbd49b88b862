//! Mass distributions: which ones exist, and how several become one.

use super::{LINK_PARAMETERS, Link, Placement};
use nalgebra::{Matrix3, Vector3};

impl Link {
    /// The reason why no body has this inertia tensor (kg·m², about the centre of mass), if so.
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
