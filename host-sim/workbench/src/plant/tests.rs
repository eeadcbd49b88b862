//! The arm against energy balance, finer steps, closed forms of gears, and the statistics of its sensors.

use super::*;
use crate::trajectory::Trajectory;
use std::f64::consts::TAU;

fn quiet(step_rate_hz: f64) -> PlantConfig {
    PlantConfig {
        step_rate_hz,
        torque_noise: 0.0,
        viscous_drift: 0.0,
        ..PlantConfig::default()
    }
}

fn truth() -> Robot {
    let ur5 = Robot::load("ur5").expect("built in");
    ur5.perturbed(1)
}

fn without_friction(joint: &mut crate::robot::Joint) {
    let friction = &mut joint.friction;
    (friction.viscous, friction.coulomb, friction.cogging) = (0.0, 0.0, 0.0);
}

/// Plays the torques of the validation path, open loop, for one second.
fn played(step_rate_hz: f64) -> Plant<6> {
    let robot = truth();
    let path = Trajectory::<6>::validation(&robot, 5);
    let mut plant = Plant::new(&robot, quiet(step_rate_hz), 1).expect("six joints");
    plant.place(&path.at(0.0).q);
    for k in 0..1000 {
        let tau = plant.true_torque(&path.at((f64::from(k) + 0.5) * 1e-3));
        plant.advance(&tau, 1e-3);
    }
    plant
}

#[test]
fn the_true_torque_makes_the_motion_and_a_step_at_8_khz_is_within_a_milliradian_of_a_finer_one() {
    let plant = played(8000.0);
    let path = Trajectory::<6>::validation(&truth(), 5);
    let error = (plant.q() - path.at(1.0).q).amax();
    assert!(error < 5e-3, "{error} rad after one second of open loop");
    let fine = played(128_000.0);
    let coarse = (plant.q() - fine.q()).amax();
    let halved = (played(16_000.0).q() - fine.q()).amax();
    assert!(coarse < 1e-3, "{coarse} rad after one second");
    // First order: 15/128 of the error is left out by comparing with 128 kHz, hence 7/15 instead of 1/2.
    let ratio = halved / coarse;
    assert!((ratio - 7.0 / 15.0).abs() < 0.1, "{ratio}");
}

#[test]
fn energy_is_kept_without_friction_and_torque() {
    let mut robot = truth();
    robot.joints.iter_mut().for_each(without_friction);
    let mut plant = Plant::<6>::new(&robot, quiet(64_000.0), 1).expect("six joints");
    plant.place(&Joints::repeat(0.4));
    let energy = |plant: &Plant<6>| plant.model.energy(&plant.q, &plant.qd);
    let start = energy(&plant);
    let kinetic = |plant: &Plant<6>| {
        (plant.qd.transpose() * plant.model.mass_matrix(&plant.q) * plant.qd)[0] / 2.0
    };
    for _ in 0..1000 {
        plant.advance(&Joints::zeros(), 1e-3);
    }
    let fallen = kinetic(&plant);
    assert!(fallen > 1.0, "the arm falls: {fallen} J");
    let lost = (energy(&plant) - start).abs() / fallen;
    assert!(lost < 5e-3, "{lost} of the kinetic energy");
}

#[test]
fn friction_and_work_balance_the_energy() {
    let robot = truth();
    let mut plant = Plant::<6>::new(&robot, quiet(64_000.0), 1).expect("six joints");
    plant.place(&Joints::repeat(-0.6));
    let start = plant.model.energy(&plant.q, &plant.qd);
    let resisted = |plant: &Plant<6>| {
        let (friction, zero) = (&plant.friction, Joints::zeros());
        friction.torque_and_slope(&plant.q, &plant.qd, &zero, 0.0).0
    };
    let mut work = 0.0;
    for k in 0..1000 {
        let tau = Joints::from_fn(|j, _| 20.0 * (f64::from(k) * 6e-3 + j as f64).sin());
        let (before, friction) = (plant.qd, resisted(&plant));
        plant.advance(&tau, 1e-3);
        let after = resisted(&plant);
        let mean = (before + plant.qd) * 0.5;
        work += 1e-3 * mean.dot(&(tau - (friction + after) * 0.5));
    }
    let change = plant.model.energy(&plant.q, &plant.qd) - start;
    let balanced = (change - work).abs() < 0.02 * change.abs().max(1.0);
    assert!(balanced, "{change} J, {work} J");
}

