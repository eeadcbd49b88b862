use super::*;

#[test]
fn the_gradient_agrees_with_central_differences() {
    let robot = Robot::load("ur5").expect("built in");
    for criterion in [
        Criterion::Condition,
        Criterion::DOptimal,
        Criterion::VOptimal,
        Criterion::Constrained,
    ] {
        let config = SearchConfig {
            criterion,
            starts: 1,
            ..SearchConfig::default()
        };
        let search = Search::<6>::new(&robot, &config).expect("six joints");
        let start = search.starts().expect("feasible").remove(0);
        // Beyond the limits, so that every penalty takes part.
        let start: Vec<f64> = start.iter().map(|x| 1.3 * x).collect();
        let penalties = search.penalties(10.0, 0.0);
        let mut gradient = vec![0.0; start.len()];
        search
            .objective
            .value(&start, &penalties, Some(&mut gradient));
        let size = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        for v in 0..start.len() {
            let h = 1e-5;
            let at = |step: f64| {
                let mut moved = start.clone();
                moved[v] += step;
                search.objective.value(&moved, &penalties, None)
            };
            let expected = (at(h) - at(-h)) / (2.0 * h);
            assert!(
                (gradient[v] - expected).abs() < 1e-4 * size,
                "{criterion:?}, variable {v}: {} {expected}",
                gradient[v]
            );
        }
    }
}
