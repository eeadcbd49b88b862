use super::*;
use foretorque::arm::Arm;
use foretorque::arm::ur5::Ur5;
use foretorque::dynamics::{FRICTION_COLUMNS, FrictionColumn, FrictionParameters};
use foretorque::feedforward::FeedForwardConfig;
use foretorque::learning::ParameterSet;
use proptest::prelude::*;
use std::vec::Vec as List;

const N: usize = 6;
const P: usize = 40;

fn nominal() -> ParameterBank {
    ParameterBank::nominal::<Ur5, N, P>()
}

fn bytes(bank: &ParameterBank) -> List<u8> {
    let mut buffer = [0; ParameterBank::MAX_BYTES];
    bank.encode(&mut buffer).unwrap().to_vec()
}

fn verdict(change: impl FnOnce(&mut ParameterBank)) -> Option<BankError> {
    let mut bank = nominal();
    change(&mut bank);
    bank.parameters::<Ur5, N, P>().err()
}

#[test]
fn a_bank_of_finite_nonsense_is_refused_with_the_joint() {
    for place in 0..P + FRICTION_COLUMNS * N {
        for value in [1e30, -1e30, 3e4, f32::MAX] {
            let refused = verdict(|bank| bank.columns[place].value = value);
            let implausible = matches!(refused, Some(BankError::Implausible(_)));
            assert!(implausible, "column {place} of {value}: {refused:?}");
        }
    }
    let moment = verdict(|bank| bank.columns[1].value = 1e30);
    assert_eq!(moment, Some(BankError::Implausible(1)));
    let scaled = |factor: f32| {
        verdict(|bank| {
            let rigid = bank.columns.iter_mut().take(P);
            rigid.for_each(|column| column.value *= factor);
        })
    };
    for (factor, usable) in [
        (-3.0, false),
        (0.5, true),
        (1.0, true),
        (1.3, true),
        (8.0, false),
    ] {
        assert_eq!(scaled(factor).is_none(), usable, "masses times {factor}");
    }
}

#[test]
fn columns_are_links_then_rotors_then_friction() {
    let names: List<_> = nominal().columns.iter().map(|c| c.id.to_string()).collect();
    assert_eq!(names.len(), P + FRICTION_COLUMNS * N);
    let front = [
        "Izz1", "mx2", "my2", "Ixx2", "Izz2", "Ixy2", "Ixz2", "Iyz2", "mx3",
    ];
    assert_eq!(names[..9], front);
    assert_eq!(names[36..40], ["Ia3", "Ia4", "Ia5", "Ia6"]);
    let friction = (1..=N).flat_map(|joint| {
        FrictionColumn::ALL.map(|column| format!("{}{joint}", column.properties().symbol))
    });
    assert!(friction.eq(names[40..].iter().cloned()));
}

#[test]
fn the_nominal_bank_is_the_nominal_set_with_the_arms_limits() {
    let bank = nominal();
    let set = bank.set::<Ur5, N, P>().unwrap();
    assert_eq!(set, ParameterSet::nominal::<Ur5>(NETWORK_SEED));
    assert_eq!(set.rigid.as_slice(), Ur5::NOMINAL);
    assert!(bank.columns.iter().all(|column| column.deviation > 0.0));
    let config = bank.feed_forward_config::<Ur5, N, P>(1e-3).unwrap();
    let wanted = FeedForwardConfig::for_arm::<Ur5, P>(1e-3);
    assert_eq!(config.limits, wanted.limits);
    for (slew, wanted) in config.slew_per_tick.iter().zip(wanted.slew_per_tick) {
        // N·m/s times s against N·m a tick: one rounding apart.
        assert!((slew - wanted).abs() <= 2.0 * f32::EPSILON * wanted);
    }
}

#[test]
fn every_set_survives_the_bank_in_any_order_of_columns() {
    let mut set = ParameterSet::<N, P>::nominal::<Ur5>(3);
    for (k, value) in set.rigid.iter_mut().enumerate() {
        *value = k as f32 - 7.25;
    }
    for (j, friction) in set.friction.iter_mut().enumerate() {
        for (k, value) in friction.0.iter_mut().enumerate() {
            *value = 10.0 * k as f32 - 0.5 * j as f32;
        }
        set.network[j].output_bias[0] = 0.01 * j as f32;
        set.network[j].hidden_weights[(5, 1)] = j as f32;
    }
    let mut bank = ParameterBank::from_set::<Ur5, N, P>(&set);
    assert_eq!(bank.set::<Ur5, N, P>(), Ok(set));
    bank.columns.reverse();
    let again = ParameterBank::decode(&bytes(&bank)).unwrap();
    assert_eq!(again, bank);
    assert_eq!(again.set::<Ur5, N, P>(), Ok(set));
}