#[test]
fn sensors_round_to_counts_and_carry_one_percent_of_noise() {
    let robot = truth();
    let mut plant = Plant::<6>::new(&robot, PlantConfig::default(), 3).expect("six joints");
    plant.place(&Joints::repeat(0.123_456));
    let count = TAU / 131_072.0;
    let mut spread = Joints::<6>::zeros();
    for _ in 0..4000 {
        let seen = plant.measure();
        for j in 0..6 {
            let counts = seen.q[j] / count;
            assert!((counts - counts.round()).abs() < 1e-6);
            assert!((seen.q[j] - 0.123_456).abs() <= 0.5001 * count);
        }
        let error = seen.tau - plant.tau;
        spread += error.component_mul(&error) / 4000.0;
    }
    for (j, joint) in robot.joints.iter().enumerate() {
        let share = spread[j].sqrt() / joint.limits.torque;
        assert!((share - 0.01).abs() < 1e-3, "joint {j}: {share}");
    }
}

fn with_effects<const N: usize>(robot: &Robot, rate_hz: f64, effects: PlantEffects) -> Plant<N> {
    let config = PlantConfig {
        effects,
        ..quiet(rate_hz)
    };
    Plant::new(robot, config, 1).expect("its size")
}

fn effects(effects: PlantEffects) -> Plant<6> {
    with_effects(&truth(), 8000.0, effects)
}

#[test]
fn stiff_gears_move_the_arm_as_rigid_ones_do_and_soft_ones_twist_by_the_load() {
    let twisted = |twist_mrad| {
        let elastic = PlantEffects {
            twist_mrad,
            twist_damping: 0.1,
            ..PlantEffects::default()
        };
        let mut plant = effects(elastic);
        plant.place(&Joints::repeat(0.4));
        let hold = plant.tau;
        for k in 0..500 {
            let wave = Joints::from_fn(|j, _| 10.0 * (f64::from(k) * 6e-3 + j as f64).sin());
            plant.advance(&(hold + wave), 1e-3);
        }
        plant
    };
    let (rigid, stiff, soft) = (twisted(0.0), twisted(1e-3), twisted(8.0));
    let apart = (rigid.q() - stiff.q()).amax();
    assert!(apart < 2e-4, "{apart}");
    let moved = (rigid.q() - soft.q()).amax();
    assert!(moved > 1e-4, "{moved}");
    let gear = soft.gear.as_ref().expect("elastic");
    let twist = (soft.q() - gear.q).component_mul(&gear.stiffness);
    // The damper carries the rest.
    let damped = (twist - gear.torque).amax();
    assert!(damped < 2.0, "{damped} N·m");
    assert!(soft.q().iter().chain(soft.qd()).all(|x| x.is_finite()));
}

#[test]
fn a_link_swings_on_its_gear_at_the_frequency_of_both_masses() {
    let mut robot = truth();
    robot.joints.truncate(1);
    without_friction(&mut robot.joints[0]);
    robot.joints[0].link.inertia_com *= 100.0;
    let effects = PlantEffects {
        twist_mrad: 8.0,
        ..PlantEffects::default()
    };
    let mut plant = with_effects::<1>(&robot, 32_000.0, effects);
    plant.qd[0] = 0.1;
    let (mut turns, mut before) = (Vec::new(), 0.0);
    for k in 0..1000 {
        plant.advance(&Joints::zeros(), 1e-3);
        let torque = plant.gear.as_ref().expect("elastic").torque[0];
        if before < 0.0 && torque >= 0.0 {
            turns.push(k);
        }
        before = torque;
    }
    let gear = plant.gear.as_ref().expect("elastic");
    let link = plant.model.mass_matrix(&gear.q)[(0, 0)] - gear.rotor[0];
    let expected = (gear.stiffness[0] * (1.0 / gear.rotor[0] + 1.0 / link)).sqrt() / TAU;
    let found = 1e3 * (turns.len() - 1) as f64 / f64::from(turns[turns.len() - 1] - turns[0]);
    let near = (found / expected - 1.0).abs() < 0.01;
    assert!(near, "{found} {expected} Hz");
}

