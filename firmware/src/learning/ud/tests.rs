use super::*;

/// Takes in `rows` rows of joint 0, with its first friction column alone, and noise that changes from row to row.
/// Returns the filter and the sum of what the rows say, `Σ φ²/R`.
fn after(rows: u32) -> (UdFilter<2, 1>, f64) {
    let mut filter = UdFilter::new();
    let mut phi = Stacked::filled(0.0);
    let mut gain = Stacked::filled(0.0);
    let mut said = 0.0;
    for row in 0..rows {
        let weight = 0.5 + 0.01 * (row % 97) as f32;
        let variance = 0.7 + 0.013 * (row % 89) as f32;
        phi.friction[0][0] = weight;
        filter.update(0, &phi, variance, &mut gain);
        said += f64::from(weight).powi(2) / f64::from(variance);
    }
    (filter, said)
}

#[test]
fn what_no_row_touches_stays_as_uncertain_as_it_was() {
    let (filter, _) = after(100_000);
    let touched = 1;
    assert!(filter.diagonal().iter().skip(touched).all(|&d| d == 1.0));
}

#[test]
fn after_many_rows_a_variance_is_what_they_say() {
    for (rows, limit) in [(10_000, 1e-6), (1_000_000, 1e-5), (10_000_000, 5e-3)] {
        let (filter, said) = after(rows);
        let variance = f64::from(filter.diagonal().friction[0][0]);
        let error = variance * (1.0 + said) - 1.0;
        std::println!("{rows} rows: off by {error:.1e}");
        assert!(error.abs() < limit, "{rows} rows: {error}");
    }
}

#[test]
fn a_row_of_any_size_leaves_the_diagonal_positive() {
    for size in [1e-12, 1e-3, 1.0, 1e3, 1e6, 1e9, 1e12] {
        let mut filter = UdFilter::<2, 1>::new();
        let (mut gain, mut random) = (Stacked::filled(0.0), 1u32);
        for _ in 0..1000 {
            let mut phi = Stacked::filled(0.0);
            for phi in phi.friction[0].iter_mut().chain(&mut phi.rigid) {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *phi = size * (random >> 8) as f32 / (1 << 23) as f32;
            }
            filter.update(0, &phi, 0.02, &mut gain);
            assert!(filter.diagonal().iter().all(|&d| d > 0.0), "{size}");
        }
    }
}
