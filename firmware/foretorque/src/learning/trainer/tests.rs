use super::*;

const CONFIG: TrainerConfig = TrainerConfig {
    output_sigma: 0.02,
    hidden_rate: 1e-4,
    clip_sigmas: 3.0,
    memory_rows: 3333.0,
};

fn silent() -> JointNetwork {
    JointNetwork::silent(4)
}

/// Trainer of one joint, with its active network.
#[derive(Clone, Copy, PartialEq)]
struct Joint {
    trainer: NetworkTrainer<1>,
    active: JointNetwork,
}

impl Joint {
    /// Silent candidate and active network.
    fn new() -> Self {
        Self {
            trainer: NetworkTrainer::new(&[silent()]),
            active: silent(),
        }
    }

    fn train(&mut self, row: &NetworkRow) -> Option<NetworkDecision> {
        self.trainer.train(&CONFIG, 0, row, &mut self.active)
    }
}

/// Row at speeds evenly spread over ±2 rad/s, with friction outside the linear columns, and noise.
fn row(k: u32, height: f32) -> NetworkRow {
    let qd = 4.0 * (f64::from(k) * 0.618_033_988_75).fract() as f32 - 2.0;
    let word = k.wrapping_mul(0x9E37_79B9) ^ (k << 7);
    let noise = 0.017 * (word.wrapping_mul(0x85EB_CA6B) as i32) as f32 / i32::MAX as f32;
    NetworkRow {
        qd,
        residual: height * crate::math::tanh(qd * 5.0) + noise,
        sigma: 0.01,
        of_arm: true,
    }
}

#[test]
fn a_significantly_better_candidate_is_promoted_and_none_before() {
    let mut joint = Joint::new();
    let mut promoted = None;
    for k in 0..20_000 {
        let decision = joint.train(&row(k, 0.02));
        if let Some(NetworkDecision::Promoted(ratio)) = decision {
            assert!(ratio < PROMOTION_RATIO);
            promoted = promoted.or(Some(k));
        }
        assert_eq!(joint.active == silent(), promoted.is_none(), "row {k}");
    }
    // 3 σ of equal observations are nine.
    let soonest = 9 * BLOCK_ROWS - 1;
    let in_time = promoted.is_some_and(|k| (soonest..6 * soonest).contains(&k));
    assert!(in_time, "{promoted:?}");
    for qd in [-1.5, -0.1, 0.1, 1.5] {
        let output = joint.active.forward(&network_inputs(qd))[0];
        let wanted = 0.02 * crate::math::tanh(qd * 5.0);
        assert!((output - wanted).abs() < 0.003, "{output} at {qd}");
    }
}

#[test]
fn rows_of_a_payload_are_not_learnt_and_silence_a_network_that_costs() {
    let of_payload = |k, height| NetworkRow {
        of_arm: false,
        ..row(k, height)
    };
    let mut joint = Joint::new();
    for k in 0..10_000 {
        assert_eq!(joint.train(&of_payload(k, 0.02)), None, "row {k}");
    }
    let NetworkTrainer {
        candidate, filter, ..
    } = joint.trainer;
    assert_eq!(
        (candidate, filter),
        ([silent()], Joint::new().trainer.filter)
    );
    // The network helped the arm alone, and the payload turns its sign.
    let decision = (1..20_000).find_map(|k| joint.train(&row(k, 0.02)));
    assert!(matches!(decision, Some(NetworkDecision::Promoted(_))));
    let candidate = joint.trainer.candidate;
    let decision = (20_000..40_000).find_map(|k| joint.train(&of_payload(k, -0.02)));
    assert!(matches!(decision, Some(NetworkDecision::Silenced(_))));
    assert_eq!(joint.trainer.candidate, candidate);
}

#[test]
fn without_residual_no_network_is_promoted() {
    let mut joint = Joint::new();
    for k in 0..60_000 {
        assert_eq!(joint.train(&row(k, 0.0)), None);
    }
    assert_eq!(joint.active, silent());
}