#[test]
fn a_torque_loop_measures_behind_the_gear_and_carries_friction_and_rotor() {
    let behind = PlantEffects {
        twist_mrad: 5.0,
        twist_damping: 0.3,
        torque_loop_gain: 9.0,
        backlash_mrad: 0.2,
        ..PlantEffects::default()
    };
    let mut plant = effects(behind);
    let [q, qd, qdd] = [0.3, 1.0, 2.0].map(Joints::repeat);
    let motion = State { q, qd, qdd };
    let model = ReferenceModel::<6>::new(&truth()).expect("six joints");
    let rotors = truth().each(|joint| 2.0 * joint.drive.rotor_inertia);
    let rotors = Joints::from(rotors.expect("six joints"));
    let links = model.inverse_dynamics(&motion) - rotors;
    assert!((plant.true_torque(&motion) - links).amax() < 1e-9);
    // The commanded torque contains a tenth of friction and rotor.
    let commanded = effects(PlantEffects {
        reports_commanded_torque: true,
        ..behind
    });
    let open = effects(PlantEffects {
        torque_loop_gain: 0.0,
        ..behind
    });
    let tenth = (open.true_torque(&motion) - links) / 10.0;
    assert!((commanded.true_torque(&motion) - links - tenth).amax() < 1e-9);
    // At rest the sensor carries gravity, whatever the gear.
    plant.place(&Joints::repeat(0.3));
    let hold = plant.tau;
    for _ in 0..300 {
        plant.advance(&hold, 1e-3);
    }
    let error = plant.sensed() - hold;
    assert!(error.amax() < 0.1, "{error}");
}

#[test]
fn errors_of_current_sensors_are_torque_that_the_arm_lacks() {
    let wrong = PlantEffects {
        torque_offset: 0.02,
        torque_offset_drift: 0.01,
        drive_gain_spread: 0.08,
        ..PlantEffects::default()
    };
    let (mut plant, right) = (effects(wrong), effects(PlantEffects::default()));
    let rest = State::rest(Joints::repeat(0.4));
    let error = plant.true_torque(&rest) - right.true_torque(&rest);
    assert!(error.amax() > 0.3, "{error}");
    // What the errors ask for holds the arm.
    plant.place(&rest.q);
    for _ in 0..200 {
        let hold = plant.true_torque(&rest);
        plant.advance(&hold, 1e-3);
    }
    assert!((plant.q() - rest.q).amax() < 1e-4);
}

#[test]
fn reports_are_delayed_and_torque_lags_behind_the_position() {
    let late = PlantEffects {
        delay_ms: 3.0,
        torque_lag_ms: 5.0,
        ..PlantEffects::default()
    };
    let mut plant = effects(late);
    let mut sent = Vec::new();
    for k in 0..50 {
        plant.advance(&Joints::repeat(f64::from(k)), 1e-3);
        let measured = plant.measure();
        let report = plant.report(&measured).expect("none is lost");
        sent.push(measured);
        if k >= 8 {
            let k = k as usize;
            assert_eq!((report.q, report.tau), (sent[k - 3].q, sent[k - 8].tau));
        }
    }
    let jitter = PlantEffects {
        delay_jitter_ms: 4.0,
        sampling_jitter_ms: 0.5,
        ..PlantEffects::default()
    };
    let mut plant = effects(jitter);
    let (mut ages, mut newest) = ([0; 6], 0);
    let mut sent: Vec<Measurement<6>> = Vec::new();
    for k in 0..400 {
        plant.advance(&Joints::repeat(f64::from(k) * 0.1), 1e-3);
        sent.push(plant.measure());
        let report = plant.report(&sent[k as usize]).expect("none is lost");
        let place = sent.iter().rposition(|sent| sent.tau == report.tau);
        let place = place.expect("one that was sent");
        assert!(place >= newest, "reports never go back in time");
        newest = place;
        ages[k as usize - place] += 1;
    }
    assert!(ages[1] > 20 && ages[3] > 20 && ages[5] == 0, "{ages:?}");
}

