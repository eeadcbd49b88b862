use super::*;

const CONFIG: TrainerConfig = TrainerConfig {
    output_sigma: 0.02,
    hidden_rate: 1e-4,
    clip_sigmas: 3.0,
};

fn silent() -> [JointNetwork; 1] {
    [JointNetwork::silent(4)]
}

/// Speeds that visit ±2 rad/s evenly in a mixed order, a friction the linear columns do not know, and noise.
fn row(k: u32, height: f32) -> NetworkRow {
    let qd = 4.0 * (f64::from(k) * 0.618_033_988_75).fract() as f32 - 2.0;
    let word = k.wrapping_mul(0x9E37_79B9) ^ (k << 7);
    let noise = 0.017 * (word.wrapping_mul(0x85EB_CA6B) as i32) as f32 / i32::MAX as f32;
    NetworkRow {
        qd,
        residual: height * crate::math::tanh(qd * 5.0) + noise,
        sigma: 0.01,
    }
}

#[test]
fn a_network_that_explains_unseen_rows_is_believed_and_nothing_is_before_it_is_proven() {
    let [mut active] = silent();
    let mut trainer = NetworkTrainer::new(&[active]);
    let mut believed = None;
    for k in 0..20_000 {
        let verdict = trainer.train(&CONFIG, 0, &row(k, 0.02), &mut active);
        if let Some(NetworkVerdict::Promoted(ratio)) = verdict {
            assert!(ratio < PROMOTION_RATIO);
            believed = believed.or(Some(k));
        }
        assert_eq!(active == silent()[0], believed.is_none(), "row {k}");
    }
    assert!(
        believed.is_some_and(|k| (PROOF_ROWS - 1..2 * PROOF_ROWS).contains(&k)),
        "{believed:?}"
    );
    for qd in [-1.5, -0.1, 0.1, 1.5] {
        let said = active.forward(&network_inputs(qd))[0];
        let wanted = 0.02 * crate::math::tanh(qd * 5.0);
        assert!((said - wanted).abs() < 0.003, "{said} at {qd}");
    }
}

#[test]
fn where_the_linear_parameters_explain_everything_no_network_is_believed() {
    let [mut active] = silent();
    let mut trainer = NetworkTrainer::new(&[active]);
    for k in 0..60_000 {
        assert_eq!(trainer.train(&CONFIG, 0, &row(k, 0.0), &mut active), None);
    }
    assert_eq!(active, silent()[0]);
}

#[test]
fn what_is_plain_in_all_joints_is_believed_of_each_that_does_not_speak_against_it() {
    // Half of a standard deviation of each joint's own, where all together are six.
    let mut record = Record::NONE;
    record.rows = PROOF_ROWS;
    (record.active, record.trainee, record.silent) = (1000.0, 970.0, 1000.0);
    (record.advantage.sum, record.advantage.scatter) = (30.0, 150.0);
    let mut trainer = NetworkTrainer::new(&[silent()[0]; 6]);
    trainer.record = [record; 6];
    trainer.record[3].advantage.sum = 0.0;
    for joint in 0..6 {
        let mut active = silent()[0];
        let mut fresh = trainer;
        let believed = fresh.judge(joint, &mut active).is_some();
        assert_eq!(believed, joint != 3, "joint {joint}");
    }
    let mut alone = NetworkTrainer::new(&silent());
    alone.record = [record];
    assert_eq!(alone.judge(0, &mut silent()[0]), None);
}

#[test]
fn what_is_left_for_tenths_of_a_second_is_one_piece_of_news() {
    let (mut white, mut slow) = (Difference::NONE, Difference::NONE);
    for k in 0..4096u32 {
        let sign = |k: u32| {
            if k.wrapping_mul(0x9E37_79B9) >> 31 == 1 {
                1.0
            } else {
                -1.0
            }
        };
        white.block += 0.1 + sign(k);
        slow.block += 0.1 + sign(k / BLOCK_ROWS);
        if k % BLOCK_ROWS == BLOCK_ROWS - 1 {
            white.close_block();
            slow.close_block();
        }
    }
    assert!(white.proves(SIGNIFICANCE) && !slow.proves(SIGNIFICANCE));
}

#[test]
fn a_network_that_harms_is_silenced_in_two_seconds() {
    let [mut active] = silent();
    active.output_bias[0] = 0.02;
    let mut trainer = NetworkTrainer::new(&silent());
    for k in 0..HARM_ROWS {
        trainer.train(&CONFIG, 0, &row(k, 0.0), &mut active);
    }
    assert_eq!(active, silent()[0]);
}

#[test]
fn without_doubt_about_the_output_layer_nothing_is_trained() {
    let config = TrainerConfig {
        output_sigma: 0.0,
        ..CONFIG
    };
    let [mut active] = silent();
    let mut trainer = NetworkTrainer::new(&silent());
    let before = trainer;
    for k in 0..5000 {
        trainer.train(&config, 0, &row(k, 0.02), &mut active);
    }
    assert!(trainer == before && active == silent()[0]);
}

#[test]
fn the_hidden_layer_goes_down_the_gradient() {
    let mut trainer = NetworkTrainer::new(&silent());
    let config = TrainerConfig {
        hidden_rate: 0.01,
        ..CONFIG
    };
    let [mut active] = silent();
    for k in 0..500 {
        trainer.train(&config, 0, &row(k, 0.02), &mut active);
    }
    assert_ne!(
        trainer.trainee[0].hidden_weights,
        silent()[0].hidden_weights
    );
}

#[test]
fn what_is_not_finite_teaches_nothing() {
    let [mut active] = silent();
    let mut trainer = NetworkTrainer::new(&[active]);
    trainer.train(&CONFIG, 0, &row(1, 0.02), &mut active);
    let before = trainer;
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
            trainer.train(&CONFIG, 0, &row, &mut active);
            assert!(trainer == before);
        }
    }
}