#[test]
fn significance_of_all_joints_promotes_each_that_agrees() {
    // Each joint has 2.4 standard deviations, all together 5.
    let mut test = NetworkTest::NONE;
    (test.active, test.candidate, test.silent) = (1000.0, 970.0, 1000.0);
    test.advantage.total = PairedSum {
        sum: 30.0,
        squares: 150.0,
    };
    let mut trainer = NetworkTrainer::new(&[silent(); 6]);
    trainer.test = [test; 6];
    trainer.test[3].advantage.total.sum = 0.0;
    for joint in 0..6 {
        let mut fresh = trainer;
        let promoted = fresh.decide(joint, &mut silent()).is_some();
        assert_eq!(promoted, joint != 3, "joint {joint}");
    }
    let mut alone = Joint::new().trainer;
    alone.test = [test];
    assert_eq!(alone.decide(0, &mut silent()), None);
}

#[test]
fn rows_of_one_block_count_as_one_observation() {
    let (mut white, mut slow) = (BlockSum::ZERO, BlockSum::ZERO);
    for k in 0..4096u32 {
        let sign = |k: u32| {
            if k.wrapping_mul(0x9E37_79B9) >> 31 == 1 {
                1.0
            } else {
                -1.0
            }
        };
        white.add(0.1 + sign(k));
        slow.add(0.1 + sign(k / BLOCK_ROWS));
        assert_eq!(white.close_block(4000.0), slow.close_block(4000.0));
    }
    assert!(white.total.is_above(SIGNIFICANCE) && !slow.total.is_above(SIGNIFICANCE));
}

#[test]
fn a_candidate_is_not_promoted_by_motion_in_one_direction() {
    // What it learns is a constant of this direction; the linear parameters lack it here.
    let ahead = |k| NetworkRow {
        qd: row(k, 0.0).qd.abs(),
        residual: row(k, 0.0).residual + 0.02,
        ..row(k, 0.0)
    };
    let mut joint = Joint::new();
    for k in 0..10_000 {
        assert_eq!(joint.train(&ahead(k)), None);
    }
    assert_eq!(joint.active, silent());
}

#[test]
fn a_harmful_network_is_silenced_in_two_seconds() {
    let mut joint = Joint::new();
    joint.active.output_bias[0] = 0.02;
    for k in 0..HARM_ROWS {
        joint.train(&row(k, 0.0));
    }
    assert_eq!(joint.active, silent());
}

#[test]
fn a_prior_deviation_of_zero_disables_training() {
    let config = TrainerConfig {
        output_sigma: 0.0,
        ..CONFIG
    };
    let mut joint = Joint::new();
    for k in 0..5000 {
        let Joint { trainer, active } = &mut joint;
        trainer.train(&config, 0, &row(k, 0.02), active);
    }
    assert!(joint == Joint::new());
}

#[test]
fn the_hidden_layer_is_trained() {
    let mut joint = Joint::new();
    let config = TrainerConfig {
        hidden_rate: 0.01,
        ..CONFIG
    };
    for k in 0..500 {
        let Joint { trainer, active } = &mut joint;
        trainer.train(&config, 0, &row(k, 0.02), active);
    }
    let [candidate] = joint.trainer.candidate;
    assert_ne!(candidate.hidden_weights, silent().hidden_weights);
}

#[test]
fn a_row_that_is_not_finite_is_ignored() {
    let mut joint = Joint::new();
    joint.train(&row(1, 0.02));
    let before = joint;
    for bad in [f32::NAN, f32::INFINITY] {
        let broken = [
            NetworkRow {
                residual: bad,
                ..row(2, 0.0)
            },
            NetworkRow {
                qd: bad,
                ..row(2, 0.0)
            },
            NetworkRow {
                sigma: 1.0 / bad,
                ..row(2, 0.0)
            },
        ];
        for row in broken {
            joint.train(&row);
            assert!(joint == before);
        }
    }
}