#[test]
fn a_file_of_effects_is_checked() {
    let here = tempfile::tempdir().expect("is created");
    let file = here.path().join("effects.toml");
    for (text, outcome) in [
        ("twist_mrad = 5\nbacklash_mrad = 0.2", ""),
        ("backlash_mrad = 0.2", "need twist_mrad"),
        ("delay_ms = -1", "not negative"),
        ("warm_viscous_fall = 0.3", "needs warm_up_s"),
        ("stiffness = 1", "unknown field"),
    ] {
        std::fs::write(&file, text).expect("is written");
        let message = PlantEffects::load(&file).err().map(|e| e.to_string());
        let message = message.unwrap_or_default();
        assert_eq!(message.is_empty(), outcome.is_empty(), "{message}");
        assert!(message.contains(outcome), "{message}");
    }
}

fn with(events: Events<6>) -> Plant<6> {
    let plant = Plant::new(&truth(), PlantConfig::default(), 1).expect("six joints");
    plant.with_events(events)
}

#[test]
fn a_payload_loads_the_joints_only_while_it_is_held() {
    let body = Payload::cube(3.0, [0.02, -0.01, 0.05], 0.010, 0.020);
    let mut plant = with(Events {
        payloads: vec![body],
        pushes: Vec::new(),
    });
    let still = State::rest(Joints::<6>::zeros());
    let before = plant.true_torque(&still);
    let mut loads = Vec::new();
    for _ in 0..30 {
        plant.advance(&before, 1e-3);
        loads.push((plant.carried().is_some(), plant.true_torque(&still)));
    }
    for (tick, (carried, torque)) in loads.iter().enumerate() {
        // The payload is looked at when a step begins: after tick 10 its first step has run.
        assert_eq!(*carried, (10..20).contains(&tick), "tick {tick}");
        if *carried {
            // Stretched out, the shoulder carries a lever of 0.82 m and more.
            assert!((torque[1] - before[1]).abs() > 3.0 * 9.81 * 0.75);
        } else {
            assert!((torque - before).amax() < 1e-9);
        }
    }
}

#[test]
fn a_push_moves_the_arm_but_not_the_torque_of_a_motion() {
    let mut torque = Joints::zeros();
    torque[0] = 40.0;
    let push = Push {
        torque,
        from_s: 0.05,
        to_s: 0.15,
    };
    let events = Events {
        payloads: Vec::new(),
        pushes: vec![push],
    };
    assert_eq!(events.push_at(0.04), Joints::<6>::zeros());
    let half_way_up = events.push_at(0.055)[0];
    assert!((half_way_up - 20.0).abs() < 1e-9, "{half_way_up}");
    assert_eq!(events.push_at(0.1), torque);
    let (mut pushed, mut left) = (with(events), with(Events::default()));
    let hold = left.true_torque(&State::rest(Joints::zeros()));
    for _ in 0..150 {
        pushed.advance(&hold, 1e-3);
        left.advance(&hold, 1e-3);
    }
    assert!((pushed.q() - left.q())[0] > 0.01);
    let [q, qd, qdd] = [0.3, 1.0, 2.0].map(Joints::repeat);
    let motion = State { q, qd, qdd };
    assert_eq!(pushed.true_torque(&motion), left.true_torque(&motion));
}

#[test]
fn an_arm_that_is_put_down_rests_on_its_gears() {
    let mut config = quiet(4000.0);
    (config.effects.twist_mrad, config.effects.backlash_mrad) = (1.0, 1.0);
    let mut plant = Plant::<6>::new(&truth(), config, 1).expect("six joints");
    let q = Joints::from([0.3, -0.8, 0.9, -0.4, 1.1, 0.2]);
    plant.place(&q);
    let weight = plant.model.gravity_torques(&q);
    plant.advance(&weight, 1e-3);
    let carried = plant.gear.as_ref().expect("elastic").torque;
    let heavy = weight.iamax();
    assert!(
        (carried[heavy] / weight[heavy] - 1.0).abs() < 0.1,
        "{carried} {weight}"
    );
}
