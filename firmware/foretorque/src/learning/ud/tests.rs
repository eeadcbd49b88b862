use super::*;

/// Filter after `rows` rows with the first friction column of joint 0 alone and varying noise, and its information
/// `Σ φ²/R`.
fn after(rows: u32) -> (UdFilter<2, 1>, f64) {
    let mut filter = UdFilter::new();
    let mut phi = LinearParameters::filled(0.0);
    let mut gain = LinearParameters::filled(0.0);
    let mut information = 0.0;
    for row in 0..rows {
        let weight = 0.5 + 0.01 * (row % 97) as f32;
        let variance = 0.7 + 0.013 * (row % 89) as f32;
        phi.friction[0][0] = weight;
        filter.update(0, &phi, variance, &mut gain);
        information += f64::from(weight).powi(2) / f64::from(variance);
    }
    (filter, information)
}

#[test]
fn parameters_outside_all_rows_keep_their_variance() {
    let (filter, _) = after(100_000);
    let touched = 1;
    assert!(filter.diagonal().iter().skip(touched).all(|&d| d == 1.0));
}

#[test]
fn after_many_rows_the_variance_is_exact() {
    for (rows, limit) in [(10_000, 1e-6), (1_000_000, 1e-5), (10_000_000, 5e-3)] {
        let (filter, information) = after(rows);
        let variance = f64::from(filter.diagonal().friction[0][0]);
        let error = variance * (1.0 + information) - 1.0;
        std::println!("{rows} rows: off by {error:.1e}");
        assert!(error.abs() < limit, "{rows} rows: {error}");
    }
}

#[test]
fn a_row_of_any_size_leaves_the_diagonal_positive() {
    for size in [1e-12, 1e-3, 1.0, 1e3, 1e6, 1e9, 1e12] {
        let mut filter = UdFilter::<2, 1>::new();
        let (mut gain, mut random) = (LinearParameters::filled(0.0), 1u32);
        for _ in 0..1000 {
            let mut phi = LinearParameters::filled(0.0);
            for phi in phi.friction[0].iter_mut().chain(&mut phi.rigid) {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *phi = size * (random >> 8) as f32 / (1 << 23) as f32;
            }
            filter.update(0, &phi, 0.02, &mut gain);
            assert!(filter.diagonal().iter().all(|&d| d > 0.0), "{size}");
        }
    }
}

/// Factors in f64, updated by columns as by Bierman: rows of U, and D.
struct Wide<const P: usize> {
    u: [[f64; P]; P],
    d: [f64; P],
}

impl<const P: usize> Wide<P> {
    fn new() -> Self {
        let unit = |i| core::array::from_fn(|j| f64::from(u8::from(i == j)));
        Self {
            u: core::array::from_fn(unit),
            d: [1.0; P],
        }
    }

    fn update(&mut self, phi: &[f32; P], variance: f64) {
        let f: [f64; P] =
            core::array::from_fn(|j| (0..=j).map(|i| self.u[i][j] * f64::from(phi[i])).sum());
        let mut b = [0.0; P];
        let mut alpha = variance;
        for j in 0..P {
            let v = self.d[j] * f[j];
            let lambda = -f[j] / alpha;
            let before = alpha;
            alpha += v * f[j];
            self.d[j] *= before / alpha;
            for (row, b) in self.u.iter_mut().zip(&mut b).take(j) {
                let u = row[j];
                row[j] += lambda * *b;
                *b += v * u;
            }
            b[j] = v;
        }
    }
}

#[test]
fn a_million_rows_do_not_degrade_the_correlations() {
    const P: usize = 12;
    let (mut filter, mut wide) = (UdFilter::<1, P>::new(), Wide::<P>::new());
    let (mut gain, mut random) = (LinearParameters::filled(0.0), 1u32);
    for _ in 0..1_000_000 {
        let mut phi = LinearParameters::<1, P>::filled(0.0);
        for phi in &mut phi.rigid {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *phi = 0.5 + (random >> 8) as f32 / (1 << 24) as f32;
        }
        filter.update(0, &phi, 5.0, &mut gain);
        wide.update(&phi.rigid, 5.0);
    }
    let mut worst = 0.0_f64;
    for (block, (row, exact)) in filter.rigid.iter().zip(&wide.u).enumerate() {
        // Diagonal blocks are not compensated.
        for j in (block / ROWS + 1) * ROWS..P {
            worst = worst.max((f64::from(row[j]) - exact[j]).abs());
        }
    }
    std::println!("off by {worst:.1e}");
    assert!(worst < 3e-6, "{worst}");
}
