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
    let (filter, _) = after(1_000_000);
    let touched = 1;
    assert!(filter.diagonal().iter().skip(touched).all(|&d| d == 1.0));
}

#[test]
fn after_ten_million_rows_a_variance_is_still_what_the_rows_say() {
    let (filter, said) = after(10_000_000);
    let variance = f64::from(filter.diagonal().friction[0][0]);
    let error = variance * (1.0 + said) - 1.0;
    std::println!("off by {error:.1e}");
    assert!(error.abs() < 1e-5, "{error}");
}