#[test]
fn missing_friction_columns_are_zero_and_can_be_learnt() {
    let mut set = ParameterSet::<N, P>::nominal::<Ur5>(3);
    for friction in &mut set.friction {
        *friction = FrictionParameters([1.0; FRICTION_COLUMNS]);
    }
    let mut bank = ParameterBank::from_set::<Ur5, N, P>(&set);
    let new = [
        FrictionColumn::Load,
        FrictionColumn::Offset,
        FrictionColumn::CoggingSine,
        FrictionColumn::CoggingCosine,
    ];
    let kinds = new.map(ColumnKind::friction);
    bank.columns
        .retain(|column| !kinds.contains(&column.id.kind));
    let set = bank.set::<Ur5, N, P>().unwrap();
    for friction in set.friction {
        for column in FrictionColumn::ALL {
            let wanted = if new.contains(&column) { 0.0 } else { 1.0 };
            assert_eq!(friction[column], wanted, "{column:?}");
        }
    }
    // Values learnt in them are kept.
    let mut learnt = set;
    learnt.friction[2][FrictionColumn::CoggingSine] = 0.4;
    bank.refresh::<Ur5, N, P>(&learnt);
    assert_eq!(bank.columns.len(), P + FRICTION_COLUMNS * N);
    assert_eq!(bank.set::<Ur5, N, P>(), Ok(learnt));
}

#[test]
fn a_bank_that_does_not_fit_is_refused_with_the_place() {
    use BankError::*;
    type Change = fn(&mut ParameterBank);
    let refusals: [(Change, BankError); 18] = [
        (|b| b.arm_hash = !b.arm_hash, WrongArm { found: !Ur5::HASH }),
        (|b| b.columns[3].value = f32::NAN, Column(3)),
        (|b| b.columns[4].deviation = -1.0, Column(4)),
        (|b| b.columns[4].deviation = f32::INFINITY, Column(4)),
        (|b| _ = b.columns.remove(5), MissingColumn(5)),
        (
            |b| b.columns[6].id.kind = ColumnKind::try_from(0).unwrap(),
            UnknownColumn(6),
        ),
        (|b| b.columns[7].id = b.columns[1].id, UnknownColumn(7)),
        (|b| b.columns[41].id.joint = 6, UnknownColumn(41)),
        (|b| b.network.hidden = 7, NetworkShape),
        (
            |b| b.network.activation = ActivationKind::Tanh,
            NetworkShape,
        ),
        (|b| _ = b.weights.pop(), NetworkShape),
        (|b| b.weights[100] = f32::INFINITY, Weight(100)),
        (|b| b.drive_gains_nm_a[2] = -1.0, DriveGain(2)),
        (|b| b.drive_gains_nm_a[2] = f32::INFINITY, DriveGain(2)),
        (|b| _ = b.drive_gains_nm_a.pop(), DriveGain(5)),
        (|b| b.limits[1].torque_nm = 151.0, Limit(1)),
        (|b| b.limits[0].slew_nm_s = 0.0, Limit(0)),
        (|b| _ = b.limits.pop(), Limit(5)),
    ];
    for (change, error) in refusals {
        assert_eq!(verdict(change), Some(error));
    }
    let widest = nominal().limits[3].slew_nm_s;
    for (slew, error) in [
        (widest, None),
        (0.5 * widest, None),
        (widest.next_up(), Some(Limit(3))),
        (f32::INFINITY, Some(Limit(3))),
        (f32::NAN, Some(Limit(3))),
    ] {
        assert_eq!(verdict(|b| b.limits[3].slew_nm_s = slew), error);
    }
}

#[test]
fn the_largest_bank_fits_the_buffer() {
    let mut bank = nominal();
    let column = bank.columns[0];
    while bank.columns.push(column).is_ok() {}
    while bank.weights.push(1.0).is_ok() {}
    while bank.drive_gains_nm_a.push(1.0).is_ok() {}
    let bounds = bank.limits[0];
    while bank.limits.push(bounds).is_ok() {}
    while bank.arm.push('x').is_ok() {}
    assert_eq!(bytes(&bank).len(), ParameterBank::MAX_BYTES);
    assert_eq!(bank.encode(&mut [0; 100]), Err(BankError::TooLong));
}

#[test]
fn another_version_and_other_bytes_differ_in_error() {
    let mut foreign = bytes(&nominal());
    foreign[4] = 2;
    assert_eq!(ParameterBank::decode(&foreign), Err(BankError::Version(2)));
    assert_eq!(ParameterBank::decode(b"hello"), Err(BankError::NotABank));
    assert_eq!(ParameterBank::decode(&[]), Err(BankError::NotABank));
    assert_eq!(ParameterBank::decode(b"FTPB"), Err(BankError::NotABank));
    let mut sealed = b"FTPB\x01nothing of the kind".to_vec();
    let crc = crate::wire::CRC.checksum(&sealed);
    sealed.extend(crc.to_le_bytes());
    assert_eq!(ParameterBank::decode(&sealed), Err(BankError::Malformed));
}

proptest! {
    #[test]
    fn a_bank_cut_short_or_followed_by_more_is_refused(
        cut in any::<prop::sample::Index>(),
        more in prop::collection::vec(any::<u8>(), 1..50),
    ) {
        let good = bytes(&nominal());
        prop_assert!(ParameterBank::decode(&good[..cut.index(good.len())]).is_err());
        prop_assert!(ParameterBank::decode(&[good, more].concat()).is_err());
    }
}
